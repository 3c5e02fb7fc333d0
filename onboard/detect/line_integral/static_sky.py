"""What stood at the same place in the frame before: stars, spikes, blooming (fixed to the sky), hot columns (to the pixels).

A mover leaves noise behind in the earlier frame; a star of true S/N s leaves s +- 1. So the temporal test needs no catalogue
and no model of a star's halo. Positions are mapped by a (2, 3) transform of (row, col) from this frame to the earlier one.
"""

import math
from dataclasses import dataclass
from typing import Final

import numba as nb
import numpy as np
from numpy.typing import NDArray

from onboard.detect.line_integral.kept_frame import BEYOND, KeptFrame, KeptPixels, in_sigmas, kept
from onboard.detect.whiten import UNIT
from onboard.image import registration
from onboard.prefetch import ask_for
from sboc_e2e.icd.signals import DetectorView

STARS_AHEAD: Final = 8  # whose memory is asked for: some 3 us before it is read

EDGE_PX: Final = 3.0
"""Closer to the edge of the earlier frame a star is not measured there."""

CLIP_SIGMA: Final = BEYOND / UNIT
"""Clip of the image that trails are found on; a pixel at the end of a bled column, brighter then than now, tells nothing more."""


@dataclass(frozen=True, kw_only=True, eq=False)
class EarlierFrame:
    """What was kept of the preceding frame, and the transform (2, 3) of (row, col) from this frame into it."""

    frame: KeptFrame
    transform: NDArray[np.float64]


def earlier_frame(view: DetectorView, reach_px: float) -> EarlierFrame | None:
    """The newest frame of the history when its stars can be matched with those of this frame; kept frames or whole views."""
    if not view.history:
        return None
    newest = view.history[-1]
    frame = newest if isinstance(newest, KeptFrame) else kept(newest)
    if frame.pixels[0].shape != view.residual_adu.shape:
        return None
    transform = registration.register(view.stars, frame.stars, reach_px=reach_px)
    return None if transform is None else EarlierFrame(frame=frame, transform=transform)


@nb.njit(cache=True)
def _point_snr(pixels: KeptPixels, row: float, col: float, psf_sigma_px: float) -> float:
    """Matched-filter S/N of a point source at (row, col); NaN where less than half of its light falls on known pixels."""
    codes = pixels[0]
    rows, cols = codes.shape
    radius = math.ceil(2.5 * psf_sigma_px)
    centre_row, centre_col = math.floor(row + 0.5), math.floor(col + 0.5)
    factor = -0.5 / psf_sigma_px**2
    # g along a row by two multiplications per step: exp(a (d+1)^2) = exp(a d^2) exp(a (2 d + 1))
    d = centre_col - radius - col
    first, first_ratio, growth = math.exp(factor * d * d), math.exp(factor * (2.0 * d + 1.0)), math.exp(2.0 * factor)
    signal = power = full = 0.0
    for i in range(centre_row - radius, centre_row + radius + 1):
        g, ratio = first * math.exp(factor * (i - row) ** 2), first_ratio
        for j in range(centre_col - radius, centre_col + radius + 1):
            full += g * g
            if 0 <= i < rows and 0 <= j < cols:
                value = float(codes[i, j])
                if abs(value) >= BEYOND:
                    value = UNIT * in_sigmas(pixels, i, j)
                if not math.isnan(value):
                    signal += g * value
                    power += g * g
            g *= ratio
            ratio *= growth
    return signal / (UNIT * math.sqrt(power)) if power > 0.5 * full else math.nan


@nb.njit(cache=True)
def point_snr_before(
    pixels: KeptPixels,
    transform: NDArray[np.float64],
    row: NDArray[np.float64],
    col: NDArray[np.float64],
    psf_sigma_px: float,
) -> NDArray[np.float64]:
    """S/N in the earlier frame at the mapped places of points (n,) of this frame; NaN where it cannot be known."""
    rows, cols = pixels[0].shape
    out = np.full(row.shape[0], np.nan)
    reach = math.ceil(2.5 * psf_sigma_px)
    for k in range(row.shape[0]):
        later = min(k + STARS_AHEAD, row.shape[0] - 1)
        r = transform[0, 0] * row[later] + transform[0, 1] * col[later] + transform[0, 2]
        c = transform[1, 0] * row[later] + transform[1, 1] * col[later] + transform[1, 2]
        for i in range(math.floor(r + 0.5) - reach, math.floor(r + 0.5) + reach + 1):
            ask_for(pixels[0], (i, math.floor(c + 0.5)))
        r = transform[0, 0] * row[k] + transform[0, 1] * col[k] + transform[0, 2]
        c = transform[1, 0] * row[k] + transform[1, 1] * col[k] + transform[1, 2]
        if EDGE_PX <= r <= rows - 1 - EDGE_PX and EDGE_PX <= c <= cols - 1 - EDGE_PX:
            out[k] = _point_snr(pixels, r, c, psf_sigma_px)
    return out


@nb.njit(cache=True)
def lit_pixels(
    blocked: NDArray[np.uint8], ignored: int, ends: NDArray[np.float64], psf_sigma_px: float
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.float64]]:
    """Rows, columns and profile (n,) of the pixels within 3 sigma of a segment (row0, col0, row1, col1).

    Line by line of its major axis; pixels with bits of `blocked` other than `ignored` are left out.
    """
    factor, reach = -0.5 / psf_sigma_px**2, 3.0 * psf_sigma_px
    d_row, d_col = ends[2] - ends[0], ends[3] - ends[1]
    length = max(math.hypot(d_row, d_col), 1.0)
    u_row, u_col = d_row / length, d_col / length
    if u_row == 0.0 and u_col == 0.0:
        u_col = 1.0
    steep = abs(u_row) >= abs(u_col)
    along = abs(u_row) if steep else abs(u_col)
    start, stop = (ends[0], ends[2]) if steep else (ends[1], ends[3])
    origin, slope = (ends[1], u_col / u_row) if steep else (ends[0], u_row / u_col if u_col != 0.0 else 0.0)
    low, high = math.ceil(min(start, stop)), math.floor(max(start, stop))
    most = max(high - low + 1, 0) * (math.floor(2.0 * reach / along) + 2)  # one more, for sums are rounded
    at_row, at_col, profile = np.empty(most, np.int32), np.empty(most, np.int32), np.empty(most)
    n = 0
    for major in range(low, high + 1):
        minor = origin + slope * (major - start)
        for k in range(math.ceil(minor - reach / along), math.floor(minor + reach / along) + 1):
            i, j = (major, k) if steep else (k, major)
            if 0 <= i < blocked.shape[0] and 0 <= j < blocked.shape[1] and (blocked[i, j] & ~ignored) == 0:
                at_row[n], at_col[n], profile[n] = i, j, math.exp(factor * ((k - minor) * along) ** 2)
                n += 1
    return at_row[:n], at_col[:n], profile[:n]


@nb.njit(cache=True)
def segment_snr(
    residual_adu: NDArray[np.float32],
    mask: NDArray[np.uint8],
    sigma_adu: NDArray[np.float32],
    tile_px: int,
    blanked: tuple[NDArray[np.uint8], int],
    mesh: tuple[NDArray[np.float32], int],
    ends: NDArray[np.float64],
    psf_sigma_px: float,
) -> float:
    """S/N along a segment (row0, col0, row1, col1) of this frame, not clipped; NaN if most of its pixels are masked.

    blanked : working mask, and its bits that do not count (the segment's own blanking). mesh : the light that the background
    left over, sigma/16, and its tiles' side, px.
    """
    (blocked, ignored), (level, level_tile_px) = blanked, mesh
    signal = power = total = 0.0
    at_row, at_col, profile = lit_pixels(blocked, ignored, ends, psf_sigma_px)
    for k in range(profile.size):
        i, j, g = at_row[k], at_col[k], profile[k]
        total += g * g
        if mask[i, j] == 0:
            sigma = sigma_adu[min(i // tile_px, sigma_adu.shape[0] - 1), min(j // tile_px, sigma_adu.shape[1] - 1)]
            if sigma > 0.0:
                signal += g * (residual_adu[i, j] / sigma - level[i // level_tile_px, j // level_tile_px] / 16.0)
                power += g * g
    return signal / math.sqrt(power) if power > 0.5 * total and power > 0.0 else math.nan


@nb.njit(cache=True)
def segment_snr_before(
    pixels: KeptPixels,
    transform: NDArray[np.float64],
    sky: NDArray[np.float64],
    blanked: tuple[NDArray[np.uint8], int],
    mesh: tuple[NDArray[np.float32], int],
    ends: NDArray[np.float64],
    psf_sigma_px: float,
) -> float:
    """As `segment_snr`, in an earlier frame at the mapped place of a segment of this one, on the pixels it was found on.

    sky : transform from that place to where its stars are in this frame; pixels of masked ones are left out. NaN if most of the
    segment lies outside.
    """
    (blocked, ignored), (level, level_tile_px) = blanked, mesh
    rows, cols = pixels[0].shape
    signal = power = total = 0.0
    at_row, at_col, profile = lit_pixels(blocked, ignored, ends, psf_sigma_px)
    for k in range(profile.size):
        i, j, g = at_row[k], at_col[k], profile[k]
        total += g * g
        r = math.floor(transform[0, 0] * i + transform[0, 1] * j + transform[0, 2] + 0.5)
        c = math.floor(transform[1, 0] * i + transform[1, 1] * j + transform[1, 2] + 0.5)
        if 0 <= r < rows and 0 <= c < cols:
            m = math.floor(sky[0, 0] * i + sky[0, 1] * j + sky[0, 2] + 0.5)
            n = math.floor(sky[1, 0] * i + sky[1, 1] * j + sky[1, 2] + 0.5)
            star = 0 <= m < rows and 0 <= n < cols and (blocked[m, n] & ~ignored) != 0
            value = in_sigmas(pixels, r, c)
            if not (star or math.isnan(value)):
                value = min(value, CLIP_SIGMA)
                signal += g * (value - level[i // level_tile_px, j // level_tile_px] / 16.0)
                power += g * g
    return signal / math.sqrt(power) if power > 0.5 * total and power > 0.0 else math.nan


@nb.njit(cache=True)
def subtracted_snr(
    row: NDArray[np.float64],
    col: NDArray[np.float64],
    snr: NDArray[np.float64],
    transform: NDArray[np.float64],
    ends: NDArray[np.float64],
    psf_sigma_px: float,
) -> float:
    """S/N that Gaussian stars (n,) at the mapped places add to a segment (row0, col0, row1, col1) whose pixels are all usable.

    With g = exp(-v^2 / 2 s^2) across the segment and a star S exp(-r^2 / 2 s^2) / (sqrt(pi) s): sum(g star) is
    S sqrt(2 pi) s exp(-v0^2 / 4 s^2) times the star's share between the ends, and sum(g^2) is L sqrt(pi) s.
    """
    length = max(math.hypot(ends[2] - ends[0], ends[3] - ends[1]), 1.0)
    u_row, u_col = (ends[2] - ends[0]) / length, (ends[3] - ends[1]) / length
    reach = 4.0 * psf_sigma_px
    root = 1.0 / (math.sqrt(2.0) * psf_sigma_px)
    light = 0.0
    for k in range(row.shape[0]):
        d_row = transform[0, 0] * row[k] + transform[0, 1] * col[k] + transform[0, 2] - ends[0]
        if abs(d_row) > length + reach:
            continue
        d_col = transform[1, 0] * row[k] + transform[1, 1] * col[k] + transform[1, 2] - ends[1]
        along, across = d_row * u_row + d_col * u_col, d_row * u_col - d_col * u_row
        if abs(across) < reach and -reach < along < length + reach:
            inside = 0.5 * (math.erf((length - along) * root) + math.erf(along * root))
            light += snr[k] * inside * math.exp(-0.25 * (across / psf_sigma_px) ** 2)
    return light * math.sqrt(2.0 * math.pi) * psf_sigma_px / math.sqrt(length * math.sqrt(math.pi) * psf_sigma_px)


@nb.njit(cache=True)
def _count_static(now: NDArray[np.int8], before: NDArray[np.int8], each: int, both: int) -> int:
    count = np.int32(0)
    for i in range(now.shape[0]):
        bright = (np.int16(now[i]) + np.int16(before[i]) > both) & (now[i] > each) & (before[i] > each)
        count = np.int32(count + np.int32(bright))
    return int(count)


def shifted_rows(transform: NDArray[np.float64], top: int, tile_px: int, cols: int) -> tuple[int, int]:
    """Smallest and largest whole-pixel row shift of the tiles whose first row is `top`."""
    middle = top + 0.5 * tile_px
    shift = transform[0, 0] * middle + transform[0, 1] * np.array([0.0, cols + 0.5 * tile_px]) + transform[0, 2] - middle
    return math.floor(shift.min() + 0.5), math.floor(shift.max() + 0.5)


@nb.njit(cache=True)
def faint_static_stars(
    now: NDArray[np.int8],
    before: NDArray[np.int8],
    now_first: int,
    then_first: int,
    top: int,
    rows: int,
    transform: NDArray[np.float64],
    each: int,
    both: int,
    clip: int,
    tile_px: int,
    places: NDArray[np.float64],
    found: int,
) -> int:
    """Stars of one row of tiles, too faint for the star list but present in both frames.

    Fills rows (row, col, S/N now, S/N then) of places from number `found` on and returns how many there are. now, then : smoothed
    bands of the two frames, sigma/16, that begin at rows now_first and then_first of frames of `rows` rows; top : first row of
    the tiles. A star is a local maximum of the sum where each exceeds `each` and the sum exceeds `both` (sigma/16). The
    transform (this frame to the earlier one) acts as one whole-pixel shift for each tile.
    """
    cols = now.shape[1]
    for tile_col in range(0, cols, tile_px):
        r, c = top + 0.5 * tile_px, tile_col + 0.5 * tile_px
        d_row = math.floor(transform[0, 0] * r + transform[0, 1] * c + transform[0, 2] - r + 0.5)
        d_col = math.floor(transform[1, 0] * r + transform[1, 1] * c + transform[1, 2] - c + 0.5)
        first = max(tile_col, 1, 1 - d_col)
        last = min(tile_col + tile_px, cols - 1, cols - 1 - d_col)
        if last <= first:
            continue
        for row in range(max(top, 1, 1 - d_row), min(top + tile_px, rows - 1, rows - 1 - d_row)):
            i, m = row - now_first, row + d_row - then_first
            if _count_static(now[i, first:last], before[m, first + d_col : last + d_col], each, both) == 0:
                continue
            for j in range(first, last):
                a, b = np.int32(now[i, j]), np.int32(before[m, j + d_col])
                if a <= each or b <= each or a + b <= both:
                    continue
                peak = True
                for di in range(-1, 2):
                    for dj in range(-1, 2):
                        beside = np.int32(now[i + di, j + dj]) + np.int32(before[m + di, j + d_col + dj])
                        # of equal neighbours the first one, unless both frames are at their clip: all of that plain counts
                        if beside > a + b or (beside == a + b < 2 * clip and (di < 0 or (di == 0 and dj < 0))):
                            peak = False
                if peak and found < places.shape[0]:
                    places[found, 0], places[found, 1] = row, j
                    places[found, 2], places[found, 3] = a / 16.0, b / 16.0
                    found += 1
    return found


@nb.njit(cache=True)
def subtract_stars(
    image: NDArray[np.int8],
    blocked: NDArray[np.uint8],
    row: NDArray[np.float64],
    col: NDArray[np.float64],
    snr: NDArray[np.float64],
    psf_sigma_px: float,
) -> None:
    """Subtract Gaussian stars of the given matched-filter S/N from an image in sigma/16, in place; columns (n,).

    With the S/N of the *earlier* frame a mover's own light is not touched, and the star's place keeps its information at
    twice the noise variance instead of losing it to a mask.
    """
    rows, cols = image.shape
    radius = math.ceil(3.0 * psf_sigma_px)
    factor = -0.5 / psf_sigma_px**2
    # matched filter over the peak pixel of a Gaussian of unit peak: sqrt(sum g^2) = sqrt(pi) s
    scale = 16.0 / (math.sqrt(math.pi) * psf_sigma_px)
    profile = np.empty(2 * radius + 1)
    for k in range(row.shape[0]):
        later = min(k + STARS_AHEAD, row.shape[0] - 1)
        for i in range(math.floor(row[later] + 0.5) - radius, math.floor(row[later] + 0.5) + radius + 1):
            ask_for(image, (i, math.floor(col[later] + 0.5)))
        i0, j0 = math.floor(row[k] + 0.5) - radius, math.floor(col[k] + 0.5) - radius
        for m in range(2 * radius + 1):
            profile[m] = math.exp(factor * (j0 + m - col[k]) ** 2)
        for i in range(max(0, i0), min(rows, i0 + 2 * radius + 1)):
            peak = snr[k] * scale * math.exp(factor * (i - row[k]) ** 2)
            for j in range(max(0, j0), min(cols, j0 + 2 * radius + 1)):
                if blocked[i, j] == 0:
                    value = image[i, j] - peak * profile[j - j0]
                    image[i, j] = np.int8(math.floor(min(max(value, -127.0), 127.0) + 0.5))
