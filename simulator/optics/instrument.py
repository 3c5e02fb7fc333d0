"""The instrument: aperture, focal plane geometry, throughput; and how far the built one departs from the nominal one."""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd.errors import UserError
from simulator.optics.far_scatter import FarScatterOptions
from simulator.optics.passband import (
    LONGEST_NM,
    SHORTEST_NM,
    CurvePointOptions,
    Passband,
    colour_factor,
    refuse_disorder,
    sun_electrons_m2_s,
)
from simulator.optics.projection import Distortion, Projection, without_sip
from simulator.optics.sip import Sip

SIP_RADIUS = 1.25
"""A SIP polynomial holds this far from the axis, in half diagonals of the detector; beyond it nothing is imaged."""


@dataclass(frozen=True, kw_only=True)
class SipTermOptions:
    """One term ``coefficient (col - axis)^col_power (row - axis)^row_power`` of a SIP polynomial, pixels of the detector."""

    col_power: int = field(default=2, metadata={"doc": "power of the column offset", "min": 0, "max": 9})
    row_power: int = field(default=0, metadata={"doc": "power of the row offset", "min": 0, "max": 9})
    coefficient: float = field(default=0.0, metadata={"doc": "in px to 1 minus the sum of powers", "min": -1e-2, "max": 1e-2})


@dataclass(frozen=True, kw_only=True)
class DistortionOptions:
    """Brown-Conrady coefficients, for tangents (radians) as coordinates; and, behind them, a forward SIP polynomial."""

    k1: float = field(default=-1.0, metadata={"doc": "radial, third order", "min": -50.0, "max": 50.0})
    k2: float = field(default=0.0, metadata={"doc": "radial, fifth order", "min": -5e3, "max": 5e3})
    p1: float = field(default=2e-5, metadata={"doc": "tangential, along rows", "min": -0.1, "max": 0.1})
    p2: float = field(default=-1e-5, metadata={"doc": "tangential, along cols", "min": -0.1, "max": 0.1})
    sip_a: tuple[SipTermOptions, ...] = field(default=(), metadata={"doc": "SIP terms A of the columns"})
    sip_b: tuple[SipTermOptions, ...] = field(default=(), metadata={"doc": "SIP terms B of the rows"})


@dataclass(frozen=True, kw_only=True)
class AsBuiltOptions:
    """How the built camera departs from the nominal one that on-board and ground software know."""

    focal_length_ppm: float = field(
        default=150.0, metadata={"doc": "relative error of the focal length", "min": -2e4, "max": 2e4}
    )
    focal_drift_ppm_s: float = field(
        default=0.0,
        metadata={
            "doc": "relative growth of the focal length from the epoch on, as a tube that warms has it (aluminium: 23 ppm/K)",
            "min": -1e3,
            "max": 1e3,
        },
    )
    center_row_px: float = field(
        default=1.8, metadata={"doc": "shift of the optical axis along rows", "min": -200.0, "max": 200.0}
    )
    center_col_px: float = field(
        default=-1.3, metadata={"doc": "shift of the optical axis along cols", "min": -200.0, "max": 200.0}
    )
    distortion: float = field(default=0.02, metadata={"doc": "relative error of k1, k2 and SIP", "min": -1.0, "max": 1.0})
    zero_point_mag: float = field(default=0.04, metadata={"doc": "the built camera is brighter by this", "min": -2.0, "max": 2.0})
    colour_term: float = field(
        default=0.0,
        metadata={"doc": "mag of V for 1 mag of B-V by which the camera file's colour term is off", "min": -1.0, "max": 1.0},
    )
    drawn: bool = field(
        default=False,
        metadata={"doc": "drawn by the seed, normal with these values (and those of gains and seeing) as sigmas"},
    )
    psf_width: float = field(default=0.02, metadata={"doc": "relative error of the PSF width", "min": -0.5, "max": 0.5})


@dataclass(frozen=True, kw_only=True)
class InstrumentOptions:
    """Nominal instrument. The defaults are the ASSUMED SBOC-like one: its real numbers are unpublished."""

    name: str = field(default="sboc_like", metadata={"doc": "name of the camera"})
    aperture_m: float = field(default=0.20, metadata={"doc": "diameter of the entrance pupil", "min": 1e-3, "max": 20.0})
    obstruction: float = field(default=0.0, metadata={"doc": "central obstruction, of the diameter", "min": 0.0, "max": 0.9})
    focal_length_mm: float = field(default=400.0, metadata={"doc": "effective focal length", "min": 1.0, "max": 1e5})
    pixel_um: float = field(default=9.0, metadata={"doc": "pitch of detector pixels", "min": 0.5, "max": 500.0})
    rows: int = field(default=4096, metadata={"doc": "detector rows", "min": 16, "max": 16384})
    cols: int = field(default=4096, metadata={"doc": "detector columns", "min": 16, "max": 16384})
    throughput: float = field(default=0.8, metadata={"doc": "share of the light that the optics pass", "min": 1e-4, "max": 1.0})
    throughput_curve: tuple[CurvePointOptions, ...] = field(
        default=(), metadata={"doc": "factor on it by wavelength, linear between points"}
    )
    quantum_efficiency: float = field(
        default=0.625, metadata={"doc": "electrons for each photon on the detector", "min": 1e-4, "max": 1.0}
    )
    quantum_efficiency_curve: tuple[CurvePointOptions, ...] = field(
        default=(), metadata={"doc": "factor on it by wavelength, linear between points"}
    )
    band_short_nm: float = field(default=420.0, metadata={"doc": "short edge of the band", "min": SHORTEST_NM, "max": 3900.0})
    band_long_nm: float = field(default=850.0, metadata={"doc": "long edge of the band", "min": 285.0, "max": LONGEST_NM})
    stray_light_e_px_s: float = field(default=0.0, metadata={"doc": "stray light at the centre", "min": 0.0, "max": 1e5})
    stray_gradient: float = field(
        default=0.0, metadata={"doc": "relative change of stray light across the columns", "min": -2.0, "max": 2.0}
    )
    scatter: FarScatterOptions = field(
        default_factory=FarScatterOptions, metadata={"doc": "veil of bright bodies outside the field"}
    )
    distortion: DistortionOptions = field(default_factory=DistortionOptions, metadata={"doc": "distortion"})
    as_built: AsBuiltOptions = field(default_factory=AsBuiltOptions, metadata={"doc": "departure of the built camera"})

    def __post_init__(self) -> None:
        if self.band_long_nm <= self.band_short_nm:
            raise UserError(
                f"instrument.band_long: {self.band_long_nm} nm must be longer than band_short, {self.band_short_nm} nm"
            )
        refuse_disorder("instrument.throughput_curve", self.throughput_curve)
        refuse_disorder("instrument.quantum_efficiency_curve", self.quantum_efficiency_curve)
        self.sip()

    @property
    def focal_px(self) -> float:
        """Nominal focal length in detector pixels."""
        return self.focal_length_mm * 1e3 / self.pixel_um

    @property
    def area_m2(self) -> float:
        """Collecting area."""
        return 0.25 * np.pi * self.aperture_m**2 * (1.0 - self.obstruction**2)

    @property
    def passband(self) -> Passband:
        """Electrons for each photon of the entrance pupil, by wavelength."""
        return Passband(
            short_nm=self.band_short_nm,
            long_nm=self.band_long_nm,
            peak=self.throughput * self.quantum_efficiency,
            curves=(self.throughput_curve, self.quantum_efficiency_curve),
        )

    @property
    def zero_point_e_s(self) -> float:
        """Nominal electrons per second of V = 0 and solar colour, on axis."""
        return sun_electrons_m2_s(self.passband) * self.area_m2

    def colour_factor(self, b_v: NDArray[np.float64], giant: NDArray[np.bool_] | None = None) -> NDArray[np.float64]:
        """Electrons of stars of a colour B-V, giants or dwarfs, over those of the Sun's colour and the same V."""
        return colour_factor(b_v, self.passband, giant)

    def sip(self, factor: float = 1.0) -> Sip | None:
        """The SIP polynomial with all terms times a factor; None without terms.

        UserError for powers that SIP does not have, and for a polynomial that folds the field.
        """
        if not self.distortion.sip_a and not self.distortion.sip_b:
            return None
        terms = [
            tuple((t.col_power, t.row_power, factor * t.coefficient) for t in side)
            for side in (self.distortion.sip_a, self.distortion.sip_b)
        ]
        made = Sip(a=terms[0], b=terms[1], radius_px=SIP_RADIUS * 0.5 * float(np.hypot(self.rows, self.cols)))
        made.refuse_folding("instrument.distortion.sip")
        return made

    def known_projection(self) -> Projection:
        """What ground and on-board software know of the nominal geometry: no SIP, but its best fit in the terms they have."""
        nominal = self.nominal_projection()
        return nominal if nominal.sip is None else without_sip(nominal, self.rows, self.cols)

    def nominal_projection(self) -> Projection:
        """Geometry of the nominal instrument, in detector pixels."""
        bent = self.distortion
        return Projection(
            focal_px=self.focal_px,
            center_row=0.5 * (self.rows - 1),
            center_col=0.5 * (self.cols - 1),
            distortion=Distortion(k1=bent.k1, k2=bent.k2, p1=bent.p1, p2=bent.p2),
            sip=self.sip(),
        )

    def true_projection(self) -> Projection:
        """Geometry of the built camera, in detector pixels."""
        nominal, built = self.nominal_projection(), self.as_built
        bent = nominal.distortion
        return Projection(
            focal_px=nominal.focal_px * (1.0 + 1e-6 * built.focal_length_ppm),
            center_row=nominal.center_row + built.center_row_px,
            center_col=nominal.center_col + built.center_col_px,
            distortion=replace(bent, k1=bent.k1 * (1.0 + built.distortion), k2=bent.k2 * (1.0 + built.distortion)),
            sip=self.sip(1.0 + built.distortion),
        )

    @property
    def true_zero_point_e_s(self) -> float:
        """Electrons per second of V = 0 and solar colour that the built camera gives on axis."""
        return self.zero_point_e_s * 10.0 ** (0.4 * self.as_built.zero_point_mag)
