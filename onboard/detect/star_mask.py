"""Selection of the entries of the star list that are stars, and the mask that they need.

A trail that is brighter than a few sigma per pixel enters the star list as a chain of "stars"; masking them would eat the
trail. An entry is a piece of a trail when the light goes on along a straight path for 7 px on at least one side.
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
) -> bool:
    """Whether every pair of neighbouring samples from 2 to 7 px in some direction lies between `level` and `brightest` of it."""
    rows, cols = residual.shape
    for k in range(DIRECTIONS):
        d_row, d_col = unit[k, 0], unit[k, 1]
        before = 0.0
        bright = True
        for d in range(2, REACH_PX + 1):
            i, j = math.floor(row + d * d_row + 0.5), math.floor(col + d * d_col + 0.5)
            if i < 0 or j < 0 or i >= rows or j >= cols:
                bright = d > 4
                break
            value = float(smooth[i, j]) / 16.0 if use_smooth else residual[i, j] * scale
            if d > 2 and not level < 0.5 * (value + before) < brightest * level:
                bright = False
                break
            before = value
        if bright:
            return True
    return False


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
    unit = np.empty((DIRECTIONS, 2))
    for k in range(DIRECTIONS):
        angle = 2.0 * math.pi * k / DIRECTIONS
        unit[k, 0], unit[k, 1] = math.sin(angle), math.cos(angle)
    for k in range(row.shape[0]):
        mesh_row = min(max(int(row[k]) // tile_px, 0), sigma_adu.shape[0] - 1)
        mesh_col = min(max(int(col[k]) // tile_px, 0), sigma_adu.shape[1] - 1)
        sigma = sigma_adu[mesh_row, mesh_col]
        if not sigma > 0.0:
            continue
        faint = snr[k] < FAINT_SNR
        level = 0.42 * snr[k] * (1.0 if faint else peak)
        out[k] = _goes_on(residual_adu, row[k], col[k], level, 1.0 / sigma, smooth, faint, unit, brightest)
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
