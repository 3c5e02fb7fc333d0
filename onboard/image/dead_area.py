"""Parts of the detector that have gone dead: tiles whose pixels do not differ, in a frame whose other tiles are noisy.

Dark sky always has noise. An unmasked dead part would bias level and noise of the sky next to it.
"""

from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sboc_e2e.icd.flags import MaskBit

TILE_PX: Final = 32  # the smallest dead part that is seen. Chosen, not measured
ROW_STEP: Final = 16  # 2 rows, 64 pairs of a tile: fewer than 4 differ with a chance of 1e-10 where 0.4 do
DEAD_BELOW: Final = 0.05
"""Share of neighbours in a row that differ: noise of half a count makes it 0.5, of two counts 0.86."""

NOISY_ABOVE: Final = 0.4
"""Share in the median tile above which noise resolves the counts, so that its absence means something."""


@njit(cache=True)
def _count_differing(row: NDArray[np.uint16] | NDArray[np.int32]) -> int:
    """How many pixels of a row differ from their left neighbours."""
    count = np.int32(0)
    for col in range(1, row.size):
        count += np.int32(row[col] != row[col - 1])
    return int(count)


@njit(cache=True)
def shares_that_differ(pixels: NDArray[np.uint16] | NDArray[np.int32], share: NDArray[np.float64]) -> None:
    """Share of each tile's pixels, on every `ROW_STEP`-th row, that differ from their left neighbours."""
    rows, cols = pixels.shape
    for i in range(share.shape[0]):
        for j in range(share.shape[1]):
            first, stop = j * TILE_PX, min((j + 1) * TILE_PX, cols)
            number = 0
            for row in range(i * TILE_PX, min((i + 1) * TILE_PX, rows), ROW_STEP):
                share[i, j] += _count_differing(pixels[row, max(first - 1, 0) : stop])
                number += stop - first
            share[i, j] /= number


def dead_tiles(pixels: NDArray[np.uint16] | NDArray[np.int32]) -> NDArray[np.bool_]:
    """(tile rows, tile columns) of `TILE_PX`: True where the detector does not answer."""
    share = np.zeros((-(-pixels.shape[0] // TILE_PX), -(-pixels.shape[1] // TILE_PX)))
    shares_that_differ(pixels, share)
    return (share < DEAD_BELOW) & bool(np.median(share) > NOISY_ABOVE)


def mark_dead_area(defects: NDArray[np.uint8], pixels: NDArray[np.uint16] | NDArray[np.int32], saturation: int) -> None:
    """Set `MaskBit.DEAD` on dead tiles of the map of defects.

    Pixels of saturated parts do not differ either. They are not dead, and are masked as saturated.
    """
    for i, j in zip(*np.nonzero(dead_tiles(pixels)), strict=True):
        part = np.s_[i * TILE_PX : (i + 1) * TILE_PX, j * TILE_PX : (j + 1) * TILE_PX]
        if not (pixels[part] >= saturation).any():
            defects[part] |= np.uint8(MaskBit.DEAD)
