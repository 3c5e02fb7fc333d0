"""Directions as unit vectors and as spherical positions."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

ARCSEC_RAD: Final = np.pi / 648000.0


def cross(a: Array, b: Array) -> Array:
    """Cross products (..., 3): `numpy.cross`, which takes ten times as long to see what shapes it has."""
    return np.stack(
        (
            a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1],
            a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2],
            a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0],
        ),
        axis=-1,
    )


def unit_vectors(ra_rad: Array, dec_rad: Array) -> Array:
    """Unit vectors (..., 3) of spherical positions."""
    cos_dec = np.cos(dec_rad)
    return np.stack((cos_dec * np.cos(ra_rad), cos_dec * np.sin(ra_rad), np.sin(dec_rad)), axis=-1)


def spherical_deg(vectors: Array) -> tuple[Array, Array]:
    """Right ascension in [0, 360) and declination, deg, of vectors (..., 3)."""
    ra = np.degrees(np.arctan2(vectors[..., 1], vectors[..., 0])) % 360.0
    return ra, np.degrees(np.arctan2(vectors[..., 2], np.hypot(vectors[..., 0], vectors[..., 1])))


def east_north(unit: Array) -> tuple[Array, Array]:
    """Unit vectors (3,) east and north of a direction; at the poles towards +y and away from +x."""
    horizontal = float(np.hypot(unit[0], unit[1]))
    east = np.array([-unit[1], unit[0], 0.0]) / horizontal if horizontal > 1e-12 else np.array([0.0, 1.0, 0.0])
    return east, cross(unit, east)
