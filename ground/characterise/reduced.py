"""Magnitudes at a standard distance, and the phase function that several passes give."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from sboc_e2e.icd import validate
from sboc_e2e.icd.errors import UserError

Array = NDArray[np.float64]

STANDARD_KM: Final = 1000.0
"""The usual range of standard magnitudes of satellites."""
_MIRROR: Final = 0.375
"""Light of a mirror-like sphere over that of a Lambert sphere at full phase, both of the same size and albedo."""
_LEAST_SPAN_DEG: Final = 10.0
"""Passes over less phase angle cannot separate the two spheres; then the share is assumed. Chosen, not measured."""
_LEAST_ERROR_MAG: Final = 1e-4
"""No photometry is better; smaller errors are a mistake of the file, and would make weights of 1e8 and more."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Pass:
    """Light of an object in one passage: times (n,) s, rising; mag and its one sigma (n,); range (n,) km; phase angle (n,) deg.

    The samples are frames (a sequence of points) or bins along trails (streak light curves): only their times differ.
    """

    t_s: Array
    mag: Array
    mag_err: Array
    range_km: Array
    phase_deg: Array

    def __post_init__(self) -> None:
        n = len(self.t_s)
        for name in ("t_s", "mag", "mag_err", "range_km", "phase_deg"):
            object.__setattr__(self, name, validate.finite_array(f"light.{name}", getattr(self, name), (n,)))
        if n < 1 or (np.diff(self.t_s) < 0.0).any():
            raise UserError("light: a passage without magnitudes, or whose times fall")
        if (self.mag_err < _LEAST_ERROR_MAG).any() or (self.range_km <= 0.0).any():
            raise UserError(f"light: errors below {_LEAST_ERROR_MAG:g} mag, or ranges that are not above 0")
        if (self.phase_deg < 0.0).any() or (self.phase_deg > 180.0).any():
            raise UserError("light: phase angles are expected between 0 and 180 deg")

    @property
    def at_standard(self) -> Array:
        """Magnitudes (n,) at a range of `STANDARD_KM`; the Sun's distance is taken as one astronomical unit."""
        return np.asarray(self.mag - 5.0 * np.log10(self.range_km / STANDARD_KM))


@dataclass(frozen=True, kw_only=True)
class PhaseFunction:
    """A diffuse and a mirror-like sphere mixed (Hejduk 2011, AMOS).

    absolute_mag : of both at full phase and the standard range. mirror_share : of the mirror-like one, 0 to 1. fitted : False
    where the phases of the passes span too little; the share is then the one that was assumed.
    """

    absolute_mag: float
    mirror_share: float
    fitted: bool

    def at(self, phase_deg: Array) -> Array:
        """Magnitudes (n,) over the absolute one."""
        diffuse, mirror = _spheres(phase_deg)
        return np.asarray(-2.5 * np.log10((1.0 - self.mirror_share) * diffuse + self.mirror_share * mirror))


def _spheres(phase_deg: Array) -> tuple[Array, Array]:
    alpha = np.radians(np.minimum(phase_deg, 175.0))
    diffuse = (np.sin(alpha) + (np.pi - alpha) * np.cos(alpha)) / np.pi
    return diffuse, np.full(len(alpha), _MIRROR)


def phase_function(passes: Sequence[Pass], *, assumed_share: float = 0.25) -> PhaseFunction:
    """The phase function of an object's mean light; both spheres' light is not negative.

    Light is averaged over 1/8 of a passage, so that turning averages out and flashes of one sample count little.
    """
    phase, light = [], []
    for one in passes:
        for part in np.array_split(np.arange(len(one.t_s)), min(8, len(one.t_s))):
            phase.append(float(one.phase_deg[part].mean()))
            light.append(float(np.mean(10.0 ** (-0.4 * one.at_standard[part]))))
    alpha, flux = np.array(phase), np.array(light)
    diffuse, mirror = _spheres(alpha)
    if float(np.ptp(alpha)) >= _LEAST_SPAN_DEG:
        # relative errors are alike: turning, not noise, makes the scatter
        columns = np.column_stack([diffuse, mirror]) / flux[:, None]
        (one_share, other), _ = nnls(columns, np.ones(len(flux)))
        total = float(one_share + other)
        return PhaseFunction(absolute_mag=-2.5 * np.log10(total), mirror_share=float(other) / total, fitted=True)
    mixed = (1.0 - assumed_share) * diffuse + assumed_share * mirror
    return PhaseFunction(absolute_mag=-2.5 * float(np.log10(np.median(flux / mixed))), mirror_share=assumed_share, fitted=False)
