"""HEALPix pixels (NESTED order, Gorski et al. 2005, ApJ 622, 759) that a cone touches."""

from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from astropy import units as u
from numpy.typing import NDArray

if TYPE_CHECKING:
    from astropy_healpix import HEALPix

NSIDE = 64
"""Of the catalogue file: 49,152 pixels of 0.92 deg, 19 stars of V < 11 in each on average. Larger ones read more stars outside a
cone."""
N_PIXELS = 12 * NSIDE**2


def grid(nside: int) -> "HEALPix":
    """The grid of so many pixels a side, NESTED order."""
    from astropy_healpix import HEALPix  # takes a fifth of a second, which frames without directions do not need

    return HEALPix(nside=nside, order="nested")


def pixel_of(ra_deg: NDArray[np.float64], dec_deg: NDArray[np.float64]) -> NDArray[np.int64]:
    """Pixel number of each direction, shape (n,)."""
    return np.asarray(grid(NSIDE).lonlat_to_healpix(ra_deg * u.deg, dec_deg * u.deg), dtype=np.int64)


@cache
def _centres() -> NDArray[np.float64]:
    """Unit vectors of all pixel centres, shape (N_PIXELS, 3)."""
    lon, lat = grid(NSIDE).healpix_to_lonlat(np.arange(N_PIXELS))
    lon, lat = lon.to_value(u.rad), lat.to_value(u.rad)
    return np.stack((np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)), axis=1)


def _largest_pixel_radius_rad() -> float:
    """Largest distance from a pixel's centre to its corner: the pixel at z = 2/3 (Gorski et al., section 5)."""
    z, phi = 2.0 / 3.0, np.pi / (4.0 * NSIDE)
    z_corner = 1.0 - (1.0 - 1.0 / NSIDE) ** 2 / 3.0
    centre = np.array([np.sqrt(1.0 - z * z) * np.cos(phi), np.sqrt(1.0 - z * z) * np.sin(phi), z])
    corner = np.array([np.sqrt(1.0 - z_corner**2), 0.0, z_corner])
    return float(np.arctan2(np.linalg.norm(np.cross(centre, corner)), centre @ corner))


def pixels_in_cone(axis: NDArray[np.float64], radius_rad: float) -> NDArray[np.intp]:
    """Numbers of all pixels that may hold a direction within `radius_rad` of the unit vector `axis` (3,)."""
    reach = min(radius_rad + _largest_pixel_radius_rad(), np.pi)
    return np.flatnonzero(_centres() @ axis >= np.cos(reach))
