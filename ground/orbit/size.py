"""Size of a sunlit sphere from its magnitude and range."""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd.products import Tracklet

SUN_V_MAG = -26.76
"""Apparent V of the Sun at one astronomical unit (Willmer 2018, ApJS 236, 47)."""


def sun_direction(tai_ns: int) -> NDArray[np.float64]:
    """Unit vector (3,) to the Sun, mean equator and equinox of date, good to 0.01 deg (Astronomical Almanac, section C).

    Precession since J2000 (0.014 deg a year) is left in: the phase angle does not feel it.
    """
    days = tai_ns / 86_400e9 + 2436204.5 - 2451545.0
    anomaly = np.radians(357.528 + 0.9856003 * days)
    longitude = np.radians(280.460 + 0.9856474 * days + 1.915 * np.sin(anomaly) + 0.020 * np.sin(2.0 * anomaly))
    obliquity = np.radians(23.439 - 4e-7 * days)
    return np.array([np.cos(longitude), np.cos(obliquity) * np.sin(longitude), np.sin(obliquity) * np.sin(longitude)])


def lambert_phase(phase_rad: NDArray[np.float64] | float) -> NDArray[np.float64]:
    """Brightness of a Lambert sphere relative to a mirror-free disc: 2/(3 pi) ((pi - phi) cos phi + sin phi)."""
    phi = np.asarray(phase_rad, dtype=np.float64)
    return np.asarray(2.0 / (3.0 * np.pi) * ((np.pi - phi) * np.cos(phi) + np.sin(phi)))


_Z95: Final = 1.6449
"""95 % point of the normal distribution."""


def magnitude_draws(tracklet: Tracklet, normal: NDArray[np.float64]) -> NDArray[np.float64]:
    """Magnitudes (n,) of a tracklet's mean light for standard normal numbers (n,).

    Each side of the median has its own width, so that 5 % and 95 % of the draws lie beyond `mag_low` and `mag_high`: the mean of
    an object that may tumble more slowly than the arc lasts is not normal. Without these limits, `mag_err` on both sides.
    """
    error = tracklet.mag_err if math.isfinite(tracklet.mag_err) else 0.0
    bright, faint = ((tracklet.mag - tracklet.mag_low) / _Z95, (tracklet.mag_high - tracklet.mag) / _Z95)
    if not (math.isfinite(bright) and math.isfinite(faint)):
        bright = faint = error
    return np.asarray(tracklet.mag + normal * np.where(normal < 0.0, bright, faint))


def diameter_m(
    mag: NDArray[np.float64] | float,
    range_km: NDArray[np.float64] | float,
    albedo: NDArray[np.float64] | float,
    phase_rad: NDArray[np.float64] | float,
) -> NDArray[np.float64]:
    """Diameter (m) of a Lambert sphere: F / F_sun = albedo (d/2)^2 / rho^2 phase(phi)."""
    ratio = 10.0 ** (-0.4 * (mag - SUN_V_MAG))
    return np.asarray(2.0 * np.asarray(range_km) * 1e3 * np.sqrt(ratio / (albedo * lambert_phase(phase_rad))))


def log_size_density(size_m: float) -> float:
    """ln of d N(> d)-density, the number of objects per ln(size): 1.45 x 3.65e4 (d/10 cm)^-1.45 above 1 cm, steeper below.

    Sources: counts of ESA's MASTER-8 model above 10 cm, 1 cm and 1 mm. Below 0.1 mm and above 30 m nothing is expected.
    """
    if not 1e-4 < size_m < 30.0:
        return -1e4
    if size_m < 0.01:
        return float(np.log(2.10 * 1.04e6) - 2.10 * np.log(size_m / 0.01))
    return float(np.log(1.45 * 3.65e4) - 1.45 * np.log(size_m / 0.1))
