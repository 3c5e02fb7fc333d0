"""Azimuth, elevation and two-way ranges of an antenna as measurements: station axes, refraction and delay of radio waves."""

from dataclasses import dataclass
from typing import Final

import erfa
import numpy as np
from numpy.typing import NDArray

from ground.determination.measurements import Directions, Ranges
from ground.determination.propagation import itrs_to_gcrs
from ground.orbit.dynamics import LIGHT_KM_S
from sboc_e2e.icd import tai

Array = NDArray[np.float64]

_HUMIDITY: Final = 0.5
"""Relative, of the standard atmosphere at sea level; it falls with exp(-0.6396 h)."""


@dataclass(frozen=True, kw_only=True)
class Station:
    """Geodetic place on WGS 84, rad and km."""

    latitude_rad: float
    longitude_rad: float
    height_km: float

    def frame(self, t_tai_ns: NDArray[np.int64]) -> tuple[Array, Array]:
        """Places (n, 3) km and axes (n, 3, 3): rows east, north, up, GCRS."""
        sl, cl, sp, cp = (f(x) for x in (self.longitude_rad, self.latitude_rad) for f in (np.sin, np.cos))
        fixed = np.array([[-sl, cl, 0.0], [-sp * cl, -sp * sl, cp], [cp * cl, cp * sl, sp]])
        place = 1e-3 * np.asarray(erfa.gd2gc(1, self.longitude_rad, self.latitude_rad, 1e3 * self.height_km))
        turn = itrs_to_gcrs(t_tai_ns)
        return turn @ place, np.einsum("nij,kj->nki", turn, fixed)


def refraction_rad(elevation_rad: Array, height_km: float) -> Array:
    """How much higher radio waves arrive than the geometric elevation (n,): ITU-R P.834, for the mean atmosphere."""
    e, h = np.degrees(elevation_rad), height_km
    low = 1.728 + 0.5411 * e + 0.03723 * e**2 + h * (0.1815 + 0.06272 * e + 0.01380 * e**2) + h**2 * (0.01727 + 0.008288 * e)
    return np.asarray(np.radians(1.0 / low))


def radio_delay_km(elevation_rad: Array, height_km: float) -> Array:
    """One-way delay of the troposphere (n,) km in a standard atmosphere.

    Zenith: Saastamoinen 1972 (Geophys. Monogr. 15, 247). Down to the elevation: Chao's mapping of the dry part.
    """
    h = 1e3 * height_km
    pressure = 1013.25 * (1.0 - 2.2557e-5 * h) ** 5.2568
    kelvin = 291.15 - 6.5e-3 * h
    vapour = _HUMIDITY * np.exp(-6.396e-4 * h) * np.exp(-37.2465 + 0.213166 * kelvin - 0.000256908 * kelvin**2)
    zenith = 0.002277 * (pressure + (1255.0 / kelvin + 0.05) * vapour)
    down = np.sin(elevation_rad) + 0.00143 / (np.tan(elevation_rad) + 0.0445)
    return np.asarray(1e-3 * zenith / down)


def directions_of(
    t_tai_ns: NDArray[np.int64], azimuth_rad: Array, elevation_rad: Array, sigma_rad: tuple[float, float], station: Station
) -> Directions:
    """Azimuths from north over east and elevations (n,) at reception, refraction removed. sigma_rad : of both."""
    place, axes = station.frame(t_tai_ns)
    elevation = elevation_rad
    for _ in range(5):
        elevation = elevation_rad - refraction_rad(elevation, station.height_km)
    ca, sa, ce, se = np.cos(azimuth_rad), np.sin(azimuth_rad), np.cos(elevation), np.sin(elevation)
    zero = np.zeros(len(ca))
    unit, rising_azimuth, rising = (
        np.einsum("nk,nki->ni", np.column_stack(rows), axes)
        for rows in ((ce * sa, ce * ca, se), (ca, -sa, zero), (-se * sa, -se * ca, ce))
    )
    covariance = np.zeros((len(ca), 2, 2))
    covariance[:, 0, 0], covariance[:, 1, 1] = (sigma_rad[0] * ce) ** 2, sigma_rad[1] ** 2
    return Directions(
        t_tai_ns=t_tai_ns, observer_km=place, direction=unit, axes=np.stack([rising_azimuth, rising], axis=1),
        covariance_rad2=covariance,
    )  # fmt: skip


def two_way_ranges(
    t_tai_ns: NDArray[np.int64], range_km: Array, offset_km: float, sigma_km: float, positions_km: Array, station: Station
) -> Ranges:
    """Half of the way there and back (n,) km, received at the epochs (n,), as ranges when the signal met the object.

    offset_km : about what the equipment adds, so that the epoch is right. positions_km : (n, 3) of the object, roughly, GCRS.
    """
    met = t_tai_ns - np.round((range_km - offset_km) / LIGHT_KM_S * tai.NS_PER_S).astype(np.int64)
    place, axes = station.frame(met)
    line = positions_km - place
    elevation = np.arcsin(np.einsum("ni,ni->n", line, axes[:, 2]) / np.linalg.norm(line, axis=1))
    measured = range_km - radio_delay_km(elevation, station.height_km)
    return Ranges(t_tai_ns=met, station_km=place, range_km=measured, sigma_km=np.full(len(met), sigma_km))
