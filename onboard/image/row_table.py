"""Tables of the few pixels of an image that something is to be kept of, row by row: where each row begins, and columns."""

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True)
def place_of(first: NDArray[np.int64], column: NDArray[np.int32], row: int, col: int) -> int:
    """Place of a pixel in the table, or -1. first : (rows + 1); column : of all entries, rising in each row."""
    low, high = first[row], first[row + 1]
    while low < high:
        middle = (low + high) // 2
        if column[middle] < col:
            low = middle + 1
        else:
            high = middle
    return low if low < first[row + 1] and column[low] == col else -1
