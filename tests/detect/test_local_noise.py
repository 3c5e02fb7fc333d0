"""Thresholds that follow the lines beside a detection."""

import numpy as np
import pytest

from onboard.detect.line_integral import local_noise

OFFSET = np.array([side * (12.0 + 3.0 * k) for k in range(22) for side in (1.0, -1.0)])


def test_white_noise_leaves_a_detection_as_it_is() -> None:
    """In 400 draws the S/N falls by 0.1 on average, and by more than 0.5 in one of fifty."""
    rng = np.random.default_rng(1)
    local = np.array([local_noise.locally(8.0, rng.standard_normal(44), OFFSET) for _ in range(400)])
    assert (local <= 8.0).all()
    assert local.mean() > 7.85
    assert np.mean(local < 7.5) < 0.04


def test_lines_that_scatter_twice_as_much_halve_the_significance() -> None:
    rng = np.random.default_rng(2)
    local = np.array([local_noise.locally(8.0, 2.0 * rng.standard_normal(44), OFFSET) for _ in range(100)])
    assert local.mean() == pytest.approx(8.0 / 2.0 / 0.84, rel=0.06)


def test_a_crest_on_which_all_lines_are_bright_is_taken_off() -> None:
    """A wave of 200 px period and amplitude 4, a detection of 9 on its crest: 5 and what a cubic misses are left."""
    rng = np.random.default_rng(3)
    wave = 4.0 * np.cos(2.0 * np.pi * OFFSET / 200.0)
    local = np.array([local_noise.locally(9.0, wave + rng.standard_normal(44), OFFSET) for _ in range(100)])
    assert local.mean() == pytest.approx(5.9, abs=0.3)


def test_another_trail_beside_it_does_not_raise_the_threshold() -> None:
    rng = np.random.default_rng(4)
    values = rng.standard_normal(44)
    lit = values.copy()
    lit[10] += 60.0
    assert local_noise.locally(8.0, lit, OFFSET) == pytest.approx(local_noise.locally(8.0, values, OFFSET), abs=0.4)


def test_too_few_lines_say_nothing() -> None:
    assert local_noise.locally(8.0, np.full(23, 5.0), OFFSET[:23]) == 8.0
