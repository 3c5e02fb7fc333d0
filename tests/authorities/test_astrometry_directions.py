"""Directions against astropy, and the published direction against retarded positions in the barycentric frame."""

import astropy.units as u
import erfa
import numpy as np
import pytest
from astropy.coordinates import GCRS, CartesianRepresentation, SkyCoord
from astropy.time import Time

from ground.sky.apparent import apparent_directions, jyear_of
from ground.sky.published import LIGHT_M_S, without_observer_aberration
from sboc_e2e.icd.tai import from_jd_parts

MAS = np.pi / 648000e3
AU_M = 149597870700.0


def test_apparent_directions_are_astropys_gcrs():
    t = Time("2027-01-29T03:14:15", scale="utc")
    rng = np.random.default_rng(1)
    ra, dec = rng.uniform(0.0, 360.0, 200), np.degrees(np.arcsin(rng.uniform(-1.0, 1.0, 200)))
    position, velocity = np.array([5.0e6, -4.0e6, 3.0e6]), np.array([4000.0, 5000.0, -3500.0])
    frame = GCRS(
        obstime=t, obsgeoloc=CartesianRepresentation(position * u.m), obsgeovel=CartesianRepresentation(velocity * u.m / u.s)
    )
    want = SkyCoord(ra=ra * u.deg, dec=dec * u.deg).transform_to(frame).cartesian.xyz.value.T
    want /= np.linalg.norm(want, axis=1, keepdims=True)
    got = apparent_directions(ra, dec, from_jd_parts(t.tai.jd1, t.tai.jd2), position, velocity)
    assert np.linalg.norm(got - want, axis=1).max() < 0.01 * MAS


def test_julian_epoch_is_that_of_astropy():
    t = Time("2027-01-29T03:14:15", scale="utc")
    assert abs(jyear_of(from_jd_parts(t.tai.jd1, t.tai.jd2)) - t.tt.jyear) < 1e-9


def _boost(direction, beta):
    """Direction of a photon's source seen from a frame that moves with beta (special relativity)."""
    inverse_gamma = np.sqrt(1.0 - beta @ beta)
    along = direction @ beta
    moved = inverse_gamma * direction + (1.0 + along / (1.0 + inverse_gamma)) * beta
    return moved / np.linalg.norm(moved)


@pytest.mark.parametrize("range_km", [50.0, 1000.0, 36000.0])
def test_published_direction_is_the_geocentric_retarded_one(range_km):
    """Anti-Sun pointing: Earth's velocity stands across the line of sight, the worst case, and the normal one."""
    t = Time("2027-01-29T00:00:00", scale="tdb")
    heliocentric, barycentric = erfa.epv00(t.jd1, t.jd2)
    earth_velocity = barycentric["v"] * AU_M / 86400.0
    sight = heliocentric["p"] / np.linalg.norm(heliocentric["p"])
    # exactly across, so that Lorentz contraction (0.5 mas at 45 deg) stays out of the comparison
    sight = sight - earth_velocity * (sight @ earth_velocity) / (earth_velocity @ earth_velocity)
    sight /= np.linalg.norm(sight)
    side = np.cross(sight, [0.0, 0.0, 1.0])
    observer_velocity = 7500.0 * side / np.linalg.norm(side)
    observer = 7.078e6 * np.cross(side, sight)
    target_velocity = -7000.0 * side / np.linalg.norm(side) + 3000.0 * np.cross(side, sight)
    target_now = observer + range_km * 1e3 * sight

    def retarded(drift):
        """Vector from the observer to where the target was when the light left it."""
        delay = range_km * 1e3 / LIGHT_M_S
        for _ in range(6):
            arrow = target_now - (target_velocity + drift) * delay - observer
            delay = np.linalg.norm(arrow) / LIGHT_M_S
        return arrow / np.linalg.norm(arrow)

    # barycentric frame: the target is dragged along by the Earth while the light travels; then one boost to the Earth, one
    # to the camera, as special relativity composes velocities
    in_barycentric_frame = retarded(earth_velocity)
    apparent = _boost(_boost(in_barycentric_frame, earth_velocity / LIGHT_M_S), observer_velocity / LIGHT_M_S)
    published = without_observer_aberration(apparent[None, :], observer_velocity)[0]
    assert np.linalg.norm(published - retarded(np.zeros(3))) < 0.02 * MAS
    # and what a catalogue-relative direction would be wrong by
    astrometric = _boost(apparent, -(earth_velocity + observer_velocity) / LIGHT_M_S)
    assert 20_000.0 * MAS < np.linalg.norm(astrometric - published) < 21_500.0 * MAS


def test_aberration_is_removed_exactly():
    rng = np.random.default_rng(5)
    directions = rng.normal(size=(100, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    velocity = np.array([5000.0, -4000.0, 3500.0])
    beta = velocity / LIGHT_M_S
    seen = np.array([erfa.ab(d, beta, 1.0, np.sqrt(1.0 - beta @ beta)) for d in directions])
    # ERFA adds the Sun's potential to aberration: 0.4 microarcsec
    assert np.linalg.norm(without_observer_aberration(seen, velocity) - directions, axis=1).max() < 0.001 * MAS
