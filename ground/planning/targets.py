"""Catalogue objects as targets: where each is, GCRS axes, and how large."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from sgp4.api import SatrecArray

from ground.orbit.catalogue_match import KnownObjects
from ground.orbit.reference import teme_to_gcrs, utc_jd

Array = NDArray[np.float64]

_ROTATION_STEP_NS = 6 * 3600 * 10**9
"""The frame of SGP4 turns against GCRS by precession and nutation alone: 0.07 arcsec in six hours."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Targets:
    """m objects. weight : (m,) weight of the knowledge of each in the goal. size_m : (m,) diameters."""

    known: KnownObjects
    weight: Array
    size_m: Array

    def __len__(self) -> int:
        return len(self.known.names)


def states_of(known: KnownObjects, t_tai_ns: NDArray[np.int64]) -> tuple[Array, Array]:
    """Positions (m, n, 3) km and velocities km/s at instants (n,); NaN where SGP4 gives none (decayed, out of its range)."""
    day, fraction = utc_jd(t_tai_ns)
    error, position, velocity = SatrecArray(list(known.satellites)).sgp4(day, fraction)
    bad = error != 0
    position[bad], velocity[bad] = np.nan, np.nan
    _turn(position, velocity, t_tai_ns)
    return position, velocity


def states_at(known: KnownObjects, target: NDArray[np.int64], t_tai_ns: NDArray[np.int64]) -> tuple[Array, Array]:
    """The same (k, 3), (k, 3) of targets (k,), each at its own instant (k,)."""
    day, fraction = utc_jd(t_tai_ns)
    position, velocity = np.empty((len(target), 3)), np.empty((len(target), 3))
    by_target = np.argsort(target, kind="stable")
    for mine in np.split(by_target, np.flatnonzero(np.diff(target[by_target])) + 1):
        if len(mine):
            error, where, how_fast = known.satellites[target[mine[0]]].sgp4_array(day[mine], fraction[mine])
            bad = (error != 0)[:, None]
            position[mine], velocity[mine] = np.where(bad, np.nan, where), np.where(bad, np.nan, how_fast)
    _turn(position[None], velocity[None], t_tai_ns)
    return position, velocity


def _turn(position: Array, velocity: Array, t_tai_ns: NDArray[np.int64]) -> None:
    """From SGP4's frame to GCRS axes, in place, (m, n, 3) at instants (n,)."""
    if not len(t_tai_ns):
        return
    first = t_tai_ns.min()
    block = (t_tai_ns - first) // _ROTATION_STEP_NS
    for number in np.unique(block):
        here = np.flatnonzero(block == number)
        matrix = teme_to_gcrs(int(first + (2 * number + 1) * _ROTATION_STEP_NS // 2))
        position[:, here] = position[:, here] @ matrix.T
        velocity[:, here] = velocity[:, here] @ matrix.T
