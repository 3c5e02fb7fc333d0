"""Aberration of light by the observer's velocity, from special relativity.

Parallax (below 0.8 arcsec for the nearest star, 0.01 arcsec for nearly all) and gravitational deflection (below 4.1 mas
farther than 90 deg from the Sun) are left out on purpose; so is the orbit of the Sun, which the catalogue already holds.
"""

import numpy as np
from numpy.typing import NDArray

from simulator.platform.earth import LIGHT_KM_S, earth_velocity_km_s
from simulator.scene.light import LightOptions

Array = NDArray[np.float64]


def aberrate(directions: Array, velocity_km_s: Array) -> Array:
    """Unit directions (..., 3) as an observer with the given velocity sees them.

    Urban & Seidelmann (2013), Explanatory Supplement, eq. 7.39. The inverse is the same with the velocity reversed in
    the moving frame, exact to second order in v/c (1e-8 rad at 30 km/s is below 0.01 mas after that reversal).
    """
    beta = np.asarray(velocity_km_s) / LIGHT_KM_S
    gamma_inverse = np.sqrt(1.0 - np.sum(beta * beta, axis=-1, keepdims=True))
    along = np.sum(directions * beta, axis=-1, keepdims=True)
    seen = gamma_inverse * directions + beta * (1.0 + along / (1.0 + gamma_inverse))
    return np.asarray(seen / (1.0 + along))


def observer_velocity_km_s(effects: LightOptions, tai_ns: int, geocentric_km_s: Array) -> Array:
    """Barycentric velocity (3,) of an observer with a geocentric one, as far as aberration is on."""
    velocity = np.zeros(3)
    if effects.annual_aberration:
        velocity = velocity + earth_velocity_km_s(tai_ns)
    if effects.orbital_aberration:
        velocity = velocity + geocentric_km_s
    return velocity
