"""Aberration, Sun, Earth rotation, sites and TEME against astropy (which calls ERFA on paths of its own)."""

import numpy as np
import pytest
from astropy import units as u
from astropy.coordinates import GCRS, ICRS, ITRS, TEME, CartesianRepresentation, EarthLocation, SkyCoord, get_sun
from astropy.time import Time

from sboc_e2e.icd import tai
from simulator.platform import earth
from simulator.platform.observer import PlatformOptions, SiteObserver, SiteOptions, make_observer
from simulator.scene.aberration import aberrate
from simulator.scene.satellites import gcrs_from_teme
from simulator.scene.stars import unit_vectors

MAS = np.pi / 648000e3
EPOCHS = ("2027-01-29T00:00:00", "2026-06-21T11:17:03", "2022-01-22T06:00:00")


def astropy_time(tai_ns):
    return Time(*tai.to_jd_parts(tai_ns), format="jd", scale="tai")


def separation(a, b):
    return np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), np.sum(a * b, axis=-1))


@pytest.mark.parametrize("epoch", EPOCHS)
def test_aberration_beyond_150_deg_from_the_sun_within_2_mas(epoch):
    tai_ns = earth.tai_ns_of_utc(epoch)
    position, velocity = make_observer(PlatformOptions(), tai_ns).state(tai_ns)
    sun = earth.sun_position_km(tai_ns)
    rng = np.random.default_rng(1)
    directions = rng.standard_normal((4000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    directions = directions[directions @ sun / np.linalg.norm(sun) < np.cos(np.radians(150.0))]
    assert len(directions) > 200
    frame = GCRS(
        obstime=astropy_time(tai_ns),
        obsgeoloc=CartesianRepresentation(position * u.km),
        obsgeovel=CartesianRepresentation(velocity * u.km / u.s),
    )
    stars = SkyCoord(ICRS(CartesianRepresentation(directions.T)))
    reference = stars.transform_to(frame).cartesian.xyz.value.T
    own = aberrate(directions, earth.earth_velocity_km_s(tai_ns) + velocity)
    assert separation(own, reference).max() < 2.0 * MAS
    assert separation(directions, reference).max() > 15e3 * MAS  # the effect itself, 20 arcsec


def test_aberration_and_its_reverse_cancel():
    rng = np.random.default_rng(2)
    directions = rng.standard_normal((100, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    velocity = np.array([3.0, -6.0, 2.0])
    assert separation(aberrate(aberrate(directions, velocity), -velocity), directions).max() < 1e-3 * MAS


@pytest.mark.parametrize("epoch", EPOCHS)
def test_sun_direction_within_an_arcsecond(epoch):
    tai_ns = earth.tai_ns_of_utc(epoch)
    # get_sun is apparent (aberration and light time): compare with the geometric direction moved by the Earth's velocity
    reference = get_sun(astropy_time(tai_ns)).cartesian.xyz.to_value("km")
    sun = earth.sun_position_km(tai_ns)
    own = aberrate(sun / np.linalg.norm(sun), earth.earth_velocity_km_s(tai_ns))
    assert separation(own, reference / np.linalg.norm(reference)) < 1000.0 * MAS
    assert np.linalg.norm(sun) == pytest.approx(np.linalg.norm(reference), rel=1e-6)


@pytest.mark.parametrize("epoch", EPOCHS)
def test_site_position_and_velocity_against_earth_location(epoch):
    tai_ns = earth.tai_ns_of_utc(epoch)
    site = SiteOptions()
    position, velocity = SiteObserver(site=site).state(tai_ns)
    location = EarthLocation.from_geodetic(site.longitude_deg * u.deg, site.latitude_deg * u.deg, site.height_m * u.m)
    reference = location.get_gcrs_posvel(astropy_time(tai_ns))
    assert np.abs(position - reference[0].xyz.to_value("km")).max() < 1e-4  # 0.1 m
    assert np.abs(velocity - reference[1].xyz.to_value("km/s")).max() < 1e-6  # 1 mm/s


@pytest.mark.parametrize("epoch", EPOCHS)
def test_earth_rotation_and_teme_within_a_centimetre_at_7000_km(epoch):
    tai_ns = earth.tai_ns_of_utc(epoch)
    time = astropy_time(tai_ns)
    vector = np.array([4213.0, -5100.0, 2345.0])
    itrs = GCRS(CartesianRepresentation(vector * u.km), obstime=time).transform_to(ITRS(obstime=time))
    assert np.abs(earth.itrs_from_gcrs(tai_ns) @ vector - itrs.cartesian.xyz.to_value("km")).max() < 1e-5
    gcrs = TEME(CartesianRepresentation(vector * u.km), obstime=time).transform_to(GCRS(obstime=time))
    assert np.abs(gcrs_from_teme(tai_ns) @ vector - gcrs.cartesian.xyz.to_value("km")).max() < 1e-5


def test_sun_synchronous_orbit_follows_the_mean_sun_for_a_year():
    tai_ns = earth.tai_ns_of_utc("2026-06-01T00:00:00")
    observer = make_observer(PlatformOptions(ltan_h=18.0), tai_ns)
    later = tai_ns + 365 * 86400 * 10**9
    position, velocity = observer.state(later)
    momentum = np.cross(position, velocity)
    node = np.arctan2(momentum[0], -momentum[1])
    mean_sun = np.radians((280.46646 + 36000.76983 * (earth.jyear(later) - 2000.0) / 100.0) % 360.0)
    ltan_h = (np.degrees(node - mean_sun) / 15.0 + 12.0) % 24.0
    assert ltan_h == pytest.approx(18.0, abs=0.02)  # one minute of local time


def test_beta_angle_of_the_default_orbit():
    tai_ns = earth.tai_ns_of_utc("2027-01-29T00:00:00")
    position, velocity = make_observer(PlatformOptions(), tai_ns).state(tai_ns)
    normal = np.cross(position, velocity)
    sun = earth.sun_position_km(tai_ns)
    beta = np.degrees(np.arcsin(normal @ sun / np.linalg.norm(normal) / np.linalg.norm(sun)))
    assert abs(abs(beta) - 78.0) < 3.0


def test_praesepe_stands_in_the_anti_sun_field():
    sun = earth.sun_position_km(earth.tai_ns_of_utc("2027-01-29T00:00:00"))
    praesepe = unit_vectors(np.array(130.1), np.array(19.62))
    assert np.degrees(separation(-sun / np.linalg.norm(sun), praesepe)) == pytest.approx(1.7, abs=0.3)
