"""What stars leave around the pixels that were taken out for them is taken off, in the mean over the stars of a frame.

A star's image is wider than the model of its core. What is left around it is a fifth to half a sigma a pixel as far as 4 px away,
where no pixel is masked. It stands still, so that a track past several stars has light in every frame: in 96 simulated frames
without any object 73 tracks came within 0.4 of the threshold or above it, and 29 without this light.

The level of the sky is the mean of a tile, this light included. So as much as is taken off a tile goes back to all of its pixels:
else the sky between the stars lies 0.015 to 0.06 sigma too low, and a trail of 250 px and S/N 3.5 loses 4 % of its S/N.
"""

from typing import Final

import numba as nb
import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd.signals import UNKNOWN, StarList

REACH_PX: Final = 4
"""Pixels about a star's centre in which its light is looked for: beyond them the mean is below 0.05 sigma."""
SIDE: Final = 2 * REACH_PX + 1
"""Pixels of a star's square along a side."""
RINGS: Final = REACH_PX**2
"""Rings of equal area about a star: those at r^2 = k ... k + 1 px^2. The square's corners lie outside of all."""
PHASES: Final = 4
"""Places of a centre within its pixel that are told apart along an axis."""

FAINTEST: Final = 4.0
"""S/N of the faintest kind of star."""
PER_OCTAVE: Final = 2
"""Kinds of stars in each doubling of their S/N: masks and subtraction change with it."""
KINDS: Final = 16
"""Kinds in all; what is brighter than the last is of its kind."""

TILE_PX: Final = 256
"""Side of the tiles that get back what was taken off them: 140 stars of a frame of 35,000. Chosen, not measured."""

COUNTED: Final = 4  # known pixels are counted in one row of so many: 0.3 % of a tile's share, which is small itself

ROW_PHASE: Final = 107
"""By which the pattern that gives back fractions of a code goes on from row to row, in 256ths: the root of two, so that ..."""
COL_PHASE: Final = 158
"""... any few pixels of a line get their share. The same from column to column: the golden section."""

LEAST_PIXELS: Final = 200
"""Fewer pixels of a ring tell no mean to a tenth of a sigma, and it stays. Smoothed pixels side by side are alike."""


def take_off(image: NDArray[np.int8], stars: StarList) -> None:
    """Take off an image as `Searched.smooth` (rows, cols) what stars of like S/N leave on each ring about them. In place.

    Its mean over a tile stays.
    Nothing is taken off where stars are trails, and about those whose rings the border cuts.
    """
    if stars.motion is not None:
        return
    row, col = np.rint(stars.row).astype(np.int64), np.rint(stars.col).astype(np.int64)
    whole = (row >= REACH_PX) & (row < image.shape[0] - REACH_PX) & (col >= REACH_PX) & (col < image.shape[1] - REACH_PX)
    chosen = np.flatnonzero(whole)
    chosen = chosen[np.argsort(row[chosen], kind="stable")]  # neighbours touch the same lines of memory
    row, col = row[chosen], col[chosen]
    octaves = np.log2(np.maximum(stars.snr[chosen], FAINTEST) / FAINTEST)
    cell = (PER_OCTAVE * octaves).astype(np.int64).clip(0, KINDS - 1)
    for place, pixel in ((stars.row[chosen], row), (stars.col[chosen], col)):
        cell = PHASES * cell + (PHASES * (place - pixel + 0.5)).astype(np.int64).clip(0, PHASES - 1)
    total, count = (np.zeros((KINDS * PHASES * PHASES, SIDE, SIDE), np.int32) for _ in range(2))
    _add_up(image, row, col, cell, total, count)
    taken = np.zeros([-(-n // TILE_PX) for n in image.shape], np.int64)
    _subtract(image, row, col, cell, ring_means(total, count), taken)
    _give_back(image, taken)


def ring_means(total: NDArray[np.int32], count: NDArray[np.int32]) -> NDArray[np.int16]:
    """Mean on each pixel's ring, of sums and numbers of known pixels; all (kinds x phases x phases, SIDE, SIDE)."""
    centre = (np.arange(PHASES) + 0.5) / PHASES - 0.5
    away2 = (np.arange(-REACH_PX, REACH_PX + 1) - centre[:, None]) ** 2
    ring = np.minimum((away2[:, None, :, None] + away2[None, :, None, :]).astype(np.int64), RINGS)
    place = (np.arange(KINDS)[:, None, None, None, None] * (RINGS + 1) + ring).ravel()
    sums, n = (np.bincount(place, values.ravel(), KINDS * (RINGS + 1)) for values in (total, count))
    mean = np.where(n >= LEAST_PIXELS, sums / np.maximum(n, 1.0), 0.0).reshape(KINDS, RINGS + 1)
    mean[:, RINGS] = 0.0
    return np.rint(mean[:, ring]).astype(np.int16).reshape(total.shape)


@nb.njit(cache=True)
def _add_up(
    image: NDArray[np.int8],
    row: NDArray[np.int64],
    col: NDArray[np.int64],
    cell: NDArray[np.int64],
    total: NDArray[np.int32],
    count: NDArray[np.int32],
) -> None:
    """Sums and numbers of known pixels of the squares about stars. cell : of each star, its kind and phases."""
    for k in range(row.size):
        at, r, c = np.uint64(cell[k]), np.uint64(row[k] - REACH_PX), np.uint64(col[k] - REACH_PX)
        for i in range(np.uint64(SIDE)):
            for j in range(np.uint64(SIDE)):
                value = np.int32(image[r + i, c + j])
                known = np.int32(value != np.int32(UNKNOWN))
                total[at, i, j] += known * value
                count[at, i, j] += known


@nb.njit(cache=True)
def _subtract(
    image: NDArray[np.int8],
    row: NDArray[np.int64],
    col: NDArray[np.int64],
    cell: NDArray[np.int64],
    mean: NDArray[np.int16],
    taken: NDArray[np.int64],
) -> None:
    """Take the means of `ring_means` off known pixels, which stay within their code; add up what, by the tile of the star."""
    unknown, least, most = np.int16(UNKNOWN), np.int16(UNKNOWN + 1), np.int16(127)
    for k in range(row.size):
        at, r, c = np.uint64(cell[k]), np.uint64(row[k] - REACH_PX), np.uint64(col[k] - REACH_PX)
        off = np.int32(0)
        for i in range(np.uint64(SIDE)):
            for j in range(np.uint64(SIDE)):
                value = np.int16(image[r + i, c + j])
                less = np.int16(value - mean[at, i, j])
                less = least if less < least else less
                less = most if less > most else less
                less = value if value == unknown else less
                image[r + i, c + j] = np.int8(less)
                off += np.int32(value - less)
        taken[row[k] // TILE_PX, col[k] // TILE_PX] += off


@nb.njit(cache=True)
def _give_back(image: NDArray[np.int8], taken: NDArray[np.int64]) -> None:
    """Raise the known pixels of each tile by a share of what was taken off it: most codes are whole, so that some pixels get one
    more than others, in a pattern that no line follows."""
    rows, cols = image.shape
    for i in range(taken.shape[0]):
        row0, row1 = i * TILE_PX, min((i + 1) * TILE_PX, rows)
        for j in range(taken.shape[1]):
            col0, col1 = j * TILE_PX, min((j + 1) * TILE_PX, cols)
            known = seen = 0
            for row in range(row0, row1, COUNTED):
                known += _n_known(image[row, col0:col1])
                seen += col1 - col0
            known_share = max(known, 1) / seen
            lift = round(256.0 * taken[i, j] / (known_share * (row1 - row0) * (col1 - col0)))
            for row in range(row0, row1):
                _lift(image[row, col0:col1], np.int16(lift >> 8), np.uint8(lift & 255), np.uint8(ROW_PHASE * row & 255))


@nb.njit(cache=True)
def _n_known(line: NDArray[np.int8]) -> int:
    n = np.int32(0)
    for k in range(line.size):
        n += np.int32(line[k] != np.int8(UNKNOWN))
    return int(n)


@nb.njit(cache=True)
def _lift(line: NDArray[np.int8], whole: np.int16, part: np.uint8, phase: np.uint8) -> None:
    """Add `whole` to the known pixels of a line, and one more to part / 256 of them."""
    most, least = np.int16(127), np.int16(UNKNOWN + 1)
    for k in range(line.size):
        phase = np.uint8(phase + np.uint8(COL_PHASE))
        value = np.int16(line[k])
        more = np.int16(value + whole + np.int16(phase < part))
        more = most if more > most else more
        more = least if more < least else more
        line[k] = np.int8(more if value != np.int16(UNKNOWN) else value)
