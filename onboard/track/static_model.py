"""What moves at about a given rate is summed over a few frames, after a model of the sky that stands still was taken away.

The model is the running mean of registered frames on the grid of the first of them. Frames and model are read between pixels by
bilinear interpolation. That widens PSF and noise alike, so that the matched filter afterwards loses 0.5 % of the S/N only.
"""

import math
from typing import Final

import numba as nb
import numpy as np
from numpy.typing import NDArray

UNIT: Final = 16
"""One sigma of a pixel in a frame's codes."""

MASKED: Final = -128
"""Code of a pixel without data."""

WEIGHT_BITS: Final = 7  # shares of bilinear interpolation to a hundredth
WEIGHTS: Final = 1 << WEIGHT_BITS
"""Sum of the shares of the four pixels that a value between them is read from."""

SUM_CODES: Final = 2
"""Codes in one unit of a group's sum: eighths of the noise, so that rounding adds 0.0013 of a frame's variance. Eight bits hold
sixteen sigma of a frame, more than five of the sum of eight."""

FULL: Final = 127
"""Largest value of the model and of a sum. Changes of the model are smaller than a code, but with their noise of half a code they
are rounded to the right mean: to the 2 codes of the model's own error the rounding adds 1.2."""

BRIGHT: Final = 96
"""Codes (sixteenths of the noise) of the model from which a pixel is a star's and is not used: the model is too rough there."""

CLIP: Final = 64
"""Largest residual, in codes: a particle lights up one frame."""

READING_PX: Final = math.sqrt(1.0 / 6.0)
"""Width that reading between pixels adds, on average over places."""

STAR_REACH_SIGMAS: Final = 3.0
"""Pixels of a star that `static_snr` looks at."""

BLOCK_PX: Final = 64
"""Columns over which the way between two grids is taken for a shift; a turn by 1e-4 changes it by 0.003 px."""


@nb.njit(cache=True)
def _inside(base: int, n: int, size: int) -> tuple[int, int]:
    """Indices [low, high) of n that read `base` onwards with one neighbour, inside `size`."""
    return max(0, -base), min(n, size - 1 - base)


@nb.njit(cache=True)
def _codes_row(source: NDArray[np.float32], mask: NDArray[np.uint8], scale: NDArray[np.float32], codes: NDArray[np.int8]) -> None:
    for i in range(codes.size):
        value = source[i] * scale[i]
        value = np.float32(-127.0) if value < np.float32(-127.0) else value
        value = np.float32(127.0) if value > np.float32(127.0) else value
        value += np.float32(0.5)
        whole = np.int32(value)
        whole = np.int32(whole - np.int32(np.float32(whole) > value))  # down, not towards zero
        known = (mask[i] == np.uint8(0)) & (scale[i] > np.float32(0.0))
        codes[i] = np.int8(whole if known else np.int32(MASKED))


@nb.njit(cache=True)
def codes_of(
    residual_adu: NDArray[np.float32],
    mask: NDArray[np.uint8],
    sigma_adu: NDArray[np.float32],
    tile_px: int,
    codes: NDArray[np.int8],
) -> None:
    """A frame in units of its noise, at most 127 to either side."""
    rows, cols = residual_adu.shape
    scale = np.zeros(cols, np.float32)
    for row in range(rows):
        if row % tile_px == 0:
            mesh_row = min(row // tile_px, sigma_adu.shape[0] - 1)
            for col in range(cols):
                sigma = sigma_adu[mesh_row, min(col // tile_px, sigma_adu.shape[1] - 1)]
                scale[col] = UNIT / sigma if sigma > 0.0 else 0.0
        _codes_row(residual_adu[row], mask[row], scale, codes[row])


Weights = tuple[np.int16, np.int16, np.int16, np.int16]


@nb.njit(cache=True)
def _weights(part_row: float, part_col: float) -> Weights:
    """Shares of four neighbours in 1 / WEIGHTS; they add up to one."""
    right = round(WEIGHTS * part_col * (1.0 - part_row))
    below = round(WEIGHTS * part_row * (1.0 - part_col))
    both = round(WEIGHTS * part_row * part_col)
    return np.int16(WEIGHTS - right - below - both), np.int16(right), np.int16(below), np.int16(both)


@nb.njit(cache=True)
def _mixed(w: Weights, a: np.int8, b: np.int8, d: np.int8, e: np.int8) -> np.int16:
    """Sum of four neighbours by their shares, which 16 bits hold, and the difference of two; each step in as many."""
    upper = np.int16(np.int16(w[0] * np.int16(a)) + np.int16(w[1] * np.int16(b)))
    lower = np.int16(np.int16(w[2] * np.int16(d)) + np.int16(w[3] * np.int16(e)))
    return np.int16(upper + lower)


@nb.njit(cache=True)
def _mix_row(top: NDArray[np.int8], low: NDArray[np.int8], w: Weights, weight: np.float32, model: NDArray[np.int8]) -> None:
    """Bring a row of a frame into the model; it stays where one of the four pixels is masked. weight : for the sum of shares."""
    for j in range(model.size):
        a, b, d, e = top[j], top[j + 1], low[j], low[j + 1]
        least = min(min(a, b), min(d, e))
        old = np.int16(model[j])
        step = np.float32(np.int16(_mixed(w, a, b, d, e) - np.int16(np.int16(WEIGHTS) * old))) * weight
        new = np.int16(old + np.int16(np.int16(step + np.float32(400.5)) - np.int16(400)))
        model[j] = np.int8(new if least > np.int8(MASKED) else old)


@nb.njit(cache=True)
def _add_row(
    top: NDArray[np.int8],
    low: NDArray[np.int8],
    w: Weights,
    model_top: NDArray[np.int8],
    model_low: NDArray[np.int8],
    m: Weights,
    total: NDArray[np.int8],
) -> None:
    """Add a row of a frame less the model's to the sum; nothing where one of the eight is masked or a star's."""
    bright, dark, half = np.int8(BRIGHT), np.int8(-BRIGHT), np.int16(WEIGHTS * SUM_CODES // 2)
    most, least_sum = np.int16(CLIP // SUM_CODES), np.int16(-(CLIP // SUM_CODES))
    full, empty, none = np.int16(FULL), np.int16(-FULL), np.int16(0)
    for j in range(total.size):
        a, b, d, e = top[j], top[j + 1], low[j], low[j + 1]
        p, q, s, t = model_top[j], model_top[j + 1], model_low[j], model_low[j + 1]
        change = np.int16(np.int16(_mixed(w, a, b, d, e) - _mixed(m, p, q, s, t)) + half)
        value = min(max(np.int16(change >> np.int16(WEIGHT_BITS + 1)), least_sum), most)
        least = min(min(a, b), min(d, e))
        lowest, highest = min(min(p, q), min(s, t)), max(max(p, q), max(s, t))
        known = (least > np.int8(MASKED)) & (lowest > dark) & (highest < bright)
        added = np.int16(np.int16(total[j]) + (value if known else none))
        total[j] = np.int8(min(max(added, empty), full))


Reading = tuple[int, int, Weights]
"""Where a block of columns is read from: first of two rows, columns between here and there, shares of the four neighbours."""


@nb.njit(cache=True)
def _reading(transform: NDArray[np.float64], row: float, first: int, shift_col: float, cols: int) -> Reading:
    """Of the block that begins at column `first`. transform : (2, 3) of the grid, moved by shift_col, into the frame."""
    n = min(BLOCK_PX, cols - first)
    middle = first + 0.5 * n
    col = middle + shift_col
    at_row = transform[0, 0] * row + transform[0, 1] * col + transform[0, 2]
    at_col = transform[1, 0] * row + transform[1, 1] * col + transform[1, 2] - middle + first
    r, c = math.floor(at_row), math.floor(at_col)
    return r, c - first, _weights(at_row - r, at_col - c)


@nb.njit(cache=True)
def _readings(
    transform: NDArray[np.float64], row: float, first: int, shift_col: float, cols: int, reading: Reading
) -> tuple[int, Reading]:
    """Where the blocks that are read alike end, and how the next one is read. reading : of the block that begins at `first`."""
    stop, following = first, reading
    while stop < cols and following == reading:
        stop = min(stop + BLOCK_PX, cols)
        if stop < cols:
            following = _reading(transform, row, stop, shift_col, cols)
    return stop, following


@nb.njit(cache=True)
def update_model(codes: NDArray[np.int8], transform: NDArray[np.float64], share: int, model: NDArray[np.int8]) -> None:
    """Bring a frame into the model with a weight of 1 / share. transform : (2, 3) of the model's grid into the frame."""
    rows, cols = codes.shape
    weight = np.float32(1.0 / (WEIGHTS * share))
    for row in range(rows):
        first, following = 0, _reading(transform, float(row), 0, 0.0, cols)
        while first < cols:
            start, (r, to, w) = first, following
            first, following = _readings(transform, float(row), start, 0.0, cols, following)
            low, high = _inside(start + to, first - start, cols)
            if r < 0 or r >= rows - 1 or high <= low:
                continue
            low, high = start + low, start + high
            _mix_row(codes[r, low + to : high + to + 1], codes[r + 1, low + to : high + to + 1], w, weight, model[row, low:high])


def static_snr(model: NDArray[np.int8], place: NDArray[np.float64], psf_sigma_px: float) -> float:
    """S/N that what stands still at a place (row, col) of the model's grid has in one frame, by the PSF's matched filter."""
    width = math.hypot(psf_sigma_px, READING_PX)
    reach = math.ceil(STAR_REACH_SIGMAS * width)
    row, col = round(float(place[0])), round(float(place[1]))
    if not (reach <= row < model.shape[0] - reach and reach <= col < model.shape[1] - reach):
        return 0.0
    step = np.arange(-reach, reach + 1)
    by_row, by_col = (np.exp(-0.5 * ((at + step - p) / width) ** 2) for at, p in ((row, place[0]), (col, place[1])))
    profile = np.outer(by_row, by_col)
    seen = model[row - reach : row + reach + 1, col - reach : col + reach + 1] / UNIT
    return float((profile * seen).sum() / math.sqrt(float((profile**2).sum())))


@nb.njit(cache=True)
def add_moving(
    codes: NDArray[np.int8],
    transform: NDArray[np.float64],
    model: NDArray[np.int8],
    shift_row: float,
    shift_col: float,
    total: NDArray[np.int8],
) -> None:
    """Add a frame less the model to the sum of what moved by (shift_row, shift_col) px of the model's grid."""
    rows, cols = codes.shape
    sr, sc = math.floor(shift_row), math.floor(shift_col)
    gr, gc = shift_row - sr, shift_col - sc
    m = _weights(gr, gc)
    for row in range(rows):
        model_row, at = row + sr, row + shift_row
        if model_row < 0 or model_row >= rows - 1:
            continue
        first, following = 0, _reading(transform, at, 0, shift_col, cols)
        while first < cols:
            start, (r, to, w) = first, following
            first, following = _readings(transform, at, start, shift_col, cols, following)
            low, high = _inside(start + to, first - start, cols)
            low_model, high_model = _inside(start + sc, first - start, cols)
            low, high = start + max(low, low_model), start + min(high, high_model)
            if r < 0 or r >= rows - 1 or high <= low:
                continue
            _add_row(
                codes[r, low + to : high + to + 1],
                codes[r + 1, low + to : high + to + 1],
                w,
                model[model_row, low + sc : high + sc + 1],
                model[model_row + 1, low + sc : high + sc + 1],
                m,
                total[row, low:high],
            )
