"""Sums of group images along straight tracks: a lattice of velocities first, then a climb to the best place and velocity."""

import math
from itertools import pairwise
from typing import Final, NamedTuple

import numba as nb
import numpy as np
from numpy.typing import NDArray

from onboard.track.packed import PIXELS, ZERO, code_at, pack, read_only, words_of

GROUP_UNIT: Final = 16
"""One sigma of a group image."""

LEVELS: Final = (0, 7, 14, 22, 31, 42, 57, 80)
"""Values that four bits a pixel tell apart, and their negatives: close where noise is, and up to five sigma. Chosen."""

BAND_ROWS: Final = 128
"""Rows that are summed at a time, unpacked."""

TILE_PX: Final = 128
"""The noise of a group image is measured in squares of this side."""

GUESS_EVERY: Final = 7
"""One pixel of so many along rows and columns is looked at for the first guess of the noise: some 300 of a tile, to 6 %."""

POWER_UNIT: Final = 4.0
"""Steps per unit of a filtered sum, whose noise is about 20, in which its power is summed: rounding adds 1e-5 of it."""

REACH_SIGMAS: Final = 3.5
"""The matched filter ends at so many widths, where a thousandth of its light is left."""

CLIP_SIGMA: Final = 3.0  # sigmas; CLIPPED_RMS belongs to it
CLIPPED_RMS: Final = 0.9865817
"""Rms of a normal variable without its values beyond CLIP_SIGMA, to 3e-6: sqrt(1 - 6 phi(3) / erf(3 / sqrt(2))) is 0.9865784."""

NEIGHBOURS: Final = 2
"""A maximum is the largest of the pixels so far around it."""

OUTER_PX: Final = 2.4
"""Largest distance of neighbouring lattice tracks at the ends of the window, along either axis; an object is half of it away at
most. A PSF of 0.85 px then loses a quarter of its sum over eight groups at the worst velocity, a tenth on average; the climb
regains it. At 1.2 px (8 % and 3 %) a wide box takes 3.3 times as long for the same objects (docs/many-frames.md)."""


def filter_sigma_px(psf_sigma_px: float) -> float:
    """Width of a star in a sum that was read between pixels: the PSF's, and 1/6 px^2 of bilinear reading on average."""
    return math.sqrt(psf_sigma_px**2 + 1.0 / 6.0)


def _codes() -> NDArray[np.uint8]:
    """Code of each value in GROUP_UNIT, by the value's bits: 8 for none, the nearest of LEVELS."""
    value = np.arange(256, dtype=np.uint8).view(np.int8).astype(np.float64)
    middles = 0.5 * (np.array(LEVELS[1:]) + np.array(LEVELS[:-1]))
    return np.asarray(ZERO + np.sign(value) * np.searchsorted(middles, np.abs(value)), np.uint8)


GROUP_CODES: Final = _codes()
VALUES: Final = np.array([0, *(-v for v in LEVELS[:0:-1]), *LEVELS], np.int8)
"""Value of each code."""


def _coded_rms() -> float:
    """Rms of a group image's noise as it is kept, for noise of one sigma."""
    borders = [0.5 * (a + b) / (GROUP_UNIT * math.sqrt(2.0)) for a, b in pairwise(LEVELS)]
    above = [math.erfc(b) for b in borders]
    share = [a - b for a, b in zip(above, [*above[1:], 0.0], strict=True)]
    return math.sqrt(sum(s * v * v for s, v in zip(share, LEVELS[1:], strict=True))) / GROUP_UNIT


CODED_UNIT: Final = GROUP_UNIT * _coded_rms()
"""One sigma of the noise of a kept group image."""


def group_image(total: NDArray[np.int8], psf_sigma_px: float) -> NDArray[np.uint64]:
    """Sum of a few frames -> matched filter -> units of its own noise, tile by tile; in four bits a pixel, LEVELS."""
    rows, cols = total.shape
    width = filter_sigma_px(psf_sigma_px)
    taps = np.exp(-0.5 * (np.arange(math.ceil(REACH_SIGMAS * width) + 1) / width) ** 2).astype(np.float32)
    out = np.zeros((rows, words_of(cols)), np.uint64)
    for row in range(0, rows, TILE_PX):
        band = total[row : row + TILE_PX]
        smooth, codes = np.empty(band.shape, np.float32), np.zeros(band.shape, np.int8)
        _filter(total, row, taps, smooth)
        _in_own_noise(smooth, band, codes)
        pack(codes.view(np.uint8), GROUP_CODES, out[row : row + TILE_PX])
    return read_only(out)


@nb.njit(cache=True)
def _filter(total: NDArray[np.int8], first: int, taps: NDArray[np.float32], out: NDArray[np.float32]) -> None:
    """Rows from `first` on after a symmetric filter along both axes, nothing outside. taps : half of it, the centre first."""
    rows, cols = total.shape
    reach = taps.size - 1
    line = np.zeros(cols + 2 * reach, np.float32)
    middle = line[reach : reach + cols]
    for row in range(first, first + out.shape[0]):
        middle[:] = 0.0
        for k in range(-reach, reach + 1):
            if 0 <= row + k < rows:
                _add_codes(middle, total[row + k], taps[abs(k)])
        sums = out[row - first]
        sums[:] = 0.0
        for k in range(-reach, reach + 1):
            _add_values(sums, line[reach + k : reach + k + cols], taps[abs(k)])


@nb.njit(cache=True)
def _add_codes(line: NDArray[np.float32], codes: NDArray[np.int8], weight: np.float32) -> None:
    for i in range(line.size):
        line[i] += weight * np.float32(codes[i])


@nb.njit(cache=True)
def _add_values(line: NDArray[np.float32], values: NDArray[np.float32], weight: np.float32) -> None:
    for i in range(line.size):
        line[i] += weight * values[i]


@nb.njit(cache=True)
def _in_own_noise(smooth: NDArray[np.float32], total: NDArray[np.int8], codes: NDArray[np.int8]) -> None:
    """Fill the codes of a row of tiles: units of each tile's noise, 0 where it is not known."""
    cols = smooth.shape[1]
    for first in range(0, cols, TILE_PX):
        last = min(first + TILE_PX, cols)
        sigma = _noise(smooth, total, first, last)
        for row in range(smooth.shape[0] if sigma > 0.0 else 0):
            _code_values(smooth[row, first:last], np.float32(GROUP_UNIT / sigma), codes[row, first:last])


@nb.njit(cache=True)
def _code_values(values: NDArray[np.float32], scale: np.float32, out: NDArray[np.int8]) -> None:
    for i in range(out.size):
        value = min(max(values[i] * scale, np.float32(-127.0)), np.float32(127.0))
        out[i] = np.int8(np.int32(value + np.float32(128.5)) - np.int32(128))


@nb.njit(cache=True)
def _noise(smooth: NDArray[np.float32], total: NDArray[np.int8], first: int, last: int) -> float:
    """Rms of a tile's values without outliers and without pixels whose sum is empty; 0 of fewer than 100 values."""
    sample, n = np.empty(smooth.shape[0] * (last - first), np.float32), 0
    for row in range(0, smooth.shape[0], GUESS_EVERY):
        for col in range(first, last, GUESS_EVERY):
            if total[row, col] != 0:
                sample[n] = abs(smooth[row, col])
                n += 1
    sigma = 1.4826 * np.median(sample[:n]) if n > 0 else 0.0
    for _ in range(3):
        power = count = 0
        for row in range(smooth.shape[0]):
            p, c = _power(smooth[row, first:last], total[row, first:last], np.float32(CLIP_SIGMA * sigma))
            power += p
            count += c
        if count < 100:
            return 0.0
        sigma = math.sqrt(power / count) / (POWER_UNIT * CLIPPED_RMS)
    return sigma


@nb.njit(cache=True)
def _power(values: NDArray[np.float32], total: NDArray[np.int8], limit: np.float32) -> tuple[int, int]:
    """Sum of the squares of a row's values below the limit, in 1 / POWER_UNIT, and how many; integers add in any order."""
    power, count = np.int32(0), np.int32(0)
    for i in range(values.size):
        inside = (abs(values[i]) < limit) & (total[i] != np.int8(0))
        value = np.int32(np.int32(values[i] * np.float32(POWER_UNIT) + np.float32(32768.5)) - np.int32(32768))
        power = np.int32(power + (np.int32(value * value) if inside else np.int32(0)))
        count = np.int32(count + np.int32(inside))
    return int(power), int(count)


def lattice(half_row: float, half_col: float, epochs: NDArray[np.float64]) -> NDArray[np.float64]:
    """Velocities (n, 2) of the box, px/s about its middle, so close that OUTER_PX holds."""
    reach = max(float(np.abs(epochs).max()), 1e-9)
    axes = [
        np.linspace(-h, h, math.ceil(2.0 * h * reach / OUTER_PX) + 1) if h > 0.0 else np.zeros(1) for h in (half_row, half_col)
    ]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)


def candidates(
    groups: tuple[NDArray[np.uint64], ...], cols: int, shifts: NDArray[np.int64], least: int
) -> tuple[NDArray[np.int64], NDArray[np.int16]]:
    """Places (n, 2) where the largest sum over all velocities is at least `least` and none within 2 px exceeds it.

    shifts : (velocities, groups, 2) px. Also returned: sum and number of velocity of each place, (n, 2).
    """
    rows = groups[0].shape[0]
    reach = int(np.abs(shifts[..., 0]).max(initial=0))
    band = np.zeros((len(groups), BAND_ROWS + 2 * (reach + NEIGHBOURS), cols), np.int8)
    best = np.empty((BAND_ROWS + 2 * NEIGHBOURS, cols), np.int16)
    which = np.zeros_like(best)
    places, sums = [], []
    for first in range(0, rows, BAND_ROWS):
        last = min(rows, first + BAND_ROWS)
        low, high = max(0, first - NEIGHBOURS), min(rows, last + NEIGHBOURS)
        for group, unpacked in zip(groups, band, strict=True):
            _unpack(group, low - reach, VALUES, unpacked)
        n = high - low
        stack(band, reach, shifts, best[:n], which[:n])
        found = maxima(best[:n], least, first - low, last - low)
        sums.append(np.stack([best[found[:, 0], found[:, 1]], which[found[:, 0], found[:, 1]]], axis=-1))
        places.append(found + np.array([low, 0]))
    return np.concatenate(places), np.concatenate(sums)


@nb.njit(cache=True)
def _unpack(words: NDArray[np.uint64], first: int, values: NDArray[np.int8], out: NDArray[np.int8]) -> None:
    """Rows of an image from `first` on; zero outside."""
    cols = out.shape[1]
    for i in range(out.shape[0]):
        row = first + i
        if row < 0 or row >= words.shape[0]:
            out[i, :] = 0
            continue
        for word in range(words.shape[1] - 2):
            bits = words[row, word + 1]
            for k in range(min(PIXELS, cols - PIXELS * word)):
                out[i, PIXELS * word + k] = values[(bits >> np.uint64(4 * k)) & np.uint64(15)]


@nb.njit(cache=True)
def _add_group(total: NDArray[np.int16], values: NDArray[np.int8]) -> None:
    """A row of a group; a function of its own so that it is compiled to vector instructions, as the next one."""
    for j in range(total.size):
        total[j] += np.int16(values[j])


@nb.njit(cache=True)
def _keep_better(total: NDArray[np.int16], number: np.int16, best: NDArray[np.int16], which: NDArray[np.int16]) -> None:
    for j in range(total.size):
        better = total[j] > best[j]
        best[j] = total[j] if better else best[j]
        which[j] = number if better else which[j]


@nb.njit(cache=True)
def stack(
    groups: NDArray[np.int8], first: int, shifts: NDArray[np.int64], best: NDArray[np.int16], which: NDArray[np.int16]
) -> None:
    """Largest sum at every pixel over all velocities, and the number of its velocity.

    groups (groups, rows, cols) : from `first` rows before those of the result on.
    """
    rows, cols = best.shape
    total = np.zeros(cols, np.int16)
    for row in range(rows):
        best[row, :] = -32768
        for h in range(shifts.shape[0]):
            total[:] = 0
            for g in range(groups.shape[0]):
                c = shifts[h, g, 1]
                low, high = max(0, -c), min(cols, cols - c)
                source = groups[g, first + row + shifts[h, g, 0]]
                if low < high:
                    _add_group(total[low:high], source[low + c : high + c])
            _keep_better(total, np.int16(h), best[row], which[row])


@nb.njit(cache=True)
def maxima(best: NDArray[np.int16], least: int, first: int, last: int) -> NDArray[np.int64]:
    """Places (n, 2) in rows first ... last - 1 of the sums from `least` on that none within NEIGHBOURS px exceeds."""
    rows, cols = best.shape
    out = np.empty((((last - first) // NEIGHBOURS + 1) * (cols // NEIGHBOURS + 1), 2), np.int64)
    n = 0
    for row in range(first, last):
        for col in range(cols):
            value = best[row, col]
            if value < least:
                continue
            highest = True
            for r in range(max(0, row - NEIGHBOURS), min(rows, row + NEIGHBOURS + 1)):
                for c in range(max(0, col - NEIGHBOURS), min(cols, col + NEIGHBOURS + 1)):
                    before = r < row or (r == row and c < col)
                    if best[r, c] > value or (before and best[r, c] == value):
                        highest = False
            if highest:
                out[n, 0], out[n, 1] = row, col
                n += 1
    return out[:n]


class GroupWindow(NamedTuple):
    """Group images and their columns, their epochs, and the correlation of the noise of neighbouring pixels."""

    groups: tuple[NDArray[np.uint64], ...]
    cols: int
    epochs: NDArray[np.float64]
    likeness: float


@nb.njit(cache=True)
def along(window: GroupWindow, place: NDArray[np.float64], out: NDArray[np.float64]) -> float:
    """S/N of a track, and that of each group into `out` (0 where it lies outside).

    place : row, col, and their rates, px and px/s.
    """
    groups, cols, epochs, likeness = window
    rows = groups[0].shape[0]
    total, count = 0.0, 0
    for g in range(len(groups)):
        row, col = place[0] + place[2] * epochs[g], place[1] + place[3] * epochs[g]
        r, c = math.floor(row), math.floor(col)
        out[g] = 0.0
        # between pixels the noise of the interpolated image is lower
        if 0 <= r < rows - 1 and 0 <= c < cols - 1:
            fr, fc = row - r, col - c
            top = VALUES[code_at(groups[g], r, c)] * (1 - fc) + VALUES[code_at(groups[g], r, c + 1)] * fc
            low = VALUES[code_at(groups[g], r + 1, c)] * (1 - fc) + VALUES[code_at(groups[g], r + 1, c + 1)] * fc
            kept = (1.0 - 2.0 * fr * (1 - fr) * (1.0 - likeness)) * (1.0 - 2.0 * fc * (1 - fc) * (1.0 - likeness))
            out[g] = (top * (1 - fr) + low * fr) / (CODED_UNIT * math.sqrt(kept))
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
