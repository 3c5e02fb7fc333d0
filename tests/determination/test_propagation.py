"""Tables of Sun, Moon and Earth rotation that propagations share change no orbit that anyone could measure."""

import math
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp

from ground.determination.forces import ForceModel
from ground.determination.perigee import perigees_of
from ground.determination.propagation import Flight, _settings_with_table, instant, propagate
from ground.orbit.dynamics import MU_KM3_S2
from sboc_e2e.icd import tai
from sboc_e2e.icd.errors import UserError
from tests.association.list_simulator import kepler

satkit = pytest.importorskip("satkit", reason="satkit propagates orbits (extra `objects`)")

T0 = 2_152_656_037 * tai.NS_PER_S + 123_456_789_012
FORCES = ForceModel(gravity_degree=8)
"""Without radiation pressure: at the edges of the Earth's shadow the integrator itself is uncertain by decimetres in days."""
ORBITS = {
    "700 km": kepler(7_078.0, 0.001, math.radians(98.2), 1.0, 0.5, 0.3),
    "navigation": kepler(26_560.0, 0.01, math.radians(55.0), 2.0, 0.5, 0.3),
    "geostationary": kepler(42_164.0, 0.0005, math.radians(0.1), 0.4, 0.5, 0.3),
}


def with_a_table_of_its_own(state: np.ndarray, t_tai_ns: np.ndarray) -> np.ndarray:
    """Places (n, 3) km as satkit itself finds them."""
    settings = satkit.propsettings(
        abs_error=1e-7,
        rel_error=1e-11,
        gravity_degree=8,
        tide_model=satkit.tidemodel.solid_full,
        use_relativistic_correction=True,
    )
    run: Any = satkit.propagate(1e3 * state, instant(T0), instant(int(t_tai_ns[-1])), propsettings=settings)
    return 1e-3 * np.array([run.interp(instant(int(t)))[:3] for t in t_tai_ns])


@pytest.mark.parametrize("name", ORBITS)
@pytest.mark.parametrize("days", [0.003, -0.4, 5.0])
def test_a_shared_table_moves_no_orbit_by_a_millimetre(name: str, days: float) -> None:
    t = T0 + np.round(np.linspace(0.1, 1.0, 10) * days * tai.NS_PER_DAY).astype(np.int64)
    ours = propagate(ORBITS[name], T0, t, FORCES).states[:, :3]
    assert 1e6 * np.abs(ours - with_a_table_of_its_own(ORBITS[name], t)).max() < 1.0


def test_results_do_not_depend_on_what_was_propagated_before() -> None:
    t = np.array([T0 + 3 * tai.NS_PER_DAY])
    _settings_with_table.cache_clear()
    first = propagate(ORBITS["navigation"], T0, t, FORCES, partials=True)
    propagate(ORBITS["navigation"], T0, t + 2 * tai.NS_PER_DAY, FORCES)
    _settings_with_table.cache_clear()
    propagate(ORBITS["700 km"], T0, t + tai.NS_PER_DAY, FORCES)
    again = propagate(ORBITS["navigation"], T0, t, FORCES, partials=True)
    assert (again.states == first.states).all()
    assert (again.partials == first.partials).all()


def integrated_noise(state: np.ndarray, days: float, push_km2_s3: float) -> tuple[np.ndarray, np.ndarray]:
    """Two-body state (6,) and covariance (6, 6) of white accelerations by dP/dt = F P + P F^T + q G G^T."""

    def change(_: float, y: np.ndarray) -> np.ndarray:
        r, v, p = y[:3], y[3:6], y[6:].reshape(6, 6)
        size = np.linalg.norm(r)
        f = np.zeros((6, 6))
        f[:3, 3:], f[3:, :3] = np.eye(3), MU_KM3_S2 * (3.0 * np.outer(r, r) / size**5 - np.eye(3) / size**3)
        grows = f @ p + p @ f.T
        grows[3:, 3:] += push_km2_s3 * np.eye(3)
        return np.concatenate([v, -MU_KM3_S2 * r / size**3, grows.reshape(-1)])

    # backwards the noise adds too: the same motion with velocity and time reversed
    sign = np.where(np.arange(6) < 3, 1.0, math.copysign(1.0, days))
    start = np.concatenate([sign * state, np.zeros(36)])
    found = solve_ivp(change, (0.0, 86_400.0 * abs(days)), start, method="DOP853", rtol=1e-10, atol=1e-18)
    return sign * found.y[:6, -1], np.outer(sign, sign) * found.y[6:, -1].reshape(6, 6)


def radial_along_across_m(state: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """One sigma along radius, way and normal (3,), m."""
    radial, normal = state[:3] / np.linalg.norm(state[:3]), np.cross(state[:3], state[3:])
    normal = normal / np.linalg.norm(normal)
    axes = np.array([radial, np.cross(normal, radial), normal])
    return 1e3 * np.sqrt(np.diag(axes @ covariance[:3, :3] @ axes.T))


PLAIN = ForceModel(gravity_degree=2, tides=False, relativity=False)


@pytest.mark.parametrize("name", ["navigation", "geostationary"])
@pytest.mark.parametrize("days", [0.01, 1.0, 10.0, -3.0])
def test_noise_of_left_out_forces_is_its_integral(name: str, days: float) -> None:
    """Sun, Moon and the flattened Earth change the way that noise grows by less than two per cent in ten days."""
    state, push = ORBITS[name], 1e-18
    t = T0 + np.round(np.array([0.3, 1.0]) * days * tai.NS_PER_DAY).astype(np.int64)
    flight = Flight(state, T0, int(t.min()), int(t.max()), PLAIN)
    noise, states = flight.noise(t, push, 3 * 3600 * tai.NS_PER_S), flight.at(t).states
    for k, part in enumerate((0.3, 1.0)):
        expected = radial_along_across_m(*integrated_noise(state, part * days, push))
        assert radial_along_across_m(states[k], noise[k]) == pytest.approx(expected, rel=0.02)
    # an epoch asked for alone has the same noise
    alone = flight.noise(t[1:], push, 3 * 3600 * tai.NS_PER_S)[0]
    assert np.diag(alone) == pytest.approx(np.diag(noise[1]), rel=1e-3)
    assert not flight.noise(np.array([T0]), push, tai.NS_PER_S).any()


def test_noise_of_ten_geostationary_days_lies_along_the_way() -> None:
    """Clohessy and Wiltshire's equations with impulses: along the way three times free motion, and no growth elsewhere."""
    state, push, span_s = ORBITS["geostationary"], 1e-18, 864_000.0
    t = np.array([T0 + 10 * tai.NS_PER_DAY])
    flight = Flight(state, T0, T0, int(t[0]), PLAIN)
    rate = math.sqrt(MU_KM3_S2 / 42_164.0**3)
    # variances of a whole number of turns: radial 13/2 q T / n^2, along 3 q T^3 + 38 q T / n^2, across q T / (2 n^2)
    closed = np.sqrt(push * span_s * np.array([6.5 / rate**2, 3.0 * span_s**2 + 38.0 / rate**2, 0.5 / rate**2]))
    found = radial_along_across_m(flight.at(t).states[0], flight.noise(t, push, 3 * 3600 * tai.NS_PER_S)[0])
    assert found == pytest.approx(1e3 * closed, rel=0.02)


def by_two_bodies(perigee_km: float, e: float, true_anomaly_deg: float) -> np.ndarray:
    """State (6,) at a true anomaly of an orbit of any eccentricity."""
    nu, p = math.radians(true_anomaly_deg), perigee_km * (1.0 + e)
    speed = math.sqrt(MU_KM3_S2 / p)
    r = p / (1.0 + e * math.cos(nu))
    place = [r * math.cos(nu), r * math.sin(nu), 0.0]
    return np.array([*place, -speed * math.sin(nu), speed * (e + math.cos(nu)), 0.0])


@pytest.mark.parametrize("e", [0.0005, 0.3, 0.74, 0.99, 1.0, 1.01, 2.5])
@pytest.mark.parametrize("nu_deg", [-100.0, -5.0, 60.0, 100.0])
def test_perigee_and_its_time_are_those_of_two_bodies(e: float, nu_deg: float) -> None:
    """The time is the area that the radius sweeps (Kepler's second law), summed over true anomaly."""
    radius, since, period = perigees_of(by_two_bodies(7000.0, e, nu_deg)[None])
    swept, _ = quad(lambda nu: (7000.0 * (1.0 + e) / (1.0 + e * math.cos(nu))) ** 2, 0.0, math.radians(nu_deg), epsrel=1e-12)
    assert radius[0] == pytest.approx(7000.0, rel=1e-9)
    assert since[0] == pytest.approx(swept / math.sqrt(MU_KM3_S2 * 7000.0 * (1.0 + e)), rel=1e-5)
    if e > 1.0:
        assert period[0] == math.inf
    if e < 1.0:
        assert period[0] == pytest.approx(2.0 * math.pi * math.sqrt((7000.0 / (1.0 - e)) ** 3 / MU_KM3_S2))


def passed(state: np.ndarray, seconds: float, through: str) -> None:
    """Propagate by `propagate` or by `Flight`."""
    end = np.array([T0 + round(seconds * tai.NS_PER_S)])
    if through == "propagate":
        propagate(state, T0, end, FORCES)
    else:
        Flight(state, T0, min(T0, int(end[0])), max(T0, int(end[0])), FORCES).at(end)


@pytest.mark.parametrize("through", ["propagate", "flight"])
@pytest.mark.parametrize("slower", [0.96, 0.90, 0.80])
@pytest.mark.parametrize("hours", [6.0, -6.0, 0.3])
def test_an_orbit_that_meets_the_earth_is_refused(through: str, slower: float, hours: float) -> None:
    """From 6500 km, along the horizon and slower than a circle: the perigee of two bodies is below 5600 km."""
    state = np.array([6500.0, 0.0, 0.0, 0.0, slower * math.sqrt(MU_KM3_S2 / 6500.0), 0.0])
    with pytest.raises(UserError, match="meets the Earth"):
        passed(state, 3600.0 * hours, through)


@pytest.mark.parametrize("through", ["propagate", "flight"])
def test_only_what_is_flown_can_meet_the_earth(through: str) -> None:
    """An orbit with its perigee in the Earth, 20 minutes about its apogee and a revolution."""
    for nu_deg in (-175.0, 175.0):
        state = by_two_bodies(6000.0, 0.5, nu_deg)
        (period,) = perigees_of(state[None])[2]
        for way in (-1.0, 1.0):
            passed(state, way * 600.0, through)
            with pytest.raises(UserError, match="meets the Earth"):
                passed(state, way * period, through)
    with pytest.raises(UserError, match="meets the Earth"):
        passed(by_two_bodies(6000.0, 0.0, 0.0), 1.0, through)
    # 120 km above the surface and low, but not within
    passed(by_two_bodies(6500.0, 0.001, 10.0), 20_000.0, through)
