"""Sums of group images along straight tracks: a lattice of velocities first, then a climb to the best place and velocity."""

import math
from typing import Final, NamedTuple

import cv2
import numba as nb
import numpy as np
from numpy.typing import NDArray

GROUP_UNIT: Final = 16
"""One sigma of a group image."""

TILE_PX: Final = 128
"""The noise of a group image is measured in squares of this side."""

GUESS_EVERY: Final = 7
"""Step, in rows and columns, of the pixels that the first guess of the noise is taken from."""

CLIP_SIGMA: Final = 3.0  # sigmas; CLIPPED_RMS belongs to it
CLIPPED_RMS: Final = 0.9865817
"""Rms of a normal variable without its values beyond CLIP_SIGMA, to 3e-6: sqrt(1 - 6 phi(3) / erf(3 / sqrt(2))) is 0.9865784."""

OUTER_PX: Final = 1.2
"""Distance of neighbouring lattice tracks at the ends of the window, along either axis; an object is half of it away at most."""


def filter_sigma_px(psf_sigma_px: float) -> float:
    """Width of a star in a sum that was read between pixels: the PSF's, and 1/6 px^2 of bilinear reading on average."""
    return math.sqrt(psf_sigma_px**2 + 1.0 / 6.0)


def group_image(total: NDArray[np.int16], psf_sigma_px: float) -> NDArray[np.int8]:
    """Sum of a few frames -> matched filter -> units of its own noise, tile by tile, GROUP_UNIT for one sigma."""
    width = filter_sigma_px(psf_sigma_px)
    smooth = cv2.GaussianBlur(total.astype(np.float32), (0, 0), width, borderType=cv2.BORDER_CONSTANT)
    some = smooth[::GUESS_EVERY, ::GUESS_EVERY][total[::GUESS_EVERY, ::GUESS_EVERY] != 0]
    first = 1.4826 * float(np.median(np.abs(some))) if some.size else 0.0
    out = np.zeros(total.shape, np.int8)
    for row in range(0, total.shape[0], TILE_PX):
        for col in range(0, total.shape[1], TILE_PX):
            part = (slice(row, row + TILE_PX), slice(col, col + TILE_PX))
            values = smooth[part]
            lit = values[total[part] != 0]
            sigma = _noise(lit, first)
            if sigma > 0.0:
                out[part] = np.clip(np.rint(values * (GROUP_UNIT / sigma)), -127, 127)
    out.flags.writeable = False
    return out


def _noise(values: NDArray[np.float32], sigma: float) -> float:
    """Rms of the values without outliers, from a first guess; 0 of fewer than 100 values."""
    if values.size < 100:
        return 0.0
    for _ in range(3):
        inside = values[np.abs(values) < CLIP_SIGMA * sigma]
        sigma = math.sqrt(float(inside @ inside) / inside.size) / CLIPPED_RMS if inside.size else 0.0
    return sigma


def lattice(half_row: float, half_col: float, epochs: NDArray[np.float64]) -> NDArray[np.float64]:
    """Velocities (n, 2) of the box, px/s about its middle, so close that OUTER_PX holds."""
    reach = max(float(np.abs(epochs).max()), 1e-9)
    axes = [
        np.linspace(-h, h, max(1, math.ceil(h * reach / OUTER_PX) + 1)) if h > 0.0 else np.zeros(1) for h in (half_row, half_col)
    ]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)


@nb.njit(cache=True)
def stack(
    groups: tuple[NDArray[np.int8], ...], shifts: NDArray[np.int64], best: NDArray[np.int16], which: NDArray[np.int16]
) -> None:
    """Largest sum at every pixel over all velocities, and the number of its velocity. shifts : (velocities, groups, 2) px."""
    rows, cols = groups[0].shape
    total = np.zeros(cols, np.int16)
    for row in range(rows):
        best[row, :] = -32768
        for h in range(shifts.shape[0]):
            total[:] = 0
            for g in range(len(groups)):
                r, c = row + shifts[h, g, 0], shifts[h, g, 1]
                if 0 <= r < rows:
                    low, high = max(0, -c), min(cols, cols - c)
                    source = groups[g][r]
                    for j in range(low, high):
                        total[j] += np.int16(source[j + c])
            for j in range(cols):
                better = total[j] > best[row, j]
                best[row, j] = total[j] if better else best[row, j]
                which[row, j] = np.int16(h) if better else which[row, j]


@nb.njit(cache=True)
def maxima(best: NDArray[np.int16], least: int, most: int) -> NDArray[np.int64]:
    """Places (n, 2) of the sums above `least` that none within 2 px exceeds, at most `most`, by rows."""
    rows, cols = best.shape
    out = np.empty((most, 2), np.int64)
    n = 0
    for row in range(rows):
        for col in range(cols):
            value = best[row, col]
            if value < least or n == most:
                continue
            highest = True
            for r in range(max(0, row - 2), min(rows, row + 3)):
                for c in range(max(0, col - 2), min(cols, col + 3)):
                    before = r < row or (r == row and c < col)
                    if best[r, c] > value or (before and best[r, c] == value):
                        highest = False
            if highest:
                out[n, 0], out[n, 1] = row, col
                n += 1
    return out[:n]


class GroupWindow(NamedTuple):
    """Group images, their epochs, and the correlation of the noise of neighbouring pixels."""

    groups: tuple[NDArray[np.int8], ...]
    epochs: NDArray[np.float64]
    likeness: float


@nb.njit(cache=True)
def along(window: GroupWindow, place: NDArray[np.float64], out: NDArray[np.float64]) -> float:
    """S/N of a track, and that of each group into `out` (0 where it lies outside).

    place : row, col, and their rates, px and px/s.
    """
    groups, epochs, likeness = window
    rows, cols = groups[0].shape
    total, count = 0.0, 0
    for g in range(len(groups)):
        row, col = place[0] + place[2] * epochs[g], place[1] + place[3] * epochs[g]
        r, c = math.floor(row), math.floor(col)
        out[g] = 0.0
        # between pixels the noise of the interpolated image is lower
        if 0 <= r < rows - 1 and 0 <= c < cols - 1:
            fr, fc = row - r, col - c
            top = groups[g][r, c] * (1 - fc) + groups[g][r, c + 1] * fc
            low = groups[g][r + 1, c] * (1 - fc) + groups[g][r + 1, c + 1] * fc
            kept = (1.0 - 2.0 * fr * (1 - fr) * (1.0 - likeness)) * (1.0 - 2.0 * fc * (1 - fc) * (1.0 - likeness))
            out[g] = (top * (1 - fr) + low * fr) / (GROUP_UNIT * math.sqrt(kept))
            total += out[g]
            count += 1
    return total / math.sqrt(len(groups)) if count else 0.0


@nb.njit(cache=True)
def climb(window: GroupWindow, place: NDArray[np.float64], out: NDArray[np.float64]) -> float:
    """Move `place` to the nearest maximum of the S/N; returns it."""
    reach = max(abs(window.epochs[0]), abs(window.epochs[-1]), 1e-9)
    steps = np.array([0.5, 0.5, 0.5 / reach, 0.5 / reach])
    best = along(window, place, out)
    for _ in range(4):
        for _ in range(6):
            improved = False
            for k in range(4):
                for sign in (-1.0, 1.0):
                    place[k] += sign * steps[k]
                    value = along(window, place, out)
                    if value > best:
                        best, improved = value, True
                    else:
                        place[k] -= sign * steps[k]
            if not improved:
                break
        steps *= 0.5
    return float(along(window, place, out))
