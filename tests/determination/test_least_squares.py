"""The least squares that orbits are fitted by, on models that are not orbits; and with Orekit as the model of real tracking."""

import importlib.util
import os
import subprocess
import sys

import numpy as np
import pytest
from scipy.optimize import least_squares

from ground.determination.least_squares import adjusted
from sboc_e2e.icd.errors import UserError

RESOURCES = "SBOC_OREKIT_RESOURCES"
T = np.linspace(0.0, 3.0, 40)
TRUTH = np.array([2.0, 0.7, 0.3])


def decay(seen: np.ndarray, sigma: float, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Whitened residuals and partials of an exponential over a constant."""
    shape = np.exp(-x[1] * T)
    slope = -np.column_stack([shape, -x[0] * T * shape, np.ones(len(T))]) / sigma
    return (seen - x[0] * shape - x[2]) / sigma, slope


def seen_with_outliers() -> np.ndarray:
    seen = TRUTH[0] * np.exp(-TRUTH[1] * T) + TRUTH[2] + 0.01 * np.random.default_rng(3).standard_normal(len(T))
    seen[[5, 20]] += 0.045
    return seen


@pytest.mark.parametrize("prior", [np.inf, 0.004])
def test_robust_minima_are_those_of_scipy(prior: float) -> None:
    seen, start = seen_with_outliers(), np.array([1.0, 0.3, 0.29])
    sigma = np.array([np.inf, np.inf, prior])
    found = adjusted(lambda x: decay(seen, 0.01, x), start, sigma, huber_sigma=3.0, reject_sigma=1e3)

    def cost(x: np.ndarray) -> np.ndarray:
        away = np.abs(decay(seen, 0.01, x)[0])
        huber = np.where(away > 3.0, 6.0 * away - 9.0, away**2)
        return np.sqrt(np.append(huber, ((x - start) / sigma) ** 2))

    expected = least_squares(cost, TRUTH, xtol=1e-14, ftol=1e-14, gtol=1e-14).x
    assert found.converged
    # a tenth of a sigma: where the steps end
    assert (np.abs(found.unknowns - expected) < 0.1 * np.sqrt(np.diag(found.covariance))).all()
    assert (found.weights < 1.0).sum() >= 2


def test_a_model_that_fails_at_the_start_or_is_blind_is_refused() -> None:
    def broken(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        raise UserError("no model")

    with pytest.raises(UserError, match="no model"):
        adjusted(broken, np.zeros(3), np.full(3, np.inf), huber_sigma=3.0, reject_sigma=6.0)
    with pytest.raises(UserError, match="do not determine"):
        adjusted(lambda x: (x[:1] - 1.0, np.eye(1, 3)), np.zeros(3), np.full(3, np.inf), huber_sigma=3.0, reject_sigma=6.0)


def test_the_published_orbit_of_w3b_by_our_filter_and_the_peers_models() -> None:
    """State, offsets, leak, drag, residuals and variances, all within the tolerances that Orekit's own test states."""
    if RESOURCES not in os.environ:
        pytest.skip(f"{RESOURCES} does not name src/test/resources of Orekit's source")
    if importlib.util.find_spec("orekit_jpype") is None:
        pytest.skip('Orekit is not installed: pip install "sboc-e2e[orekit]", and Java 11 or newer')
    # its data are not those of other tests of one Java machine
    command = [sys.executable, "-m", "tests.benchmarks.published_tracking", os.environ[RESOURCES]]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "33 of 33 within" in done.stdout


def test_a_model_with_noise_of_its_own_settles_where_no_step_can_be_told_from_it() -> None:
    """A propagator is such a model: its error control takes other steps for a start that is a micrometre away."""
    seen = TRUTH[0] * np.exp(-TRUTH[1] * T) + TRUTH[2]

    def rough(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        value, slope = decay(seen, 0.01, x)
        return value + 0.3 * np.random.default_rng(int.from_bytes(x.tobytes()[:8], "little")).standard_normal(len(T)), slope

    free = np.full(3, np.inf)
    found = [adjusted(rough, TRUTH + shift, free, huber_sigma=3.0, reject_sigma=8.0) for shift in (0.0, 0.1, -0.1, 0.2)]
    assert all(one.converged for one in found)
    # the model's noise is 0.3 of a measurement's
    assert all((np.abs(one.unknowns - TRUTH) < 1.5 * np.sqrt(np.diag(one.covariance))).all() for one in found)


@pytest.mark.parametrize("scale", [1.0, 2.0, 4.0])
def test_steps_into_where_there_is_no_model_are_damped(scale: float) -> None:
    """Newton's steps overshoot the zero of an arctangent; the first one ends where the model fails, as an orbit does that meets
    the Earth."""
    zero, sigma, free = 0.55, 0.01, np.array([np.inf])
    failed_first = 0
    for start in np.linspace(0.6, 3.0, 25):
        for edge in np.linspace(0.0, 0.54, 10):
            calls: list[float] = []

            def model(x: np.ndarray, edge: float = edge, calls: list[float] = calls) -> tuple[np.ndarray, np.ndarray]:
                calls.append(float(x[0]))
                if x[0] < edge:
                    raise UserError("no model")
                away = scale * (x[0] - zero)
                return np.full(20, np.arctan(away) / sigma), np.full((20, 1), scale / (1.0 + away**2) / sigma)

            found = adjusted(model, np.array([start]), free, huber_sigma=3.0, reject_sigma=1e6)
            assert found.converged
            assert found.unknowns[0] == pytest.approx(zero, abs=0.1 * sigma / scale / np.sqrt(20.0))
            failed_first += len(calls) > 1 and calls[1] < edge
    assert failed_first > 100
