"""Directions as unit vectors and as spherical positions."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

ARCSEC_RAD: Final = np.pi / 648000.0


def unit_vectors(ra_rad: Array, dec_rad: Array) -> Array:
    """Unit vectors (..., 3) of spherical positions."""
    cos_dec = np.cos(dec_rad)
    return np.stack((cos_dec * np.cos(ra_rad), cos_dec * np.sin(ra_rad), np.sin(dec_rad)), axis=-1)


def spherical_deg(vectors: Array) -> tuple[Array, Array]:
    """Right ascension in [0, 360) and declination, deg, of vectors (..., 3)."""
    ra = np.degrees(np.arctan2(vectors[..., 1], vectors[..., 0])) % 360.0
    return ra, np.degrees(np.arctan2(vectors[..., 2], np.hypot(vectors[..., 0], vectors[..., 1])))
