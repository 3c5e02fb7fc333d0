"""The likelihood of a trail's ends, pixel by pixel, against normal densities from scipy."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import norm

from ground.streaks.end_posterior import both_ends, one_end
from ground.streaks.end_search import at_density, running_ratio

WIDTH_PX, DENSITY, NOISE_DENSITY = 1.1, 22.0, 20.0
Array = NDArray[np.float64]


def strip(length_px: float, seed: int) -> tuple[Array, Array, Array, Array]:
    """Pixels of a strip of five rows by ascending u: u, template, values and variances; the trail lies in the middle."""
    rng = np.random.default_rng(seed)
    u, v = (c.ravel() for c in np.mgrid[-40.0:41.0, -2.0:3.0])
    u = u + rng.uniform(-0.3, 0.3, u.size)
    order = np.argsort(u)
    u, v = u[order], v[order]
    template = norm.pdf(v, scale=WIDTH_PX)
    variance = rng.uniform(80.0, 120.0, u.size)
    light = DENSITY * template * (norm.cdf((u + 0.5 * length_px) / WIDTH_PX) - norm.cdf((u - 0.5 * length_px) / WIDTH_PX))
    return u, template, rng.normal(light, np.sqrt(variance + light)), variance


def log_ratio(pixels: tuple[Array, Array, Array, Array], share: Array) -> float:
    """Log probability of the pixels lit by these shares over that of dark ones."""
    _, template, value, variance = pixels
    lit = norm.logpdf(value, DENSITY * template * share, np.sqrt(variance + NOISE_DENSITY * template * share))
    return float(np.sum(lit - norm.logpdf(value, 0.0, np.sqrt(variance))))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_likelihood_of_one_end(sign: float) -> None:
    """Of the pixels on its side of the middle alone, which the other end does not reach."""
    pixels = strip(40.0, 3)
    u, template, value, variance = pixels
    split = int(np.searchsorted(u, 0.0))
    grid = sign * np.linspace(-28.0, -12.0, 33)
    running = running_ratio(template, value, variance, NOISE_DENSITY)
    got = at_density(one_end(grid, sign, u, template, value, variance, NOISE_DENSITY, running, split, WIDTH_PX), DENSITY)
    side = slice(0, split) if sign > 0.0 else slice(split, None)
    own = tuple(x[side] for x in pixels)
    wanted = [log_ratio((own[0], own[1], own[2], own[3]), norm.cdf(sign * (own[0] - end) / WIDTH_PX)) for end in grid]
    assert got == pytest.approx(np.array(wanted), abs=0.02)  # edges end at 3.4 widths
    assert np.ptp(wanted) > 5.0


def test_the_likelihood_of_both_ends_of_a_short_trail() -> None:
    pixels = strip(5.0, 4)
    grid0, grid1 = np.linspace(-6.0, 1.0, 15), np.linspace(-1.0, 6.0, 15)
    got = at_density(both_ends(grid0, grid1, *pixels, NOISE_DENSITY, WIDTH_PX), DENSITY)
    for a, end0 in enumerate(grid0):
        for b, end1 in enumerate(grid1):
            if end1 < end0:
                assert got[a, b] == -np.inf
                continue
            share = norm.cdf((pixels[0] - end0) / WIDTH_PX) - norm.cdf((pixels[0] - end1) / WIDTH_PX)
            assert got[a, b] == pytest.approx(log_ratio(pixels, share), abs=0.02)
