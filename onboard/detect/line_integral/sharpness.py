"""Sharpness of a segment: a particle track is a line of no width behind the pixels, a trail of light is as wide as the PSF.

The same lines of the calibrated image, not clipped, are summed with both cross-sections. Two matched filters on the same
Gaussian noise: half the difference of their squared S/N is the logarithm of the likelihood ratio of the two shapes, each with
its best amplitude and place.
"""

import math
from dataclasses import replace
from typing import Final

import numba as nb
import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.signals import Detection, DetectorView

NARROW_PX: Final = 0.4
"""Sigma of the cross-section of a particle track: what pixels make of a line of no width.

Two Gaussians s and n fit a third of width sqrt(s n) equally well: with the PSF of 0.87 px, 0.59 px. No trail of light is that
sharp, most tracks are, unless charge spreads sideways by more than 0.5 px.
"""

SHARP_EVIDENCE: Final = 20.0
"""Gain in squared S/N by which a track must beat the PSF.

The S/N of a trail of light falls by 1 - rho with the narrow cross-section, rho = sqrt(2 s n / (s^2 + n^2)) = 0.87, and the
difference scatters by sqrt(2 (1 - rho)) = 0.51; the search for the best place and single hits on the way widen that. That of
a track rises by 1 / rho: it is flagged from S/N 9 on.
"""

LEAST_WIDTH_PX: Final = NARROW_PX
MOST_WIDTHS: Final = 3.0
"""Measured widths are held between that of a track and so many times the nominal one."""

MOST_LINES: Final = 128
"""Lines of a segment that are looked at, around its middle."""

CLIP_SIGMA: Final = 5.0
"""Pixels are clipped at so many sigma plus CLIP_PEAKS times the peak of a track with the segment's median light per line ..."""

CLIP_PEAKS: Final = 3.0
"""... so that a star or a hit under a faint trail does not answer for it."""

OUTLIER_SIGMA: Final = 5.0
"""Lines whose light is so far from the median, and by more than all of it, show something else and are left out."""

CLEAR_EVIDENCE: Final = 12.0  # in squared S/N; less saves more searches and turns more tracks into trails. Chosen, not measured
CLEAR_SHARE: Final = 0.1
"""Where the PSF explains the light better by so much, and this share of its squared S/N, on the path as it was found, no search
for a better one turns that round; nor where the narrow cross-section does by three times as much beyond what is asked for."""

RIDGE_PX: Final = 0.75
"""A path lies on the light when no end can be moved so far across and gain."""

REACH_SIGMAS: Final = 3.5
"""Cross-sections are summed out to so many of their widths."""

ACROSS_PX: Final = 1.5
"""How far the ends may be moved across in search of the largest S/N with the PSF ..."""

ACROSS_AGAIN_PX: Final = 0.75
"""... and from there with the narrow cross-section."""


@nb.njit(cache=True)
def gather_lines(
    residual_adu: NDArray[np.float32],
    mask: NDArray[np.uint8],
    sigma_adu: NDArray[np.float32],
    tile_px: int,
    level: NDArray[np.float32],
    level_tile_px: int,
    ends: NDArray[np.float64],
    sagitta_px: float,
    values: NDArray[np.float64],
    corner: NDArray[np.float64],
) -> tuple[int, float, float]:
    """Pixels around the middle of a segment (row0, col0, row1, col1), in sigma, laid straight.

    sagitta_px : of the bend that is taken out (as in `Detection`). values : (lines, odd width), NaN where masked or outside;
    corner : minor coordinate of each line's first pixel, less the bend. level : mesh of the light that the background left
    over, sigma/16. At least three lines are read, beyond the ends if need be.

    Returns the number of lines, and the segment's minor coordinate on the first and its slope.
    """
    half_px = values.shape[1] // 2
    rows, cols = residual_adu.shape
    steep = abs(ends[2] - ends[0]) >= abs(ends[3] - ends[1])
    start, stop, first, last = (ends[0], ends[2], ends[1], ends[3]) if steep else (ends[1], ends[3], ends[0], ends[2])
    turned = start > stop
    if turned:
        start, stop, first, last = stop, start, last, first
    slope = (last - first) / (stop - start) if stop > start else 0.0
    bend = 4.0 * sagitta_px * math.sqrt(1.0 + slope * slope) * (1.0 if steep == turned else -1.0)
    middle = 0.5 * (start + stop)
    reach = min(max(0.5 * (stop - start), 1.0), 0.5 * (values.shape[0] - 1))
    low, high = math.ceil(middle - reach - 1e-6), math.floor(middle + reach + 1e-6)
    n = min(high - low + 1, values.shape[0])
    for k in range(n):
        major = low + k
        u = (major - start) / (stop - start) if stop > start else 0.0
        bow = bend * u * (1.0 - u)
        left = math.floor(first + slope * (major - start) + bow + 0.5) - half_px
        corner[k] = left - bow
        for m in range(values.shape[1]):
            i, j = (major, left + m) if steep else (left + m, major)
            values[k, m] = math.nan
            if 0 <= i < rows and 0 <= j < cols and mask[i, j] == 0:
                sigma = sigma_adu[min(i // tile_px, sigma_adu.shape[0] - 1), min(j // tile_px, sigma_adu.shape[1] - 1)]
                if sigma > 0.0:
                    values[k, m] = residual_adu[i, j] / sigma - level[i // level_tile_px, j // level_tile_px] / 16.0
    return n, first + slope * (low - start), slope


@nb.njit(cache=True)
def line_sums(
    values: NDArray[np.float64],
    corner: NDArray[np.float64],
    n: int,
    minor: float,
    slope: float,
    width_px: float,
    signal: NDArray[np.float64],
    weight: NDArray[np.float64],
) -> None:
    """Matched sums of each line about a path: signal = sum(g x) and weight = sum(g^2), g of unit area across the path."""
    cosine = 1.0 / math.sqrt(1.0 + slope * slope)
    norm = 1.0 / (math.sqrt(2.0 * math.pi) * width_px)
    factor = -0.5 * (cosine / width_px) ** 2
    growth = math.exp(2.0 * factor)
    reach = REACH_SIGMAS * width_px / cosine
    for k in range(n):
        s = w = 0.0
        # g at equal steps by two multiplications per step: exp(a (d+1)^2) = exp(a d^2) exp(a (2 d + 1))
        at = minor + slope * k - corner[k]
        first, last = max(0, math.ceil(at - reach)), min(values.shape[1] - 1, math.floor(at + reach))
        d = first - at
        g, ratio = norm * math.exp(factor * d * d), math.exp(factor * (2.0 * d + 1.0))
        for m in range(first, last + 1):
            x = values[k, m]
            if not math.isnan(x):
                s += g * x
                w += g * g
            g *= ratio
            ratio *= growth
        signal[k], weight[k] = s, w


@nb.njit(cache=True)
def _total(signal: NDArray[np.float64], weight: NDArray[np.float64], use: NDArray[np.bool_]) -> float:
    s = w = 0.0
    for k in range(use.shape[0]):
        if use[k]:
            s += signal[k]
            w += weight[k]
    return s / math.sqrt(w) if w > 0.0 else 0.0


@nb.njit(cache=True)
def best_path(
    values: NDArray[np.float64],
    corner: NDArray[np.float64],
    use: NDArray[np.bool_],
    minor: float,
    slope: float,
    width_px: float,
    across_px: float,
    signal: NDArray[np.float64],
    weight: NDArray[np.float64],
) -> tuple[float, float, float]:
    """Largest S/N of the used lines over paths whose ends are at most across_px from the given one: (S/N, minor, slope).

    signal, weight : `line_sums` of the best path.
    """
    n = use.shape[0]
    span = max(n - 1.0, 2.0)
    best, at0, at1 = -1e9, 0.0, 0.0
    step = across_px / 3.0
    reach = 3
    while step > 0.07:
        centre0, centre1, before = at0, at1, best
        for i in range(-reach, reach + 1):
            for j in range(-reach, reach + 1):
                d0, d1 = centre0 + i * step, centre1 + j * step
                if max(abs(d0), abs(d1)) > across_px + 1e-9:
                    continue
                line_sums(values, corner, n, minor + d0, slope + (d1 - d0) / span, width_px, signal, weight)
                snr = _total(signal, weight, use)
                if snr > best:
                    best, at0, at1 = snr, d0, d1
        if reach == 3 or best <= before:
            step *= 0.5
        reach = 1
    minor, slope = minor + at0, slope + (at1 - at0) / span
    line_sums(values, corner, n, minor, slope, width_px, signal, weight)
    return best, minor, slope


@nb.njit(cache=True)
def on_ridge(
    values: NDArray[np.float64],
    corner: NDArray[np.float64],
    minor: float,
    slope: float,
    width_px: float,
    signal: NDArray[np.float64],
    weight: NDArray[np.float64],
) -> bool:
    """Whether the light of all lines is brightest on a path, and not beside it or across it. signal, weight : work space."""
    n = values.shape[0]
    span = max(n - 1.0, 2.0)
    use = np.ones(n, np.bool_)
    line_sums(values, corner, n, minor, slope, width_px, signal, weight)
    here = _total(signal, weight, use)
    for d0, d1 in ((RIDGE_PX, RIDGE_PX), (-RIDGE_PX, -RIDGE_PX), (RIDGE_PX, -RIDGE_PX), (-RIDGE_PX, RIDGE_PX)):
        line_sums(values, corner, n, minor + d0, slope + (d1 - d0) / span, width_px, signal, weight)
        if _total(signal, weight, use) > here:
            return False
    return True


@nb.njit(cache=True)
def keep_even_lines(signal: NDArray[np.float64], weight: NDArray[np.float64], use: NDArray[np.bool_]) -> None:
    """Leave out of `use` the lines whose light is far from that of the others; in place."""
    amplitude = signal / np.maximum(weight, 1e-6)
    middle = np.median(amplitude)
    for k in range(use.shape[0]):
        limit = max(OUTLIER_SIGMA / math.sqrt(max(weight[k], 1e-6)), middle)
        use[k] &= weight[k] > 0.0 and abs(amplitude[k] - middle) <= limit


@nb.njit(cache=True)
def both_snr(
    values: NDArray[np.float64],
    corner: NDArray[np.float64],
    minor: float,
    slope: float,
    wide_px: float,
    narrow_px: float,
    sure: bool,
) -> tuple[float, float]:
    """S/N of gathered lines with the wide and with the narrow cross-section; values are clipped in place.

    sure : the path is meant to be that of the light; where it is, a clear answer needs no search.
    """
    n, width = values.shape
    use = np.ones(n, np.bool_)
    signal, weight = np.empty(n), np.empty(n)
    line_sums(values, corner, n, minor, slope, wide_px, signal, weight)
    limit = CLIP_SIGMA + CLIP_PEAKS * max(0.0, np.median(signal / np.maximum(weight, 1e-6)))
    for k in range(n):
        for m in range(width):
            if abs(values[k, m]) > limit:
                values[k, m] = math.copysign(limit, values[k, m])
    line_sums(values, corner, n, minor, slope, wide_px, signal, weight)
    keep_even_lines(signal, weight, use)
    wide = _total(signal, weight, use)
    line_sums(values, corner, n, minor, slope, narrow_px, signal, weight)
    narrow = _total(signal, weight, use)
    gain, clear = narrow * narrow - wide * wide, CLEAR_EVIDENCE + CLEAR_SHARE * wide * wide
    if sure and gain > SHARP_EVIDENCE + 3.0 * clear:
        return wide, narrow
    # a bright track beside its path has nothing in the narrow cross-section, and more than it should in the wide one
    if sure and gain < -clear and on_ridge(values, corner, minor, slope, wide_px, signal, weight):
        return wide, narrow
    use[:] = True
    _, minor, slope = best_path(values, corner, use, minor, slope, wide_px, ACROSS_PX, signal, weight)
    keep_even_lines(signal, weight, use)
    wide = _total(signal, weight, use)
    line_sums(values, corner, n, minor, slope, narrow_px, signal, weight)
    narrow = _total(signal, weight, use)
    if narrow * narrow - wide * wide > SHARP_EVIDENCE + 3.0 * (CLEAR_EVIDENCE + CLEAR_SHARE * wide * wide):
        return wide, narrow
    _, minor, slope = best_path(values, corner, use, minor, slope, wide_px, ACROSS_AGAIN_PX, signal, weight)
    best_path(values, corner, use, minor, slope, narrow_px, ACROSS_AGAIN_PX, signal, weight)
    keep_even_lines(signal, weight, use)
    wide, _, _ = best_path(values, corner, use, minor, slope, wide_px, ACROSS_AGAIN_PX, signal, weight)
    narrow, _, _ = best_path(values, corner, use, minor, slope, narrow_px, ACROSS_AGAIN_PX, signal, weight)
    return wide, narrow


def measured_width_px(view: DetectorView) -> float:
    """Width of the PSF (sigma, px) as the stars of the frame show it; nominal where they do not."""
    measured = view.stars.psf_sigma_px
    return view.psf_sigma_px if measured is None else min(max(measured, LEAST_WIDTH_PX), MOST_WIDTHS * view.psf_sigma_px)


def sharpness(detection: Detection, view: DetectorView, level: NDArray[np.float32], level_tile_px: int) -> float:
    """Gain in squared S/N of a track of no width over the PSF on the middle of a detection; negative for trails of light.

    level : mesh of what the background left over, sigma/16. A point has no direction: the larger gain along rows and columns. A
    track is straight, and its step from one column to the next is easily found as a bend: a bent detection is held for light on
    its bend or on the straight line, whichever is brighter, and for a track on the straight line.
    """
    psf_sigma_px = measured_width_px(view)
    half_px = math.ceil(3.0 * math.sqrt(2.0) * psf_sigma_px + 2.0 * ACROSS_PX)
    values, corner = np.empty((MOST_LINES, 2 * half_px + 1)), np.empty(MOST_LINES)
    ends = np.array([detection.row0, detection.col0, detection.row1, detection.col1])
    background = view.background

    def snr_of(segment: NDArray[np.float64], sagitta_px: float, sure: bool) -> tuple[float, float]:
        n, minor, slope = gather_lines(
            view.residual_adu,
            view.mask,
            background.sigma_adu,
            background.tile_px,
            level,
            level_tile_px,
            segment,
            sagitta_px,
            values,
            corner,
        )
        return both_snr(values[:n], corner[:n], minor, slope, psf_sigma_px, NARROW_PX, sure)

    if detection.sagitta_px != 0.0 and detection.length_px > 1.0:
        bent, _ = snr_of(ends, detection.sagitta_px, True)
        wide, narrow = snr_of(ends, 0.0, False)
        return narrow**2 - max(wide, bent) ** 2
    directions = [ends] if detection.length_px > 1.0 else [ends + np.array([-1.0, 0, 1, 0]), ends + np.array([0, -1.0, 0, 1])]
    gain = -math.inf
    for segment in directions:
        wide, narrow = snr_of(segment, 0.0, True)
        gain = max(gain, narrow**2 - wide**2)
    return gain


def with_sharpness(detection: Detection, view: DetectorView, level: NDArray[np.float32], level_tile_px: int) -> Detection:
    """The detection with COSMIC_LIKE set when a track of no width explains its light better by SHARP_EVIDENCE."""
    if sharpness(detection, view, level, level_tile_px) > SHARP_EVIDENCE:
        return replace(detection, flags=detection.flags | StreakFlag.COSMIC_LIKE)
    return detection
