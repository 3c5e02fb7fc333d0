"""Approximate Radon transform over dyadic segments: sums along all lines of all lengths 2^l of a half-resolution image.

Block sums of height 2^(l+1) follow from pairs of height 2^l (Götz & Druckmüller 1996, Pattern Recognition 29, 711;
Brady 1998, SIAM J. Comput. 27, 107; as a streak detector Nir et al. 2018, AJ 156, 229): with s the shift of a line over a
block, ``S[l+1][j][s'](x) = S[l][2j][s'//2](x) + S[l][2j+1][s'//2](x + (s'+1)//2)``. Beside the blocks that begin at
multiples of their height, those that begin half a height later are tested too, so that a segment of any phase has a block
that holds most of it. Lines may enter and leave through the sides of the image: a block of shift s is stored for
x = -s ... cols-1 at index x + s.
"""

import math
from typing import Final, NamedTuple

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

HALVED: Final = (6, 9)
"""Sums of 2^6 and 2^9 rows are halved, so that 16 bits hold those of all heights."""

LONG_BLOCK_STEP: Final = 0.06
"""The threshold falls by so many sigma for each doubling of the block beyond 32 rows."""


@nb.njit(cache=True)
def _add_best(store: NDArray[np.int16], upper: int, lower: int, out: int, n: int) -> np.int16:
    """Add n sums from two places of the store into a third; the largest is returned.

    Places instead of slices: each slice is counted by atomic operations, which took as long as the sums.
    """
    a, b, o = np.uint64(upper), np.uint64(lower), np.uint64(out)
    best = np.int16(-32768)
    for i in range(np.uint64(n)):
        value = np.int16(store[a + i] + store[b + i])
        store[o + i] = value
        best = max(best, value)
    return best


@nb.njit(cache=True)
def _largest_sum(store: NDArray[np.int16], upper: int, lower: int, n: int) -> np.int16:
    a, b = np.uint64(upper), np.uint64(lower)
    best = np.int16(-32768)
    for i in range(np.uint64(n)):
        best = max(best, np.int16(store[a + i] + store[b + i]))
    return best


@nb.njit(cache=True)
def _copy(store: NDArray[np.int16], first: int, out: int, n: int) -> None:
    a, o = np.uint64(first), np.uint64(out)
    for i in range(np.uint64(n)):
        store[o + i] = store[a + i]


@nb.njit(cache=True)
def _halve(values: NDArray[np.int16]) -> None:
    for i in range(values.shape[0]):
        values[i] = (values[i] + np.int16(1)) >> 1


@nb.njit(cache=True)
def _merge_row(store: NDArray[np.int16], a: int, b: int, out: int, n: int, lag: int) -> np.int16:
    """out[k] = a[k - lag] + b[k] on rows of length n (a, b) and n + lag (out) of the store; the largest sum is returned."""
    _copy(store, b, out, lag)
    _copy(store, a + n - lag, out + n, lag)
    return _add_best(store, a, b + lag, out + lag, n - lag)


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
def _keep_best(found: NDArray[np.float32], stop: int) -> tuple[int, float]:
    """Keep the better half of the first `stop` rows by S/N, in place and in their order; returns how many, and the least S/N."""
    values = np.sort(found[:stop, 4])
    least = values[values.size // 2]
    n = 0
    for k in range(stop):
        if found[k, 4] > least:
            found[n] = found[k]
            n += 1
    return n, float(least)


class Search(NamedTuple):
    """What is looked for in blocks of each height 2^level, and what was found; level comes first in all shapes.

    wanted (levels + 1,) : least S/N. noise (2,), work (1,) : see `line_sums`. blocks (levels + 1,) : of each height in the image.
    best, place, hit : of the block that is being made (see `_collect`). found (levels + 1, room, 5), listed : what `line_sums`
    returns.
    """

    wanted: NDArray[np.float64]
    noise: NDArray[np.float64]
    work: NDArray[np.int64]
    blocks: NDArray[np.int64]
    best: NDArray[np.float32]
    place: NDArray[np.int32]
    hit: NDArray[np.bool_]
    found: NDArray[np.float32]
    listed: NDArray[np.int64]


@nb.njit(cache=True)
def _search(
    rows: int, cols: int, levels: int, noise: NDArray[np.float64], sigma: float, max_found: int, work: NDArray[np.int64]
) -> Search:
    """Nothing found yet."""
    wanted, blocks = np.empty(levels + 1), np.empty(levels + 1, np.int64)
    for level in range(levels + 1):
        # long blocks fit a trail's length and slope less well, and there are few independent ones
        wanted[level] = sigma - LONG_BLOCK_STEP * max(0.0, math.log2((1 << level) / 32.0))
        blocks[level] = (rows + (1 << level) - 1) >> level
    cells = cols // CELL + (1 << levels) // CELL + 2
    best, place = np.empty((levels + 1, cells), np.float32), np.empty((levels + 1, cells, 2), np.int32)
    found = np.empty((levels + 1, max(2, max_found // levels), 5), np.float32)
    hit, listed = np.zeros(levels + 1, np.bool_), np.zeros(levels + 1, np.int64)
    return Search(wanted, noise, work, blocks, best, place, hit, found, listed)


@nb.njit(cache=True)
def _look(search: Search, level: int, shift: int, unit: float, sums: NDArray[np.int16]) -> None:
    """Collect from a block's sums of one shift, of which one exceeds what is wanted."""
    if not search.hit[level]:
        search.hit[level] = True
        search.best[level] = 0.0
    _collect(sums, shift, int(search.wanted[level] / unit), unit, search.best[level], search.place[level])
    search.work[0] += COLLECT_WORK * sums.shape[0]


@nb.njit(cache=True)
def _list(search: Search, level: int, first_row: int) -> None:
    """List what a complete block showed above what is wanted."""
    found, best, place, n = search.found[level], search.best[level], search.place[level], search.listed[level]
    search.hit[level] = False
    search.work[0] += COLLECT_WORK * best.shape[0]
    for cell in range(best.shape[0]):
        if n == found.shape[0]:
            n, least = _keep_best(found, n)
            search.wanted[level] = max(search.wanted[level], least)
        if best[cell] > search.wanted[level]:
            found[n, 0], found[n, 1] = first_row, 1 << level
            found[n, 2], found[n, 3] = place[cell, 1], place[cell, 0]
            found[n, 4] = best[cell]
            n += 1
    search.listed[level] = n


@nb.njit(cache=True)
def _unit(noise: NDArray[np.float64], level: int, shift: int) -> float:
    """S/N of a sum of 1 along a block's line."""
    height, scale = 1 << level, 1.0 if level <= HALVED[0] else 2.0 if level <= HALVED[1] else 4.0
    return scale / math.sqrt(height * (noise[0] + (noise[1] - noise[0]) * (shift / (height - 1))))


@nb.njit(cache=True)
def _bring(
    search: Search, store: NDArray[np.int16], place: NDArray[np.int64], cols: int, lowest: int, block: int, min_rows: int
) -> None:
    """Take up a block of height 2^lowest, and make all that it completes, row by row: each makes two of the next height.

    block : its number; a row of the image, or one past its last block of this height, which holds nothing. place (levels + 1,
    full / 2 + 1) : where in the store the row of each shift is; at index 2^level a free one, which takes the next; the last one
    for rows that are not kept.
    """
    levels, top, empty = place.shape[0] - 1, lowest, block == search.blocks[lowest]
    scratch = place[levels, 0]
    while (block >> (top - lowest)) & 1:
        top += 1
    for turn in range(1 << top):
        for level in range(lowest, top + 1):
            if turn & ((1 << (top - level)) - 1):
                continue
            shift, number, height = turn >> (top - level), block >> (level - lowest), 1 << level
            sums = place[level, height] if level < levels else scratch
            if level > lowest:
                half = shift >> 1
                lag, n = shift - half, cols + half
                free = place[level - 1, height >> 1]
                if empty and level == lowest + 1:
                    store[sums : sums + lag] = 0
                    _copy(store, place[level - 1, half], sums + lag, n)
                else:
                    peak = _merge_row(store, place[level - 1, half], free, sums, n, lag)
                    if height >= min_rows:
                        unit = _unit(search.noise, level, shift)
                        if peak * unit > search.wanted[level]:
                            _look(search, level, shift, unit, store[sums : sums + cols + shift])
                        if shift == height - 1 and search.hit[level]:
                            _list(search, level, number * height)
                    if shift & 1:  # both rows that it makes are made
                        place[level - 1, height >> 1], place[level - 1, half] = place[level - 1, half], free
                if level in HALVED:
                    _halve(store[sums : sums + cols + shift])
            if level < top or level == levels or (empty and level == lowest):
                continue
            before = place[level, shift]
            if number > 0 and 2 * height >= min_rows:
                # with the block before it, half a height later than what is stored
                n = cols + shift
                for k in range(2):
                    lag, later = shift + k, shift + shift + k
                    unit = _unit(search.noise, level + 1, later)
                    if _largest_sum(store, before, sums + lag, n - lag) * unit > search.wanted[level + 1]:
                        _merge_row(store, before, sums, scratch, n, lag)
                        _look(search, level + 1, later, unit, store[scratch : scratch + n + lag])
                if shift == height - 1 and search.hit[level + 1]:
                    _list(search, level + 1, (number - 1) * height)
            place[level, height], place[level, shift] = before, sums


@nb.njit(cache=True, nogil=True)
def line_sums(
    image: NDArray[np.int16],
    upside_down: bool,
    noise: NDArray[np.float64],
    threshold_sigma: float,
    min_rows: int,
    max_found: int,
    store: NDArray[np.int16],
    work: NDArray[np.int64],
) -> NDArray[np.float32]:
    """Segments along growing rows with 0 <= dcol/drow <= 1 whose sum exceeds the threshold.

    image : (rows, cols) int16, zero mean, two rows or more. noise : (2,) standard deviation of a sum of n rows is
    sqrt(n (noise[0] + (noise[1] - noise[0]) slope)). upside_down : rows are taken in reverse. store : work space of `work_size`.
    work (1,) : grows by the sums that were looked at one by one, in blocks with one above the threshold.
    Returns (n, 5): first row, number of rows, first column, shift, S/N. Blocks of each height have the same share of the room,
    so that a storm of short ones does not crowd the long ones out; of more than that the most significant are kept.

    Each row of the image makes the sums of all heights that it completes before the next one comes. Only the newest block of each
    height is stored, and low ones stay in the cache.
    """
    rows, cols = image.shape
    levels = 0
    while (1 << levels) < rows:
        levels += 1
    place, begin = np.empty((levels + 1, (1 << levels) // 2 + 1), np.int64), 0
    for level in range(levels):
        for k in range((1 << level) + 1):
            place[level, k] = begin
            begin += cols + (1 << level)
    place[levels, 0] = begin
    search = _search(rows, cols, levels, noise, threshold_sigma, max_found, work)
    for row in range(rows):
        store[place[0, 1] : place[0, 1] + cols] = image[rows - 1 - row if upside_down else row]
        _bring(search, store, place, cols, 0, row, min_rows)
    for level in range(levels):
        if search.blocks[level] & 1:  # half of the block that it belongs to lies outside
            _bring(search, store, place, cols, level, search.blocks[level], min_rows)
    out, n = np.empty((search.listed.sum(), 5), np.float32), 0
    for level in range(levels + 1):
        out[n : n + search.listed[level]] = search.found[level, : search.listed[level]]
        n += search.listed[level]
    return out


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
    """Elements of the work array of `line_sums`: a block of each height but the last, a row more of each, and one not kept."""
    size, height = 0, 1
    while height < rows:
        size += (height + 1) * (cols + height)
        height *= 2
    return size + cols + height


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
    store = np.empty(size, np.int16)
    for axis in (0, 1):
        image = turned(binned, store) if axis else binned
        for upside_down in (False, True):
            found = line_sums(image, upside_down, noise, threshold_sigma, min_rows, max_found, store, work)
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
