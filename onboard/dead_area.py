"""Parts of the detector that have gone dead: tiles whose pixels do not differ, in a frame whose other tiles are noisy.

Dark sky is never without noise. Left in, a dead part would pull level and noise of the sky beside it towards its own.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd.flags import MaskBit

TILE_PX: Final = 32
ROW_STEP: Final = 16
DEAD_BELOW: Final = 0.05
"""Share of neighbours in a row that differ: noise of half a count makes it 0.5, of two counts 0.86."""

NOISY_ABOVE: Final = 0.4
"""Share in the median tile above which noise resolves the counts, so that its absence means something."""


def dead_tiles(pixels: NDArray[np.uint16] | NDArray[np.int32]) -> NDArray[np.bool_]:
    """(tile rows, tile columns) of `TILE_PX`: True where the detector does not answer."""
    sample = pixels[::ROW_STEP]
    first_row, first_col = (np.arange(0, n, step) for n, step in zip(sample.shape, (TILE_PX // ROW_STEP, TILE_PX), strict=True))
    differs = np.zeros(sample.shape, dtype=np.uint8)
    np.not_equal(sample[:, 1:], sample[:, :-1], out=differs[:, 1:].view(np.bool_))
    along_rows = np.add.reduceat(differs, first_col, axis=1)
    in_tiles = np.add.reduceat(along_rows, first_row, axis=0, dtype=np.int64)
    size = np.outer(np.diff(first_row, append=sample.shape[0]), np.diff(first_col, append=sample.shape[1]))
    share: NDArray[np.float64] = in_tiles / size
    return (share < DEAD_BELOW) & bool(np.median(share) > NOISY_ABOVE)


def with_dead_area(
    defects: NDArray[np.uint8], pixels: NDArray[np.uint16] | NDArray[np.int32], saturation: int
) -> NDArray[np.uint8]:
    """The defect map with `MaskBit.DEAD` on dead tiles; the map itself where there is none.

    Saturated parts do not differ either; they are not dead, and are masked as what they are.
    """
    dead = dead_tiles(pixels)
    if not dead.any():
        return defects
    marked = defects.copy()
    for i, j in zip(*np.nonzero(dead), strict=True):
        part = np.s_[i * TILE_PX : (i + 1) * TILE_PX, j * TILE_PX : (j + 1) * TILE_PX]
        if not (pixels[part] >= saturation).any():
            marked[part] |= np.uint8(MaskBit.DEAD)
    return marked
