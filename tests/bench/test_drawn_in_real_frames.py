"""Trails drawn into frames of others: their shape against the closed form, their light against the frame's scatter."""

import math

import numpy as np
import pytest

from tests.benchmarks.drawn_in_real_frames import (
    METEORS,
    SATELLITES,
    drawn,
    from_border_to_border,
    scatter_at,
    star_sigma_px,
    with_trails,
)


def test_a_drawn_trail_has_a_gaussian_across_and_its_ends_where_its_light_is_half() -> None:
    sigma, (row, first, last) = 1.2, (40.0, 30.0, 90.0)
    where, light = drawn((80, 120), (row, first, row, last), sigma, "even")
    image = np.zeros((80, 120))
    image[where] = light
    assert image.max() == pytest.approx(1.0)
    across = image[36:45, 60] / image[40, 60]
    assert across == pytest.approx(np.exp(-0.5 * (np.arange(-4.0, 5.0) / sigma) ** 2), abs=1e-6)
    assert image[40, [30, 90]] == pytest.approx([0.5, 0.5], abs=0.02)
    assert image.sum() == pytest.approx(math.sqrt(2.0 * math.pi) * sigma * (last - first), rel=0.01)


def test_trails_are_as_bright_as_they_say_and_repeat_with_the_seed() -> None:
    noise = np.random.default_rng(1).normal(100.0, 2.0, (400, 500))
    assert scatter_at(noise, 200.0, 250.0) == pytest.approx(2.0, rel=0.05)
    image, again = noise.copy(), noise.copy()
    trails = list(with_trails(image, 3, np.random.default_rng(7)))
    assert trails == list(with_trails(again, 3, np.random.default_rng(7)))
    assert np.array_equal(image, again)
    assert len(trails) == 3
    assert all(METEORS.peaks[0] <= one["peak"] <= METEORS.peaks[1] for one in trails)
    brightest = max(one["peak"] for one in trails)
    whole = np.clip(np.rint(3.0 * noise) / 3.0, 0.0, 255.0)  # the light is rounded to thirds where a frame holds bytes
    assert (image - whole).max() == pytest.approx(2.0 * brightest, rel=0.1, abs=1.0)


def test_trails_are_as_wide_as_the_stars_where_these_tell() -> None:
    """Gaussians of 1.5 px; the light within a pixel adds a twelfth of its square."""
    rng = np.random.default_rng(3)
    noise = rng.normal(100.0, 1.0, (400, 400))
    assert star_sigma_px(noise) is None
    row, col = np.mgrid[:400, :400].astype(float)
    sky = noise.copy()
    for r, c in rng.uniform(20.0, 380.0, (40, 2)):
        sky += rng.uniform(100.0, 300.0) * np.exp(-0.5 * ((row - r) ** 2 + (col - c) ** 2) / 1.5**2)
    assert star_sigma_px(sky) == pytest.approx(1.5, rel=0.07)
    widths = [one["sigma_px"] for one in with_trails(sky, 3, rng)]
    assert len(widths) == 3
    assert min(widths) > 1.35
    assert max(widths) < 2.3


def test_satellites_cross_the_frame_or_lie_within_it() -> None:
    """Four in ten go from border to border, and shine there as in the middle."""
    assert from_border_to_border((30.0, 50.0), 0.0, (61, 101)) == pytest.approx((30.0, 0.0, 30.0, 100.0))
    assert from_border_to_border((20.0, 20.0), math.pi / 4.0, (61, 101)) == pytest.approx((0.0, 0.0, 60.0, 60.0))
    image = np.random.default_rng(2).normal(100.0, 2.0, (500, 600))
    every = []
    for seed in range(30):
        lit = image.copy()
        (one,) = with_trails(lit, 1, np.random.default_rng(seed), SATELLITES)
        every.append(one)
        row0, col0, row1, col1 = one["ends"]
        on_border = {row0, row1} <= {0.0, 499.0} or bool({col0, col1} & {0.0, 599.0})
        assert on_border == one["crosses"]
        if one["crosses"] and one["peak"] > 5.0:
            light = (lit - image)[round(row0), round(col0)]
            assert light > 1.2 * one["peak"]  # of 2 ADU times the peak, less what half a pixel beside the middle lacks
    assert 6 <= sum(one["crosses"] for one in every) <= 18
    assert all(0.7 <= one["peak"] <= 30.0 for one in every)
