"""The fitter's closed-form trail against brute-force integration, and its derivatives against finite differences."""

import math
from dataclasses import replace

import numpy as np
import pytest

from ground.streaks import trail_model
from ground.streaks.centre_line import effective_width_px
from ground.streaks.trail_frame import TrailFrame
from ground.streaks.trail_model import DENSITY, END0, END1, LN_WIDTH, N_PARAMETERS, Q1, SAGITTA, SLOPE, V_MID
from tests.streaks.trail_rendering import Trail, render, strip, trail_at


def model_image(trail: Trail, row: np.ndarray, col: np.ndarray) -> np.ndarray:
    """The fitter's model of a trail on the given pixels."""
    frame = TrailFrame.of_chord(trail.row0, trail.col0, trail.row1, trail.col1)
    u, v = frame.to_trail(row, col)
    half = 0.5 * trail.length_px
    p = np.zeros(N_PARAMETERS)
    p[DENSITY], p[END0], p[END1] = trail.flux_e / trail.length_px, -half, half
    p[LN_WIDTH] = math.log(effective_width_px(trail.sigma_px))
    p[SAGITTA], p[V_MID], p[Q1] = trail.sagitta_px, 2.0 / 3.0 * trail.sagitta_px, 0.5 * trail.gradient
    quartic = trail_model.quartic_px4(frame.angle_rad)
    return trail_model.mean_all(p, u, v, (half, 0.0, 0.0, quartic))


@pytest.mark.parametrize("angle_deg", [0.0, 13.0, 45.0, 88.0])
@pytest.mark.parametrize("sigma_px", [0.6, 0.85, 1.5])
def test_pixel_integration_is_exact_to_a_few_thousandths_of_the_peak(angle_deg: float, sigma_px: float) -> None:
    """The widened Gaussian with its fourth cumulant stands for a PSF integrated over square pixels."""
    rng = np.random.default_rng(2)
    trail = replace(trail_at(rng, 30.0, angle_rad=math.radians(angle_deg), sigma_px=sigma_px), flux_e=1000.0)
    row, col = strip(trail, margin_px=8.0, half_px=8.0)
    truth, model = render(trail, row, col), model_image(trail, row, col)
    tolerance = {0.6: 0.012, 0.85: 0.004, 1.5: 0.001}[sigma_px]
    assert np.abs(model - truth).max() < tolerance * truth.max()
    assert model.sum() == pytest.approx(truth.sum(), rel=1e-3)


def test_curved_and_uneven_trails_match_the_rendering() -> None:
    """Sagitta and gradient mean what the contract says: height over the chord towards (+drow, -dcol), end to end change."""
    rng = np.random.default_rng(3)
    trail = replace(trail_at(rng, 120.0, angle_rad=0.4), flux_e=5000.0, sagitta_px=1.0, gradient=0.4)
    row, col = strip(trail, margin_px=8.0, half_px=10.0)
    truth, model = render(trail, row, col), model_image(trail, row, col)
    assert np.abs(model - truth).max() < 0.01 * truth.max()


def test_score_and_fisher_matrix_match_finite_differences() -> None:
    """Analytic derivatives of all nine parameters."""
    rng = np.random.default_rng(4)
    u, v = rng.uniform(-16.0, 16.0, 400), rng.uniform(-3.0, 3.0, 400)
    value, variance = rng.normal(5.0, 3.0, 400), np.full(400, 8.0)
    p = np.array([30.0, -10.3, 11.2, 0.2, 0.3, 0.4, 0.15, -0.1, math.log(0.95)])
    index = np.arange(N_PARAMETERS)
    gradient, fisher = np.empty(N_PARAMETERS), np.empty((N_PARAMETERS, N_PARAMETERS))
    lengths = (11.0, 0.3, 0.5, 0.0)
    trail_model.accumulate(p, u, v, value, variance, lengths, index, gradient, fisher)

    def image(q: np.ndarray) -> np.ndarray:
        return trail_model.mean_all(q, u, v, lengths)

    mean = image(p)
    used = mean > 1e-4 * mean.max()  # both sides leave out pixels beyond 4.5 widths
    weight = np.where(used, 1.0 / (variance + mean), 0.0)
    jacobian = []
    for k in range(N_PARAMETERS):
        step = np.zeros(N_PARAMETERS)
        step[k] = 1e-5 * max(abs(p[k]), 1.0)
        jacobian.append((image(p + step) - image(p - step)) / (2.0 * step[k]))
    jacobian = np.array(jacobian)
    scale = np.sqrt(np.diag(fisher))
    np.testing.assert_allclose(
        (jacobian * weight) @ jacobian.T / np.outer(scale, scale), fisher / np.outer(scale, scale), atol=2e-3
    )
    np.testing.assert_allclose(jacobian @ (weight * (value - mean)) / scale, gradient / scale, atol=0.02)


def test_an_end_beyond_the_image_has_no_score() -> None:
    """Edge-cut trails: an end far outside neither moves nor limits the fit."""
    p = np.zeros(N_PARAMETERS)
    p[DENSITY], p[END0], p[END1], p[LN_WIDTH] = 10.0, -1e7, 5.0, 0.0
    gradient, fisher = np.empty(2), np.empty((2, 2))
    u, v = np.linspace(-20.0, 10.0, 90), np.zeros(90)
    index, ones = np.array([END0, SLOPE]), np.ones(90)
    trail_model.accumulate(p, u, v, ones, ones, (10.0, 0.0, 0.0, 0.0), index, gradient, fisher)
    assert gradient[0] == 0.0
    assert fisher[0, 0] == 0.0


def test_axes_round_trip() -> None:
    """Pixels to trail axes and back; v points towards (+drow, -dcol)."""
    frame = TrailFrame.of_chord(10.0, 20.0, 40.0, 60.0)
    row, col = frame.to_pixel(7.0, 1.5)
    u, v = frame.to_trail(np.array([row]), np.array([col]))
    assert (u[0], v[0]) == pytest.approx((7.0, 1.5))
    assert TrailFrame.of_chord(0.0, 0.0, 0.0, 10.0).to_trail(np.array([1.0]), np.array([0.0]))[1][0] == pytest.approx(1.0)


def test_image_limits_lie_half_a_pixel_outside_the_outermost_centres() -> None:
    """Where a trail enters and leaves the image."""
    low, high = TrailFrame.of_chord(5.0, 2.0, 5.0, 8.0).image_limits((11, 21))
    assert (low, high) == pytest.approx((-5.5, 15.5))


def test_pixel_variance_is_that_of_a_unit_square() -> None:
    """1/12 along any direction."""
    x = (np.arange(1000) + 0.5) / 1000 - 0.5
    a, b = np.meshgrid(x, x)
    for angle in (0.0, 0.3, 0.7):
        assert np.var(a * math.cos(angle) + b * math.sin(angle)) == pytest.approx(trail_model.PIXEL_VARIANCE_PX2, rel=1e-5)
        fourth = np.mean((a * math.cos(angle) + b * math.sin(angle)) ** 4) - 3.0 * trail_model.PIXEL_VARIANCE_PX2**2
        assert fourth == pytest.approx(trail_model.quartic_px4(angle), rel=1e-4)
