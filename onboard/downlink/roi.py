"""ROI strips: sheared rectangles of pixels that follow a streak, with margins that follow its uncertainty."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.image.dark_map import Codes, DarkMap, whole_at
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.signals import FIXED_POINT, BackgroundModel, Detection, Strip

LEAST_END_MARGIN_SIGMA = 6.0
"""Margin beyond a bright streak's end, in PSF sigmas: the light of the end itself."""

STRAIGHT_WITHIN_PX = 1.5
"""A strip is cut shorter until the trail's arc stays this close to its chord."""


@dataclass(frozen=True, kw_only=True)
class StripGeometry:
    """Where a strip lies; see `sboc_e2e.icd.signals.Strip`."""

    axis: int
    major0: int
    n: int
    width: int
    minor0_fp: int
    slope_fp: int


def end_margin_px(length_px: float, snr: float, psf_sigma_px: float, factor: float) -> float:
    """Margin beyond an end: `factor` times the rms of a maximum-likelihood end.

    rms = max(sqrt(2 sqrt(pi) s L) / S, sqrt(26) L / S^2): the Cramer-Rao bound, or the change-point law of a trail that
    starts in noise (the position of the maximum of a two-sided Brownian motion with drift has variance 26 in its units).
    """
    snr = max(snr, 1.0)
    bound = math.sqrt(2.0 * math.sqrt(math.pi) * psf_sigma_px * max(length_px, psf_sigma_px)) / snr
    change_point = math.sqrt(26.0) * length_px / (snr * snr)
    return factor * max(bound, change_point) + LEAST_END_MARGIN_SIGMA * psf_sigma_px


def arc_points(detection: Detection, fractions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points (n, 2) row, col on the detection's parabola at fractions of its chord; beyond its ends on the tangents."""
    drow, dcol = detection.row1 - detection.row0, detection.col1 - detection.col0
    length = math.hypot(drow, dcol)
    rise = np.where(fractions < 0.0, fractions, np.where(fractions > 1.0, 1.0 - fractions, fractions * (1.0 - fractions)))
    height = 4.0 * detection.sagitta_px * rise
    normal_row, normal_col = (dcol / length, -drow / length) if length > 0.0 else (0.0, 0.0)
    return np.column_stack(
        (detection.row0 + fractions * drow + height * normal_row, detection.col0 + fractions * dcol + height * normal_col)
    )


def piece_geometry(
    start: NDArray[np.float64], stop: NDArray[np.float64], half_width_px: float, axis: int, shape: tuple[int, int]
) -> StripGeometry | None:
    """The strip around the straight piece from start to stop (row, col); None when it lies outside the frame."""
    minor_axis = 1 - axis
    major_a, major_b, minor_a, minor_b = start[axis], stop[axis], start[minor_axis], stop[minor_axis]
    if major_a > major_b:
        major_a, major_b, minor_a, minor_b = major_b, major_a, minor_b, minor_a
    run = major_b - major_a
    slope = min(max((minor_b - minor_a) / run, -1.0), 1.0) if run > 1e-9 else 0.0
    first = max(math.ceil(major_a - 0.5), 0)
    last = min(math.floor(major_b + 0.5), shape[axis] - 1)
    if last < first:
        return None
    half_minor = half_width_px * math.sqrt(1.0 + slope * slope)
    width = 2 * math.ceil(half_minor) + 1
    centre = minor_a + slope * (first - major_a)
    slope_fp = round(slope * FIXED_POINT)
    minor0_fp = round((centre - 0.5 * (width - 1) + 0.5) * FIXED_POINT)
    edges = [(minor0_fp + k * slope_fp) >> 16 for k in (0, last - first)]
    if max(edges) + width <= 0 or min(edges) >= shape[minor_axis]:
        return None
    return StripGeometry(axis=axis, major0=first, n=last - first + 1, width=width, minor0_fp=minor0_fp, slope_fp=slope_fp)


def plan_strips(
    detection: Detection,
    shape: tuple[int, int],
    *,
    half_width_px: float,
    margins_px: tuple[float, float],
    pixels_per_strip: int,
    margin_half_width_px: float | None = None,
) -> tuple[StripGeometry, ...]:
    """Strips that cover a detection with margins beyond both ends, clipped to the frame; together they follow its arc.

    margin_half_width_px : of the margins, where it is another.
    """
    length = max(detection.length_px, 1e-3)
    edges = (StreakFlag.EDGE0, StreakFlag.EDGE1)
    margins = [0.0 if detection.flags & edge else px for edge, px in zip(edges, margins_px, strict=True)]
    if length < 1.0:
        return _square(detection, shape, half_width_px, max(*margins_px, half_width_px), pixels_per_strip)
    low, high = -margins[0] / length, 1.0 + margins[1] / length
    # within a piece the arc departs from the chord by 1/n^2 of the whole; what remains is allowed for in the width
    pieces_for_arc = max(1, math.ceil(math.sqrt(abs(detection.sagitta_px) / STRAIGHT_WITHIN_PX)))
    half_width_px += abs(detection.sagitta_px) / pieces_for_arc**2
    if margin_half_width_px is None:
        parts = [(low, high, half_width_px, pieces_for_arc)]
    else:
        parts = [
            (low, 0.0, margin_half_width_px, 1),
            (0.0, 1.0, half_width_px, pieces_for_arc),
            (1.0, high, margin_half_width_px, 1),
        ]
    strips = [strip for part in parts for strip in _strips_between(detection, shape, *part, pixels_per_strip)]
    return _without_repeats(strips)


def _strips_between(
    detection: Detection,
    shape: tuple[int, int],
    low: float,
    high: float,
    half_width_px: float,
    least_pieces: int,
    pixels_per_strip: int,
) -> Iterator[StripGeometry]:
    """Strips along a part of a detection, between fractions of its chord. Neighbours share a line."""
    drow, dcol = abs(detection.row1 - detection.row0), abs(detection.col1 - detection.col0)
    longer = max(drow, dcol)
    lines = (high - low) * longer + 1.0
    width = 2.0 * math.ceil(half_width_px * max(detection.length_px, 1e-3) / longer) + 1.0
    pieces = max(least_pieces, math.ceil(lines * width / pixels_per_strip))
    nodes = arc_points(detection, np.linspace(low, high, pieces + 1))
    for a, b in pairwise(nodes):
        strip = piece_geometry(a, b, half_width_px, 0 if drow >= dcol else 1, shape)
        if strip is not None:
            yield strip


def _without_repeats(strips: list[StripGeometry]) -> tuple[StripGeometry, ...]:
    """Drop lines that the previous strip already contains, so that no line is sent twice: neighbouring pieces share a node."""
    out: list[StripGeometry] = []
    for strip in strips:
        if out:
            before = out[-1]
            first, last = strip.major0, strip.major0 + strip.n - 1
            if strip.major0 >= before.major0:
                first = max(first, before.major0 + before.n)
            else:
                last = min(last, before.major0 - 1)
            if last < first:
                continue
            strip = StripGeometry(
                axis=strip.axis,
                major0=first,
                n=last - first + 1,
                width=strip.width,
                minor0_fp=strip.minor0_fp + (first - strip.major0) * strip.slope_fp,
                slope_fp=strip.slope_fp,
            )
        out.append(strip)
    return tuple(out)


def _square(
    detection: Detection, shape: tuple[int, int], half_width_px: float, half_height_px: float, pixels_per_strip: int
) -> tuple[StripGeometry, ...]:
    """Strips of a point-like detection: a square, cut into bands when it does not fit into one packet."""
    row, col = 0.5 * (detection.row0 + detection.row1), 0.5 * (detection.col0 + detection.col1)
    half = max(half_width_px, half_height_px)
    bands = max(1, math.ceil((2.0 * half + 1.0) ** 2 / pixels_per_strip))
    rows = np.linspace(row - half, row + half, bands + 1)
    strips = [piece_geometry(np.array((a, col)), np.array((b, col)), half, 0, shape) for a, b in pairwise(rows)]
    return _without_repeats([strip for strip in strips if strip is not None])


@njit(cache=True)
def gather(
    pixels: NDArray[np.uint16] | NDArray[np.int32],
    dark: Codes,
    axis: int,
    major0: int,
    minor0_fp: int,
    slope_fp: int,
    level: int,
    out: NDArray[np.int32],
) -> None:
    """``pixels - dark`` of a strip into out (n, width); `level` outside the frame."""
    rows, cols = pixels.shape
    for i in range(out.shape[0]):
        first = (minor0_fp + i * slope_fp) >> 16
        for j in range(out.shape[1]):
            row, col = (major0 + i, first + j) if axis == 0 else (first + j, major0 + i)
            if 0 <= row < rows and 0 <= col < cols:
                out[i, j] = np.int32(pixels[row, col]) - np.int32(whole_at(dark, row, col))
            else:
                out[i, j] = level


def cut_strip(geometry: StripGeometry, pixels: NDArray[np.uint16] | NDArray[np.int32], dark: DarkMap, level: int) -> Strip:
    """The pixels of a strip."""
    values = np.empty((geometry.n, geometry.width), dtype=np.int32)
    gather(pixels, dark.codes, geometry.axis, geometry.major0, geometry.minor0_fp, geometry.slope_fp, level, values)
    return strip_of(geometry, level, values)


def strip_of(geometry: StripGeometry, level: int, values: NDArray[np.int32]) -> Strip:
    """The contract's record of a strip with these pixel values (n, width), ADU above its level."""
    return Strip(
        axis=geometry.axis,
        major0=geometry.major0,
        minor0_fp=geometry.minor0_fp,
        slope_fp=geometry.slope_fp,
        level_adu=level,
        values_adu=values,
    )


def sky_at(background: BackgroundModel, geometry: StripGeometry) -> tuple[float, float]:
    """Level and noise, ADU, of the mesh tile under the middle of a strip."""
    major = geometry.major0 + geometry.n // 2
    minor = ((geometry.minor0_fp + (geometry.n // 2) * geometry.slope_fp) >> 16) + geometry.width // 2
    row, col = (major, minor) if geometry.axis == 0 else (minor, major)
    i = min(max(row // background.tile_px, 0), background.level_adu.shape[0] - 1)
    j = min(max(col // background.tile_px, 0), background.level_adu.shape[1] - 1)
    return float(background.level_adu[i, j]), float(background.sigma_adu[i, j])


def split(geometry: StripGeometry) -> tuple[StripGeometry, StripGeometry]:
    """Two halves of a strip whose block did not fit into a packet: by lines, or by width when there is one line."""
    if geometry.n > 1:
        half = geometry.n // 2
        return (
            StripGeometry(
                axis=geometry.axis,
                major0=geometry.major0,
                n=half,
                width=geometry.width,
                minor0_fp=geometry.minor0_fp,
                slope_fp=geometry.slope_fp,
            ),
            StripGeometry(
                axis=geometry.axis,
                major0=geometry.major0 + half,
                n=geometry.n - half,
                width=geometry.width,
                minor0_fp=geometry.minor0_fp + half * geometry.slope_fp,
                slope_fp=geometry.slope_fp,
            ),
        )
    half = geometry.width // 2
    return (
        StripGeometry(axis=geometry.axis, major0=geometry.major0, n=1, width=half, minor0_fp=geometry.minor0_fp, slope_fp=0),
        StripGeometry(
            axis=geometry.axis,
            major0=geometry.major0,
            n=1,
            width=geometry.width - half,
            minor0_fp=geometry.minor0_fp + half * FIXED_POINT,
            slope_fp=0,
        ),
    )
