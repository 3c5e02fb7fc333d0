"""Laser ranges of normal points: stations in Earth-fixed axes and the delay of the troposphere."""

from collections.abc import Mapping
from typing import Final

import erfa
import numpy as np
from numpy.typing import NDArray

from ground.determination.measurements import Ranges
from ground.determination.precise import NormalPoints
from ground.determination.propagation import itrs_to_gcrs
from sboc_e2e.icd.errors import UserError

Array = NDArray[np.float64]

_MAPPING: Final = (
    (12100.8e-7, 1729.5e-9, 319.1e-7, -1847.8e-11),
    (30496.5e-7, 234.6e-8, -103.5e-6, -185.6e-10),
    (6877.7e-5, 197.2e-7, -345.8e-5, 106.0e-9),
)
"""FCULa: Mendes et al. 2002, Geophys. Res. Lett. 29, 1414: constant, per deg C, per cosine of latitude, per metre of height."""


def zenith_delay_m(
    pressure_hpa: Array, vapour_hpa: Array, wavelength_um: Array, latitude_rad: Array, height_m: Array
) -> Array:  # fmt: skip
    """One-way delay at zenith (n,) m: Mendes & Pavlis 2004, Geophys. Res. Lett. 31, L14602 (IERS Conventions 2010, 9.1)."""
    s2 = 1.0 / wavelength_um**2
    dry = 1e-2 * (19990.975 * (238.0185 + s2) / (238.0185 - s2) ** 2 + 579.55174 * (57.362 + s2) / (57.362 - s2) ** 2)
    dry *= 1.0 + 0.534e-6 * (375.0 - 450.0)
    wet = 0.003101 * (295.235 + 3.0 * 2.6422 * s2 - 5.0 * 0.032380 * s2**2 + 7.0 * 0.004028 * s2**3)
    gravity = 1.0 - 0.00266 * np.cos(2.0 * latitude_rad) - 0.00000028 * height_m
    hydrostatic = 0.002416579 * dry / gravity * pressure_hpa
    return np.asarray(hydrostatic + 1e-4 * (5.316 * wet - 3.759 * dry) * vapour_hpa / gravity)


def mapping(elevation_rad: Array, temperature_k: Array, latitude_rad: Array, height_m: Array) -> Array:
    """Delay at an elevation over that at zenith (n,)."""
    a = [c[0] + c[1] * (temperature_k - 273.15) + c[2] * np.cos(latitude_rad) + c[3] * height_m for c in _MAPPING]
    sine = np.sin(elevation_rad)
    return np.asarray((1.0 + a[0] / (1.0 + a[1] / (1.0 + a[2]))) / (sine + a[0] / (sine + a[1] / (sine + a[2]))))


def vapour_pressure_hpa(temperature_k: Array, humidity_percent: Array) -> Array:
    """Partial pressure of water (n,): Magnus' formula over water (Alduchov & Eskridge 1996)."""
    celsius = temperature_k - 273.15
    return np.asarray(0.01 * humidity_percent * 6.1094 * np.exp(17.625 * celsius / (celsius + 243.04)))


def laser_ranges(
    points: NormalPoints,
    stations: Mapping[int, tuple[float, float, float]],
    positions_gcrs_km: Array,
    *,
    centre_km: float,
    sigma_km: float,
) -> Ranges:
    """Ranges to the centre of mass, the air's delay removed.

    stations : pad number to place in Earth-fixed axes (ITRF) of the date, km. positions_gcrs_km : (n, 3) of the object, roughly.
    centre_km : from the reflectors' effective surface to the centre of mass. UserError for a station that is not listed.
    """
    missing = sorted({int(s) for s in points.station} - set(stations))
    if missing:
        raise UserError(f"normal points: stations {', '.join(map(str, missing))}: coordinates are not given")
    where = np.array([stations[int(s)] for s in points.station])
    longitude, latitude, height = erfa.gc2gd(1, 1e3 * where)
    height_m = np.asarray(height)
    turn = itrs_to_gcrs(points.t_tai_ns)
    there = np.einsum("nij,nj->ni", turn, where)
    up = np.column_stack([np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)])
    line = positions_gcrs_km - there
    sine = (line * np.einsum("nij,nj->ni", turn, up)).sum(axis=1) / np.linalg.norm(line, axis=1)
    if float(sine.min()) < np.sin(np.radians(2.0)):
        raise UserError("normal points: the object was below 2 degrees; the start orbit or the stations are wrong")
    vapour = vapour_pressure_hpa(points.temperature_k, points.humidity_percent)
    delay_m = zenith_delay_m(points.pressure_hpa, vapour, points.wavelength_um, latitude, height_m)
    delay_m = delay_m * mapping(np.arcsin(sine), points.temperature_k, latitude, height_m)
    return Ranges(
        t_tai_ns=points.t_tai_ns,
        station_km=there,
        range_km=points.range_km - 1e-3 * delay_m + centre_km,
        sigma_km=np.full(len(sine), sigma_km),
    )
