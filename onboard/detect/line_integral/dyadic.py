"""Approximate Radon transform over dyadic segments: sums along all lines of all lengths 2^l of a half-resolution image.

Block sums of height 2^(l+1) follow from pairs of height 2^l (Götz & Druckmüller 1996, Pattern Recognition 29, 711;
Brady 1998, SIAM J. Comput. 27, 107; as a streak detector Nir et al. 2018, AJ 156, 229): with s the shift of a line over a
block, ``S[l+1][j][s'](x) = S[l][2j][s'//2](x) + S[l][2j+1][s'//2](x + (s'+1)//2)``. Beside the blocks that begin at
multiples of their height, those that begin half a height later are tested too, so that a segment of any phase has a block
that holds most of it. Lines may enter and leave through the sides of the image: a block of shift s is stored for
x = -s ... cols-1 at index x + s.
"""

import math
from typing import Final

import numba as nb
import numpy as np
from numpy.typing import NDArray

from onboard.detect.whiten import UNIT

FAIR_ABOVE: Final = 8_000
"""From so many candidates on, those of each length and place share the work, best first: it may end before their list does."""

PLACE_PX: Final = 256
"""Side of a place, or more where candidates are longer. A horizon or a cloud has thousands of candidates, and a trail elsewhere
was never reached: in a picture of a landscape (1080 x 1920 px) 267 of 66,290 were. Chosen, not measured."""

COLLECT_WORK: Final = 2
"""Operations of a sum that is looked at for itself."""

CELL: Final = 8
"""Candidates of one block that cross its middle in the same cell of this many columns are one: the best of all shifts."""


CHUNK: Final = 256
"""Sums of which the largest is looked for at once, and which are passed over where it is below the threshold."""

LONG_BLOCK_STEP: Final = 0.06
"""The threshold falls by so many sigma for each doubling of the block beyond 32 rows."""


@nb.njit(cache=True)
def _add_best(a: NDArray[np.int16], b: NDArray[np.int16], out: NDArray[np.int16]) -> np.int16:
    best = np.int16(-32768)
    for i in range(out.shape[0]):
        value = np.int16(a[i] + b[i])
        out[i] = value
        best = max(best, value)
    return best


@nb.njit(cache=True)
def _halve(values: NDArray[np.int16]) -> None:
    for i in range(values.shape[0]):
        values[i] = (values[i] + np.int16(1)) >> 1


@nb.njit(cache=True)
def _merge_row(a: NDArray[np.int16], b: NDArray[np.int16], out: NDArray[np.int16], lag: int) -> np.int16:
    """out[k] = a[k - lag] + b[k] on rows of length n (a, b) and n + lag (out); the largest sum is returned."""
    n = a.shape[0]
    out[:lag] = b[:lag]
    best = _add_best(a[: n - lag], b[lag:], out[lag:n])
    out[n : n + lag] = a[n - lag :]
    return best


@nb.njit(cache=True)
def _collect(
    sums: NDArray[np.int16], shift: int, threshold: int, unit: float, best: NDArray[np.float32], place: NDArray[np.int32]
) -> None:
    """Keep the best sum of each cell of the block's middle; place holds (shift, first column)."""
    for low in range(0, sums.shape[0], CHUNK):
        high = min(low + CHUNK, sums.shape[0])
        if _largest(sums[low:high]) <= threshold:
            continue
        for k in range(low, high):
            if sums[k] > threshold:
                value = sums[k] * unit
                first = k - shift
                cell = max(0, (first + shift // 2) // CELL)
                if value > best[cell]:
                    best[cell] = value
                    place[cell, 0] = shift
                    place[cell, 1] = first


@nb.njit(cache=True)
def _largest(values: NDArray[np.int16]) -> np.int16:
    best = np.int16(-32768)
    for i in range(values.shape[0]):
        best = max(best, values[i])
    return best


@nb.njit(cache=True)
def _keep_best(found: NDArray[np.float32], first: int, stop: int) -> tuple[int, float]:
    """Keep the better half of rows first..stop-1 by S/N, in place and in their order; returns the new stop and the least S/N."""
    values = np.sort(found[first:stop, 4])
    least = values[values.size // 2]
    n = first
    for k in range(first, stop):
        if found[k, 4] > least:
            found[n] = found[k]
            n += 1
    return n, float(least)


@nb.njit(cache=True, nogil=True)
def line_sums(
    image: NDArray[np.int16],
    upside_down: bool,
    noise: NDArray[np.float64],
    threshold_sigma: float,
    min_rows: int,
    max_found: int,
    current: NDArray[np.int16],
    following: NDArray[np.int16],
    work: NDArray[np.int64],
) -> NDArray[np.float32]:
    """Segments along growing rows with 0 <= dcol/drow <= 1 whose sum exceeds the threshold.

    image : (rows, cols) int16, zero mean. noise : (2,) standard deviation of a sum of n rows is sqrt(n (noise[0] +
    (noise[1] - noise[0]) slope)). upside_down : rows are taken in reverse. current, following : work space of `work_size`.
    work (1,) : grows by the sums that were looked at one by one, in blocks with one above the threshold.
    Returns (n, 5): first row, number of rows, first column, shift, S/N. Blocks of each height have the same share of the room,
    so that a storm of short ones does not crowd the long ones out; of more than that the most significant are kept.
    """
    rows, cols = image.shape
    found = np.empty((max_found, 5), np.float32)
    n_found = 0
    levels = 0
    while (1 << levels) < rows:
        levels += 1
    full = 1 << levels
    for row in range(rows):
        current[row * (cols + 1) : row * (cols + 1) + cols] = image[rows - 1 - row if upside_down else row]
    blocks = rows
    scratch = np.empty(cols + full, np.int16)
    best = np.zeros(cols // CELL + full // CELL + 2, np.float32)
    place = np.zeros((cols // CELL + full // CELL + 2, 2), np.int32)
    unit_scale = 1.0
    for doubling in range(levels):
        half = 1 << doubling
        height = 2 * half
        pitch, next_pitch = cols + half, cols + height
        next_blocks = (blocks + 1) // 2
        searched = height >= min_rows
        level_start, room = n_found, max(2, max_found // levels)
        rescale = doubling == 5 or doubling == 8
        # long blocks fit a trail's length and slope less well, and there are few independent ones
        wanted = threshold_sigma - LONG_BLOCK_STEP * max(0.0, math.log2(height / 32.0))
        for first in range(blocks):
            last = first + 1
            even = first % 2 == 0
            if last == blocks and not even:
                continue
            kept = even and height < rows
            if not (kept or searched):
                continue
            best[:] = 0.0
            hit = False
            for shift in range(height):
                half_shift = shift // 2
                lag = shift - half_shift
                a0 = (first * half + half_shift) * pitch
                a = current[a0 : a0 + cols + half_shift]
                if kept:
                    o0 = (first // 2 * height + shift) * next_pitch
                    out = following[o0 : o0 + cols + shift]
                else:
                    out = scratch[: cols + shift]
                if last < blocks:
                    b0 = (last * half + half_shift) * pitch
                    peak = _merge_row(a, current[b0 : b0 + cols + half_shift], out, lag)
                else:
                    out[:lag] = 0
                    out[lag:] = a
                    peak = np.int16(0)
                if searched:
                    slope = shift / (height - 1)
                    unit = unit_scale / math.sqrt(height * (noise[0] + (noise[1] - noise[0]) * slope))
                    if peak * unit > wanted:
                        _collect(out, shift, int(wanted / unit), unit, best, place)
                        hit = True
                        work[0] += COLLECT_WORK * out.shape[0]
                if kept and rescale:
                    _halve(out)
            if hit:
                work[0] += COLLECT_WORK * best.shape[0]
                for cell in range(best.shape[0]):
                    if n_found - level_start == room:
                        n_found, least = _keep_best(found, level_start, n_found)
                        wanted = max(wanted, least)
                    if best[cell] > wanted:
                        found[n_found, 0] = first * half
                        found[n_found, 1] = height
                        found[n_found, 2] = place[cell, 1]
                        found[n_found, 3] = place[cell, 0]
                        found[n_found, 4] = best[cell]
                        n_found += 1
        if rescale:
            unit_scale *= 2.0
        current, following = following, current
        blocks = next_blocks
    return found[:n_found]


def half_resolution_noise(taps: NDArray[np.int16], usable: float) -> NDArray[np.float64]:
    """Variance per row of a line sum of the half-resolution image, for slope 0 and slope 1 (shape (2,)).

    taps : half of the even smoothing kernel, which correlates neighbours. usable : share of pixels that are not masked.
    """
    kernel = np.concatenate([taps[::-1], taps]).astype(np.float64)
    correlation = np.correlate(kernel, kernel, "full")[len(kernel) - 1 :: 2]
    correlation = correlation[1:] / correlation[0]
    variance = (2.0 * UNIT) ** 2 * max(usable, 0.01)
    return variance * np.array([1.0 + 2.0 * correlation.sum(), 1.0 + 2.0 * (correlation**2).sum()])


@nb.njit(cache=True)
def work_size(rows: int, cols: int) -> int:
    """Elements of one work array of `line_sums`: all block sums of the level that needs most (the last one is not kept)."""
    size, height = rows * (cols + 1), 1
    while 2 * height < rows:
        height *= 2
        size = max(size, ((rows + height - 1) // height) * height * (cols + height))
    return size


def turned(image: NDArray[np.int16], room: NDArray[np.int16]) -> NDArray[np.int16]:
    """The image transposed in its own memory; room : work space of at least as many elements."""
    copy = room[: image.size].reshape(image.shape[::-1])
    _transpose(image, copy)
    out = image.reshape(copy.shape)
    out[:] = copy
    return out


@nb.njit(cache=True)
def _transpose(image: NDArray[np.int16], out: NDArray[np.int16]) -> None:
    """In blocks whose rows fit the ways of the cache: rows of 4,096 bytes all fall into one set."""
    rows, cols = image.shape
    for i0 in range(0, rows, 32):
        for j0 in range(0, cols, 8):
            for i in range(i0, min(rows, i0 + 32)):
                for j in range(j0, min(cols, j0 + 8)):
                    out[j, i] = image[i, j]


def coarse_segments(
    binned: NDArray[np.int16], noise: NDArray[np.float64], threshold_sigma: float, min_rows: int, max_found: int
) -> tuple[NDArray[np.float64], int]:
    """Candidates of all four quadrants of angles, (n, 6): axis, major0, minor0, major1, minor1 (px), S/N; best first.

    Also the operations beside those of the sums themselves. The memory of `binned` is used up.
    """
    tables, work = [], np.zeros(1, np.int64)
    size = max(work_size(*binned.shape), work_size(*binned.shape[::-1]))
    current, following = np.empty(size, np.int16), np.empty(size, np.int16)
    for axis in (0, 1):
        image = turned(binned, current) if axis else binned
        for upside_down in (False, True):
            found = line_sums(image, upside_down, noise, threshold_sigma, min_rows, max_found, current, following, work)
            found = found.astype(np.float64)
            first, last = found[:, 0], found[:, 0] + found[:, 1] - 1.0
            enter, leave = found[:, 2], found[:, 2] + found[:, 3]
            if upside_down:
                first, last = image.shape[0] - 1 - last, image.shape[0] - 1 - first
                enter, leave = leave, enter
            ends = 2.0 * np.stack([first, enter, last, leave], axis=1) + 0.5
            tables.append(np.column_stack([np.full(len(found), float(axis)), ends, found[:, 4]]))
    return in_order(np.concatenate(tables)), int(work[0])


def in_order(candidates: NDArray[np.float64]) -> NDArray[np.float64]:
    """Candidates best first; of more than FAIR_ABOVE those of each octave of length and each place share the work."""
    best_first = candidates[np.argsort(-candidates[:, 5], kind="stable")]
    if len(best_first) <= FAIR_ABOVE:
        return np.asarray(best_first)
    length = best_first[:, 3] - best_first[:, 1] + 2.0
    octave = np.log2(length).astype(np.int64)
    middle = 0.5 * (best_first[:, 1:3] + best_first[:, 3:5])
    middle = np.where(best_first[:, :1] == 0.0, middle, middle[:, ::-1])
    row, col = np.maximum(middle / np.maximum(2.0**octave, PLACE_PX)[:, None], 0.0).astype(np.int64).T
    return np.asarray(best_first[np.argsort(spent_before((octave << 16) + (row << 8) + col, length), kind="stable")])


def wanted_sigma(threshold_sigma: float, rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """S/N asked of blocks of so many rows of the half-resolution image."""
    return np.asarray(threshold_sigma - LONG_BLOCK_STEP * np.maximum(0.0, np.log2(rows / 32.0)))


def above(candidates: NDArray[np.float64], threshold_sigma: float) -> NDArray[np.bool_]:
    """Which candidates (see `coarse_segments`) a search with a higher threshold would have kept."""
    rows = 0.5 * (candidates[:, 3] - candidates[:, 1]) + 1.0
    return np.asarray(candidates[:, 5] > wanted_sigma(threshold_sigma, rows))


def spent_before(group: NDArray[np.int64], work: NDArray[np.float64]) -> NDArray[np.float64]:
    """Work for the members of the same group before each one, shape (n,)."""
    order = np.argsort(group, kind="stable")
    before = np.cumsum(work[order]) - work[order]
    start = np.searchsorted(group[order], group[order], side="left")
    out = np.empty(len(group))
    out[order] = before - before[start]
    return out


def turns(group: NDArray[np.int64]) -> NDArray[np.float64]:
    """Number of members of the same group before each one, shape (n,)."""
    return spent_before(group, np.ones(len(group)))
