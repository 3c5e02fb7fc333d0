"""Correlation with mean elements: predictions against sgp4 turned by astropy, and tracklets of an object and of a stranger."""

import math

import numpy as np
from astropy import units
from astropy.coordinates import GCRS, TEME, CartesianDifferential, CartesianRepresentation
from astropy.time import Time
from sgp4.api import WGS72, Satrec

from ground.association.arc import arc_orbits
from ground.association.correlate import correlate_elements, predicted_by_elements
from ground.determination.measurements import Directions
from sboc_e2e.icd import tai

T0 = 25_000 * 86400 * 10**9


def epoch_of(t_tai_ns: int) -> Time:
    return Time(*tai.to_jd_parts(t_tai_ns), format="jd", scale="tai")


def satellite(number: int, mean_anomaly_deg: float, *, revolutions: float = 1.00273, inclination_deg: float = 3.0) -> Satrec:
    out = Satrec()
    at = epoch_of(T0).utc
    days = (at.jd1 - 2433281.5) + at.jd2
    out.sgp4init(
        WGS72, "i", number, days, 0.0, 0.0, 0.0, 0.0002, 1.0, math.radians(inclination_deg),
        math.radians(mean_anomaly_deg), revolutions * 2.0 * math.pi / 1440.0, 0.5,
    )  # fmt: skip
    return out


def by_astropy(one: Satrec, t_tai_ns: int) -> np.ndarray:
    """State (6,) GCRS: sgp4's own numbers, turned by astropy."""
    at = epoch_of(t_tai_ns)
    error, place, speed = one.sgp4(at.utc.jd1, at.utc.jd2)
    assert error == 0
    moving = CartesianDifferential(*speed, unit=units.km / units.s)
    turned = TEME(CartesianRepresentation(*place, unit=units.km).with_differentials(moving), obstime=at).transform_to(
        GCRS(obstime=at)
    )
    xyz = turned.cartesian
    return np.concatenate([xyz.xyz.to_value(units.km), xyz.differentials["s"].d_xyz.to_value(units.km / units.s)])


def test_predictions_are_those_of_sgp4_turned_by_astropy() -> None:
    one = satellite(1, 40.0)
    t = T0 + np.array([0, 3600, 86400], dtype=np.int64) * 10**9
    found = predicted_by_elements(one, t)
    for k, instant in enumerate(t):
        away = found.states[k] - by_astropy(one, int(instant))
        # astropy's TEME leaves the last arc seconds of precession models; 0.01 arcsec at GEO is 2 m
        assert np.linalg.norm(away[:3]) < 0.02
        assert np.linalg.norm(away[3:]) < 2e-6
        assert np.linalg.eigvalsh(found.covariances[k][:3, :3])[0] > 0.5
    # older elements know less
    assert np.trace(found.covariances[2]) > 2.0 * np.trace(found.covariances[0])


def test_a_tracklet_finds_its_elements_among_neighbours() -> None:
    known = [satellite(k, 40.0 + 0.5 * k) for k in range(5)]
    strange = satellite(9, 43.7, inclination_deg=8.0)
    rng = np.random.default_rng(6)
    tracklets = []
    for one in (known[2], strange):
        t = T0 + (np.int64(7200) + 30 * np.arange(15, dtype=np.int64)) * 10**9
        angle = 0.00106 * (t - T0) * 1e-9
        observer = 7078.0 * np.column_stack([np.cos(angle + 0.6), np.sin(angle + 0.6), 0.1 * np.ones(15)])
        direction = np.empty((15, 3))
        for k in range(15):
            state = by_astropy(one, int(t[k]))
            delay = np.linalg.norm(state[:3] - observer[k]) / 299792.458
            direction[k] = state[:3] - delay * state[3:] - observer[k]
        direction += np.linalg.norm(direction, axis=1, keepdims=True) * math.radians(0.5 / 3600.0) * rng.normal(size=(15, 3))
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        first = np.cross(direction, [0.0, 0.0, 1.0])
        first /= np.linalg.norm(first, axis=1, keepdims=True)
        tracklets.append(
            Directions(
                t_tai_ns=t, observer_km=observer, direction=direction,
                axes=np.stack([first, np.cross(direction, first)], axis=1),
                covariance_rad2=np.tile(math.radians(0.5 / 3600.0) ** 2 * np.eye(2), (15, 1, 1)),
            )
        )  # fmt: skip
    arcs = arc_orbits(tracklets)
    own, other = correlate_elements([a for a in arcs if a is not None], known)
    assert own[0].known == 2
    assert own[0].probability > 0.99
    assert not other
