"""The dark map in one byte a pixel: the distance from the middle of its column over some rows. Outliers are in a table.

With whole ADU and a fraction in 1/128 ADU, the map would take three bytes a pixel, more than the frame itself. But pixels are
similar, except for hot ones.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

FRACTIONS_PER_ADU: Final = 128  # rounding errs by 1 / (128 sqrt(12)) = 0.002 ADU; +-64 of them fit a byte
STEPS_PER_ADU: Final = FRACTIONS_PER_ADU + 1
"""A value of the map is STEPS_PER_ADU * (whole ADU) + fraction: fractions are -64 ... 64, for half an ADU may go either way."""

BAND_ROWS: Final = 64
"""Rows over which the middle of a column is taken."""

MOST_BEYOND: Final = 0.02
"""Share of pixels in the table above which the map takes two bytes a pixel; in the table a pixel takes eight."""

LIFT: Final = 255 * STEPS_PER_ADU + FRACTIONS_PER_ADU // 2
"""Makes every distance positive, so that a product and a shift divide it; the last term rounds."""

RECIPROCAL: Final = 65028
"""2^23 / STEPS_PER_ADU, rounded up: n * RECIPROCAL >> 23 is n // STEPS_PER_ADU and fits into 32 bits for all n below 65,800."""

Codes = tuple[
    NDArray[np.int8] | NDArray[np.int16],
    NDArray[np.int16],
    NDArray[np.int64],
    NDArray[np.int32],
    NDArray[np.int32],
    NDArray[np.int64],
]
"""A map as compiled code takes it. codes (rows, cols): distance from the column's middle, the lowest code for those in the table.
middle (2, bands, cols): whole ADU and fraction. The table: where each row begins in it (rows + 1), column, value. corner: row and
column of the part of the map that is meant.
"""


@dataclass(frozen=True, kw_only=True, eq=False)
class DarkMap:
    """Dark under a frame of some shape: whole ADU, which both ends of the link know, and the rest in 1/128 ADU."""

    shape: tuple[int, int]
    codes: Codes

    @classmethod
    def of(cls, dark_adu: NDArray[np.float32]) -> "DarkMap":
        """A calibration's map (rows, cols), ADU; halves of ADU are rounded to even."""
        narrow = cls._coded(dark_adu, np.dtype(np.int8))
        return narrow if narrow.codes[3].size <= MOST_BEYOND * dark_adu.size else cls._coded(dark_adu, np.dtype(np.int16))

    @classmethod
    def _coded(cls, dark_adu: NDArray[np.float32], dtype: np.dtype[np.int8] | np.dtype[np.int16]) -> "DarkMap":
        rows, cols = dark_adu.shape
        lowest = np.iinfo(dtype).min
        codes, middle = np.empty((rows, cols), dtype), np.empty((2, -(-rows // BAND_ROWS), cols), np.int16)
        line, column, beyond = [], [], []
        for band, row in enumerate(range(0, rows, BAND_ROWS)):  # temporaries of the whole map would be the largest of the process
            part = dark_adu[row : row + BAND_ROWS]
            whole = np.clip(np.rint(part), -32768, 32767)
            value = STEPS_PER_ADU * whole.astype(np.int32)
            value += np.rint(np.clip(part - whole, -0.5, 0.5) * FRACTIONS_PER_ADU).astype(np.int32)
            half = len(value) // 2
            centre = np.partition(value, half, axis=0)[half]
            middle[0, band] = (centre + FRACTIONS_PER_ADU // 2) // STEPS_PER_ADU
            middle[1, band] = centre - STEPS_PER_ADU * middle[0, band].astype(np.int32)
            away = value - centre
            far = np.abs(away) >= -lowest
            codes[row : row + BAND_ROWS] = np.where(far, lowest, away)
            at = np.nonzero(far)
            line.append(at[0] + row)
            column.append(at[1])
            beyond.append(value[far])
        first = np.searchsorted(np.concatenate(line), np.arange(rows + 1))
        table = (first.astype(np.int64), np.concatenate(column).astype(np.int32), np.concatenate(beyond))
        return cls(shape=(rows, cols), codes=(codes, middle, *table, np.zeros(2, np.int64)))

    @classmethod
    def of_fractions(cls, fractions: NDArray[np.int8]) -> "DarkMap":
        """A map of fractions (rows, cols), -64 ... 64, alone."""
        rows, cols = fractions.shape
        none = np.zeros(0, np.int32)
        middle = np.zeros((2, -(-rows // BAND_ROWS), cols), np.int16)
        codes = (fractions, middle, np.zeros(rows + 1, np.int64), none, none, np.zeros(2, np.int64))
        return cls(shape=(rows, cols), codes=codes)

    def window(self, row: int, col: int, shape: tuple[int, int]) -> "DarkMap":
        """A part of the map, whose memory it shares."""
        return replace(self, shape=shape, codes=(*self.codes[:5], self.codes[5] + np.array((row, col))))

    def whole_adu(self, out: NDArray[np.int16] | None = None) -> NDArray[np.int16]:
        """The whole ADU (rows, cols), written out; out : memory for them."""
        out = np.empty(self.shape, np.int16) if out is None else out
        write_whole(self.codes, out)
        return out

    def fractions(self) -> NDArray[np.int8]:
        """The rest (rows, cols) in 1/128 ADU, written out."""
        out, whole = np.empty(self.shape, np.int8), np.empty(self.shape[1], np.int16)
        for row in range(len(out)):
            dark_row(self.codes, row, whole, out[row])
        return out


@njit(cache=True)
def whole_steps(away: np.int32, one_byte: bool) -> np.int32:
    """Whole ADU in the distance of a pixel from its column's whole ADU; without division, so that loops become vectors."""
    if one_byte:  # no farther than 1.5 ADU
        half = np.int32(FRACTIONS_PER_ADU // 2)
        return np.int32(np.int32(away > half) - np.int32(away < -half))
    lifted = np.uint32(np.int32(away + np.int32(LIFT)))
    return np.int32(np.int32(np.uint32(lifted * np.uint32(RECIPROCAL)) >> np.uint32(23)) - np.int32(255))


@njit(cache=True)
def split_value(value: int) -> tuple[int, int]:
    """Whole ADU and fraction of a value of the table."""
    whole = (value + FRACTIONS_PER_ADU // 2) // STEPS_PER_ADU
    return whole, value - STEPS_PER_ADU * whole


@njit(cache=True)
def _from_codes(
    codes: NDArray[np.int8] | NDArray[np.int16],
    middle: NDArray[np.int16],
    rest: NDArray[np.int16],
    one_byte: bool,
    whole: NDArray[np.int16],
    fraction: NDArray[np.int8],
) -> None:
    """A row without its table; a function of its own so that it is compiled to vector instructions."""
    for col in range(whole.size):
        away = np.int32(np.int32(codes[col]) + np.int32(rest[col]))
        steps = whole_steps(away, one_byte)
        whole[col] = np.int16(np.int32(middle[col]) + steps)
        fraction[col] = np.int8(away - np.int32(steps * np.int32(STEPS_PER_ADU)))


@njit(cache=True)
def dark_row(dark: Codes, row: int, whole: NDArray[np.int16], fraction: NDArray[np.int8]) -> None:
    """Whole ADU and fractions (cols) of a row."""
    codes, middle, first, column, value, corner = dark
    row, col = row + corner[0], corner[1]
    band, stop = row // BAND_ROWS, col + whole.size
    _from_codes(codes[row, col:stop], middle[0, band, col:stop], middle[1, band, col:stop], codes.itemsize == 1, whole, fraction)
    for k in range(first[row], first[row + 1]):
        at = column[k] - col
        if 0 <= at < whole.size:
            whole[at], fraction[at] = split_value(value[k])


@njit(cache=True)
def write_whole(dark: Codes, out: NDArray[np.int16]) -> None:
    """Whole ADU of the map (rows, cols)."""
    fraction = np.empty(out.shape[1], np.int8)
    for row in range(out.shape[0]):
        dark_row(dark, row, out[row], fraction)


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


@njit(cache=True)
def whole_at(dark: Codes, row: int, col: int) -> int:
    """Whole ADU of a pixel."""
    codes, middle, first, column, value, corner = dark
    row, col = row + corner[0], col + corner[1]
    place = place_of(first, column, row, col)
    if place >= 0:
        return split_value(value[place])[0]
    step = middle[1, row // BAND_ROWS, col] + np.int64(codes[row, col])
    return middle[0, row // BAND_ROWS, col] + split_value(step)[0]
