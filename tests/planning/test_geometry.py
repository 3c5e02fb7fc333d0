"""Directions, darkness and windows against astropy, which takes its own way through frames and ephemerides."""

import numpy as np
import pytest
from astroplan import Observer
from astropy import units as u
from astropy.coordinates import TEME, AltAz, CartesianRepresentation, EarthLocation, SkyCoord, get_body, get_sun
from astropy.time import Time
from astropy.utils import iers
from erfa import DJM0
from scipy.optimize import brentq
from sgp4.api import Satrec

from ground.orbit.catalogue_match import read_elements
from ground.planning.constraints import sun_elevation_rad, visibility_of
from ground.planning.options import ConstraintOptions
from ground.planning.sky import Orbit, Site, sky_of
from ground.planning.targets import states_at, states_of
from ground.planning.windows import windows_of
from ground.sky.orientation_data import covered_mjd, refuse_outside_orientation
from sboc_e2e.icd import tai
from sboc_e2e.icd.errors import UserError
from tests.element_lines import with_checksums

LINES = with_checksums(
    "0 NAVIGATION\n"
    "1 37846U 11060A   22021.50000000  .00000000  00000-0  00000-0 0  9990\n"
    "2 37846  56.0000  60.0000 0002000  30.0000 330.0000  1.70475000 60000\n"
)
RING = with_checksums(
    "0 RING\n"
    "1 41866U 16071A   22021.50000000  .00000000  00000-0  00000-0 0  9990\n"
    "2 41866   0.0500  95.0000 0001000 180.0000  20.0000  1.00271000 40000\n"
)
SITE = Site(longitude_deg=-6.631, latitude_deg=38.216, height_m=565.0)
PLACE = EarthLocation.from_geodetic(-6.631 * u.deg, 38.216 * u.deg, 565.0 * u.m)


def start_ns() -> int:
    atomic = Time("2022-01-22T12:00:00", scale="utc").tai
    return tai.from_jd_parts(atomic.jd1, atomic.jd2)


def time_of(t_tai_ns: int) -> Time:
    return Time(*tai.to_jd_parts(t_tai_ns), format="jd", scale="tai")


def altitude_deg(satellite: Satrec, t_tai_ns: int) -> float:
    """Geometric elevation by astropy: TEME to ITRS, seen from the site's own place."""
    now = time_of(t_tai_ns)
    _, position, _ = satellite.sgp4(now.utc.jd1, now.utc.jd2)
    itrs = SkyCoord(TEME(CartesianRepresentation(position * u.km), obstime=now)).itrs
    line = itrs.cartesian.xyz.to_value(u.km) - np.array([PLACE.x.to_value(u.km), PLACE.y.to_value(u.km), PLACE.z.to_value(u.km)])
    lon, lat = PLACE.lon.rad, PLACE.lat.rad
    up = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    return float(np.degrees(np.arcsin(line @ up / np.linalg.norm(line))))


def sun_altitude_deg(t_tai_ns: int) -> float:
    now = time_of(t_tai_ns)
    return float(get_sun(now).transform_to(AltAz(obstime=now, location=PLACE)).alt.deg)


def test_sun_and_moon_stand_where_astropy_has_them() -> None:
    instants = start_ns() + np.arange(0, 20 * 86400, 50_000, dtype=np.int64) * 10**9
    sky = sky_of(SITE, instants)
    for k, t in enumerate(instants):
        for name, body in (("sun", sky.sun_km[k]), ("moon", sky.moon_km[k])):
            want = get_body(name, time_of(int(t))).gcrs.cartesian.xyz.to_value(u.km)
            cosine = body @ want / np.linalg.norm(body) / np.linalg.norm(want)
            assert np.degrees(np.arccos(min(cosine, 1.0))) * 3600 < 60.0, name  # constraints are whole degrees


@pytest.mark.parametrize("date", ["1972-06-01", "2027-12-01", "2030-01-01", "2040-01-01"])
def test_a_site_outside_the_earth_orientation_data_is_refused(date: str) -> None:
    """Tables of today end in autumn 2027 or later; those of a later package may hold the first dates, and then give a place."""
    table = iers.earth_orientation_table.get()
    atomic = Time(date, scale="tai")
    instants = tai.from_jd_parts(atomic.jd1, atomic.jd2) + 60 * 10**9 * np.arange(3, dtype=np.int64)
    if table["MJD"][0].value <= atomic.mjd < table["MJD"][-1].value - 1.0:
        assert np.isfinite(sky_of(SITE, instants).station_km).all()
        return
    with pytest.raises(UserError, match=f"plan: {date} lies outside the installed Earth-orientation data"):
        sky_of(SITE, instants)
    orbit = Orbit(state=np.array([7078.0, 0, 0, 0, -1.06, 7.43]), epoch_tai_ns=int(instants[0]))
    assert np.isfinite(sky_of(orbit, instants).station_km).all()


def test_the_earth_orientation_data_end_where_astropy_has_them_end() -> None:
    table = iers.earth_orientation_table.get()
    assert covered_mjd() == (table["MJD"][0].value, table["MJD"][-1].value)
    first, last = (tai.from_jd_parts(DJM0 + day, 0.0) for day in covered_mjd())
    refuse_outside_orientation(np.array([first, last]), "x")
    refuse_outside_orientation(np.zeros(0, dtype=np.int64), "x")
    for outside in (first - 10**9, last + 10**9):
        with pytest.raises(UserError, match=r"^x: "):
            refuse_outside_orientation(np.array([first, outside]), "x")


@pytest.mark.parametrize("station", [SITE, Orbit(state=np.array([7078.0, 0, 0, 0, -1.06, 7.43]), epoch_tai_ns=start_ns())])
def test_splines_through_many_instants_are_what_each_instant_has_by_itself(station: Site | Orbit) -> None:
    """Few instants are computed one by one, by ERFA and the equations of motion; thousands go through splines."""
    rng = np.random.default_rng(2)
    many = start_ns() + np.sort(rng.integers(0, 2 * 3600 * 10**9, 2000))
    few = many[::500]
    through, alone = sky_of(station, many), sky_of(station, few)
    for name, limit_km in (("sun_km", 1e-3), ("moon_km", 1e-3), ("station_km", 2e-5), ("station_km_s", 1e-6)):
        worst = np.linalg.norm(getattr(through, name)[::500] - getattr(alone, name), axis=1).max()
        assert worst < limit_km, (name, worst)


def test_targets_at_their_own_instants_are_where_all_of_them_are_together() -> None:
    known = read_elements(LINES + RING)
    instants = start_ns() + np.arange(0, 86400, 1800, dtype=np.int64) * 10**9
    position, velocity = states_of(known, instants)
    target = np.random.default_rng(3).integers(0, 2, len(instants))
    where, how_fast = states_at(known, target, instants)
    np.testing.assert_allclose(where, position[target, np.arange(len(instants))], rtol=0, atol=1e-6)
    np.testing.assert_allclose(how_fast, velocity[target, np.arange(len(instants))], rtol=0, atol=1e-9)


def test_darkness_begins_when_astropy_says_so() -> None:
    instants = start_ns() + np.arange(0, 86400, 10, dtype=np.int64) * 10**9
    sky = sky_of(SITE, instants)
    assert sky.up is not None
    dark = np.degrees(sun_elevation_rad(sky, sky.up)) <= -12.0
    found = instants[np.flatnonzero(dark)[0]]
    want = brentq(lambda s: sun_altitude_deg(start_ns() + round(s * 1e9)) + 12.0, 0, 12 * 3600, xtol=0.01)
    assert 0.0 <= (found - start_ns()) * 1e-9 - want <= 11.0  # the first instant that is dark, of one in ten seconds


def test_windows_begin_and_end_with_the_night_of_astroplan() -> None:
    """A satellite that never sets and is not eclipsed is seen while the Sun is low: four nights against astroplan."""
    known = read_elements(RING)
    site = Observer(location=PLACE)
    options = ConstraintOptions(elevation_deg=-90.0, moon_deg=0.0, darkness_deg=-15.0)
    instants = start_ns() + np.arange(0, 4 * 86400, 300, dtype=np.int64) * 10**9
    position, velocity = states_of(known, instants)
    seen = visibility_of(position, velocity, sky_of(SITE, instants), options)
    found = windows_of(known, SITE, options, instants, seen.allowed)
    assert len(found.target) == 4
    for start, end in zip(found.start_tai_ns, found.end_tai_ns, strict=True):
        middle = time_of(int(start + end) // 2)
        dusk = site.sun_set_time(middle, which="previous", horizon=-15 * u.deg, n_grid_points=1_500)
        dawn = site.sun_rise_time(middle, which="next", horizon=-15 * u.deg, n_grid_points=1_500)
        assert abs((time_of(int(start)) - dusk).to_value(u.s)) < 1.0
        assert abs((time_of(int(end)) - dawn).to_value(u.s)) < 1.0


def test_windows_of_a_satellite_are_right_to_a_second() -> None:
    known = read_elements(LINES)
    options = ConstraintOptions(elevation_deg=20.0, moon_deg=0.0, darkness_deg=0.0)
    instants = start_ns() + np.arange(0, 86400, 300, dtype=np.int64) * 10**9
    position, velocity = states_of(known, instants)
    seen = visibility_of(position, velocity, sky_of(SITE, instants), options)
    found = windows_of(known, SITE, options, instants, seen.allowed)
    assert len(found.target) >= 1
    checked = 0
    for edges in (found.start_tai_ns, found.end_tai_ns):
        for t in edges:
            if instants[0] < t < instants[-1] and sun_altitude_deg(int(t)) < -1.0:
                near = [(int(t) - start_ns()) * 1e-9 + step for step in (-5.0, 5.0)]
                want = brentq(lambda s: altitude_deg(known.satellites[0], start_ns() + round(s * 1e9)) - 20.0, *near, xtol=0.01)
                assert (int(t) - start_ns()) * 1e-9 == pytest.approx(want, abs=1.0)
                checked += 1
    assert checked >= 1
