"""Power spectrum of the noise: over radial frequency, and along rows and columns, where read-out structure shows."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.validation.background import Background

TILE_PX: Final = 64
"""Hann-windowed tiles, as wide as a mesh of the background: what is longer is taken away with it."""
RADIAL_BINS: Final = 16
"""From 2 to 32 periods a tile, two periods each. Chosen: finer bins hold less than the window resolves."""
MIN_FREE: Final = 0.6
"""Tiles with a smaller share of source-free pixels are left out."""


@dataclass(frozen=True, kw_only=True, eq=False)
class NoiseSpectrum:
    """Power over that of white noise of the same variance, so that white noise is 1 everywhere.

    frequency : (bins,) cycles/px, radial power beside it. along_rows, along_cols : (TILE_PX / 2 - 1,) power at zero
    frequency of the other axis. row_structure, col_structure : variance of row (column) means times the number of pixels in
    each over the pixel variance: 1 for white noise. n_tiles : tiles averaged.
    """

    frequency: NDArray[np.float64]
    radial: NDArray[np.float64]
    along_rows: NDArray[np.float64]
    along_cols: NDArray[np.float64]
    row_structure: float
    col_structure: float
    n_tiles: int


def noise_spectrum(background: Background) -> NoiseSpectrum | None:
    """Mean periodogram of Hann-windowed tiles (Welch 1967, IEEE Trans. Audio Electroacoust. 15, 70); None without a free tile.

    Masked pixels are set to the tile's mean, and each tile's power is divided by its own source-free variance and share.
    """
    window = np.outer(np.hanning(TILE_PX), np.hanning(TILE_PX))
    rows, cols = background.residual.shape
    total, n_tiles = np.zeros((TILE_PX, TILE_PX)), 0
    for r in range(0, rows - TILE_PX + 1, TILE_PX):
        for c in range(0, cols - TILE_PX + 1, TILE_PX):
            free = background.free[r : r + TILE_PX, c : c + TILE_PX]
            if free.mean() < MIN_FREE:
                continue
            tile = background.residual[r : r + TILE_PX, c : c + TILE_PX].astype(np.float64)
            middle, weight = tile[free].mean(), np.where(free, window, 0.0)
            # Clipped at 5 sigma: a single cosmic ray has a white spectrum of its own.
            reach = 5.0 * background.noise
            value = np.where(free, np.clip(tile - middle, -reach, reach), 0.0)
            variance = float(np.mean(value[free] ** 2))
            if variance > 0.0:
                total += np.abs(np.fft.fft2(value * window)) ** 2 / (variance * np.sum(weight**2))
                n_tiles += 1
    if n_tiles == 0:
        return None
    power = total / n_tiles
    f = np.fft.fftfreq(TILE_PX)
    radius = np.hypot(f[:, None], f[None, :])
    # Frequencies below two steps are spoilt by the subtraction of mean and mesh.
    edges = np.linspace(2.0 / TILE_PX, 0.5, RADIAL_BINS + 1)
    which = np.digitize(radius.ravel(), edges) - 1
    inside = (which >= 0) & (which < RADIAL_BINS)
    count = np.bincount(which[inside], minlength=RADIAL_BINS)
    radial = np.bincount(which[inside], power.ravel()[inside], minlength=RADIAL_BINS) / count
    frequency = np.bincount(which[inside], radius.ravel()[inside], minlength=RADIAL_BINS) / count
    half = TILE_PX // 2
    return NoiseSpectrum(
        frequency=frequency,
        radial=radial,
        along_rows=power[0, 1:half],
        along_cols=power[1:half, 0],
        row_structure=line_structure(background.residual, background.free, axis=1),
        col_structure=line_structure(background.residual, background.free, axis=0),
        n_tiles=n_tiles,
    )


def line_structure(residual: NDArray[np.float32], free: NDArray[np.bool_], axis: int) -> float:
    """Variance of the means of lines over what independent pixels would give; axis 1: rows, axis 0: columns.

    The means are taken relative to a running mean of 15 lines, so that large-scale residuals of the background do not count
    (which takes about 1/15 of a white variance away again, and is put back).
    """
    clipped = np.where(free, residual, 0.0).astype(np.float64)
    count = free.sum(axis=axis)
    good = count > 0.5 * free.shape[axis]
    if good.sum() < 16:
        return float("nan")
    mean = clipped.sum(axis=axis)[good] / count[good]
    reach = 7
    padded = np.pad(mean, reach, mode="reflect")
    smooth = np.mean(np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1), axis=1)
    deviation = (mean - smooth)[reach:-reach] if len(mean) > 4 * reach else mean - smooth
    variance = float(np.var(residual[free], dtype=np.float64))
    expected = variance * float(np.mean(1.0 / count[good])) * (1.0 - 1.0 / (2 * reach + 1))
    return float(np.mean(deviation**2) / expected)
