"""The counts of a frame in little more than half a byte a pixel, without loss. Strips of a kept frame can still be sent.

A pixel is stored relative to the whole ADU of the dark and the level of the sky: in four bits if it differs by `NEAR` counts at
most, which noise of 2.6 ADU exceeds in one pixel of forty, in a byte of its row's rest if it differs by less than `BEYOND`, and
in a table otherwise. Nothing of it has to be unpacked before a strip is cut.
"""

from dataclasses import dataclass
from typing import Final

import numba as nb
import numpy as np
from numpy.typing import NDArray

from onboard.downlink.roi import StripGeometry, strip_of
from onboard.image.calibrate import Counts
from onboard.image.dark_map import Codes, dark_row, place_of
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.signals import BackgroundModel, RoiGroup, Strip

NEAR: Final = 7
"""Largest difference that four bits hold; they hold it plus eight, and nothing where it is larger."""

BEYOND: Final = 127
"""Byte of a pixel whose value is in the table."""

PIXELS: Final = 16
"""Pixels in a word."""

Table = tuple[NDArray[np.int32], int, NDArray[np.int64], NDArray[np.int32], NDArray[np.int32]]
"""Level of each tile in whole counts and the tiles' size in px; where each row begins in the table (rows + 1), column, value."""


Packed = tuple[NDArray[np.uint64], NDArray[np.int64], NDArray[np.int8]]
"""Sixteen pixels in each word of a row, the first in its lowest bits; where each row begins in the rest (rows + 1); the rest."""


@dataclass(frozen=True, kw_only=True, eq=False)
class KeptCounts:
    """A frame that strips can be cut from. sent : its regions that were sent when it was the newest frame."""

    header: FrameHeader
    background: BackgroundModel
    adu_scale: float
    adu_offset: float
    packed: Packed
    table: Table
    sent: tuple[RoiGroup, ...]

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.header.rows, self.header.cols

    def cut(self, geometry: StripGeometry, level: int) -> Strip:
        """The pixels of a strip, as `roi.cut_strip` cuts them from the frame itself."""
        values = np.empty((geometry.n, geometry.width), dtype=np.int32)
        cols, place = self.header.cols, (geometry.major0, geometry.minor0_fp, geometry.slope_fp)
        _gather(self.packed, cols, self.table, geometry.axis, place, level, values)
        return strip_of(geometry, level, values)


def kept_counts(header: FrameHeader, background: BackgroundModel, counts: Counts, sent: tuple[RoiGroup, ...]) -> KeptCounts:
    """The kept form of a frame."""
    level = np.rint((background.level_adu - counts.adu_offset) / counts.adu_scale).astype(np.int32)
    rows, cols = counts.pixels.shape
    words = np.empty((rows, -(-cols // PIXELS)), np.uint64)
    rest, table = _encode(counts.pixels, counts.dark.codes, level, background.tile_px, words)
    return KeptCounts(
        header=header,
        background=background,
        adu_scale=counts.adu_scale,
        adu_offset=counts.adu_offset,
        packed=(words, *rest),
        table=(level, background.tile_px, *table),
        sent=tuple(RoiGroup(roi_id=g.roi_id, detection=g.detection, strips=(), n_strips=g.n_strips) for g in sent),
    )


@nb.njit(cache=True)
def _encode_row(
    pixels: NDArray[np.uint16] | NDArray[np.int32], whole: NDArray[np.int16], level: NDArray[np.int32], codes: NDArray[np.int8]
) -> int:
    """Differences of a row; returns how many of its pixels belong into the table."""
    count = np.int32(0)
    for i in range(pixels.size):
        value = np.int32(np.int32(pixels[i]) - np.int32(whole[i]) - level[i])
        far = (value >= np.int32(BEYOND)) | (value <= np.int32(-BEYOND))
        codes[i] = np.int8(BEYOND) if far else np.int8(value)
        count = np.int32(count + np.int32(far))
    return int(count)


@nb.njit(cache=True)
def _fours(codes: NDArray[np.int8], out: NDArray[np.uint8]) -> None:
    """What four bits hold of each difference, in a byte."""
    for i in range(codes.size):
        near = (codes[i] >= np.int8(-NEAR)) & (codes[i] <= np.int8(NEAR))
        out[i] = np.uint8(np.int32(codes[i]) + np.int32(NEAR + 1)) if near else np.uint8(0)


@nb.njit(cache=True)
def _squeezed(eight: np.uint64) -> np.uint64:
    """The low four bits of eight bytes side by side, in the low half."""
    eight = (eight | (eight >> np.uint64(4))) & np.uint64(0x00FF00FF00FF00FF)
    eight = (eight | (eight >> np.uint64(8))) & np.uint64(0x0000FFFF0000FFFF)
    return (eight | (eight >> np.uint64(16))) & np.uint64(0xFFFFFFFF)


@nb.njit(cache=True)
def _pack_row(
    codes: NDArray[np.int8], fours: NDArray[np.uint8], words: NDArray[np.uint64], rest: NDArray[np.int8], n: int
) -> int:
    """Pack the differences of a row; those that need a byte come to the n of the rest, whose new number is returned.

    fours : room for a byte of each.
    """
    _fours(codes, fours)
    eights = fours.view(np.uint64)
    ones, three = np.uint64(0x1111111111111111), np.uint64(0x7777777777777777)
    for word in range(words.size):
        bits = _squeezed(eights[2 * word]) | (_squeezed(eights[2 * word + 1]) << np.uint64(32))
        words[word] = bits
        # the lowest bit of each four that hold nothing
        empty = (~(((bits & three) + three) | bits) >> np.uint64(3)) & ones
        while empty != np.uint64(0):
            # a product counts the fours below the lowest one
            below = ((empty & ~(empty - np.uint64(1))) - np.uint64(1)) & ones
            rest[n] = codes[np.uint64(PIXELS * word) + ((below * ones) >> np.uint64(60))]
            n += 1
            empty &= empty - np.uint64(1)
    return n


@nb.njit(cache=True)
def _holds_beyond(eight: np.uint64) -> bool:
    """Whether one of eight bytes is `BEYOND`: it becomes 0, of which alone, or beside which, a one is borrowed."""
    ones = np.uint64(0x0101010101010101)
    eight ^= ones * np.uint64(BEYOND)
    return ((eight - ones) & ~eight & (ones << np.uint64(7))) != np.uint64(0)


@nb.njit(cache=True)
def _encode(
    pixels: NDArray[np.uint16] | NDArray[np.int32],
    dark: Codes,
    level: NDArray[np.int32],
    tile_px: int,
    words: NDArray[np.uint64],
) -> tuple[tuple[NDArray[np.int64], NDArray[np.int8]], tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.int32]]]:
    """Fill the words of a frame; return the rest of its rows and the table."""
    rows, cols = pixels.shape
    whole, fraction, sky = np.empty(cols, np.int16), np.empty(cols, np.int8), np.empty(cols, np.int32)
    codes = np.zeros(PIXELS * words.shape[1], np.int8)
    eights, fours = codes.view(np.uint64), np.zeros(codes.size, np.uint8)
    first, n = np.zeros(rows + 1, np.int64), 0
    column, value = np.empty(cols, np.int32), np.empty(cols, np.int32)
    first_rest, n_rest, rest = np.zeros(rows + 1, np.int64), 0, np.empty(2 * cols, np.int8)
    for row in range(rows):
        if row % tile_px == 0:
            for j in range(cols):
                sky[j] = level[row // tile_px, j // tile_px]
        dark_row(dark, row, whole, fraction)
        count = _encode_row(pixels[row], whole, sky, codes)
        if n_rest + cols > rest.size:
            rest = np.append(rest, np.empty_like(rest))
        n_rest = _pack_row(codes, fours, words[row], rest, n_rest)
        first_rest[row + 1] = n_rest
        if n + count > column.size:
            column, value = np.append(column, np.empty_like(column)), np.append(value, np.empty_like(value))
        for word in range(eights.size if count > 0 else 0):
            if not _holds_beyond(eights[word]):
                continue
            for j in range(8 * word, 8 * word + 8):
                if codes[j] == np.int8(BEYOND):
                    column[n], value[n] = j, np.int32(pixels[row, j]) - np.int32(whole[j])
                    n += 1
        first[row + 1] = n
    return (first_rest, rest[:n_rest].copy()), (first, column[:n].copy(), value[:n].copy())


@nb.njit(cache=True)
def _difference(packed: Packed, row: int, col: int) -> int:
    """Of a pixel: from four bits, or the byte of the rest that belongs to it."""
    words, first_rest, rest = packed
    code = int((words[row, col // PIXELS] >> np.uint64(4 * (col % PIXELS))) & np.uint64(15))
    if code > 0:
        return code - NEAR - 1
    before = 0
    low, three = np.uint64(0x1111111111111111), np.uint64(0x7777777777777777)
    for word in range(col // PIXELS + 1):
        bits = words[row, word]
        # the highest bit of each four that hold nothing
        empty = ~(((bits & three) + three) | bits) & (low << np.uint64(3))
        if word == col // PIXELS:
            empty &= (np.uint64(1) << np.uint64(4 * (col % PIXELS))) - np.uint64(1)
        while empty != np.uint64(0):
            empty &= empty - np.uint64(1)
            before += 1
    return int(rest[first_rest[row] + before])


@nb.njit(cache=True)
def _gather(
    packed: Packed,
    cols: int,
    table: Table,
    axis: int,
    place: tuple[int, int, int],
    outside: int,
    out: NDArray[np.int32],
) -> None:
    """Values of a strip at place (major0, minor0_fp, slope_fp) into out (n, width); `outside` beyond the frame."""
    level, tile_px, first, column, value = table
    major0, minor0_fp, slope_fp = place
    rows = first.size - 1
    for i in range(out.shape[0]):
        start = (minor0_fp + i * slope_fp) >> 16
        for j in range(out.shape[1]):
            row, col = (major0 + i, start + j) if axis == 0 else (start + j, major0 + i)
            if not (0 <= row < rows and 0 <= col < cols):
                out[i, j] = outside
                continue
            difference = _difference(packed, row, col)
            if difference == BEYOND:
                out[i, j] = value[place_of(first, column, row, col)]
            else:
                out[i, j] = np.int32(difference) + level[row // tile_px, col // tile_px]
