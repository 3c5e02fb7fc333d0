"""Bright trails fitted with everything free: slopes against differences, and the truth of drawn trails."""

import math

import numpy as np
import pytest

from onboard.stars.trail_vectors import _normal, _shape, fitted_vectors
from sboc_e2e.icd.signals import StarMotion
from tests.benchmarks import sky_frames
from tests.benchmarks.detection_frames import Streak


def test_slopes_are_those_of_the_model() -> None:
    point = (2.3, -0.7, 6.0, 0.9)
    slopes = _shape(*point)[1:]
    for k in range(4):
        step = [1e-5 * (m == k) for m in range(4)]
        ahead, behind = (_shape(*(p + sign * s for p, s in zip(point, step, strict=True)))[0] for sign in (1.0, -1.0))
        assert slopes[k] == pytest.approx((ahead - behind) / 2e-5, rel=1e-5, abs=1e-9)


def test_the_gradient_is_that_of_the_sum_of_squares() -> None:
    rng = np.random.default_rng(0)
    places, values = rng.uniform(-12.0, 12.0, (60, 2)), rng.normal(0.0, 1.0, 60)
    fit = np.array([30.0, 0.4, -0.3, 6.0, 0.7, 0.9])
    matrix, gradient = np.empty((6, 6)), np.empty(6)
    _normal(values, places, fit, matrix, gradient)
    scratch = np.empty((6, 6)), np.empty(6)
    for k in range(6):
        step = np.eye(6)[k] * 1e-5
        ahead, behind = (_normal(values, places, fit + sign * step, *scratch) for sign in (1.0, -1.0))
        assert gradient[k] == pytest.approx(-0.5 * (ahead - behind) / 2e-5, rel=1e-4, abs=1e-6)


@pytest.mark.parametrize(("drow", "dcol"), [(30.0, 12.0), (-3.0, 9.0), (0.0, 50.0)])
def test_places_and_vectors_of_drawn_trails(drow: float, dcol: float) -> None:
    """Trails of S/N 400 with their photon noise: bounds of middle and length of 50 px are 0.05 and 0.1 px; four times that."""
    rng, side = np.random.default_rng(1), 256
    light = np.full((side, side), sky_frames.SKY_E)
    width = sky_frames.width_px(sky_frames.FWHM_PX)
    places = np.array([[60.3, 60.7], [60.1, 180.4], [190.2, 70.9], [185.6, 190.1]])
    for row, col in places:
        streak = Streak(row0=row - drow / 2, col0=col - dcol / 2, row1=row + drow / 2, col1=col + dcol / 2, snr=400.0)
        window, shape = sky_frames.streak_light(streak, light.shape, width)
        light[window] += 400.0 * sky_frames.SIGMA_E / math.sqrt(float(np.sum(shape**2))) * shape
    residual = (sky_frames.exposed(light, rng) - sky_frames.PEDESTAL - sky_frames.SKY_E).astype(np.float32)
    guess = StarMotion(drow=drow + 1.0, dcol=dcol - 2.0, turn_rad=0.0, middle_row=127.5, middle_col=127.5)
    at, vectors, widths, work = fitted_vectors(residual, np.zeros((side, side), np.uint8), places + 1.4, guess, 0.85)
    assert len(at) == 4
    assert np.abs(at - places).max() < 0.2
    assert np.abs(np.abs(vectors @ (drow, dcol)) / math.hypot(drow, dcol) - math.hypot(drow, dcol)).max() < 0.4
    assert np.median(widths) == pytest.approx(width, abs=0.06)
    assert work > 0
