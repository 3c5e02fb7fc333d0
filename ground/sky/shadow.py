"""Where sunlight and sight of objects end: the shadow of the Earth, and the Earth before them."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from ground.sky.apparent import EARTH_RADIUS_KM

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

SUN_RADIUS_KM: Final = 695700.0
"""Nominal solar radius, IAU 2015 resolution B3."""


def sunlit(position_km: Array, sun_km: Array) -> Flags:
    """Whether objects (..., n, 3) are outside the Earth's penumbra (Montenbruck & Gill, Satellite Orbits, section 3.4.2)."""
    to_sun = sun_km - position_km
    sun_distance, radius = np.linalg.norm(to_sun, axis=-1), np.linalg.norm(position_km, axis=-1)
    with np.errstate(invalid="ignore"):
        sun_disc, earth_disc = np.arcsin(SUN_RADIUS_KM / sun_distance), np.arcsin(np.minimum(EARTH_RADIUS_KM / radius, 1.0))
        apart = np.arccos(np.clip(-np.sum(position_km * to_sun, axis=-1) / (radius * sun_distance), -1.0, 1.0))
        return np.asarray(apart >= sun_disc + earth_disc)


def before_the_earth(position_km: Array, observer_km: Array) -> Flags:
    """Whether a spherical Earth does not hide objects (n, 3) from observers (n, 3), whose lines of sight are straight."""
    line = position_km - observer_km
    length2 = np.maximum(np.sum(line * line, axis=-1), 1e-12)
    nearest = -np.sum(observer_km * line, axis=-1) / length2
    height = np.linalg.norm(observer_km + line * nearest[..., None], axis=-1)
    return np.asarray((nearest <= 0.0) | (nearest >= 1.0) | (height >= EARTH_RADIUS_KM))
