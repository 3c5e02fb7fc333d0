"""Light far from a star: diffraction at the pupil's rim and at vanes, aureole, ghost; shares of a pixel of unit flux.

An aureole falls as r^-2 to r^-3 (King 1971, PASP 83, 199; Racine 1996, PASP 108, 699: scatter by micro-roughness and dust).
Outside an Airy pattern's core the mean brightness of rings is ``lambda F / (pi^3 r^3)`` (from 1 - E = 2 lambda F / (pi^2 r),
Born & Wolf, section 8.5.2). Vanes take their share of the pupil from the image and spread it (Babinet) into arms,
along which it falls as
``1 / (core^2 + x^2)`` in a wide band, core = lambda f / (pi width).
"""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class AureoleOptions:
    """Light scattered by roughness and dust: ``(1 + (r / core)^2)^(-slope / 2)``."""

    share: float = field(
        default=0.0, metadata={"doc": "share of a star's light that is scattered into the aureole", "min": 0.0, "max": 0.5}
    )
    core_px: float = field(default=3.0, metadata={"doc": "radius at which the power law begins", "min": 0.1, "max": 1000.0})
    slope: float = field(default=3.0, metadata={"doc": "power of the fall", "min": 2.1, "max": 4.0})


@dataclass(frozen=True, kw_only=True)
class SpiderOptions:
    """Vanes that hold a secondary mirror, evenly around the pupil."""

    vanes: int = field(
        default=0,
        metadata={"doc": "number of vanes; an even number has as many arms, an odd one twice as many", "min": 0, "max": 8},
    )
    width_mm: float = field(default=2.0, metadata={"doc": "width of a vane", "min": 0.01, "max": 100.0})
    angle_deg: float = field(default=20.0, metadata={"doc": "turn of the first vane against the rows", "min": 0.0, "max": 360.0})


@dataclass(frozen=True, kw_only=True)
class GhostOptions:
    """A star's light reflected twice between detector and window: a disc out of focus."""

    share: float = field(default=0.0, metadata={"doc": "share of a star's light in its ghost", "min": 0.0, "max": 0.1})
    diameter_px: float = field(default=90.0, metadata={"doc": "diameter of the disc", "min": 2.0, "max": 4000.0})
    magnification: float = field(
        default=1.02,
        metadata={
            "doc": "distance of the ghost from the axis over that of its star; negative: across the axis",
            "min": -5.0,
            "max": 5.0,
        },
    )


@dataclass(frozen=True, kw_only=True)
class Halo:
    """Everything of a star outside its core, in pixels of the detector.

    aureole_share, aureole_core_px, slope : of the aureole. rim_px : ``lambda F / pi^3`` of diffraction. arms : (n, 2) unit
    vectors (row, col). arm_share : of each arm. arm_core_px : along it; arm_sigma_px : across.
    """

    aureole_share: float
    aureole_core_px: float
    slope: float
    rim_px: float
    arms: Array
    arm_share: float
    arm_core_px: float
    arm_sigma_px: float
    ghost: GhostOptions

    @property
    def core_share(self) -> float:
        """What is left for the core."""
        return 1.0 - self.aureole_share - self.ghost.share - 2.0 * self.arm_share * len(self.arms)

    def aureole(self, r_px: Array) -> Array:
        """Aureole alone, per pixel of unit flux."""
        peak = self.aureole_share * (self.slope - 2.0) / (2.0 * math.pi * self.aureole_core_px**2)
        return np.asarray(peak * (1.0 + (r_px / self.aureole_core_px) ** 2) ** (-0.5 * self.slope))

    def ring(self, r_px: Array) -> Array:
        """Aureole and diffraction at the rim, far from the core."""
        return np.asarray(self.aureole(r_px) + self.core_share * self.rim_px / np.maximum(r_px, 1e-3) ** 3)

    def spikes(self, row_px: Array, col_px: Array) -> Array:
        """Light of all arms at offsets that broadcast against each other."""
        out = np.zeros(np.broadcast_shapes(np.shape(row_px), np.shape(col_px)))
        width = math.sqrt(2.0 * math.pi) * self.arm_sigma_px
        for d_row, d_col in self.arms:
            along = row_px * d_row + col_px * d_col
            across = row_px * d_col - col_px * d_row
            line = self.arm_share * 2.0 / math.pi * self.arm_core_px / (self.arm_core_px**2 + along**2)
            out += np.where(along >= 0.0, line, 0.0) * np.exp(-0.5 * (across / self.arm_sigma_px) ** 2) / width
        return out


def make_halo(
    aureole: AureoleOptions,
    spider: SpiderOptions,
    ghost: GhostOptions,
    *,
    wavelength_nm: float,
    aperture_m: float,
    obstruction: float,
    focal_px: float,
    sigma_px: float,
    diffracts: bool,
) -> Halo:
    """The halo of a camera. diffracts : whether the core is that of a wavefront, whose rings go on outside its table."""
    f_lambda_px = 1e-9 * wavelength_nm / aperture_m * focal_px
    rim = f_lambda_px / math.pi**3 / (1.0 - obstruction) if diffracts else 0.0
    angles = np.radians(spider.angle_deg) + np.arange(spider.vanes) * 2.0 * math.pi / max(spider.vanes, 1)
    # A vane at an angle has an arm to either side, at right angles to it; the arms of opposite vanes coincide.
    turned = np.concatenate([angles + 0.5 * math.pi, angles - 0.5 * math.pi])
    arms = np.stack([np.sin(turned), np.cos(turned)], axis=-1)
    length_m = 0.5 * aperture_m * (1.0 - obstruction)
    area_m2 = 0.25 * math.pi * aperture_m**2 * (1.0 - obstruction**2)
    share = spider.vanes * 1e-3 * spider.width_mm * length_m / area_m2
    return Halo(
        aureole_share=aureole.share,
        aureole_core_px=aureole.core_px,
        slope=aureole.slope,
        rim_px=rim,
        arms=arms,
        arm_share=share / max(len(arms), 1),
        arm_core_px=1e-9 * wavelength_nm / (math.pi * 1e-3 * spider.width_mm) * focal_px,
        arm_sigma_px=math.hypot(sigma_px, 0.4 * 1e-9 * wavelength_nm / max(length_m, 1e-6) * focal_px),
        ghost=ghost,
    )
