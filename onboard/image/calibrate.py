"""Raw pixels to the calibrated image: dark and background level removed, unusable pixels masked, in one pass.

The background image is never built: each row's level is interpolated from the mesh while the row is in the cache.
"""

import math
from dataclasses import dataclass
from typing import cast

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.image.background import continued
from onboard.image.dark_map import BAND_ROWS, FRACTIONS_PER_ADU, STEPS_PER_ADU, Codes, DarkMap, split_value, whole_steps
from sboc_e2e.icd.flags import MaskBit
from sboc_e2e.icd.frame import LARGEST_ADU, Calibration, Frame, FrameHeader
from sboc_e2e.icd.signals import BackgroundModel

ROWS_AT_ONCE = 64  # bounds the memory of the search for defects
LINE_LIMIT_SIGMA = 2.5
"""Values beyond this many sigmas are left out of the means of rows and columns."""

LANES = 32  # sums side by side: four vectors of eight
FLOAT_QUANTUM_SIGMA = 0.05
"""Float frames are rounded to this share of their noise."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Counts:
    """A frame as integers: one count is `adu_scale` ADU, zero is `adu_offset` (1 and 0 for uint16 frames).

    pixels : (rows, cols) uint16 or int32. dark : whole counts, and what rounding took from the dark, in ADU.
    defects : (rows, cols) uint8 of `MaskBit`, writable: it becomes the mask.
    saturation : counts at and above which a pixel is saturated.
    """

    pixels: NDArray[np.uint16] | NDArray[np.int32]
    dark: DarkMap
    defects: NDArray[np.uint8]
    adu_scale: float
    adu_offset: float
    saturation: int


@dataclass(frozen=True, kw_only=True, eq=False)
class LineSums:
    """Number and sum of the usable values within +-`LINE_LIMIT_SIGMA` of each line of an image.

    rows : (2, rows). cols : (2, cols). float32, sums in ADU.
    """

    rows: NDArray[np.float32]
    cols: NDArray[np.float32]


def robust_noise(pixels: NDArray[np.float32], missing: NDArray[np.bool_]) -> tuple[float, float]:
    """Median of a float frame and its noise from differences of neighbours (free of gradients and of most stars)."""
    step = max(1, pixels.shape[0] // 256)
    sample = np.where(missing[::step], np.float32(np.nan), pixels[::step])
    finite = sample[np.isfinite(sample)]
    if finite.size == 0:
        return 0.0, 0.0
    steps = np.diff(sample.astype(np.float64), axis=1)
    steps = np.abs(steps[np.isfinite(steps)])
    if steps.size == 0:
        return float(np.median(finite)), 0.0
    # the mean, not the median, of the common steps: frames that were integers once have few distinct steps
    common = steps[steps <= 5.0 * 1.4826 * float(np.median(steps))]
    return float(np.median(finite)), 0.5 * math.sqrt(math.pi) * float(common.mean())


def float_counts(pixels: NDArray[np.float32]) -> tuple[NDArray[np.int32], NDArray[np.bool_], float, float]:
    """A float frame as (counts, missing, scale, offset), rounded at 0.05 sigma. Values that are no measurement are missing."""
    missing = ~(np.abs(pixels) <= LARGEST_ADU)  # NaN too
    offset, noise = robust_noise(pixels, missing)
    values = np.where(missing, np.float32(offset), pixels).astype(np.float64)
    reach = float(np.abs(values - offset).max(initial=0.0))
    scale = max(FLOAT_QUANTUM_SIGMA * noise, reach / 2.0**29)
    if scale <= 0.0:
        scale = 1.0
    scale, offset = float(np.float32(scale)), float(np.float32(offset))
    return np.rint((values - offset) / scale).astype(np.int32), missing, scale, offset


@dataclass(frozen=True, kw_only=True, eq=False)
class IntegerCalibration:
    """The calibration as the on-board software uses it.

    dark : rounded to whole ADU, so that its removal is reversible and known at both ends of the link, and the rest of it; left
    in, that would add 1/12 ADU^2 of fixed pattern to the image that the detector sees.
    defects : (n, 4) runs of pixels with the same bits, for the map would take a byte a pixel: row, first col, col after the
    last, `MaskBit`.
    """

    dark: DarkMap
    defects: NDArray[np.int32]

    @classmethod
    def of(cls, calibration: Calibration) -> "IntegerCalibration":
        """Rounded dark of a calibration."""
        return cls(dark=DarkMap.of(calibration.dark_adu), defects=runs_of(calibration.defects))

    def window(self, header: FrameHeader) -> "IntegerCalibration":
        """The part that a frame covers."""
        row0, col0 = header.corner_in(self.dark.shape)
        first = np.array((row0, col0, col0, 0), dtype=np.int32)
        return IntegerCalibration(dark=self.dark.window(row0, col0, (header.rows, header.cols)), defects=self.defects - first)

    @classmethod
    def none(cls, header: FrameHeader) -> "IntegerCalibration":
        """No dark and no defects."""
        dark = DarkMap.of_fractions(np.zeros((header.rows, header.cols), np.int8))
        return cls(dark=dark, defects=np.zeros((0, 4), np.int32))


def runs_of(defects: NDArray[np.uint8]) -> NDArray[np.int32]:
    """Runs (n, 4) of a map of defects, as in `IntegerCalibration`."""
    runs = []
    for row in range(0, len(defects), ROWS_AT_ONCE):
        part = np.pad(defects[row : row + ROWS_AT_ONCE], ((0, 0), (1, 1)))
        line, col = np.nonzero(part[:, 1:] != part[:, :-1])
        bits = part[line, col + 1]
        # the next change in the row ends a run: each row ends with 0
        start = np.flatnonzero(bits)
        runs.append(np.column_stack((line[start] + row, col[start], col[start + 1], bits[start])))
    return np.concatenate(runs).astype(np.int32)


@njit(cache=True)
def write_runs(runs: NDArray[np.int32], out: NDArray[np.uint8]) -> None:
    """A map of defects from its runs; what lies outside of the map is left out."""
    rows, cols = out.shape
    out[:] = 0
    for k in range(runs.shape[0]):
        if 0 <= runs[k, 0] < rows:
            for col in range(max(runs[k, 1], 0), min(runs[k, 2], cols)):
                out[runs[k, 0], col] = runs[k, 3]


def to_counts(frame: Frame, calibration: IntegerCalibration, defects: NDArray[np.uint8] | None = None) -> Counts:
    """Integer pixels of a frame with the dark and defects that go with them. defects : memory for their map."""
    if defects is None:
        defects = np.empty(frame.pixels.shape, dtype=np.uint8)
    write_runs(calibration.defects, defects)
    saturation_adu = frame.header.saturation_adu if frame.header.saturation_adu is not None else math.inf
    if frame.pixels.dtype == np.uint16:
        return Counts(
            pixels=cast("NDArray[np.uint16]", frame.pixels),
            dark=calibration.dark,
            defects=defects,
            adu_scale=1.0,
            adu_offset=0.0,
            saturation=int(min(max(saturation_adu, 1.0), 65535.0)),
        )
    dark = calibration.dark.whole_adu()
    pixels, missing, scale, offset = float_counts(cast("NDArray[np.float32]", frame.pixels) - dark.astype(np.float32))
    defects[missing] |= np.uint8(MaskBit.MISSING)
    saturation = (saturation_adu - float(np.median(dark)) - offset) / scale
    return Counts(
        pixels=pixels,
        dark=DarkMap.of_fractions(calibration.dark.fractions()),
        defects=defects,
        adu_scale=scale,
        adu_offset=offset,
        saturation=int(min(max(saturation, -(2.0**31)), 2.0**31 - 1)),
    )


def background_in_adu(background: BackgroundModel, counts: Counts) -> BackgroundModel:
    """A mesh estimated in counts, in ADU above the dark."""
    if counts.adu_scale == 1.0 and counts.adu_offset == 0.0:
        return background
    return BackgroundModel(
        tile_px=background.tile_px,
        level_adu=background.level_adu * np.float32(counts.adu_scale) + np.float32(counts.adu_offset),
        sigma_adu=background.sigma_adu * np.float32(counts.adu_scale),
    )


@njit(cache=True)
def between_nodes(pixel: int, nodes: int, tile_px: int, pixels: int) -> tuple[int, float]:
    """The interval of a mesh axis that a pixel is in, as its first node, and where in it, 0 at this node and 1 at the next.

    nodes : with the one beyond each edge (`background.continued`); a level held from the outer tiles' middles on would be wrong
    by half a tile's slope at the edge of the frame. Nodes stand at the middle of their tiles; the last tile may be shorter.
    """
    tiles = nodes - 2
    position = (pixel - 0.5 * (tile_px - 1)) / tile_px + 1.0
    last_px = pixels - (tiles - 1) * tile_px
    if position > tiles - 1 and tiles > 1 and last_px < tile_px:
        position = tiles - 1 + (position - (tiles - 1)) * 2.0 * tile_px / (tile_px + last_px)
    first = min(max(int(position), 0), tiles)
    return first, position - first


@njit(cache=True)
def expand_nodes(nodes: NDArray[np.float32], tile_px: int, out: NDArray[np.float32]) -> None:
    """Linear interpolation of one mesh row, with a node beyond each edge, to every column."""
    for col in range(out.size):
        left, share = between_nodes(col, nodes.size, tile_px, out.size)
        out[col] = nodes[left] + np.float32(share) * (nodes[left + 1] - nodes[left])


@njit(cache=True, fastmath={"contract", "nsz", "arcp"})  # no NaN reaches this loop; reordering changes the last bit only
def _residual_row(
    pixels: NDArray[np.uint16] | NDArray[np.int32],
    codes: NDArray[np.int8] | NDArray[np.int16],
    middle: NDArray[np.int16],
    rest: NDArray[np.int16],
    one_byte: bool,
    mask: NDArray[np.uint8],
    level: NDArray[np.float32],
    saturation: int,
    scale: np.float32,
    residual: NDArray[np.float32],
) -> np.int32:
    """One row of `residual_pass`, without the table of the dark. A separate function, so that its loop is vectorised."""
    unusable = np.int32(0)
    unit, limit = np.float32(1.0 / FRACTIONS_PER_ADU), np.int32(saturation)
    for col in range(pixels.size):
        away = np.int32(np.int32(codes[col]) + np.int32(rest[col]))
        steps = whole_steps(away, one_byte)
        fraction = np.int32(away - np.int32(steps * np.int32(STEPS_PER_ADU)))
        value = np.int32(pixels[col])
        bits = np.uint8(mask[col] | (np.uint8(4) if value >= limit else np.uint8(0)))
        net = (
            np.float32(np.int32(np.int32(value - np.int32(middle[col])) - steps)) * scale
            - np.float32(fraction) * unit
            - level[col]
        )
        residual[col] = net if bits == 0 else np.float32(0.0)
        mask[col] = bits
        unusable = np.int32(unusable + np.int32(bits != 0))
    return unusable


@njit(cache=True, inline="always")
def _add_pixel(
    residual: NDArray[np.float32],
    mask: NDArray[np.uint8],
    limit: np.float32,
    col_number: NDArray[np.float32],
    col_total: NDArray[np.float32],
    col: int,
    lanes: NDArray[np.float32],
    lane: int,
) -> np.int32:
    """One pixel of `_add_line`, of its full groups and of the rest; 1 where it counts."""
    value = residual[col]
    good = mask[col] == 0 and abs(value) < limit
    kept = value if good else np.float32(0.0)
    col_number[col] += np.float32(1.0) if good else np.float32(0.0)
    col_total[col] += kept
    lanes[lane] += kept
    return np.int32(good)


@njit(cache=True)
def _add_line(
    residual: NDArray[np.float32],
    mask: NDArray[np.uint8],
    limit: np.float32,
    col_number: NDArray[np.float32],
    col_total: NDArray[np.float32],
    lanes: NDArray[np.float32],
) -> tuple[np.float32, np.float32]:
    """Number and sum of a row's usable values within +-limit; each is added to the sums of its column as well.

    lanes (`LANES`,) : work space. A row's sum is that of as many sums side by side, in an order that is written down: where the
    compiler may choose it, code that was just compiled and code that was loaded differ in the last bit.
    """
    number, lanes[:] = np.int32(0), np.float32(0.0)
    whole = residual.size - residual.size % LANES
    for first in range(0, whole, LANES):
        for lane in range(LANES):
            number += _add_pixel(residual, mask, limit, col_number, col_total, first + lane, lanes, lane)
    for col in range(whole, residual.size):
        number += _add_pixel(residual, mask, limit, col_number, col_total, col, lanes, col - whole)
    total = np.float32(0.0)
    for lane in range(LANES):
        total += lanes[lane]
    return np.float32(number), total


@njit(cache=True)
def residual_pass(
    pixels: NDArray[np.uint16] | NDArray[np.int32],
    dark: Codes,
    mask: NDArray[np.uint8],
    level_nodes: NDArray[np.float32],
    tile_px: int,
    saturation: int,
    scale: float,
    limit: float,
    residual: NDArray[np.float32],
    row_sums: NDArray[np.float32],
    col_sums: NDArray[np.float32],
) -> int:
    """``residual = (pixels - dark) * scale - fraction / 128 - level``; masked pixels get 0. Returns their number.

    mask : the map of defects, to which saturated pixels are added.
    row_sums, col_sums : (2, rows) and (2, cols), number and sum of the usable values within +-limit, taken while the row is in
    the cache.
    `MaskBit.SATURATED` (4) is set from the pixels before the dark is removed; level_nodes are relative to the offset,
    with a node beyond each edge.
    """
    rows, cols = pixels.shape
    upper, lower = np.empty(cols, dtype=np.float32), np.empty(cols, dtype=np.float32)
    level, lanes = np.empty(cols, dtype=np.float32), np.empty(LANES, dtype=np.float32)
    codes, middle, first, column, value, corner = dark
    left, right = corner[1], corner[1] + cols
    held = -1
    unusable = 0
    col_sums[:] = 0.0
    for row in range(rows):
        above, place = between_nodes(row, level_nodes.shape[0], tile_px, rows)
        if above != held:
            expand_nodes(level_nodes[above], tile_px, upper)
            expand_nodes(level_nodes[above + 1], tile_px, lower)
            held = above
        share = np.float32(place)
        for col in range(cols):
            level[col] = upper[col] + share * (lower[col] - upper[col])
        line = row + corner[0]
        band = line // BAND_ROWS
        unusable += int(
            _residual_row(
                pixels[row],
                codes[line, left:right],
                middle[0, band, left:right],
                middle[1, band, left:right],
                codes.itemsize == 1,
                mask[row],
                level,
                saturation,
                np.float32(scale),
                residual[row],
            )
        )
        for k in range(first[line], first[line + 1]):
            col = column[k] - left
            if 0 <= col < cols and mask[row, col] == 0:
                whole, fraction = split_value(value[k])
                net = np.float32(np.int64(pixels[row, col]) - whole) * np.float32(scale)
                residual[row, col] = net - np.float32(fraction) * np.float32(1.0 / FRACTIONS_PER_ADU) - level[col]
        number, total = _add_line(residual[row], mask[row], np.float32(limit), col_sums[0], col_sums[1], lanes)
        row_sums[0, row], row_sums[1, row] = number, total
    return unusable


def fill_residual(counts: Counts, background: BackgroundModel, residual: NDArray[np.float32]) -> tuple[LineSums, int]:
    """`residual_pass` over a frame, in place; returns the sums of its lines and how many pixels are masked.

    background : in ADU. residual : (rows, cols) ADU, filled.
    """
    rows, cols = residual.shape
    sums = LineSums(rows=np.empty((2, rows), np.float32), cols=np.empty((2, cols), np.float32))
    sigma_adu = float(np.median(background.sigma_adu))
    n_masked = residual_pass(
        counts.pixels,
        counts.dark.codes,
        counts.defects,
        continued(background.level_adu - np.float32(counts.adu_offset), sigma_adu),
        background.tile_px,
        counts.saturation,
        counts.adu_scale,
        LINE_LIMIT_SIGMA * sigma_adu,
        residual,
        sums.rows,
        sums.cols,
    )
    return sums, int(n_masked)
