"""Proper motion: straight, uniform motion in space without radial velocity and parallax.

With those two unknown the standard model of stellar motion (ESA SP-1200, vol. 1, eq. 1.5.3 ff.) reduces to
``u(t) = normalised(u0 + (t - t0) mu)`` with mu the proper-motion vector in the tangent plane at t0.
"""

import numpy as np
from numpy.typing import NDArray

MAS_PER_RAD = 180.0 * 3600e3 / np.pi


def propagate(
    ra_deg: NDArray[np.float64],
    dec_deg: NDArray[np.float64],
    pm_ra_mas_yr: NDArray[np.float64],
    pm_dec_mas_yr: NDArray[np.float64],
    years: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Right ascension, declination (deg) and proper motion (mas/yr, RA times cos dec) after `years` Julian years.

    All arrays (n,). Exact on the whole sphere, poles included.
    """
    ra, dec = np.radians(ra_deg), np.radians(dec_deg)
    sin_ra, cos_ra, sin_dec, cos_dec = np.sin(ra), np.cos(ra), np.sin(dec), np.cos(dec)
    pm_e, pm_n = pm_ra_mas_yr / MAS_PER_RAD, pm_dec_mas_yr / MAS_PER_RAD
    motion = np.stack((-sin_ra * pm_e - cos_ra * sin_dec * pm_n, cos_ra * pm_e - sin_ra * sin_dec * pm_n, cos_dec * pm_n))
    vector = np.stack((cos_ra * cos_dec, sin_ra * cos_dec, sin_dec)) + years * motion
    stretch = np.sqrt(np.sum(vector**2, axis=0))
    x, y, z = vector / stretch
    ra_new, in_plane = np.arctan2(y, x), np.hypot(x, y)
    # d/dt of the normalised vector, along the new local east and north
    east = (-np.sin(ra_new) * motion[0] + np.cos(ra_new) * motion[1]) / stretch
    north = (-z * (np.cos(ra_new) * motion[0] + np.sin(ra_new) * motion[1]) + in_plane * motion[2]) / stretch
    return np.degrees(ra_new) % 360.0, np.degrees(np.arctan2(z, in_plane)), east * MAS_PER_RAD, north * MAS_PER_RAD
