"""One force model for camera and objects: against an integration of the potential's gradient, and against each other."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from simulator.platform import earth
from simulator.platform.kepler import elements_deg, state_of
from simulator.platform.observer import PlatformOptions, make_observer
from simulator.platform.orbit_motion import OrbitMotion
from simulator.scene.sources import OrbitOptions, orbiting

EPOCH = "2027-01-29T00:00:00"


def potential(r: np.ndarray) -> float:
    """Point mass and second zonal harmonic, ``mu / r (1 - J2 (R / r)^2 P2(sin latitude))``."""
    radius = np.linalg.norm(r)
    legendre = 1.5 * (r[2] / radius) ** 2 - 0.5
    return float(earth.MU_KM3_S2 / radius * (1.0 - earth.J2 * (earth.EARTH_RADIUS_KM / radius) ** 2 * legendre))


def derivative(_: float, y: np.ndarray) -> np.ndarray:
    """The gradient is taken numerically, with an error of 1e-11 of gravity."""
    step = 5.0
    pull = np.zeros(3)
    for c in range(3):
        d = np.zeros(3)
        d[c] = step
        near, far = potential(y[:3] + d) - potential(y[:3] - d), potential(y[:3] + 2 * d) - potential(y[:3] - 2 * d)
        pull[c] = (8.0 * near - far) / (12.0 * step)
    return np.concatenate([y[3:], pull])


@pytest.mark.parametrize(("a_km", "e"), [(7078.0, 0.0), (26560.0, 0.7), (42164.0, 0.01)])
def test_motion_is_that_of_the_potential(a_km, e):
    """An hour forwards and ten minutes back, to 1 cm and 0.01 mm/s."""
    position, velocity = state_of(elements_deg(a_km, e, 63.4, 20.0, 40.0, 10.0))
    motion = OrbitMotion(position, velocity)
    for end_s in (3600.0, -600.0):
        found = solve_ivp(
            derivative, (0.0, end_s), np.concatenate([position, velocity]), method="DOP853", rtol=1e-12, atol=1e-9
        ).y[:, -1]
        there, speed = motion.states(end_s)
        assert np.abs(there - found[:3]).max() < 1e-5
        assert np.abs(speed - found[3:]).max() < 1e-8


def test_camera_and_object_of_the_same_elements_stay_together():
    """To a millimetre over ten minutes; J2 in one of them alone parts them by 9 m/s."""
    orbit = {
        "semi_major_axis_km": 7078.137, "eccentricity": 0.001, "inclination_deg": 98.2, "node_deg": 30.0, "perigee_deg": 50.0,
        "mean_anomaly_deg": 70.0,
    }  # fmt: skip
    epoch = earth.tai_ns_of_utc(EPOCH)
    observer = make_observer(PlatformOptions(kind="kepler", **orbit), epoch)
    thing = orbiting(OrbitOptions(**orbit), epoch)
    time_s = np.linspace(0.0, 600.0, 61)
    camera_km = np.array([observer.state(epoch + round(t * 1e9))[0] for t in time_s])
    assert np.linalg.norm(thing.positions_km(time_s) - camera_km, axis=1).max() < 1e-6


def test_states_do_not_depend_on_what_was_asked_before():
    start = state_of(elements_deg(7078.0, 0.001, 98.0, 20.0, 40.0, 10.0))
    first, second = OrbitMotion(*start), OrbitMotion(*start)
    second.states(np.array([9000.0, -4000.0, 10.0]))
    for time_s in (61.7, 5000.3, -3333.3, 0.0):
        assert np.array_equal(np.concatenate(first.states(time_s)), np.concatenate(second.states(time_s)))


@pytest.mark.parametrize("altitude_km", [300.0, 700.0, 2000.0, 5800.0])
def test_node_of_sun_synchronous_orbits_follows_the_mean_sun(altitude_km):
    """30 days: the node moves by 29.57 deg, to 0.05 deg."""
    epoch = earth.tai_ns_of_utc(EPOCH)
    observer = make_observer(PlatformOptions(altitude_km=altitude_km), epoch)
    angles = []
    for day in (0, 30):
        momentum = np.cross(*observer.state(epoch + day * 86400 * 10**9))
        angles.append(np.degrees(np.arctan2(momentum[0], -momentum[1])))
    assert (angles[1] - angles[0]) % 360.0 == pytest.approx(30.0 * 360.0 / 365.2422, abs=0.05)
