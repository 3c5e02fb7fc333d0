"""What detectors deliver, real and false: classes of simulated detections that a vetter has to tell apart.

All are exposures of the little camera of `trail_rendering`; nothing of the fitter's or the vetter's models is used.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from tests.streaks.particle_hits import NUMBERS, SEEN_NUMBERS, Hits, seen
from tests.streaks.trail_rendering import (
    PSF_SIGMA_PX,
    READ_NOISE_E,
    SKY_E,
    VARIANCE_E2,
    Exposure,
    Trail,
    expose,
    render,
    strip,
    trail_at,
)

THRESHOLD_SNR = 7.0
LONGEST_PX = 500.0

HOT_LENGTHS_PX: Final = (6.0, LONGEST_PX)
HOT_LEVELS: Final = (1.2, 30.0)
"""Of bad lines, over the read noise."""

GROUP_PX: Final = 12.0
"""Hits closer than this to one another may be taken for one trail."""


def power_law(rng: np.random.Generator, slope: float, low: float, high: float) -> float:
    """A draw from p(x) ~ x^-slope between low and high."""
    a, b = low ** (1.0 - slope), high ** (1.0 - slope)
    return float((a + rng.random() * (b - a)) ** (1.0 / (1.0 - slope)))


def real_streak(rng: np.random.Generator) -> Exposure:
    """Debris: N(>S) ~ S^-1.05 (size slope 2.1), any length; the PSF is up to 15 % wider than believed.

    30 % change their brightness by up to half along the trail, 15 % tumble, 4 % are out of focus.
    """
    length = power_law(rng, 1.0001, 3.0, LONGEST_PX)
    sigma = PSF_SIGMA_PX * (1.0 + 0.15 * rng.random() ** 2)
    if rng.random() < 0.04:
        sigma = math.hypot(sigma, power_law(rng, 1.5, 0.5, 3.0))
    uneven = float(rng.uniform(-0.5, 0.5)) if rng.random() < 0.3 else 0.0
    tumbles = rng.random() < 0.15
    amplitude, cycles = (float(rng.uniform(0.2, 0.9)), power_law(rng, 1.0001, 0.5, 12.0)) if tumbles else (0.0, 0.0)
    trail = trail_at(rng, length, sigma_px=sigma, gradient=uneven * (1.0 - amplitude), amplitude=amplitude, cycles=cycles)
    return expose(rng, trail, power_law(rng, 2.05, THRESHOLD_SNR, 300.0), half_px=8.0)


def noise_maximum(rng: np.random.Generator) -> Exposure:
    """White noise whose matched-filter statistic for a random segment is S: noise + (S - its own statistic) x template.

    That is the exact distribution of noise given the statistic. S follows the expected Euler characteristic,
    p(S) ~ S^3 exp(-S^2 / 2) above the threshold; lengths are uniform, thinned as rare-event simulations say
    (1.09 at 20 px falling to 0.13 at 1,000 px).
    """
    while True:
        snr = THRESHOLD_SNR + rng.exponential(1.0 / THRESHOLD_SNR)
        extra = snr - THRESHOLD_SNR
        if rng.random() < (snr / THRESHOLD_SNR) ** 3 * math.exp(-0.5 * extra**2) / 1.3:
            return noise_of_statistic(rng, snr)


def noise_of_statistic(rng: np.random.Generator, snr: float) -> Exposure:
    """A noise maximum given its statistic: the rarest ones cost no more than the common ones (conditional injection)."""
    while True:
        length = float(rng.uniform(10.0, LONGEST_PX))
        if rng.random() < math.exp(-length / 350.0):
            break
    shot = expose(rng, trail_at(rng, length), snr, cross_error_px=0.2)
    template = render(shot.trail, shot.pixels.row, shot.pixels.col)
    template /= math.sqrt(float(np.sum(template**2)) / VARIANCE_E2)
    noise = rng.poisson(SKY_E, template.shape) - SKY_E + rng.normal(0.0, READ_NOISE_E, template.shape)
    statistic = float(np.sum(noise * template)) / VARIANCE_E2
    return replace(shot, pixels=replace(shot.pixels, value_e=noise + (snr - statistic) * template))


def particle_track(rng: np.random.Generator) -> Exposure:
    """A track through silicon whose charge spreads by 1 to 4.5 um; one in five is shorter than 3 px."""
    lengths = (0.0, 3.0) if rng.random() < 0.2 else (3.0, math.inf)
    return _silicon(rng, Hits(lengths_px=lengths, spread_px=rng.uniform(0.1, 0.5), trapped=rng.random() < 0.5))


def hit_group(rng: np.random.Generator) -> Exposure:
    """Two to four hits close together, taken for one trail. (What is fitted to a row of them stays below S/N 6.)"""
    count = int(rng.integers(2, 5))
    return _silicon(rng, Hits(count=count, within_px=GROUP_PX, spread_px=rng.uniform(0.1, 0.5), trapped=rng.random() < 0.5))


def _silicon(rng: np.random.Generator, hits: Hits) -> Exposure:
    """One exposure of these hits."""
    return hits.exposure(rng.standard_normal(NUMBERS))


def hot_line(rng: np.random.Generator) -> Exposure:
    """A piece of a noisy column or row, one pixel wide."""
    return hot_line_of(rng.standard_normal(NUMBERS))


def hot_line_of(z: NDArray[np.float64]) -> Exposure:
    """The piece of a noisy column or row of NUMBERS standard normal numbers: lengths even in their logarithm, levels ~ x^-2."""
    u = ndtr(z[:3])
    half = 0.5 * HOT_LENGTHS_PX[0] * (HOT_LENGTHS_PX[1] / HOT_LENGTHS_PX[0]) ** float(u[0])
    low, high = HOT_LEVELS
    level = 1.0 / (1.0 / low + float(u[1]) * (1.0 / high - 1.0 / low))
    centre = 2000.0
    ends = (centre, centre - half, centre, centre + half) if u[2] < 0.3 else (centre - half, centre, centre + half, centre)
    trail = Trail(row0=ends[0], col0=ends[1], row1=ends[2], col1=ends[3], flux_e=level * READ_NOISE_E * 2.0 * half, sigma_px=0.03)
    row, col = strip(trail, margin_px=20.0, half_px=8.0)
    return seen(trail, row, col, render(trail, row, col), z[3 : 3 + SEEN_NUMBERS], z[3 + SEEN_NUMBERS :])


def star_chain(rng: np.random.Generator) -> Exposure:
    """Two to four unlisted stars or star residuals in a row, taken for a trail."""
    length = power_law(rng, 1.5, 6.0, 120.0)
    trail = trail_at(rng, length, sigma_px=PSF_SIGMA_PX)
    row, col = strip(trail, margin_px=25.0, half_px=8.0)
    count = int(rng.integers(2, 5))
    places = np.concatenate([[0.0, 1.0], rng.random(count - 2)])
    stars = [(place, rng.normal(0.0, 0.5), power_law(rng, 2.0, 20.0, 400.0)) for place in places]
    return _of_mean(rng, trail, row, col, _stars_in_a_row(trail, row, col, stars))


def _stars_in_a_row(
    trail: Trail, row: NDArray[np.int32], col: NDArray[np.int32], stars: list[tuple[float, float, float]]
) -> NDArray[np.float64]:
    """Electrons (n,) of stars given by place along the trail (0 to 1), offset across it (px) and flux."""
    cos, sin = trail.axes
    mean = np.zeros(row.shape)
    for place, offset, flux in stars:
        r = trail.row0 + place * trail.length_px * sin + offset * cos
        c = trail.col0 + place * trail.length_px * cos - offset * sin
        mean += render(Trail(row0=r, col0=c - 1e-3, row1=r, col1=c + 1e-3, flux_e=flux, sigma_px=PSF_SIGMA_PX), row, col)
    return mean


LISTED_E: Final = 52.0
FAINTEST_E: Final = 26.0
"""Stars of S/N 5, from which a star list names them, and 2.5, below which they are sky."""

STARS_PER_PX2: Final = 30_600 / 4096**2
"""Above LISTED_E: the truth tables of `sso_antisun` (30,482 and 30,818 in frames 13 and 22; Gaia's counts, docs/physics.md)."""

COUNTS_SLOPE: Final = 0.80
"""-d ln N(> flux) / d ln flux, all sky: 24,000 per frame above S/N 8 to 35,000 above S/N 5."""

UNLISTED_PER_PX2: Final = STARS_PER_PX2 * ((LISTED_E / FAINTEST_E) ** COUNTS_SLOPE - 1.0)
ROW_WIDTH_PX: Final = 2.0
"""Stars within so wide a strip are in a row."""

CHAIN_LENGTHS_PX: Final = (6.0, 120.0)


def chains_per_frame(count: int, length_px: float) -> float:
    """Rows of `count` unlisted stars per px of length in a frame of 4096 x 4096: a pair, and the others between the two.

    Unordered pairs of a Poisson field at a distance, times the Poisson probability of `count` - 2 stars in the strip between.
    """
    pairs = 0.5 * UNLISTED_PER_PX2**2 * 4096**2 * 2.0 * math.pi * length_px
    between = UNLISTED_PER_PX2 * ROW_WIDTH_PX * length_px
    return pairs * between ** (count - 2) * math.exp(-between) / math.factorial(count - 2)


def chain_of_unlisted(rng: np.random.Generator, count: int, length_px: float) -> Exposure:
    """A row of `count` stars that no list names: its ends are stars, the others lie anywhere between (conditional injection)."""
    trail = trail_at(rng, length_px, sigma_px=PSF_SIGMA_PX)
    row, col = strip(trail, margin_px=25.0, half_px=8.0)
    places = np.concatenate([[0.0, 1.0], rng.random(count - 2)])
    half = 0.5 * ROW_WIDTH_PX
    stars = [
        (place, 0.0 if k < 2 else float(rng.uniform(-half, half)), power_law(rng, 1.0 + COUNTS_SLOPE, FAINTEST_E, LISTED_E))
        for k, place in enumerate(places)
    ]
    return _of_mean(rng, trail, row, col, _stars_in_a_row(trail, row, col, stars))


def _of_mean(
    rng: np.random.Generator, trail: Trail, row: NDArray[np.int32], col: NDArray[np.int32], mean: NDArray[np.float64]
) -> Exposure:
    """A noisy exposure of expected electrons."""
    return seen(trail, row, col, mean, rng.standard_normal(SEEN_NUMBERS), rng.standard_normal(row.shape))


CLASSES: dict[str, Callable[[np.random.Generator], Exposure]] = {
    "real": real_streak,
    "noise": noise_maximum,
    "particle": particle_track,
    "hit_group": hit_group,
    "hot_line": hot_line,
    "star_chain": star_chain,
}
"""How to draw a detection of each class."""


def draw(name: str, rng: np.random.Generator) -> Exposure:
    """A detection of the class that a detector would have delivered: at or above its threshold."""
    while True:
        shot = CLASSES[name](rng)
        if shot.snr >= THRESHOLD_SNR:
            return shot
