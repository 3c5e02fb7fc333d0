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
    block = (t_tai_ns - t_tai_ns[0]) // _ROTATION_STEP_NS
    for number in np.unique(block):
        here = np.flatnonzero(block == number)
        matrix = teme_to_gcrs(int(t_tai_ns[here[len(here) // 2]]))
        position[:, here] = position[:, here] @ matrix.T
        velocity[:, here] = velocity[:, here] @ matrix.T
    return position, velocity
