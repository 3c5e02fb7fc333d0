"""A small picture of the frame for a person, and for the archive: mean residual of square cells, 8 bits."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

BRIGHT_SIGMA = 40.0
"""Cells brighter than this many sigmas of a cell's mean are shown white."""


ROW_STEP = 8
"""Rows from one that is read to the next in large cells: an eighth of the work for 2.8 times the noise of a cell."""


@njit(cache=True)
def cell_means(residual: NDArray[np.float32], cell_px: int, row_step: int, out: NDArray[np.float32]) -> None:
    """Mean of every `row_step`-th row of each cell."""
    rows, cols = residual.shape
    for i in range(out.shape[0]):
        row1 = min((i + 1) * cell_px, rows)
        for j in range(out.shape[1]):
            col0, col1 = j * cell_px, min((j + 1) * cell_px, cols)
            total, number = 0.0, 0
            for row in range(i * cell_px, row1, row_step):
                for col in range(col0, col1):
                    total += residual[row, col]
                number += col1 - col0
            out[i, j] = total / number


def thumbnail(residual: NDArray[np.float32], level: float, sigma: float, cell_px: int) -> tuple[NDArray[np.uint8], float, float]:
    """Cells as uint8 with the offset and unit (ADU above the dark) that turn them back into means."""
    shape = (-(-residual.shape[0] // cell_px), -(-residual.shape[1] // cell_px))
    means = np.empty(shape, dtype=np.float32)
    row_step = ROW_STEP if cell_px >= 4 * ROW_STEP else 1
    cell_means(residual, cell_px, row_step, means)
    noise = sigma / max(cell_px / math.sqrt(row_step), 1.0)
    unit = float(np.float32(max(BRIGHT_SIGMA * noise / 255.0, 1e-3)))
    offset = float(np.float32(level - 16.0 * unit))
    return np.clip(np.rint((means + level - offset) / unit), 0, 255).astype(np.uint8), offset, unit
