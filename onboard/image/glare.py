"""Parts of a frame that are not sky: large saturated areas, and the glow around them where no mesh can follow it."""

from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sboc_e2e.icd.flags import MaskBit
from sboc_e2e.icd.signals import BackgroundModel

SATURATED: Final = np.uint8(MaskBit.SATURATED)

FULL_SHARE: Final = 0.5
"""Least share of saturated pixels of a tile in a large area. Saturated pixels of stars do not fill a tile of 64 px."""

BENT_SIGMA: Final = 3.0
"""Second difference of the level, in sigma of the sky, that leaves up to 0.1 sigma beside the finest mesh."""


def _grown(area: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The area and the tiles that touch it."""
    padded = np.pad(area, 1)
    rows, cols = area.shape
    out = area.copy()
    for i in range(3):
        for j in range(3):
            out |= padded[i : i + rows, j : j + cols]
    return out


def _bend(level: NDArray[np.float32]) -> NDArray[np.float64]:
    """Largest second difference of a mesh along rows, columns."""
    padded = np.pad(level.astype(np.float64), 1, mode="edge")
    middle = padded[1:-1, 1:-1]
    bends = (padded[:-2, 1:-1] + padded[2:, 1:-1] - 2.0 * middle, padded[1:-1, :-2] + padded[1:-1, 2:] - 2.0 * middle)
    return np.asarray(np.maximum(np.abs(bends[0]), np.abs(bends[1])))


@njit(cache=True)
def _saturated(mask: NDArray[np.uint8]) -> np.int32:
    """Saturated pixels of a piece of a row; a function of its own so that it is compiled to vector instructions."""
    number = np.int32(0)
    for k in range(mask.size):
        number += np.int32((mask[k] & SATURATED) != 0)
    return number


@njit(cache=True)
def count_saturated(mask: NDArray[np.uint8], tile_px: int, out: NDArray[np.int32]) -> None:
    """Saturated pixels of each tile, added to out; pixels beyond the last tile do not count."""
    for row in range(min(mask.shape[0], out.shape[0] * tile_px)):
        for tile in range(out.shape[1]):
            out[row // tile_px, tile] += _saturated(mask[row, tile * tile_px : (tile + 1) * tile_px])


def glare_tiles(mask: NDArray[np.uint8], background: BackgroundModel) -> NDArray[np.bool_]:
    """(tile rows, tile cols) of the mesh that large saturated areas and their glow cover."""
    tile_px, shape = background.tile_px, background.level_adu.shape
    counts = np.zeros(shape, dtype=np.int32)
    count_saturated(mask, tile_px, counts)
    area = counts > FULL_SHARE * tile_px**2
    if not area.any():
        return np.asarray(area)
    glow = _bend(background.level_adu) > BENT_SIGMA * np.median(background.sigma_adu)
    area = _grown(np.asarray(area))
    while True:
        more = area | (_grown(area) & glow)
        if (more == area).all():
            return np.asarray(area)
        area = more


def mark_glare(residual: NDArray[np.float32], mask: NDArray[np.uint8], background: BackgroundModel) -> int:
    """Mask tiles of glare in place (`MaskBit.GLARE`, 0 in the image); returns how many pixels were usable before."""
    added, tile_px = 0, background.tile_px
    for i, j in zip(*np.nonzero(glare_tiles(mask, background)), strict=True):
        part = np.s_[i * tile_px : (i + 1) * tile_px, j * tile_px : (j + 1) * tile_px]
        added += int(np.count_nonzero(mask[part] == 0))
        mask[part] |= np.uint8(MaskBit.GLARE)
        residual[part] = 0.0
    return added
