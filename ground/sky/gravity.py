"""Gravity's bend of a passage: the acceleration across the line of sight of what orbits beside an orbiting camera.

Seen from a camera in free fall at the place r from the Earth's centre, an object at the range d in the direction u is
accelerated by the difference of gravity. Across the line of sight and over the range, that is along the part of r/|r| across u:

    n^2 (R / d) [1 - (1 + 2 c d / R + d^2 / R^2)^(-3/2)],   n^2 = GM / R^3,  c = u . r / R

For near objects it is 3 n^2 c, whatever the range, for others it depends on the range alone. The range follows from the rate on
the sky and the speed across the line of sight, which is known to a factor of seven either way.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ground.sky.sphere import ARCSEC_RAD
from sboc_e2e.icd.frame import ObserverState

Array = NDArray[np.float64]

GM_M3_S2: Final = 3.986004418e14
"""Of the Earth (WGS 84)."""
SPEEDS_M_S: Final = np.geomspace(300.0, 15_000.0, 41)
"""Across the line of sight, evenly in the logarithm: two circular orbits at 700 km differ by 15 km/s at most."""
UNMODELLED: Final = 0.02
"""Of n^2, one sigma: other accelerations. The largest is that of the Earth's oblateness (J2 times some ten: 0.01)."""
FREE_FALL: Final = 0.5
"""Least speed of a camera in orbit, over that of a circular orbit at its place."""


class Bend(NamedTuple):
    """Acceleration in a direction across the line of sight, and its error, arcsec/s^2."""

    mean: float
    sigma: float


def bend_by_gravity(observer: ObserverState | None, sight: Array, side: Array, rate_arcsec_s: float) -> Bend | None:
    """Bend of a passage about the direction `sight` (3,) towards `side` (3,), unit vectors in GCRS axes.

    None without a camera in orbit.
    """
    if observer is None:
        return None
    place = np.asarray(observer.position_m)
    distance = float(np.linalg.norm(place))
    if not distance > 1e6 or float(np.linalg.norm(observer.velocity_m_s)) < FREE_FALL * np.sqrt(GM_M3_S2 / distance):
        return None
    up = place / distance
    cosine = float(up @ sight)
    range_over = SPEEDS_M_S / max(rate_arcsec_s * ARCSEC_RAD, 1e-9) / distance
    strength = (1.0 - (1.0 + 2.0 * cosine * range_over + range_over**2) ** -1.5) / range_over
    n2_arcsec = GM_M3_S2 / distance**3 / ARCSEC_RAD
    part = float((up - cosine * sight) @ side)
    sigma = float(np.hypot(strength.std() * part, UNMODELLED))
    return Bend(n2_arcsec * float(strength.mean()) * part, n2_arcsec * sigma)
