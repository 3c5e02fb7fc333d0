"""Directions in which objects of known orbits should have been seen."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import erfa
import numpy as np
from numpy.typing import NDArray

from ground.orbit.dynamics import LIGHT_KM_S
from sboc_e2e.icd import tai, validate

if TYPE_CHECKING:
    from scipy.interpolate import CubicHermiteSpline

Path = Callable[[NDArray[np.int64]], NDArray[np.float64]]
"""GCRS states (n, 6) km, km/s at TAI epochs (n,) ns."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PreciseOrbit:
    """States of an object whose orbit is known to metres (OEM or SP3 derived), GCRS axes, rising epochs.

    t_tai_ns : (n,) steps of a minute or less for low orbits. position_km, velocity_km_s : (n, 3).
    """

    name: str
    t_tai_ns: NDArray[np.int64]
    position_km: NDArray[np.float64]
    velocity_km_s: NDArray[np.float64]

    def __post_init__(self) -> None:
        object.__setattr__(self, "t_tai_ns", validate.array("precise_orbit.t_tai_ns", self.t_tai_ns, np.int64, (None,)))
        shape = (len(self.t_tai_ns), 3)
        for name in ("position_km", "velocity_km_s"):
            object.__setattr__(self, name, validate.finite_array(f"precise_orbit.{name}", getattr(self, name), shape))

    def states(self, t_tai_ns: NDArray[np.int64]) -> NDArray[np.float64]:
        """States (n, 6) by cubic Hermite interpolation (0.3 m at one-minute steps of a low orbit); NaN outside the table."""
        t_s = (np.asarray(t_tai_ns) - self.t_tai_ns[0]) * 1e-9
        return np.hstack([self._spline(t_s), self._spline(t_s, 1)])

    @cached_property
    def _spline(self) -> "CubicHermiteSpline":
        """Positions in seconds from the first epoch; made once, since an orbit is asked for each track of a session."""
        from scipy.interpolate import CubicHermiteSpline  # takes a fifth of a second, which runs without known orbits do not need

        t_s = (self.t_tai_ns - self.t_tai_ns[0]) * 1e-9
        return CubicHermiteSpline(t_s, self.position_km, self.velocity_km_s, extrapolate=False)


def seen_from(
    path: Path, t_tai_ns: NDArray[np.int64], observer_km: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Geometric directions (n, 3) of the places that light received at the epochs had left, and ranges (n,) km."""
    delay_s = np.zeros(len(t_tai_ns))
    relative = np.zeros((len(t_tai_ns), 3))
    for _ in range(3):
        relative = path(t_tai_ns - np.round(delay_s * 1e9).astype(np.int64))[:, :3] - observer_km
        delay_s = np.nan_to_num(np.linalg.norm(relative, axis=1) / LIGHT_KM_S)
    rho = np.linalg.norm(relative, axis=1)
    return relative / rho[:, None], rho


def teme_to_gcrs(t_tai_ns: int) -> NDArray[np.float64]:
    """Matrix (3, 3) from the frame of SGP4 (true equator, mean equinox) to GCRS axes.

    Vallado et al. (2006, AIAA 2006-6753): TOD = R3(-equation of the equinoxes) TEME; then IAU 2006/2000A backwards.
    """
    day, fraction = tai.to_jd_parts(t_tai_ns)
    tt = erfa.taitt(day, fraction)
    equinox = float(erfa.eqeq94(*tt))
    turn = np.array([[np.cos(equinox), -np.sin(equinox), 0.0], [np.sin(equinox), np.cos(equinox), 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(erfa.pnm06a(*tt).T @ turn)


def utc_jd(t_tai_ns: Sequence[int] | NDArray[np.int64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Two-part Julian dates of UTC (n,), (n,), as SGP4 takes them."""
    day, fraction = erfa.taiutc(*tai.jd_parts_of(np.asarray(t_tai_ns, dtype=np.int64)))
    return np.asarray(day), np.asarray(fraction)
