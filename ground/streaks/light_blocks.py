"""Light along a trail and beyond its end in blocks, each above the level of the sky beside it; and that of lines beside it.

At a vignetted border the frame's own level is wrong, so each block has its own.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ground.streaks.trail_pixels import TrailPixels

Array = NDArray[np.float64]

BLOCK_WIDTHS: Final = 4.0
"""Length of a block in widths of the profile: neighbouring blocks are then nearly independent."""

LIT_WIDTHS: Final = 2.5
"""Pixels within this many widths of the line hold its light (0.988 of it)."""

BESIDE_WIDTHS: Final = 3.3
"""Pixels beyond this many widths hold the sky alone (1e-3 of the light)."""

LEAST_BESIDE: Final = 12
"""Pixels beside three blocks from which the sky's level is taken there."""

MEDIAN_VARIANCE: Final = 0.5 * math.pi
"""Variance of a median over that of a mean, of Gaussian values."""

STRAY_SIGMAS: Final = 4.0
"""By chance in one of 30,000 blocks."""
STRAY_SHARE: Final = 1.5
"""A block that differs from those on both sides by so many sigmas and by this factor is not the trail's light alone."""

BESIDE_LINES: Final = (5.0, 8.0, 11.0, 14.0)
"""Widths to both sides at which lines beside a trail tell what light is there without it, as far as the region reaches. They are
three apart, so that they hardly share a star."""
BESIDE_BLOCKS: Final = 4
"""Fewer blocks on lines beside a trail tell no scatter. Chosen, not measured."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Blocks:
    """Light along one half of a trail, outwards: place of each block's middle (px), density and its sigma (e-/px), all (n,).

    Infinite sigma: unknown.
    """

    place: Array
    density: Array
    sigma: Array
    length_px: float


def light_beside(
    outwards: TrailPixels, end_px: float, width_px: float, border_px: float, block_widths: float = BLOCK_WIDTHS
) -> tuple[Array, Array]:
    """Densities (n,) of blocks on lines beside a trail, beyond its end, and their noise variances (n,).

    Empty where less than `BESIDE_BLOCKS` of such lines are seen. Stars that are too faint to be listed are light on any line.
    """
    found = list(_blocks_beside(outwards, end_px, width_px, border_px, block_widths))
    density, variance = (np.concatenate([np.zeros(0), *(each[k] for each in found)]) for k in (0, 1))
    return (density, variance) if density.size >= BESIDE_BLOCKS else (np.zeros(0), np.zeros(0))


def _blocks_beside(
    outwards: TrailPixels, end_px: float, width_px: float, border_px: float, block_widths: float
) -> Iterator[tuple[Array, Array]]:
    """Density and variance of the known blocks of each line beside a trail that its region holds."""
    for shift in (side * away for away in BESIDE_LINES for side in (-1.0, 1.0)):
        reach = float((np.sign(shift) * outwards.v).max(initial=0.0))
        if reach < (abs(shift) + 1.0) * width_px:
            continue
        beside = blocks_of(replace(outwards, v=outwards.v - shift * width_px), width_px, border_px, block_widths)
        used = (beside.place > end_px + width_px) & np.isfinite(beside.sigma)
        yield beside.density[used], beside.sigma[used] ** 2


def blocks_of(pixels: TrailPixels, width_px: float, border_px: float, block_widths: float = BLOCK_WIDTHS) -> Blocks:
    """Light in blocks from the middle outwards, above the sky beside each. block_widths : their length in widths."""
    length = block_widths * width_px
    number = max(int(min(float(pixels.u.max(initial=0.0)), border_px) / length), 0)
    block = np.floor(pixels.u / length).astype(np.int64)
    inside = (block >= 0) & (block < number)
    lit = inside & (np.abs(pixels.v) < LIT_WIDTHS * width_px)
    beside = inside & (np.abs(pixels.v) > BESIDE_WIDTHS * width_px)
    level, level_variance = _sky_beside(block[beside], pixels.value_e[beside], pixels.variance_e2[beside], number)
    profile = np.exp(-0.5 * (pixels.v[lit] / width_px) ** 2) / (math.sqrt(2.0 * math.pi) * width_px)
    place, weight = block[lit], 1.0 / pixels.variance_e2[lit]
    information = np.bincount(place, weight * profile**2, number)
    known = information > 0.3 * np.median(information) if number else np.zeros(0, dtype=np.bool_)
    safe = np.where(known, np.maximum(information, 1e-300), 1.0)
    density = np.bincount(place, weight * profile * (pixels.value_e[lit] - level[place]), number) / safe
    by_level = np.bincount(place, weight * profile, number) / safe
    sigma = np.where(known, np.sqrt(1.0 / safe + by_level**2 * level_variance), math.inf)
    density = np.where(known, density, 0.0)
    sigma = np.where(_strays(density, sigma), math.inf, sigma)
    return Blocks(place=(np.arange(number, dtype=np.float64) + 0.5) * length, density=density, sigma=sigma, length_px=length)


def _sky_beside(block: NDArray[np.int64], value: Array, variance: Array, number: int) -> tuple[Array, Array]:
    """Level of the sky in each block and its variance, (number,): median of the pixels beside it and its two neighbours."""
    order = np.argsort(block, kind="stable")
    first = np.searchsorted(block[order], np.arange(-1, number + 2))  # first[k] : of block k - 1
    return _running_medians(value[order], variance[order], first)


@njit(cache=True)
def _running_medians(value: Array, variance: Array, first: NDArray[np.int64]) -> tuple[Array, Array]:
    """Median of value and variance of the median in each three neighbouring groups of pixels, (m - 3,); zero of too few.

    first : (m,) first pixel of each group.
    """
    number = first.size - 3
    level, level_variance = np.zeros(number), np.zeros(number)
    for k in range(number):
        count = first[k + 3] - first[k]
        if count >= LEAST_BESIDE:
            level[k] = np.median(value[first[k] : first[k + 3]])
            level_variance[k] = MEDIAN_VARIANCE * np.median(variance[first[k] : first[k + 3]]) / count
    return level, level_variance


def _strays(density: Array, sigma: Array) -> NDArray[np.bool_]:
    """(n,) blocks that differ much from those on both sides: stars on the line, and sky that a star beside the line raised.

    One side is not enough: the last lit block of a trail that stops is brighter than those outside it.
    """
    if density.size < 5:
        return np.zeros(density.size, dtype=np.bool_)
    inside, outside = _neighbours(density)
    usual = np.minimum(inside.max(axis=0), outside.max(axis=0))
    dark = (usual - density > STRAY_SIGMAS * sigma) & (usual > STRAY_SHARE * density)
    inside, outside = _neighbours(np.where(dark, usual, density))
    usual = np.maximum(np.maximum(inside.mean(axis=0), outside.mean(axis=0)), 0.0)
    bright = (density - usual > STRAY_SIGMAS * sigma) & (density > STRAY_SHARE * usual)
    return np.asarray(dark | bright)


def _neighbours(density: Array) -> tuple[Array, Array]:
    """The two blocks before and the two after each block, (2, n) both; ends repeat."""
    about = np.pad(density, 2, mode="edge")
    inside, outside = ([about[k : k + density.size] for k in pair] for pair in ((0, 1), (3, 4)))
    return np.stack(inside), np.stack(outside)


def weights_of(sigma: Array) -> Array:
    """(n,) inverse variances, 0 where nothing is known."""
    return np.where(np.isfinite(sigma), 1.0 / np.where(np.isfinite(sigma), sigma, 1.0) ** 2, 0.0)


def sums_before(values: Array) -> Array:
    """(n + 1,) sum of the values before each place, that of all at the end."""
    return np.concatenate([[0.0], np.cumsum(values)])
