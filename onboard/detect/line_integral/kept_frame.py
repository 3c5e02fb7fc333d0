"""What stays of a frame for the comparison with the next one: eight bits a pixel, and its few bright pixels as they are.

The calibrated image and its mask take five bytes a pixel. In sixteenths of the noise they take one, and the rounding adds
1 / (12 * 16^2) = 0.03 % to the variance of a pixel.
"""

import math
from dataclasses import dataclass
from typing import Final

import numba as nb
import numpy as np
from numpy.typing import NDArray

from onboard.detect.whiten import SATURATED, UNIT, code_of, pixel_scale
from onboard.image.dark_map import place_of
from sboc_e2e.icd.signals import DetectorView, StarList

MASKED: Final = -128
"""Code of a pixel of which nothing is known."""

BEYOND: Final = 127
"""Codes -BEYOND and BEYOND stand for all that is farther out; the values are in a table."""

KeptPixels = tuple[NDArray[np.int8], NDArray[np.int64], NDArray[np.int32], NDArray[np.float32]]
"""codes (rows, cols) in sigma / UNIT; and the table of what lies beyond them: where each row begins in it (rows + 1), column,
value in sigma. A saturated pixel has the code BEYOND and no entry.
"""


@dataclass(frozen=True, kw_only=True, eq=False)
class KeptFrame:
    """A view as far as a later one is held against it."""

    pixels: KeptPixels
    stars: StarList


def kept(view: DetectorView) -> KeptFrame:
    """What stays of a view."""
    codes, background = np.empty(view.mask.shape, np.int8), view.background
    table = encode(view.residual_adu, view.mask, background.sigma_adu, background.tile_px, codes)
    return KeptFrame(pixels=(codes, *table), stars=view.stars)


@nb.njit(cache=True)
def _encode_row(
    source: NDArray[np.float32],
    mask: NDArray[np.uint8],
    scale: NDArray[np.float32],
    codes: NDArray[np.int8],
    beyond: NDArray[np.uint8],
) -> int:
    """Codes of a row, and 1 in `beyond` for those whose value belongs into the table; returns how many these are."""
    count = np.int32(0)
    for i in range(source.shape[0]):
        code = code_of(source[i] * scale[i])
        known = (mask[i] == np.uint8(0)) & (scale[i] > np.float32(0.0))
        hidden = np.int32(BEYOND) if mask[i] == np.uint8(SATURATED) else np.int32(MASKED)
        far = known & ((code == np.int32(BEYOND)) | (code == np.int32(-BEYOND)))
        codes[i] = np.int8(code if known else hidden)
        beyond[i] = np.uint8(far)
        count = np.int32(count + np.int32(far))
    return int(count)


@nb.njit(cache=True)
def encode(
    residual_adu: NDArray[np.float32],
    mask: NDArray[np.uint8],
    sigma_adu: NDArray[np.float32],
    tile_px: int,
    codes: NDArray[np.int8],
) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.float32]]:
    """Fill the codes of a frame and return the table of what lies beyond them."""
    rows, cols = residual_adu.shape
    scale = np.zeros(cols, np.float32)
    beyond = np.zeros(-(-cols // 8) * 8, np.uint8)
    words = beyond.view(np.uint64)
    first, n = np.zeros(rows + 1, np.int64), 0
    column, value = np.empty(cols, np.int32), np.empty(cols, np.float32)
    for row in range(rows):
        if row % tile_px == 0:
            pixel_scale(sigma_adu, tile_px, row, scale)
        count = _encode_row(residual_adu[row], mask[row], scale, codes[row], beyond[:cols])
        if n + count > column.size:
            column, value = np.append(column, np.empty_like(column)), np.append(value, np.empty_like(value))
        if count > 0:
            for word in range(words.size):
                if words[word] == 0:
                    continue
                for j in range(8 * word, min(8 * word + 8, cols)):
                    if beyond[j] != 0:
                        column[n], value[n] = j, residual_adu[row, j] * scale[j] / np.float32(UNIT)
                        n += 1
        first[row + 1] = n
    return first, column[:n].copy(), value[:n].copy()


@nb.njit(cache=True)
def in_sigmas(pixels: KeptPixels, row: int, col: int) -> float:
    """A pixel in units of its noise; NaN where nothing is known of it."""
    codes, first, column, value = pixels
    code = int(codes[row, col])
    if -BEYOND < code < BEYOND:
        return code / UNIT
    if code == MASKED:
        return math.nan
    place = place_of(first, column, row, col)
    return float(value[place]) if place >= 0 else math.nan


@nb.njit(cache=True)
def _quantised_row(codes: NDArray[np.int8], out: NDArray[np.int8]) -> None:
    for i in range(out.size):
        out[i] = np.int8(0) if codes[i] == np.int8(MASKED) else codes[i]


@nb.njit(cache=True)
def quantised(codes: NDArray[np.int8]) -> NDArray[np.int8]:
    """Some rows of the codes as `whiten.quantise` gave them."""
    out = np.empty(codes.shape, np.int8)
    for row in range(len(codes)):
        _quantised_row(codes[row], out[row])
    return out
