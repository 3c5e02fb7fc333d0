"""Entries of the star list in a close, straight row: a trail that comes in dots, of flashes or behind a shutter.

Masking them would eat the trail. How many there must be in a row follows from how densely the list fills the frame.
"""

import math
from typing import Final

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

MOST_DOTS: Final = 40
"""Where more are needed, the list fills the frame, and a row says nothing."""


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
    out = np.zeros(len(row), np.bool_)
    if needed > MOST_DOTS or len(row) < needed:
        return out
    order = np.argsort(row, kind="stable")
    out[order] = _in_rows(row[order], col[order], needed)
    return out


@nb.njit(cache=True)
def _in_rows(row: NDArray[np.float64], col: NDArray[np.float64], needed: int) -> NDArray[np.bool_]:
    """The same for entries by rising row."""
    n = row.shape[0]
    out, chain = np.zeros(n, np.bool_), np.empty(n, np.int64)
    for a in range(n):
        for b in range(a + 1, n):
            if row[b] - row[a] > GAP_PX:
                break
            apart = math.hypot(row[b] - row[a], col[b] - col[a])
            if apart > GAP_PX or apart < 1.0 or (out[a] and out[b]):
                continue
            chain[0], chain[1] = a, b
            count = _grown(row, col, chain, 2)
            chain[:count] = chain[:count][::-1].copy()
            count = _grown(row, col, chain, count)
            if count >= needed:
                for k in range(count):
                    out[chain[k]] = True
    return out


@nb.njit(cache=True)
def _grown(row: NDArray[np.float64], col: NDArray[np.float64], chain: NDArray[np.int64], count: int) -> int:
    """Entries of a row that goes on beyond its last one, each time to the nearest ahead; into chain."""
    while count < row.shape[0]:
        first, last = chain[0], chain[count - 1]
        length = math.hypot(row[last] - row[first], col[last] - col[first])
        u_row, u_col = (row[last] - row[first]) / length, (col[last] - col[first]) / length
        best, nearest = -1, GAP_PX
        for step in (-1, 1):
            k = last + step
            while 0 <= k < row.shape[0] and abs(row[k] - row[last]) <= GAP_PX:
                d_row, d_col = row[k] - row[last], col[k] - col[last]
                along, across = d_row * u_row + d_col * u_col, abs(d_row * u_col - d_col * u_row)
                # a short row tells its direction less well
                if 1.0 < along < nearest and across < ASIDE_PX * (1.0 + 0.5 * along / length):
                    best, nearest = k, along
                k += step
        if best < 0:
            break
        chain[count] = best
        count += 1
    return count
