"""The counts of a frame in half a byte a pixel, without loss. Strips of a kept frame can still be sent.

A pixel is stored in a byte, relative to the whole ADU of the dark and the level of the sky. A table has values that do not fit.
The bytes are noise of a few counts, which entropy coding brings to some 3.5 bits. Bands of rows are coded each for itself,
because few of them are ever read again.
"""

from dataclasses import dataclass
from typing import Final

import numba as nb
import numpy as np
import zstandard
from numpy.typing import NDArray

from onboard.downlink.roi import StripGeometry, strip_of
from onboard.image.calibrate import Counts
from onboard.image.dark_map import Codes, dark_row, place_of
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.signals import BackgroundModel, RoiGroup, Strip

BEYOND: Final = 127
"""Code of a pixel whose value is in the table."""

BAND_ROWS: Final = 64
"""Rows that are coded together."""

LEVEL: Final = 1
"""Of zstd: it finds no matches in noise, so that Huffman coding is all there is to gain."""

Table = tuple[NDArray[np.int32], int, NDArray[np.int64], NDArray[np.int32], NDArray[np.int32]]
"""Level of each tile in whole counts and the tiles' size in px; where each row begins in the table (rows + 1), column, value."""


@dataclass(frozen=True, kw_only=True, eq=False)
class KeptCounts:
    """A frame that strips can be cut from. bands : coded rows. sent : its regions that were sent when it was the newest frame."""

    header: FrameHeader
    background: BackgroundModel
    adu_scale: float
    adu_offset: float
    bands: tuple[bytes, ...]
    table: Table
    sent: tuple[RoiGroup, ...]

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.header.rows, self.header.cols

    def cut(self, geometry: StripGeometry, level: int) -> Strip:
        """The pixels of a strip, as `roi.cut_strip` cuts them from the frame itself."""
        values = np.empty((geometry.n, geometry.width), dtype=np.int32)
        first, codes = self._rows(geometry)
        _gather(codes, first, self.table, geometry.axis, geometry.major0, geometry.minor0_fp, geometry.slope_fp, level, values)
        return strip_of(geometry, level, values)

    def _rows(self, geometry: StripGeometry) -> tuple[int, NDArray[np.int8]]:
        """Codes of the bands that a strip may touch, and their first row."""
        ends = [(geometry.minor0_fp + i * geometry.slope_fp) >> 16 for i in (0, geometry.n - 1)]
        low, high = (
            (geometry.major0, geometry.major0 + geometry.n) if geometry.axis == 0 else (min(ends), max(ends) + geometry.width)
        )
        last = len(self.bands) - 1
        first_band, last_band = (min(max(row // BAND_ROWS, 0), last) for row in (low, high - 1))
        coder = zstandard.ZstdDecompressor()
        rows = b"".join(coder.decompress(band) for band in self.bands[first_band : last_band + 1])
        return first_band * BAND_ROWS, np.frombuffer(rows, np.int8).reshape(-1, self.header.cols)


def kept_counts(header: FrameHeader, background: BackgroundModel, counts: Counts, sent: tuple[RoiGroup, ...]) -> KeptCounts:
    """The kept form of a frame."""
    level = np.rint((background.level_adu - counts.adu_offset) / counts.adu_scale).astype(np.int32)
    codes = np.empty(counts.pixels.shape, np.int8)
    coder = zstandard.ZstdCompressor(level=LEVEL)
    table = _encode(counts.pixels, counts.dark.codes, level, background.tile_px, codes)
    return KeptCounts(
        header=header,
        background=background,
        adu_scale=counts.adu_scale,
        adu_offset=counts.adu_offset,
        bands=tuple(coder.compress(codes[row : row + BAND_ROWS].tobytes()) for row in range(0, len(codes), BAND_ROWS)),
        table=(level, background.tile_px, *table),
        sent=tuple(RoiGroup(roi_id=g.roi_id, detection=g.detection, strips=(), n_strips=g.n_strips) for g in sent),
    )


@nb.njit(cache=True)
def _encode_row(
    pixels: NDArray[np.uint16] | NDArray[np.int32], whole: NDArray[np.int16], level: NDArray[np.int32], codes: NDArray[np.int8]
) -> int:
    """Codes of a row; returns how many of its pixels belong into the table."""
    count = np.int32(0)
    for i in range(codes.size):
        value = np.int32(np.int32(pixels[i]) - np.int32(whole[i]) - level[i])
        far = (value >= np.int32(BEYOND)) | (value <= np.int32(-BEYOND))
        codes[i] = np.int8(BEYOND) if far else np.int8(value)
        count += np.int32(far)
    return int(count)


@nb.njit(cache=True)
def _encode(
    pixels: NDArray[np.uint16] | NDArray[np.int32],
    dark: Codes,
    level: NDArray[np.int32],
    tile_px: int,
    codes: NDArray[np.int8],
) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.int32]]:
    """Fill the codes of a frame and return the table."""
    rows, cols = codes.shape
    whole, fraction, sky = np.empty(cols, np.int16), np.empty(cols, np.int8), np.empty(cols, np.int32)
    first, n = np.zeros(rows + 1, np.int64), 0
    column, value = np.empty(cols, np.int32), np.empty(cols, np.int32)
    for row in range(rows):
        if row % tile_px == 0:
            for j in range(cols):
                sky[j] = level[row // tile_px, j // tile_px]
        dark_row(dark, row, whole, fraction)
        count = _encode_row(pixels[row], whole, sky, codes[row])
        if n + count > column.size:
            column, value = np.append(column, np.empty_like(column)), np.append(value, np.empty_like(value))
        if count > 0:
            for j in range(cols):
                if codes[row, j] == np.int8(BEYOND):
                    column[n], value[n] = j, np.int32(pixels[row, j]) - np.int32(whole[j])
                    n += 1
        first[row + 1] = n
    return first, column[:n].copy(), value[:n].copy()


@nb.njit(cache=True)
def _gather(
    codes: NDArray[np.int8],
    first_row: int,
    table: Table,
    axis: int,
    major0: int,
    minor0_fp: int,
    slope_fp: int,
    outside: int,
    out: NDArray[np.int32],
) -> None:
    """Values of a strip into out (n, width); `outside` beyond the frame. codes : of the rows from first_row on."""
    level, tile_px, first, column, value = table
    rows, cols = first.size - 1, codes.shape[1]
    for i in range(out.shape[0]):
        start = (minor0_fp + i * slope_fp) >> 16
        for j in range(out.shape[1]):
            row, col = (major0 + i, start + j) if axis == 0 else (start + j, major0 + i)
            if not (0 <= row < rows and 0 <= col < cols):
                out[i, j] = outside
            elif codes[row - first_row, col] == BEYOND:
                out[i, j] = value[place_of(first, column, row, col)]
            else:
                out[i, j] = np.int32(codes[row - first_row, col]) + level[row // tile_px, col // tile_px]
