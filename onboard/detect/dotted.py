"""Entries of the star list in a close, straight row: a trail that comes in dots, of flashes or behind a shutter.

Masking them would eat the trail. How many there must be in a row follows from how densely the list fills the frame.
"""

import math
from typing import Final, NamedTuple

import numba as nb
import numpy as np
from numpy.typing import NDArray

GAP_PX: Final = 12.0
"""Most from entry to entry: dots are blinks of one exposure, and a few PSFs apart. Chosen, not measured."""

ASIDE_PX: Final = 1.2
"""Most across the row, where a dot and its fit err by half of it. Chosen, not measured."""

LEAST_DOTS: Final = 6
"""However sparse the list is. Chosen, not measured."""

BY_CHANCE: Final = 1e-3
"""Rows that evenly strewn entries may make in a frame."""

MOST_DOTS: Final = 16
"""Where more are needed, the list fills the frame, and a row says nothing."""


class Cells(NamedTuple):
    """Entries by cells of `GAP_PX`: where each cell begins in the order of entries, that order, and the cells of a row."""

    first: NDArray[np.int64]
    order: NDArray[np.int64]
    per_row: int


def dots_needed(n: int, n_pixels: int) -> int:
    """Entries in a row that `BY_CHANCE` frames of so many evenly strewn entries hold.

    Each has ``n pi GAP_PX^2 / n_pixels`` neighbours to begin a row with, and each row the next one in a strip ahead of it.
    """
    density = n / max(n_pixels, 1)
    ahead = min(2.0 * ASIDE_PX * GAP_PX * density, 0.99)
    pairs = n * math.pi * GAP_PX**2 * density
    if not 0.0 < BY_CHANCE < pairs:
        return LEAST_DOTS
    return max(LEAST_DOTS, 2 + math.ceil(math.log(BY_CHANCE / pairs) / math.log(ahead)))


def dots_in_rows(row: NDArray[np.float64], col: NDArray[np.float64], n_pixels: int) -> NDArray[np.bool_]:
    """Which entries (n,) lie in a row of as many as chance does not make."""
    needed = dots_needed(len(row), n_pixels)
    if needed > MOST_DOTS or len(row) < needed:
        return np.zeros(len(row), np.bool_)
    return _in_rows(row, col, needed)


@nb.njit(cache=True)
def _in_rows(row: NDArray[np.float64], col: NDArray[np.float64], needed: int) -> NDArray[np.bool_]:
    """Which entries lie in a row of so many."""
    n = row.shape[0]
    out, chain = np.zeros(n, np.bool_), np.empty(n, np.int64)
    cells = _cells(row, col)
    for a in range(n):
        for b in _near(cells, row[a], col[a]):
            apart = math.hypot(row[b] - row[a], col[b] - col[a])
            if b <= a or apart > GAP_PX or apart < 1.0 or (out[a] and out[b]):
                continue
            chain[0], chain[1] = a, b
            count = _grown(row, col, chain, 2, cells)
            chain[:count] = chain[:count][::-1].copy()
            count = _grown(row, col, chain, count, cells)
            if count >= needed:
                for k in range(count):
                    out[chain[k]] = True
    return out


@nb.njit(cache=True)
def _cells(row: NDArray[np.float64], col: NDArray[np.float64]) -> Cells:
    """Entries sorted into cells, with an empty one around all."""
    per_row = int(max(col.max(), 0.0) / GAP_PX) + 3
    first = np.zeros((int(max(row.max(), 0.0) / GAP_PX) + 3) * per_row + 1, np.int64)
    order = np.empty(row.shape[0], np.int64)
    for k in range(row.shape[0]):
        first[_cell(row[k], col[k], per_row) + 1] += 1
    first[:] = np.cumsum(first)
    place = first.copy()
    for k in range(row.shape[0]):
        cell = _cell(row[k], col[k], per_row)
        order[place[cell]] = k
        place[cell] += 1
    return Cells(first, order, per_row)


@nb.njit(cache=True)
def _cell(row: float, col: float, per_row: int) -> int:
    """The cell of a place; what lies before the first row or column is in the first."""
    return (int(max(row, 0.0) / GAP_PX) + 1) * per_row + int(max(col, 0.0) / GAP_PX) + 1


@nb.njit(cache=True)
def _near(cells: Cells, row: float, col: float) -> NDArray[np.int64]:
    """Entries in the cell of a place and in those around it."""
    first, order = cells.first, cells.order
    here = _cell(row, col, cells.per_row)
    above, below = here - cells.per_row, here + cells.per_row
    return np.concatenate(
        (
            order[first[above - 1] : first[above + 2]],
            order[first[here - 1] : first[here + 2]],
            order[first[below - 1] : first[below + 2]],
        )
    )


@nb.njit(cache=True)
def _grown(row: NDArray[np.float64], col: NDArray[np.float64], chain: NDArray[np.int64], count: int, cells: Cells) -> int:
    """Entries of a row that goes on beyond its last one, each time to the nearest ahead; into chain."""
    while count < row.shape[0]:
        begin, end = chain[0], chain[count - 1]
        length = math.hypot(row[end] - row[begin], col[end] - col[begin])
        u_row, u_col = (row[end] - row[begin]) / length, (col[end] - col[begin]) / length
        best, nearest = -1, GAP_PX
        for k in _near(cells, row[end], col[end]):
            d_row, d_col = row[k] - row[end], col[k] - col[end]
            along, across = d_row * u_row + d_col * u_col, abs(d_row * u_col - d_col * u_row)
            # a short row tells its direction less well
            if 1.0 < along < nearest and across < ASIDE_PX * (1.0 + 0.5 * along / length):
                best, nearest = k, along
        if best < 0:
            break
        chain[count] = best
        count += 1
    return count
