"""Orbits and what a visit tells of them: against integrated motion and plain linear algebra."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from ground.planning.information import Knowledge, gains, updated
from ground.planning.options import KnowledgeOptions
from ground.planning.worth import element_sigma, equinoctial, positions, views_of

MU = 398600.4418


def state_of(a: float, e: float, i_deg: float, node_deg: float, perigee_deg: float) -> np.ndarray:
    """A state at perigee, from the textbook's rotations."""
    i, node, perigee = np.radians([i_deg, node_deg, perigee_deg])
    turn = np.eye(3)
    for angle, axis in ((perigee, 2), (i, 0), (node, 2)):
        c, s = np.cos(angle), np.sin(angle)
        step = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]]) if axis == 2 else np.array([[1.0, 0, 0], [0, c, -s], [0, s, c]])
        turn = step @ turn
    speed = np.sqrt(MU / a * (1 + e) / (1 - e))
    return np.concatenate([turn @ [a * (1 - e), 0, 0], turn @ [0, speed, 0]])


ORBITS = [
    (42164.0, 1e-4, 0.05, 10, 20),
    (26560.0, 0.7, 63.4, 200, 270),
    (7000.0, 0.02, 98.0, 50, 130),
    (30000.0, 0.3, 120.0, 5, 7),
]


@pytest.mark.parametrize("orbit", ORBITS)
@pytest.mark.parametrize("dt_s", [0.0, 3000.0, 100_000.0])
def test_positions_are_those_of_integrated_two_body_motion(orbit: tuple[float, ...], dt_s: float) -> None:
    state = state_of(*orbit)
    got = positions(equinoctial(state[None]), np.array([dt_s]))[0]

    def slope(_: float, y: np.ndarray) -> np.ndarray:
        return np.concatenate([y[3:], -MU * y[:3] / np.linalg.norm(y[:3]) ** 3])

    want = state if dt_s == 0 else solve_ivp(slope, (0, dt_s), state, method="DOP853", rtol=1e-12, atol=1e-9).y[:, -1]
    assert np.linalg.norm(got - want[:3]) < 1e-3  # km


def test_gain_is_half_the_log_of_the_ratio_of_determinants() -> None:
    rng = np.random.default_rng(3)
    half = rng.normal(size=(5, 6, 6))
    covariance = half @ np.swapaxes(half, 1, 2)
    told = rng.normal(size=(5, 2, 6))
    after = np.linalg.inv(np.linalg.inv(covariance) + np.swapaxes(told, 1, 2) @ told)
    want = 0.5 * (np.linalg.slogdet(covariance)[1] - np.linalg.slogdet(after)[1])
    assert gains(covariance, told) == pytest.approx(want, rel=1e-9)
    assert updated(covariance, told) == pytest.approx(after, rel=1e-6, abs=1e-9)


def test_a_visit_tells_in_units_of_both_errors() -> None:
    """Seen from the Earth's centre, an error of the mean longitude is an angle on the sky, divided by the visit's error."""
    state = state_of(42164.0, 1e-6, 0.01, 0, 0)
    knowledge = KnowledgeOptions(along_km=42.164, across_km=1.0, drift_km_day=1.0)
    one = np.array([0])
    views = views_of(state[None], np.array([0.0]), one, one, state[None, :3], np.array([1e-4]), knowledge)
    assert np.hypot(*views.told[0, :, 5]) == pytest.approx(1e-3 / 1e-4, rel=1e-3)
    day = views_of(state[None], np.array([86400.0]), one, one, positions(equinoctial(state[None]), np.array([86400.0])),
                   np.array([1e-6]), knowledge)  # fmt: skip
    assert np.hypot(*day.told[0, :, 0]) * 1e-6 * 42164.0 == pytest.approx(1.0, rel=1e-3)  # drifted by 1 km in a day
    assert element_sigma(np.array([42164.0]), knowledge)[0, 5] == pytest.approx(1e-3)


def test_schedules_that_share_their_past_know_what_each_of_them_has_seen() -> None:
    """Against matrices of their own: 40 visits of four schedules, some of them dropped, so that the pool is packed."""
    rng = np.random.default_rng(2)
    n, schedules = 7, 4
    pool = Knowledge(np.broadcast_to(np.eye(6), (n, 6, 6)).copy())
    places, own = np.arange(n)[None], np.broadcast_to(np.eye(6), (1, n, 6, 6)).copy()
    for _ in range(200):
        target = rng.choice(n, 3, replace=False)
        told = rng.normal(size=(3, 2, 6))
        places = pool.packed(places)
        want = [gains(one[target], told) for one in own]
        assert pool.gains(places, target, told) == pytest.approx(np.array(want), rel=1e-9)
        pick = rng.integers(len(own), size=schedules)
        members = [rng.permutation(3)[: rng.integers(0, 4)] for _ in pick]
        places = np.stack([pool.after(places[k], target[m], told[m]) for k, m in zip(pick, members, strict=True)])
        grown = []
        for k, m in zip(pick, members, strict=True):
            grown.append(own[k].copy())
            grown[-1][target[m]] = updated(own[k][target[m]], told[m])
        own = np.stack(grown)
