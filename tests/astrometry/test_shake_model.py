"""The shake of a camera at shutter open and close: a random walk in closed form, a Markov process by draws."""

import numpy as np
import pytest

from ground.sky.shake_model import SHARES, STEADY, end_shake

EXPOSURE_S, STEP_S = 1.0, 2.0


def test_a_random_walk_in_closed_form() -> None:
    """Of a walk of unit variance a second: ends about a mean T / 4 and T / 12, the slope's error and the rate's by neighbours."""
    t, p = EXPOSURE_S, STEP_S
    rate = (2.0 * p - t / 3.0) / (4.0 * p**2) + 1.0 / t - 1.0 / p
    slope = 0.25 * t**2 * (rate + 0.2 / t)
    found = end_shake(1.0, t, p)
    assert found.turn == pytest.approx(np.sqrt(0.25 * t**2 * rate / slope), rel=2e-3)
    assert found.sways[0] == pytest.approx(np.sqrt(t / 12.0 / slope), rel=2e-3)
    assert found.sways[-1] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("memory_s", [2.0, 0.5, 0.2])
def test_a_process_with_memory_by_draws(memory_s: float) -> None:
    """The factor that its slopes show gives the ends of its exposures back: 3 % of 20,000 draws."""
    rng, places = np.random.default_rng(3), 60
    within = ((np.arange(places) + 0.5) / places - 0.5) * EXPOSURE_S
    t_s = np.concatenate(
        [np.append(k * STEP_S + within, k * STEP_S + 0.5 * EXPOSURE_S * np.array([-1.0, 1.0])) for k in range(4)]
    )
    covariance = np.exp(-np.abs(t_s[:, None] - t_s) / memory_s)
    path = (rng.standard_normal((20_000, len(t_s))) @ np.linalg.cholesky(covariance + 1e-10 * np.eye(len(t_s))).T).reshape(
        -1, 4, places + 2
    )
    exposed, ends = path[..., :places], path[..., places:]
    mean = exposed.mean(axis=-1)
    half = 0.5 * EXPOSURE_S
    slope = half * (exposed[:, 1] @ within / (within @ within) - (mean[:, 2] - mean[:, 0]) / (2.0 * STEP_S))
    third = mean[:, 3] - 3.0 * mean[:, 2] + 3.0 * mean[:, 1] - mean[:, 0]
    walk = np.var(third) / (6.0 * STEP_S - 10.0 / 3.0 * EXPOSURE_S)
    of_walk = walk * half**2 * ((2.0 * STEP_S - EXPOSURE_S / 3.0) / (4.0 * STEP_S**2) + 1.2 / EXPOSURE_S - 1.0 / STEP_S)
    found = end_shake(float(np.std(slope) / np.sqrt(of_walk)), EXPOSURE_S, STEP_S)
    turned = 0.5 * (ends[:, 1, 1] - ends[:, 1, 0]) - half * (mean[:, 2] - mean[:, 0]) / (2.0 * STEP_S)
    swayed = 0.5 * ends[:, 1].sum(axis=-1) - mean[:, 1]
    assert found.turn == pytest.approx(np.std(turned) / np.std(slope), rel=0.03)
    assert found.sways[0] == pytest.approx(np.std(swayed) / np.std(slope), rel=0.03)


def test_short_trails_show_the_mean_of_the_exposure() -> None:
    """The ends of a long trail have all of the sway, those of one shorter than it is wide none; nor has a run of one frame."""
    found = end_shake(1.2, EXPOSURE_S, STEP_S)
    assert found.sway(5000.0, 0.9) == pytest.approx(found.sways[0], rel=1e-2)
    assert found.sway(1.0, 0.9) == pytest.approx(0.0, abs=1e-6)
    assert list(found.sways) == sorted(found.sways, reverse=True)
    assert len(found.sways) == len(SHARES)
    assert end_shake(1.0, EXPOSURE_S, 0.0) == STEADY
