"""Sun, Moon and the station at the instants of a plan: GCRS axes, kilometres."""

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import erfa
import numpy as np
from astropy.time import Time
from astropy.utils import iers
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline, CubicSpline

from ground.orbit.dynamics import propagate
from ground.sky.apparent import EARTH_SPIN_RAD_S, TT_MINUS_TAI_DAYS
from ground.sky.orientation_data import refuse_outside_orientation
from sboc_e2e.icd import tai

Array = NDArray[np.float64]

AU_KM: Final = float(erfa.DAU / 1e3)
"""149,597,870.7, exact (IAU 2012 B2)."""
_SLOW_NODE_NS: Final = 1800 * 10**9
"""Between nodes of what moves slowly: cubic splines through Sun, Moon and the Earth's pole are within 1 m and 1e-6 arcsec."""
_ORBIT_NODE_NS: Final = 20 * 10**9
"""Between states of an orbit: a Hermite spline of a low one is within 5 mm."""
_LEAST_NODES: Final = 8
"""A cubic spline is poor at the ends of fewer."""


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
    """Sun (ERFA `epv00`), Moon (`moon98`) and station at rising instants (n,); splines between fewer where these are many.

    UserError for a site outside the Earth-orientation data that are installed.
    """
    sun, moon = np.split(_smooth(_bodies, t_tai_ns), 2, axis=1)
    up = clear = None
    if isinstance(station, Site):
        position, velocity, up = _on_ground(station, t_tai_ns)
        clear = np.ones(len(t_tai_ns), np.bool_)
        for start, end in station.closed_tai_ns:
            clear &= (t_tai_ns < start) | (t_tai_ns >= end)
    else:
        position, velocity = _in_orbit(station, t_tai_ns)
    return Sky(t_tai_ns=t_tai_ns, sun_km=sun, moon_km=moon, station_km=position, station_km_s=velocity, up=up, clear=clear)


def _bodies(t_tai_ns: NDArray[np.int64]) -> Array:
    """Sun and Moon (n, 6) km."""
    day, fraction = _tt(t_tai_ns)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", erfa.ErfaWarning)
        from_sun, of_barycentre = erfa.epv00(day, fraction)
        # the Earth's motion turns the light by 20 arcsec, through which the Sun moves in 8 minutes and sets in 1.4 s
        sun = of_barycentre["v"] / erfa.DC * np.linalg.norm(from_sun["p"], axis=-1, keepdims=True) - from_sun["p"]
        return np.concatenate([sun, erfa.moon98(day, fraction)["p"]], axis=-1) * AU_KM


def _pole(t_tai_ns: NDArray[np.int64]) -> Array:
    """X, Y and s (n, 3) of the celestial intermediate pole and origin, IAU 2006/2000A."""
    return np.stack(erfa.xys06a(*_tt(t_tai_ns)), axis=-1)


def _smooth(of: Callable[[NDArray[np.int64]], Array], t_tai_ns: NDArray[np.int64]) -> Array:
    """Values (n, c) of a slow function of time, through a spline where this asks for fewer of them."""
    nodes = _nodes(t_tai_ns, _SLOW_NODE_NS)
    if len(nodes) >= len(t_tai_ns):
        return of(t_tai_ns)
    start = t_tai_ns[0]
    return np.asarray(CubicSpline((nodes - start) * 1e-9, of(nodes))((t_tai_ns - start) * 1e-9))


def _nodes(t_tai_ns: NDArray[np.int64], step_ns: int) -> NDArray[np.int64]:
    """Evenly spaced instants from the first of some that rise to the last, or beyond it."""
    steps = max(_LEAST_NODES, -(-int(t_tai_ns[-1] - t_tai_ns[0]) // step_ns))
    return np.asarray(t_tai_ns[0] + step_ns * np.arange(steps + 1, dtype=np.int64))


def _tt(t_tai_ns: NDArray[np.int64]) -> tuple[Array, Array]:
    """Two-part Julian dates (TT)."""
    day, fraction = tai.jd_parts_of(t_tai_ns)
    return day, fraction + TT_MINUS_TAI_DAYS


def _on_ground(site: Site, t_tai_ns: NDArray[np.int64]) -> tuple[Array, Array, Array]:
    """Position, velocity and zenith (n, 3) of a site; polar motion (0.3 arcsec) is left out."""
    # Beyond its tables astropy holds the last UT1 - UTC without a word.
    refuse_outside_orientation(t_tai_ns, "plan")
    with iers.conf.set_temp("auto_download", False), iers.conf.set_temp("auto_max_age", None):
        ut1 = Time(*tai.jd_parts_of(t_tai_ns), format="jd", scale="tai").ut1
    intermediate_from_celestial = erfa.c2ixys(*_smooth(_pole, t_tai_ns).T)
    still = erfa.pom00(0.0, 0.0, 0.0)
    fixed_from_celestial = erfa.c2tcio(intermediate_from_celestial, erfa.era00(ut1.jd1, ut1.jd2), still)
    lon, lat = np.radians(site.longitude_deg), np.radians(site.latitude_deg)
    place = np.asarray(erfa.gd2gc(1, lon, lat, site.height_m)) * 1e-3
    zenith = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    spin = np.array([0.0, 0.0, EARTH_SPIN_RAD_S])
    to_celestial = np.swapaxes(fixed_from_celestial, 1, 2)
    return to_celestial @ place, to_celestial @ np.cross(spin, place), to_celestial @ zenith


def _in_orbit(orbit: Orbit, t_tai_ns: NDArray[np.int64]) -> tuple[Array, Array]:
    """Position and velocity (n, 3) of an orbit."""
    nodes = _nodes(t_tai_ns, _ORBIT_NODE_NS)
    if len(nodes) >= len(t_tai_ns):
        states = _marched(orbit, t_tai_ns)
        return states[:, :3], states[:, 3:]
    states = _marched(orbit, nodes)
    path = CubicHermiteSpline((nodes - t_tai_ns[0]) * 1e-9, states[:, :3], states[:, 3:])
    s = (t_tai_ns - t_tai_ns[0]) * 1e-9
    return np.asarray(path(s)), np.asarray(path(s, 1))


def _marched(orbit: Orbit, t_tai_ns: NDArray[np.int64]) -> Array:
    """States (n, 6) of an orbit, from one instant to the next."""
    states = np.empty((len(t_tai_ns), 6))
    state, now = orbit.state, orbit.epoch_tai_ns
    for k, instant_ns in enumerate(t_tai_ns):
        state = propagate(state, np.array([(int(instant_ns) - now) * 1e-9]))[0]
        states[k], now = state, int(instant_ns)
    return states
