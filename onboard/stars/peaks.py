"""Peaks of the PSF-smoothed image: three rows of it are held while local maxima are looked for."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.image.calibrate import expand_nodes


@njit(cache=True)
def _add_pair(k: np.float32, a: NDArray[np.float32], b: NDArray[np.float32], out: NDArray[np.float32]) -> None:
    """``out += k (a + b)``; a function of its own so that it is compiled to vector instructions."""
    for col in range(out.size):
        out[col] += k * (a[col] + b[col])


@njit(cache=True)
def _weigh_five(
    kernel: NDArray[np.float32],
    a: NDArray[np.float32],
    b: NDArray[np.float32],
    c: NDArray[np.float32],
    d: NDArray[np.float32],
    e: NDArray[np.float32],
    out: NDArray[np.float32],
) -> None:
    """``out = k2 (a + e) + k1 (b + d) + k0 c``."""
    k0, k1, k2 = kernel[0], kernel[1], kernel[2]
    for col in range(out.size):
        out[col] = k0 * c[col] + k1 * (b[col] + d[col]) + k2 * (a[col] + e[col])


@njit(cache=True)
def _smooth_row(
    residual: NDArray[np.float32],
    row: int,
    kernel: NDArray[np.float32],
    zeros: NDArray[np.float32],
    padded: NDArray[np.float32],
    out: NDArray[np.float32],
) -> None:
    """One row of the separable convolution; zeros outside the frame. kernel: centre and one side, at least 3 values."""
    rows, cols = residual.shape
    radius = kernel.size - 1
    middle = padded[radius : radius + cols]
    _weigh_five(
        kernel,
        residual[row - 2] if row >= 2 else zeros,
        residual[row - 1] if row >= 1 else zeros,
        residual[row],
        residual[row + 1] if row + 1 < rows else zeros,
        residual[row + 2] if row + 2 < rows else zeros,
        middle,
    )
    for k in range(3, radius + 1):
        _add_pair(kernel[k], residual[row - k] if row >= k else zeros, residual[row + k] if row + k < rows else zeros, middle)
    _weigh_five(
        kernel,
        padded[radius - 2 : radius - 2 + cols],
        padded[radius - 1 : radius - 1 + cols],
        middle,
        padded[radius + 1 : radius + 1 + cols],
        padded[radius + 2 : radius + 2 + cols],
        out,
    )
    for k in range(3, radius + 1):
        _add_pair(kernel[k], padded[radius - k : radius - k + cols], padded[radius + k : radius + k + cols], out)


@njit(cache=True)
def _tops(
    here: NDArray[np.float32],
    left: NDArray[np.float32],
    right: NDArray[np.float32],
    above: NDArray[np.float32],
    below: NDArray[np.float32],
    threshold: NDArray[np.float32],
    out: NDArray[np.uint8],
) -> None:
    """1 where a value exceeds its threshold and its four nearest neighbours; of equal ones the last counts."""
    for k in range(here.size):
        value = here[k]
        across = (value > threshold[k]) & (value >= left[k]) & (value > right[k])
        out[k] = np.uint8(across & (value >= above[k]) & (value > below[k]))


@njit(cache=True)
def _vertex(before: np.float32, middle: np.float32, after: np.float32) -> np.float32:
    """Where the parabola through three neighbouring values, the middle one largest, has its top, px from the middle."""
    return np.float32(0.5) * (after - before) / (middle + middle - before - after)


@njit(cache=True)
def find_peaks(
    residual: NDArray[np.float32],
    sigma_nodes: NDArray[np.float32],
    tile_px: int,
    kernel: NDArray[np.float32],
    threshold: float,
    peaks: NDArray[np.float32],
) -> int:
    """Local maxima of the smoothed image above ``threshold * sigma``; returns how many of them fitted into `peaks`.

    kernel : centre and one side of the separable smoothing kernel. peaks : (capacity, 5) row, col, smoothed value, and
    the fractions of a pixel by which a parabola moves the peak.
    """
    rows, cols = residual.shape
    zeros = np.zeros(cols, dtype=np.float32)
    padded = np.zeros(cols + 2 * (kernel.size - 1), dtype=np.float32)
    ring = np.zeros((3, cols), dtype=np.float32)
    limit = np.empty(cols, dtype=np.float32)
    hits = np.zeros(-(-cols // 8) * 8, dtype=np.uint8)
    words = hits.view(np.uint64)
    nodes = np.empty(sigma_nodes.shape[1] + 2, dtype=np.float32)  # with one beyond each edge, as `expand_nodes` wants them
    count, held = 0, -1
    for row in range(-1, rows):
        if row + 1 < rows:
            _smooth_row(residual, row + 1, kernel, zeros, padded, ring[(row + 1) % 3])
        else:
            ring[(row + 1) % 3, :] = 0.0
        if row < 0:
            continue
        tile = min(row // tile_px, sigma_nodes.shape[0] - 1)
        if tile != held:
            nodes[1:-1] = sigma_nodes[tile]
            nodes[0], nodes[-1] = nodes[1], nodes[-2]
            expand_nodes(nodes, tile_px, limit)
            limit *= np.float32(threshold)
            held = tile
        here, above, below = ring[row % 3], ring[(row + 2) % 3], ring[(row + 1) % 3]
        _tops(here[1:-1], here[:-2], here[2:], above[1:-1], below[1:-1], limit[1:-1], hits[1 : cols - 1])
        for word in range(words.size):
            if words[word] == 0:
                continue
            for col in range(8 * word, min(8 * word + 8, cols)):
                value = here[col]
                if hits[col] == 0 or value < above[col - 1] or value < above[col + 1]:
                    continue
                if value <= below[col - 1] or value <= below[col + 1]:
                    continue
                if count == peaks.shape[0]:
                    return count
                peaks[count, 0], peaks[count, 1], peaks[count, 2] = row, col, value
                peaks[count, 3] = _vertex(above[col], value, below[col])
                peaks[count, 4] = _vertex(here[col - 1], value, here[col + 1])
                count += 1
    return count


def gaussian_kernel(sigma_px: float) -> NDArray[np.float32]:
    """Centre and one side of a Gaussian of unit sum, out to 2.2 sigma."""
    offsets = np.arange(max(2, math.ceil(2.2 * sigma_px)) + 1)
    side = np.exp(-0.5 * (offsets / sigma_px) ** 2)
    return (side / (side[0] + 2.0 * side[1:].sum())).astype(np.float32)
