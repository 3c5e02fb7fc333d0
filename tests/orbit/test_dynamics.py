"""Propagation against an independent integration of an independently written force, and elements against closed forms."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from ground.orbit.breakup import state_of_elements
from ground.orbit.dynamics import elements, propagate

MU = 398600.4418


def oblate_gravity(_: float, y: np.ndarray) -> np.ndarray:
    """Gradient of mu/r (1 - J2 (R/r)^2 P2(sin lat)), differentiated by hand in another form than the module's."""
    r = np.linalg.norm(y[:3])
    sine = y[2] / r
    k = 1.5 * 1.0826359e-3 * (6378.1366 / r) ** 2
    radial = -MU / r**2 * (1.0 + k * (1.0 - 3.0 * sine**2))
    polar = -MU / r**2 * k * 2.0 * sine
    # d/dr along r, and the part along the pole that is left once the radial share 5 sin^2 is split off
    force = radial * y[:3] / r + polar * (np.array([0.0, 0.0, 1.0]) - sine * y[:3] / r)
    return np.concatenate([y[3:], force])


@pytest.mark.parametrize(
    ("a_km", "e", "dt_s", "tolerance_km"),
    [(7078.0, 0.001, 30.0, 1e-6), (6800.0, 0.02, -300.0, 1e-4), (42164.0, 0.0005, 1800.0, 1e-5)],
)
def test_propagation_matches_scipy(a_km: float, e: float, dt_s: float, tolerance_km: float) -> None:
    """Runge-Kutta with fixed steps against DOP853 at 1e-12, to a metre at worst over five minutes of low orbit."""
    start = state_of_elements(np.array([[a_km, e, 1.2]]), np.array([[0.3, 1.1, 2.0]]))[0]
    reference = solve_ivp(oblate_gravity, (0.0, dt_s), start, method="DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
    got = propagate(start, np.array([dt_s]))[0]
    np.testing.assert_allclose(got[:3], reference[:3], atol=tolerance_km)


def test_elements_invert_states() -> None:
    """Elements of states made from elements, circular to strongly eccentric."""
    rng = np.random.default_rng(3)
    wanted = np.column_stack([rng.uniform(6600, 42000, 200), 10 ** rng.uniform(-4, -0.1, 200), rng.uniform(0.01, 3.1, 200)])
    states = state_of_elements(wanted, rng.random((200, 3)) * 2 * np.pi)
    got = np.array([elements(*state) for state in states])
    np.testing.assert_allclose(got[:, 0], wanted[:, 0], rtol=1e-9)
    np.testing.assert_allclose(got[:, 1], wanted[:, 1], atol=1e-9)
    np.testing.assert_allclose(got[:, 2], wanted[:, 2], atol=1e-8)
