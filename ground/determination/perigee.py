"""Perigees of states, two bodies: how near the Earth an orbit comes, when, and how fast it turns there."""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ground.orbit.dynamics import EARTH_RADIUS_KM, MU_KM3_S2

Array = NDArray[np.float64]

_PARABOLIC: Final = 1e-9
"""Radius over semi-major axis below which an orbit counts as one of that size: closed forms of both kinds lose their digits."""


def perigees_of(states: Array) -> tuple[Array, Array, Array]:
    """Radii of perigee (n,) km of states (n, 6), seconds (n,) since the nearest passage, and periods (n,) s, infinite if unbound.

    Seconds are negative where the nearest passage, or the only one, is still to come.
    """
    r, radial, momentum2, inverse = _of_two_bodies(states)
    inverse = np.where(np.abs(inverse * r) < _PARABOLIC, _PARABOLIC / r, inverse)
    size, bound = np.abs(inverse), inverse > 0.0
    rate = np.sqrt(MU_KM3_S2 * size**3)
    # e sin E and e cos E of Kepler's equation; e sinh H and e cosh H of an unbound orbit's
    sine, cosine = radial * np.sqrt(size / MU_KM3_S2), 1.0 - r * inverse
    elliptic = np.arctan2(sine, cosine) - sine
    hyperbolic = sine - np.arctanh(np.where(bound, 0.0, sine) / np.where(bound, 1.0, cosine))
    since = np.where(bound, elliptic, hyperbolic) / rate
    return _radii(momentum2, inverse), since, np.where(bound, 2.0 * np.pi / rate, np.inf)


def perigee_radii_km(states: Array) -> Array:
    """Radii of perigee (n,) of states (n, 6)."""
    _, _, momentum2, inverse = _of_two_bodies(states)
    return _radii(momentum2, inverse)


def _of_two_bodies(states: Array) -> tuple[Array, Array, Array, Array]:
    """Radius, its product with the radial speed, squared angular momentum, and one over the semi-major axis, each (n,)."""
    place, velocity = states[:, :3], states[:, 3:]
    r2, v2 = np.einsum("ni,ni->n", place, place), np.einsum("ni,ni->n", velocity, velocity)
    radial = np.einsum("ni,ni->n", place, velocity)
    r = np.sqrt(r2)
    return r, radial, np.maximum(r2 * v2 - radial**2, 0.0), 2.0 / r - v2 / MU_KM3_S2


def _radii(momentum2: Array, inverse: Array) -> Array:
    e = np.sqrt(np.maximum(1.0 - momentum2 * inverse / MU_KM3_S2, 0.0))
    return np.asarray(momentum2 / (MU_KM3_S2 * (1.0 + e)))


def piece_ns(state: Array, per_orbit: int) -> int:
    """Time in which an orbit of a state (6,) turns at perigee by one part of a revolution."""
    return round(1e9 * 2.0 * math.pi / (per_orbit * _fastest_rad_s(state)))


def _fastest_rad_s(state: Array) -> float:
    """Angular speed at perigee of a state (6,), or at the Earth's surface if the perigee lies below it."""
    r, v = state[:3], state[3:]
    momentum = np.cross(r, v)
    e = float(np.linalg.norm(np.cross(v, momentum) / MU_KM3_S2 - r / np.linalg.norm(r)))
    perigee_km = max(float(momentum @ momentum) / (MU_KM3_S2 * (1.0 + e)), EARTH_RADIUS_KM)
    return math.sqrt(MU_KM3_S2 * (1.0 + e) / perigee_km**3)
