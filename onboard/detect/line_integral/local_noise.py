"""How lines of the same length and angle come out beside a detection: its threshold follows what they show.

Noise that is correlated, ripples, glow and what is left of stars make the sums of lines wider than those of white noise, and so
long lines more than short ones. Parallel lines on both sides of a detection have the same length and angle, and the same sky.
They are clipped, so that another trail among them does not answer for the sky.
"""

import math
from typing import Final

import numba as nb
import numpy as np
from numpy.typing import NDArray

from onboard.detect.cross_profile import cross_profile

NEAREST_PX: Final = 12.0  # 14 sigma of a PSF of 0.87 px: none of the trail's own light
APART_PX: Final = 3.0  # sums of neighbours correlate by exp(-d^2 / 4 s^2) = 0.05
LINES: Final = 44
"""Parallel lines: half of them to each side, from NEAREST_PX on, APART_PX from each other, so that they hardly share pixels."""

LEAST_LINES: Final = 24
"""Fewer usable ones say nothing."""

CLIP: Final = 3.0  # sigmas of a line's departure beyond which it shows something else
CLIPPED_STD: Final = 0.9866
"""Standard deviation of a unit Gaussian cut at +-3: 0.98658."""

ERRORS: Final = 1.5
"""Mean and width count as far as they differ from 0 and 1 by more than so many of their own standard errors."""


@nb.njit(cache=True)
def parallel_snr(
    image: NDArray[np.int8],
    blocked: NDArray[np.uint8],
    level: NDArray[np.float32],
    tile_px: int,
    segment: NDArray[np.float64],
    psf_sigma_px: float,
    out: NDArray[np.float64],
    offset: NDArray[np.float64],
) -> int:
    """S/N of lines parallel to a segment (major0, minor0, major1, minor1, sagitta), and their offsets; how many are usable."""
    room = int(segment[2] - segment[0]) + 3
    signal, weight = np.empty(room), np.empty(room)
    length = max(segment[2] - segment[0], 1e-6)
    lean = math.sqrt(1.0 + ((segment[3] - segment[1]) / length) ** 2)
    n = 0
    full = 0.0
    for k in range(-1, out.size):
        side = 1.0 if k % 2 == 0 else -1.0
        shift = 0.0 if k < 0 else side * (NEAREST_PX + APART_PX * (k // 2)) * lean
        _, lines = cross_profile(
            image,
            blocked,
            level,
            tile_px,
            segment[0],
            segment[1] + shift,
            segment[2],
            segment[3] + shift,
            segment[4],
            0,
            psf_sigma_px,
            signal,
            weight,
        )
        s = w = 0.0
        for m in range(lines):
            s += signal[m]
            w += weight[m]
        if k < 0:
            full = w
        elif w > 0.6 * full and w > 0.0:
            out[n], offset[n] = s / math.sqrt(w), shift / lean
            n += 1
    return n


@nb.njit(cache=True)
def _inverse(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """Inverse of a positive definite matrix (n, n) by Gauss and Jordan; what has no pivot stays 0."""
    n = matrix.shape[0]
    left, right = matrix.copy(), np.eye(n)
    for k in range(n):
        pivot = left[k, k]
        if pivot < 1e-9 * matrix[k, k] or pivot <= 0.0:
            left[k, :], right[k, :] = 0.0, 0.0
            continue
        left[k] /= pivot
        right[k] /= pivot
        for i in range(n):
            if i != k:
                factor = left[i, k]
                left[i] -= factor * left[k]
                right[i] -= factor * right[k]
    return right


@nb.njit(cache=True)
def baseline(values: NDArray[np.float64], offset: NDArray[np.float64]) -> tuple[float, float, float, int]:
    """What lines (n,) at offsets (n,) say of one at offset 0: its expected S/N with standard error, their width, and how many.

    A cubic follows sky that changes over a few tens of pixels; the width is that of what it leaves, but 1 at least.
    """
    n, terms = values.size, np.empty((values.size, 4))
    farthest = np.max(np.abs(offset))
    for k in range(n):
        x = offset[k] / farthest
        terms[k, 0], terms[k, 1], terms[k, 2], terms[k, 3] = 1.0, x, x * x, x * x * x
    middle = np.median(values)
    use = np.abs(values - middle) <= CLIP * max(1.0, 1.4826 * np.median(np.abs(values - middle)))
    expected, error, width, number = 0.0, 1.0, 1.0, 0
    moments, projection = np.empty((4, 4)), np.empty(4)
    for _ in range(4):
        moments[:], projection[:], number = 0.0, 0.0, 0
        for k in range(n):
            if use[k]:
                number += 1
                for i in range(4):
                    projection[i] += terms[k, i] * values[k]
                    for j in range(4):
                        moments[i, j] += terms[k, i] * terms[k, j]
        inverse = _inverse(moments)
        fit, squares = np.zeros(4), 0.0
        for i in range(4):
            for j in range(4):
                fit[i] += inverse[i, j] * projection[j]
        left = values.copy()
        for k in range(n):
            for i in range(4):
                left[k] -= terms[k, i] * fit[i]
            squares += left[k] ** 2 if use[k] else 0.0
        width = max(1.0, math.sqrt(squares / max(1, number - 4)) / CLIPPED_STD)
        expected, error = fit[0], width * math.sqrt(inverse[0, 0])
        number = 0
        for k in range(n):
            use[k] = abs(left[k]) <= CLIP * width
            number += 1 if use[k] else 0
        if number < LEAST_LINES:
            break
    return expected, error, width, number


def locally(snr: float, values: NDArray[np.float64], offset: NDArray[np.float64]) -> float:
    """S/N of a detection in the noise of the lines (n,) at offsets (n,) beside it; never higher."""
    if len(values) < LEAST_LINES:
        return snr
    expected, error, width, number = baseline(values, offset)
    above = max(0.0, expected - ERRORS * error)
    wider = max(1.0, width * (1.0 - ERRORS / math.sqrt(2.0 * number)))
    return (snr - above) / wider


def local_snr(
    row: NDArray[np.float64],
    image: NDArray[np.int8],
    blocked: NDArray[np.uint8],
    level: NDArray[np.float32],
    tile_px: int,
    psf_sigma_px: float,
) -> float:
    """The S/N of a row of `resolve.resolve` (axis, ends, sagitta, S/N) in the noise of lines beside it."""
    out, offset = np.empty(LINES), np.empty(LINES)
    images = (image, blocked, level) if row[0] == 0.0 else (image.T, blocked.T, level.T)
    n = parallel_snr(*images, tile_px, row[1:6].copy(), psf_sigma_px, out, offset)
    return locally(float(row[6]), out[:n], offset[:n])


def above(
    table: NDArray[np.float64],
    n_sigma: float,
    image: NDArray[np.int8],
    blocked: NDArray[np.uint8],
    level: NDArray[np.float32],
    tile_px: int,
    psf_sigma_px: float,
) -> NDArray[np.float64]:
    """Rows of `resolve.resolve` that pass n_sigma, or their own S/N if that is lower, in the noise beside them too."""
    local = np.array([local_snr(row, image, blocked, level, tile_px, psf_sigma_px) for row in table])
    return table[local >= np.minimum(n_sigma, table[:, 6])] if len(table) else table
