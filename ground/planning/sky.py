"""Sun, Moon and the station at the instants of a plan: GCRS axes, kilometres."""

import warnings
from dataclasses import dataclass
from typing import Final

import erfa
import numpy as np
from astropy.time import Time
from astropy.utils import iers
from numpy.typing import NDArray

from ground.orbit.dynamics import propagate
from sboc_e2e.icd import tai
from sboc_e2e.icd.errors import UserError

Array = NDArray[np.float64]

AU_KM: Final = 149597870.7
EARTH_RADIUS_KM: Final = 6378.137
SPIN_RAD_S: Final = 7.292115e-5
_TT_TAI_S: Final = 32.184
_LIGHT_AU_DAY: Final = 173.1446327


@dataclass(frozen=True, kw_only=True)
class Site:
    """A place on the WGS84 ellipsoid. closed_tai_ns : when its dome is closed, from and to."""

    longitude_deg: float
    latitude_deg: float
    height_m: float
    closed_tai_ns: tuple[tuple[int, int], ...] = ()


@dataclass(frozen=True, kw_only=True, eq=False)
class Orbit:
    """A camera in orbit: state (6,) km, km/s at an epoch, moved by the Earth's mass and oblateness."""

    state: Array
    epoch_tai_ns: int


@dataclass(frozen=True, kw_only=True, eq=False)
class Sky:
    """What the plan's geometry needs at n instants.

    t_tai_ns : (n,) rising. sun_km, moon_km : (n, 3) geocentric; the Sun where its light comes from, as the Earth moves.
    station_km, station_km_s : (n, 3). up : (n, 3) geodetic zenith of a site, None in orbit. clear : (n,) where its
    dome is open, None in orbit.
    """

    t_tai_ns: NDArray[np.int64]
    sun_km: Array
    moon_km: Array
    station_km: Array
    station_km_s: Array
    up: Array | None
    clear: NDArray[np.bool_] | None


def sky_of(station: Site | Orbit, t_tai_ns: NDArray[np.int64]) -> Sky:
    """Sun (ERFA `epv00`), Moon (`moon98`) and station at rising instants (n,).

    UserError for a site outside the Earth-orientation data that are installed.
    """
    day, fraction = _tt(t_tai_ns)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", erfa.ErfaWarning)
        from_sun, of_barycentre = erfa.epv00(day, fraction)
        # the Earth's motion turns the light by 20 arcsec, through which the Sun moves in 8 minutes and sets in 1.4 s
        sun = (of_barycentre["v"] / _LIGHT_AU_DAY * np.linalg.norm(from_sun["p"], axis=-1, keepdims=True) - from_sun["p"]) * AU_KM
        moon = erfa.moon98(day, fraction)["p"] * AU_KM
    up = clear = None
    if isinstance(station, Site):
        position, velocity, up = _on_ground(station, t_tai_ns)
        clear = np.ones(len(t_tai_ns), np.bool_)
        for start, end in station.closed_tai_ns:
            clear &= (t_tai_ns < start) | (t_tai_ns >= end)
    else:
        position, velocity = _in_orbit(station, t_tai_ns)
    return Sky(t_tai_ns=t_tai_ns, sun_km=sun, moon_km=moon, station_km=position, station_km_s=velocity, up=up, clear=clear)


def _tt(t_tai_ns: NDArray[np.int64]) -> tuple[Array, Array]:
    """Two-part Julian dates (TT)."""
    parts = np.array([tai.to_jd_parts(int(t)) for t in t_tai_ns]).reshape(-1, 2)
    return parts[:, 0], parts[:, 1] + _TT_TAI_S / 86400.0


def _on_ground(site: Site, t_tai_ns: NDArray[np.int64]) -> tuple[Array, Array, Array]:
    """Position, velocity and zenith (n, 3) of a site; polar motion (0.3 arcsec) is left out."""
    parts = np.array([tai.to_jd_parts(int(t)) for t in t_tai_ns]).reshape(-1, 2)
    with iers.conf.set_temp("auto_download", False), iers.conf.set_temp("auto_max_age", None):
        try:
            ut1 = Time(parts[:, 0], parts[:, 1], format="jd", scale="tai").ut1
        except iers.IERSRangeError as error:
            raise UserError("plan: the Earth-orientation data that are installed do not cover its days") from error
    day, fraction = _tt(t_tai_ns)
    fixed_from_celestial = erfa.c2t06a(day, fraction, ut1.jd1, ut1.jd2, 0.0, 0.0)
    lon, lat = np.radians(site.longitude_deg), np.radians(site.latitude_deg)
    place = np.asarray(erfa.gd2gc(1, lon, lat, site.height_m)) * 1e-3
    zenith = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    spin = np.array([0.0, 0.0, SPIN_RAD_S])
    to_celestial = np.swapaxes(fixed_from_celestial, 1, 2)
    return to_celestial @ place, to_celestial @ np.cross(spin, place), to_celestial @ zenith


def _in_orbit(orbit: Orbit, t_tai_ns: NDArray[np.int64]) -> tuple[Array, Array]:
    """States of an orbit, from one instant to the next."""
    states = np.empty((len(t_tai_ns), 6))
    state, now = orbit.state, orbit.epoch_tai_ns
    for k, instant_ns in enumerate(t_tai_ns):
        state = propagate(state, np.array([(int(instant_ns) - now) * 1e-9]))[0]
        states[k], now = state, int(instant_ns)
    return states[:, :3], states[:, 3:]
