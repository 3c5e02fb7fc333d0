"""Residual image -> noise-normalised 8-bit image, star masks, PSF-smoothed images at full and half resolution.

Everything here is a linear, symmetric operation on noise of unit variance followed by symmetric clipping, so that sums
along lines stay N(0, 1) after division by their known standard deviation.

Images are made with NumPy and handed to compiled code: NumPy asks the system for large pages, and memory made in compiled code
costs more time for its first touch than any of these passes.
"""

import math
from typing import Final

import numba as nb
import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd.flags import MaskBit
from sboc_e2e.icd.signals import UNKNOWN

UNIT: Final = 16
"""One sigma of a pixel in the 8-bit image."""

SATURATED: Final = int(MaskBit.SATURATED)

STAR_BIT, FOUND_BIT, POINT_BIT = 2, 4, 8
"""Bits of the working mask beside 1, `unusable`: listed stars, detections already made, unlisted stars on a trail."""

LEVEL_TILES: Final = 5
"""Side, in tiles, of the square over which the level is averaged; w px in all. The mean holds 1 / (0.332 w) of the light of a
trail that crosses the square (0.332: sum of the squared cross-section for a PSF of 2 px FWHM). 0.9 % are lost, and 1.6 % with
three tiles of 64 px."""


@nb.njit(cache=True)
def code_of(value: np.float32) -> np.int32:
    """A value rounded to an integer, at most 127 to either side; in 32 bits, for with 64 loops have half the lanes."""
    lifted = value + np.float32(128.5)
    lifted = np.float32(1.0) if lifted < np.float32(1.0) else lifted
    lifted = np.float32(255.0) if lifted > np.float32(255.0) else lifted
    return np.int32(np.int32(lifted) - np.int32(128))


@nb.njit(cache=True)
def clipped_code(value: np.float32, limit: np.float32) -> np.int32:
    """The same with a smaller limit, which as an argument of `code_of` would cost its loops half of their speed."""
    value = -limit if value < -limit else value
    value = limit if value > limit else value
    return np.int32(np.int32(value + np.float32(128.5)) - np.int32(128))


@nb.njit(cache=True)
def _quantise_row(
    source: NDArray[np.float32], mask: NDArray[np.uint8], scale: NDArray[np.float32], out: NDArray[np.int8]
) -> None:
    for i in range(source.shape[0]):
        code = code_of(source[i] * scale[i])  # of masked pixels too: a condition would keep the loop out of vector instructions
        hidden = np.int32(127) if mask[i] == np.uint8(SATURATED) else np.int32(0)
        out[i] = np.int8(code if mask[i] == np.uint8(0) else hidden)


@nb.njit(cache=True)
def pixel_scale(sigma_adu: NDArray[np.float32], tile_px: int, row: int, out: NDArray[np.float32]) -> None:
    """UNIT over the noise in the mesh tiles of a row, for every column; 0 where the noise is 0."""
    mesh_row = min(row // tile_px, sigma_adu.shape[0] - 1)
    for col in range(out.size):
        sigma = sigma_adu[mesh_row, min(col // tile_px, sigma_adu.shape[1] - 1)]
        out[col] = UNIT / sigma if sigma > 0.0 else 0.0


@nb.njit(cache=True, nogil=True)
def _quantise_rows(
    residual_adu: NDArray[np.float32],
    mask: NDArray[np.uint8],
    sigma_adu: NDArray[np.float32],
    tile_px: int,
    out: NDArray[np.int8],
) -> None:
    scale = np.zeros(residual_adu.shape[1], np.float32)
    for row in range(residual_adu.shape[0]):
        if row % tile_px == 0:
            pixel_scale(sigma_adu, tile_px, row, scale)
        _quantise_row(residual_adu[row], mask[row], scale, out[row])


def quantise(
    residual_adu: NDArray[np.float32], mask: NDArray[np.uint8], sigma_adu: NDArray[np.float32], tile_px: int
) -> NDArray[np.int8]:
    """Residual in units of sigma/16, clipped at +-7.9 sigma; saturated pixels hold the clip, other masked ones 0.

    All images (rows, cols); sigma is a mesh, and where it is 0 the result is 0.
    """
    out = np.empty(residual_adu.shape, np.int8)
    _quantise_rows(residual_adu, mask, sigma_adu, tile_px, out)
    return out


@nb.njit(cache=True)
def _unusable_row(mask: NDArray[np.uint8], out: NDArray[np.uint8]) -> None:
    for i in range(out.size):
        out[i] = np.uint8((mask[i] != 0) & (mask[i] != SATURATED))


@nb.njit(cache=True, nogil=True)
def _unusable_rows(mask: NDArray[np.uint8], out: NDArray[np.uint8]) -> None:
    for row in range(mask.shape[0]):
        _unusable_row(mask[row], out[row])


def unusable(mask: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Working mask, uint8: 1 where a pixel must not be used. A saturated one may: it is a bright trail's, or a listed star's."""
    out = np.empty(mask.shape, np.uint8)
    _unusable_rows(mask, out)
    return out


@nb.njit(cache=True, nogil=True)
def blank_discs(
    image: NDArray[np.int8],
    blocked: NDArray[np.uint8],
    row: NDArray[np.float64],
    col: NDArray[np.float64],
    radius_px: NDArray[np.float64],
) -> None:
    """Set discs of the image to 0 and mark them in `blocked` (STAR_BIT). In place; positions and radii in px, shape (n,)."""
    rows, cols = image.shape
    for k in range(row.shape[0]):
        radius = radius_px[k]
        if radius <= 0.0:
            continue
        for i in range(max(0, math.ceil(row[k] - radius)), min(rows, math.floor(row[k] + radius) + 1)):
            half = math.sqrt(max(0.0, radius * radius - (i - row[k]) ** 2))
            for j in range(max(0, math.ceil(col[k] - half)), min(cols, math.floor(col[k] + half) + 1)):
                image[i, j] = 0
                blocked[i, j] |= STAR_BIT


@nb.njit(cache=True)
def _tile_sums(values: NDArray[np.int8], blocked: NDArray[np.uint8], limit: int) -> tuple[int, int]:
    # 32-bit sums: twice the vector lanes of Python's integers
    total, count = np.int32(0), np.int32(0)
    low, high = np.int32(-limit), np.int32(limit)
    for i in range(values.shape[0]):
        value = np.int32(values[i])
        value = low if value < low else value
        value = high if value > high else value
        total = np.int32(total + value)
        count = np.int32(count + np.int32(blocked[i] == 0))
    return int(total), int(count)


@nb.njit(cache=True, nogil=True)
def local_level(image: NDArray[np.int8], blocked: NDArray[np.uint8], tile_px: int) -> NDArray[np.float32]:
    """Mean of the clipped image (+-3 sigma) in tiles, smoothed over squares of LEVEL_TILES; units of sigma/16.

    A background that is wrong by 0.02 sigma per pixel shifts a line sum over 4,000 px by 2 sigma, so the level left over
    by the mesh is taken out here. Shape (ceil(rows/tile), ceil(cols/tile)).
    """
    rows, cols = image.shape
    n_row, n_col = (rows + tile_px - 1) // tile_px, (cols + tile_px - 1) // tile_px
    total = np.zeros((n_row, n_col))
    count = np.zeros((n_row, n_col))
    for row in range(rows):
        for j in range(n_col):
            piece = slice(j * tile_px, min((j + 1) * tile_px, cols))
            s, n = _tile_sums(image[row, piece], blocked[row, piece], 3 * UNIT)
            total[row // tile_px, j] += s
            count[row // tile_px, j] += n
    level, reach = np.zeros((n_row, n_col), np.float32), LEVEL_TILES // 2
    for i in range(n_row):
        for j in range(n_col):
            light = pixels = 0.0
            for di in range(max(0, i - reach), min(n_row, i + reach + 1)):
                for dj in range(max(0, j - reach), min(n_col, j + reach + 1)):
                    light += total[di, dj]
                    pixels += count[di, dj]
            level[i, j] = light / pixels if pixels > 0.0 else 0.0
    return level


def odd_taps(psf_sigma_px: float) -> NDArray[np.int16]:
    """Half of a symmetric odd Gaussian kernel, centre first, as small integers (shape (r + 1,))."""
    radius = max(1, min(6, math.floor(2.4 * psf_sigma_px + 0.5)))
    return np.maximum(np.rint(16.0 * np.exp(-0.5 * (np.arange(radius + 1) / psf_sigma_px) ** 2)), 1).astype(np.int16)


def even_taps(psf_sigma_px: float) -> NDArray[np.int16]:
    """Half of a symmetric even Gaussian kernel (taps at 0.5, 1.5, ... px) as small integers (shape (r,))."""
    radius = max(2, min(6, math.ceil(2.0 * psf_sigma_px)))
    weights = np.exp(-0.5 * ((np.arange(radius) + 0.5) / psf_sigma_px) ** 2)
    return np.maximum(np.rint(16.0 * weights), 1).astype(np.int16)


@nb.njit(cache=True)
def _weigh_five_rows(
    out: NDArray[np.int16],
    shift: NDArray[np.int16],
    a: NDArray[np.int8],
    b: NDArray[np.int8],
    c: NDArray[np.int8],
    d: NDArray[np.int8],
    e: NDArray[np.int8],
    taps: NDArray[np.int16],
) -> None:
    """``out = shift + t2 (a + e) + t1 (b + d) + t0 c``, what a copy, `_add_row` and `_add_rows` do in four passes."""
    t0, t1, t2 = taps[0], taps[1], taps[2]
    for i in range(out.shape[0]):
        near, far = np.int16(np.int16(b[i]) + np.int16(d[i])), np.int16(np.int16(a[i]) + np.int16(e[i]))
        out[i] = np.int16(shift[i] + t0 * np.int16(c[i]) + t1 * near + t2 * far)


@nb.njit(cache=True)
def _store_five(
    line: NDArray[np.int16], taps: NDArray[np.int16], scale: np.float32, limit: np.float32, out: NDArray[np.int8]
) -> None:
    """The same along a line that is two longer than `out` at each end, scaled and clipped: `_add_pairs` and `_store_clipped`."""
    # sums of two fit 16 bits, and the products and their sum are exact in single precision
    t0, t1, t2 = np.float32(taps[0]), np.float32(taps[1]), np.float32(taps[2])
    for i in range(out.shape[0]):
        near, far = np.int16(line[i + 1] + line[i + 3]), np.int16(line[i] + line[i + 4])
        total = t0 * np.float32(line[i + 2]) + (t1 * np.float32(near) + t2 * np.float32(far))
        out[i] = np.int8(clipped_code(total * scale, limit))


@nb.njit(cache=True)
def _begin_row(out: NDArray[np.int16], shift: NDArray[np.int16], total: NDArray[np.int32]) -> None:
    """``out = shift``, ``total = 0``: a slice set to an array is checked for overlap and takes as long as a pass of its own."""
    for i in range(shift.shape[0]):
        out[i] = shift[i]
        total[i] = np.int32(0)


@nb.njit(cache=True)
def _add_rows(out: NDArray[np.int16], upper: NDArray[np.int8], lower: NDArray[np.int8], weight: np.int16) -> None:
    for i in range(out.shape[0]):
        out[i] = np.int16(out[i] + weight * np.int16(np.int16(upper[i]) + np.int16(lower[i])))


@nb.njit(cache=True)
def _add_row(out: NDArray[np.int16], row: NDArray[np.int8], weight: np.int16) -> None:
    for i in range(out.shape[0]):
        out[i] = np.int16(out[i] + weight * np.int16(row[i]))


@nb.njit(cache=True)
def _add_pairs(out: NDArray[np.int32], left: NDArray[np.int16], right: NDArray[np.int16], weight: np.int32) -> None:
    for i in range(out.shape[0]):
        out[i] += weight * (np.int32(left[i]) + np.int32(right[i]))


@nb.njit(cache=True)
def _store_clipped(total: NDArray[np.int32], scale: np.float32, limit: np.float32, out: NDArray[np.int8]) -> None:
    for i in range(out.shape[0]):
        out[i] = np.int8(clipped_code(np.float32(total[i]) * scale, limit))


def smooth(
    image: NDArray[np.int8], level: NDArray[np.float32], tile_px: int, taps: NDArray[np.int16], clip_sigma: float
) -> NDArray[np.int8]:
    """PSF-smoothed image, sigma = UNIT, clipped at +-clip_sigma; `level` is subtracted. Shape (rows, cols)."""
    out = np.empty(image.shape, np.int8)
    _smooth(image, level, tile_px, taps, clip_sigma, 0, out)
    return out


@nb.njit(cache=True)
def _fill_shift(level: NDArray[np.float32], tile_px: int, total_weight: float, out: NDArray[np.int16]) -> None:
    """What a row of the mesh takes away from the sum along each column."""
    for j in range(level.size):
        out[j * tile_px : (j + 1) * tile_px] = -np.int16(np.rint(level[j] * total_weight))


@nb.njit(cache=True, nogil=True)
def _smooth(
    image: NDArray[np.int8],
    level: NDArray[np.float32],
    tile_px: int,
    taps: NDArray[np.int16],
    clip_sigma: float,
    first: int,
    out: NDArray[np.int8],
) -> None:
    """Rows from `first` on, as many as `out` has."""
    rows, cols = image.shape
    radius = taps.shape[0] - 1
    power, total_weight = float(taps[0]) ** 2, float(taps[0])
    for k in range(1, radius + 1):
        power += 2.0 * float(taps[k]) ** 2
        total_weight += 2.0 * taps[k]
    scale = np.float32(1.0 / power)
    limit = np.float32(clip_sigma * UNIT)
    line, shift = np.zeros(cols + 2 * radius, np.int16), np.zeros(cols, np.int16)
    total = np.empty(cols, np.int32)
    blank = np.zeros(cols, np.int8)
    middle = line[radius : radius + cols]
    for row in range(first, first + out.shape[0]):
        if row == first or row % tile_px == 0:
            _fill_shift(level[row // tile_px], tile_px, total_weight, shift)
        if radius == 2:  # a PSF of 2 px FWHM: one pass in each direction
            _weigh_five_rows(
                middle,
                shift,
                image[row - 2] if row >= 2 else blank,
                image[row - 1] if row >= 1 else blank,
                image[row],
                image[row + 1] if row + 1 < rows else blank,
                image[row + 2] if row + 2 < rows else blank,
                taps,
            )
            _store_five(line, taps, scale, limit, out[row - first])
            continue
        _begin_row(middle, shift, total)
        _add_row(middle, image[row], taps[0])
        for k in range(1, radius + 1):
            upper = image[row - k] if row >= k else blank
            lower = image[row + k] if row + k < rows else blank
            _add_rows(middle, upper, lower, taps[k])
        for k in range(1, radius + 1):
            _add_pairs(total, line[radius - k : radius - k + cols], line[radius + k : radius + k + cols], np.int32(taps[k]))
        half = np.int32(taps[0])
        for i in range(cols):
            total[i] += half * np.int32(middle[i])
        _store_clipped(total, scale, limit, out[row - first])


@nb.njit(cache=True)
def _known_row(values: NDArray[np.int8], blocked: NDArray[np.uint8]) -> None:
    """Make pixels unknown that are blocked by anything but a trail."""
    for i in range(values.size):
        free = (blocked[i] == np.uint8(0)) | (blocked[i] == np.uint8(FOUND_BIT))
        values[i] = values[i] if free else np.int8(UNKNOWN)


@nb.njit(cache=True)
def _trail_pixels(blocked: NDArray[np.uint8]) -> int:
    """Pixels of a row that are a trail's; a loop of its own, for the two in one take twice the time."""
    count = np.int32(0)
    for i in range(blocked.size):
        count += np.int32(blocked[i] == np.uint8(FOUND_BIT))
    return int(count)


@nb.njit(cache=True)
def known(
    smoothed: NDArray[np.int8],
    image: NDArray[np.int8],
    blocked: NDArray[np.uint8],
    level: NDArray[np.float32],
    tile_px: int,
    taps: NDArray[np.int16],
    clip_sigma: float,
) -> None:
    """Put trails that were taken out of a smoothed image back, and `UNKNOWN` where pixels are blocked. In place.

    The other arguments are those that it was smoothed with.
    """
    again = np.empty((1, image.shape[1]), np.int8)
    for row in range(image.shape[0]):
        _known_row(smoothed[row], blocked[row])
        if _trail_pixels(blocked[row]) > 0:
            _smooth(image, level, tile_px, taps, clip_sigma, row, again)
            for i in range(image.shape[1]):
                if blocked[row, i] == np.uint8(FOUND_BIT):
                    smoothed[row, i] = again[0, i]


def smooth_binned(
    image: NDArray[np.int8], level: NDArray[np.float32], tile_px: int, taps: NDArray[np.int16], clip_sigma: float
) -> NDArray[np.int16]:
    """PSF-smoothed image sampled at the centres of 2 x 2 pixels, sigma = 2 UNIT, clipped; shape (rows // 2, cols // 2)."""
    out = np.empty((image.shape[0] // 2, image.shape[1] // 2), np.int16)
    _smooth_binned(image, level, tile_px, taps, clip_sigma, out)
    return out


@nb.njit(cache=True, nogil=True)
def _smooth_binned(
    image: NDArray[np.int8],
    level: NDArray[np.float32],
    tile_px: int,
    taps: NDArray[np.int16],
    clip_sigma: float,
    out: NDArray[np.int16],
) -> None:
    rows, cols = image.shape
    radius = taps.shape[0]
    power, total_weight = 0.0, 0.0
    for k in range(radius):
        power += 2.0 * float(taps[k]) ** 2
        total_weight += 2.0 * taps[k]
    scale = np.float32(2.0 / power)
    limit = np.float32(2.0 * clip_sigma * UNIT)
    line, shift = np.zeros(cols + 2 * radius, np.int16), np.zeros(cols, np.int16)
    total = np.empty(cols, np.int32)
    blank = np.zeros(cols, np.int8)
    middle = line[radius : radius + cols]
    for half_row in range(rows // 2):
        if half_row == 0 or 2 * half_row // tile_px != (2 * half_row - 2) // tile_px:
            _fill_shift(level[2 * half_row // tile_px], tile_px, total_weight, shift)
        _begin_row(middle, shift, total)
        for k in range(radius):
            upper = image[2 * half_row - k] if 2 * half_row >= k else blank
            lower = image[2 * half_row + 1 + k] if 2 * half_row + 1 + k < rows else blank
            _add_rows(middle, upper, lower, taps[k])
        for k in range(radius):
            _add_pairs(
                total, line[radius - k : radius - k + cols], line[radius + 1 + k : radius + 1 + k + cols], np.int32(taps[k])
            )
        target = out[half_row]
        for i in range(target.shape[0]):
            value = min(max(np.float32(total[2 * i]) * scale, -limit), limit) + np.float32(4096.5)
            target[i] = np.int16(np.int32(value) - 4096)
