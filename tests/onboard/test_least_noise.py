"""Tiles of a compressed picture that lost their noise take what the other tiles kept."""

from typing import Any

import numpy as np
import pytest

from onboard.image.least_noise import LEAST_SIGMA, with_least_noise
from tests.benchmarks.other_skies import chain, frame

SIDE = 512


def test_a_tile_without_noise_takes_the_least_quarter_of_the_others() -> None:
    sigma = np.array([[1e-7, 0.0, 0.8], [1.0, 1.2, 9.0]], np.float32)
    assert np.allclose(with_least_noise(sigma, 1.0), [[0.95, 0.95, 0.8], [1.0, 1.2, 9.0]])
    assert with_least_noise(sigma, 1e-8) is not sigma, "the tile of 0 lost its noise in any unit"
    assert np.allclose(with_least_noise(np.zeros((2, 2), np.float32), 2.0), 2.0 * LEAST_SIGMA)


def test_noise_above_that_of_rounding_stays() -> None:
    sigma = np.array([[0.3, 0.5], [4.0, 0.31]], np.float32)
    assert with_least_noise(sigma, 1.0) is sigma


def picture() -> np.ndarray:
    """Noise of one count in the upper quarter, one value below it, and a trail of 30 counts there."""
    rng = np.random.default_rng(11)
    row, col = np.mgrid[:SIDE, :SIDE].astype(float)
    sky = np.full((SIDE, SIDE), 40.0)
    sky[: SIDE // 4] += rng.normal(0.0, 1.0, (SIDE // 4, SIDE))
    across = np.abs(0.6 * (row - 330.0) - 0.8 * (col - 250.0))
    along = 0.8 * (row - 330.0) + 0.6 * (col - 250.0)
    sky += 30.0 * np.exp(-0.5 * across**2) * (np.abs(along) < 60.0)
    return np.rint(sky).astype(np.uint16)


def test_a_trail_in_tiles_of_one_value_is_found_and_has_an_snr_that_means_something() -> None:
    """Its S/N was 1e7 and more, as what rounding left of 0 was the noise."""
    work: Any = chain(SIDE)
    prepared = work.prepare(work.initial_state(), frame(0, picture()))
    assert float(prepared.view.background.sigma_adu.min()) > 0.5
    _, result = work.judge(work.initial_state(), prepared)
    best = max(result.detections, key=lambda each: each.length_px)
    assert best.length_px == pytest.approx(120.0, abs=12.0)
    assert 50.0 < best.snr < 2000.0
