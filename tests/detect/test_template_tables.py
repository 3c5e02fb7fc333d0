"""Templates in equal steps and from tables give the sums of the error function and of the Gaussian themselves."""

import math

import numpy as np
import pytest
from scipy.special import erf

from onboard.detect.line_integral.point_movers import _erf, _short_snr
from onboard.detect.line_integral.varied import light_along
from onboard.detect.whiten import UNIT

IMAGE = np.clip(np.random.default_rng(4).normal(3.0, 16.0, (90, 130)), -127, 127).astype(np.int8)
CLEAR = np.zeros(IMAGE.shape, dtype=np.uint8)
ROWS, COLS = (part.astype(np.float64) for part in np.indices(IMAGE.shape))


def test_the_error_function_is_met_to_a_millionth() -> None:
    x = np.linspace(-7.0, 7.0, 5001)
    assert np.abs([_erf(value) for value in x] - erf(x)).max() < 1e-6


@pytest.mark.parametrize("sigma_px", [0.6, 2.0, 8.0])
@pytest.mark.parametrize("angle_rad", [0.0, 0.0005, 0.7, math.pi / 2, 2.6])
def test_a_short_trail_has_the_matched_sum_of_its_template(sigma_px: float, angle_rad: float) -> None:
    length, d_row, d_col = 14.0, math.sin(angle_rad), math.cos(angle_rad)
    u = (ROWS - 44.3) * d_row + (COLS - 61.8) * d_col
    v = (ROWS - 44.3) * d_col - (COLS - 61.8) * d_row
    root = 1.0 / (math.sqrt(2.0) * sigma_px)
    t = np.exp(-((v * root) ** 2)) * (erf((u + 0.5 * length) * root) - erf((u - 0.5 * length) * root))
    t[(np.abs(v) > 2.6 * sigma_px) | (np.abs(u) > 0.5 * length + 2.6 * sigma_px)] = 0.0
    reach = math.ceil(0.5 * length + 2.5 * sigma_px)
    t[(np.abs(ROWS - 44) > reach) | (np.abs(COLS - 62) > reach)] = 0.0
    exact = float(np.sum(t * IMAGE) / (16.0 * np.sqrt(np.sum(t * t))))
    assert abs(_short_snr(IMAGE, CLEAR, 0, 44.3, 61.8, d_row, d_col, length, sigma_px) - exact) < 1e-4


@pytest.mark.parametrize("ends", [(20.0, 30.0, 31.0, 90.0), (70.0, 50.0, 15.0, 42.0), (5.0, 120.0, 5.0, 60.0)])
def test_light_along_a_line_is_the_sum_over_the_profile(ends: tuple[float, float, float, float]) -> None:
    """Across tiles of the level, whose borders the line crosses."""
    sigma, level = 4.0, np.random.default_rng(5).normal(size=(6, 9)).astype(np.float32)
    signal, power, moment = light_along(IMAGE, CLEAR, level, 16, np.array(ends), 0.0, 0, sigma)
    length = math.hypot(ends[2] - ends[0], ends[3] - ends[1])
    u_row, u_col = (ends[2] - ends[0]) / length, (ends[3] - ends[1]) / length
    off = (ROWS - ends[0]) * u_col - (COLS - ends[1]) * u_row
    steep = abs(u_row) >= abs(u_col)
    at = (ROWS - ends[0]) / u_row if steep else (COLS - ends[1]) / u_col
    inside = (np.abs(off) <= 3.0 * sigma) & (at >= 0.0) & (at <= length)
    g = np.exp(-0.5 * (off / sigma) ** 2) * inside
    value = (IMAGE - level[ROWS.astype(int) // 16, COLS.astype(int) // 16]) / UNIT
    for found, exact in ((signal, g * value), (power, g * g), (moment, g * value * off)):
        assert abs(found.sum() - exact.sum()) < 1e-3
