"""Selection of the entries of the star list that are stars, and the mask that they need.

A trail that is brighter than a few sigma per pixel enters the star list as a chain of "stars"; masking them would eat the
trail. An entry is a piece of a trail when the light goes on along a straight path for 7 px on at least one side, or for 20 px
where the entry is wider than a star.
"""

import math
from typing import Final

import numba as nb
import numpy as np
from numpy.typing import NDArray

DIRECTIONS: Final = 36
"""Of a path from an entry, 10 deg apart: 7 px away neighbouring paths are 1.2 px apart, about a pixel."""

REACH_PX: Final = 7
"""Length of a path, px: eight sigma of a PSF of 0.87 px, far beyond a star's own light. Chosen, not measured."""

FAINT_SNR: Final = 12.0
"""Fainter entries are looked at on the PSF-smoothed image."""

BRIGHTEST: Final = 6.0
"""A path that is brighter, over the level that is asked of it, is the light of something else beside a faint star."""

BRIGHTEST_UNKNOWN: Final = 12.0
"""The same where no star tells the PSF. A line of sigma w has sqrt(1 + s^2 / w^2) / 0.42 where s is assumed: 3.4 with the PSF's
own width, and 9.8 for lines of 0.3 px where 1.2 is assumed."""

LEAST_PEAK: Final = 0.6
"""Brightest pixel of an entry over the peak that its flux gives a star: an entry with less is wider than a star, and is held
against its own light too. A fit weighs the wings of bright light: on a line of twice the PSF's width the flux
of an entry is 2.5 times as large as its light, and the line has 0.3 to 0.4 of the peak. Chosen, not measured."""

WIDE_REACH_PX: Final = 20
"""Length of the path of such an entry, px. Ridges of clouds and trees go on for 7 px as often as not. In eight pictures
as many entries on two wide trails are told with 20 px as with 7, and 589 instead of 1,572 elsewhere."""

LEVEL: Final = 0.42
"""Share of an entry's light that its path must keep."""

ASIDE: Final = 0.5
"""Share of the light of such an entry that is not kept on both sides of its path: a nebula or a full star is bright there too."""

FINE_DIRECTIONS: Final = 144
"""Of a path of `WIDE_REACH_PX`: a trail of one pixel is still under the nearest of them at its end."""

AWAY_DEG: Final = 15.0
"""A path so near to the stars' motion is the trail of a star, or of two in a row. Chosen, not measured."""

SHORT_STAR_PX: Final = 8.0
"""Where stars move by less, two of them in a row with their own width are shorter than the path, which may then lie anyhow."""

GAPS_ACROSS: Final = 4
"""Of the 18 pairs of samples on the path of an entry across the stars' motion, so many may have less light: meteors flicker, and
blocks of JPEG break them. In ten pictures of trailed stars all six entries on a meteor that was masked are pieces with 4, none
with 0, and 1,137 instead of 402 others of some 127,000 are."""

LEAST_OWN: Final = 6.0
"""Brightest pixel of an entry, in sigmas, below which noise decides how its path goes on. Chosen, not measured."""

MARGIN_PX: Final = 0.3
"""Added to the radius at which a star falls to 0.4 sigma of a pixel."""


def by_row(row: NDArray[np.float64]) -> NDArray[np.intp]:
    """The order in which neighbouring stars share what is in the cache."""
    return np.argsort(np.clip(row, 0.0, 65535.0).astype(np.uint16), kind="stable")  # of 16 bits, counted instead of compared


@nb.njit(cache=True)
def _goes_on(
    residual: NDArray[np.float32],
    row: float,
    col: float,
    level: float,
    scale: float,
    smooth: NDArray[np.int8],
    use_smooth: bool,
    unit: NDArray[np.float64],
    brightest: float,
    aside: float,
    reach: int,
    gaps: int,
) -> bool:
    """Whether in some direction each pair of samples from 2 px to `reach` lies between `level` and `brightest` of it.

    gaps : so many pairs may lie below.
    aside : and whether the light 7 px to both sides of the entry is less than this, across such a path.
    """
    rows, cols = residual.shape
    for k in range(unit.shape[0]):
        d_row, d_col = unit[k, 0], unit[k, 1]
        before, dark = 0.0, 0
        bright = True
        for d in range(2, reach + 1):
            i, j = math.floor(row + d * d_row + 0.5), math.floor(col + d * d_col + 0.5)
            if i < 0 or j < 0 or i >= rows or j >= cols:
                bright = d > 4
                break
            value = float(smooth[i, j]) / 16.0 if use_smooth else residual[i, j] * scale
            mean = 0.5 * (value + before)
            if d > 2 and not level < mean < brightest * level:
                dark += 1
                if dark > gaps or not mean < brightest * level:
                    bright = False
                    break
            before = value
        one, other = row + REACH_PX * d_col, row - REACH_PX * d_col
        if (
            bright
            and _light_at(residual, one, col - REACH_PX * d_row) * scale < aside
            and _light_at(residual, other, col + REACH_PX * d_row) * scale < aside
        ):
            return True
    return False


@nb.njit(cache=True)
def _light_at(residual: NDArray[np.float32], row: float, col: float) -> float:
    """Of the pixel at a place; none beyond the borders."""
    i, j = math.floor(row + 0.5), math.floor(col + 0.5)
    return float(residual[i, j]) if 0 <= i < residual.shape[0] and 0 <= j < residual.shape[1] else -math.inf


@nb.njit(cache=True)
def _directions(n: int) -> NDArray[np.float64]:
    """Unit vectors (n, 2: row, col), evenly spaced."""
    unit = np.empty((n, 2))
    for k in range(n):
        angle = 2.0 * math.pi * k / n
        unit[k, 0], unit[k, 1] = math.sin(angle), math.cos(angle)
    return unit


@nb.njit(cache=True)
def _noise_at(sigma_adu: NDArray[np.float32], tile_px: int, row: float, col: float) -> float:
    """Of the tile of a place, or of the nearest one."""
    tile_row = min(max(int(row) // tile_px, 0), sigma_adu.shape[0] - 1)
    tile_col = min(max(int(col) // tile_px, 0), sigma_adu.shape[1] - 1)
    return float(sigma_adu[tile_row, tile_col])


@nb.njit(cache=True)
def _brightest_near(residual: NDArray[np.float32], row: float, col: float) -> float:
    """Light of the brightest of nine pixels about a place."""
    brightest = -math.inf
    for d_row in range(-1, 2):
        for d_col in range(-1, 2):
            brightest = max(brightest, _light_at(residual, row + d_row, col + d_col))
    return brightest


@nb.njit(cache=True, nogil=True)
def trail_pieces(
    residual_adu: NDArray[np.float32],
    smooth: NDArray[np.int8],
    sigma_adu: NDArray[np.float32],
    tile_px: int,
    row: NDArray[np.float64],
    col: NDArray[np.float64],
    snr: NDArray[np.float32],
    psf_sigma_px: float,
    psf_known: bool,
) -> NDArray[np.bool_]:
    """Entries that are pieces of trails, shape (n,). `smooth` is the PSF-smoothed image in units of sigma/16, not star-masked.

    psf_known : whether stars tell psf_sigma_px.
    """
    out = np.zeros(row.shape[0], np.bool_)
    brightest = BRIGHTEST if psf_known else BRIGHTEST_UNKNOWN
    peak = 1.0 / (2.0 * math.sqrt(math.pi) * psf_sigma_px)
    unit = _directions(DIRECTIONS)
    for k in range(row.shape[0]):
        sigma = _noise_at(sigma_adu, tile_px, row[k], col[k])
        if not sigma > 0.0:
            continue
        faint, scale = snr[k] < FAINT_SNR, 1.0 / sigma
        light = snr[k] * (1.0 if faint else peak)
        level, most = LEVEL * light, math.inf
        out[k] = _goes_on(residual_adu, row[k], col[k], level, scale, smooth, faint, unit, brightest, most, REACH_PX, 0)
        if not faint and not out[k]:
            own = _brightest_near(residual_adu, row[k], col[k]) * scale
            if own < LEAST_PEAK * light:
                level, most = LEVEL * own, ASIDE * own
                out[k] = _goes_on(
                    residual_adu, row[k], col[k], level, scale, smooth, False, unit, brightest, most, WIDE_REACH_PX, 0
                )
    return out


@nb.njit(cache=True, nogil=True)
def pieces_across(
    residual_adu: NDArray[np.float32],
    sigma_adu: NDArray[np.float32],
    tile_px: int,
    row: NDArray[np.float64],
    col: NDArray[np.float64],
    d_row: NDArray[np.float64],
    d_col: NDArray[np.float64],
) -> NDArray[np.bool_]:
    """Entries of a sky of trailed stars that are pieces of a line which runs elsewhere than the stars do, shape (n,).

    d_row, d_col (n,) : the stars' motion there.
    """
    out, no_smooth = np.zeros(row.shape[0], np.bool_), np.zeros((0, 0), np.int8)
    every, allowed, most = _directions(FINE_DIRECTIONS), np.empty((FINE_DIRECTIONS, 2)), math.cos(math.radians(AWAY_DEG))
    for k in range(row.shape[0]):
        sigma = _noise_at(sigma_adu, tile_px, row[k], col[k])
        if not sigma > 0.0:
            continue
        own = _brightest_near(residual_adu, row[k], col[k]) / sigma
        if own < LEAST_OWN:
            continue
        n, length = 0, max(math.hypot(d_row[k], d_col[k]), 1e-6)
        for unit in every:
            if length < SHORT_STAR_PX or abs(unit[0] * d_row[k] + unit[1] * d_col[k]) < most * length:
                allowed[n] = unit
                n += 1
        level = LEVEL * own
        out[k] = _goes_on(
            residual_adu, row[k], col[k], level, 1.0 / sigma, no_smooth, False, allowed[:n], BRIGHTEST_UNKNOWN, ASIDE * own,
            WIDE_REACH_PX, GAPS_ACROSS,
        )  # fmt: skip
    return out


def mask_radii_px(snr: NDArray[np.float32], psf_sigma_px: float, halo_px: float | NDArray[np.float64]) -> NDArray[np.float64]:
    """Radius at which a Gaussian star of matched-filter S/N `snr` falls to 0.4 sigma of a pixel, plus a halo ~ sqrt(snr)."""
    signal = np.maximum(np.asarray(snr, np.float64), 1.0)
    # step by step in place: it is called where a frame's memory has its peak
    radius = signal / (2.0 * math.sqrt(math.pi) * psf_sigma_px)
    radius /= 0.4
    np.maximum(radius, 1.65, out=radius)
    np.log(radius, out=radius)
    radius *= 2.0
    np.sqrt(radius, out=radius)
    radius *= psf_sigma_px
    radius += MARGIN_PX
    signal /= 100.0
    np.sqrt(signal, out=signal)
    signal -= 1.0
    np.maximum(0.0, signal, out=signal)
    signal *= halo_px
    radius += signal
    return radius
