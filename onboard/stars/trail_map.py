"""Where trails shine, and which of the peaks lie on no brighter one's trail."""

import math
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.stars.fits import SATURATED
from onboard.stars.trail_fits import ResidualImage

BRIGHT_SIGMA: Final = 3.0  # S/N of its pixels, below which noise hides what the ends have. Chosen, not measured
DARK_END: Final = 0.25  # the end of a trail has half of its light in its last pixel, noise aside. Chosen, not measured
LEAST_SHAPE_PX: Final = 12
"""The ends of a trail exceed the share `DARK_END` of its median. Ends are judged where the median exceeds `BRIGHT_SIGMA` and the
path has `LEAST_SHAPE_PX` pixels."""

POINT_SIGMA: Final = 5.0  # noise makes one pixel in 3.5 million so bright
POINT_PX: Final = 3  # 3.4 sigma of a PSF of 0.87 px, beyond which a point has no light
LEAST_BESIDE: Final = 2.0
"""A path with a pixel above `POINT_SIGMA` shows a point when the others, but for those within `POINT_PX` of it, add up to less
than `LEAST_BESIDE` sigma."""

CORE: Final = 1  # bit of its own width
AROUND: Final = 2  # bit of its light
ABOVE_SIDES: Final = 1.5
"""Bits of a map of trails: within the trail's own width, and as far as its light matters. There another trail must be
`ABOVE_SIDES` times as bright as what lies beside it."""

FULL_SIGMA: Final = 1e4
"""Saturated pixels, over the noise."""


@njit(cache=True)
def paint_trail(out: NDArray[np.uint8], row: float, col: float, half_row: float, half_col: float, reach: float, bit: int) -> None:
    """Set a bit of `out` within `reach` px of a segment from centre and half vector, in place."""
    rows, cols = out.shape
    half = math.hypot(half_row, half_col)
    unit_row, unit_col = (half_row / half, half_col / half) if half > 1e-9 else (1.0, 0.0)
    reach_row, reach_col = abs(half_row) + reach, abs(half_col) + reach
    for i in range(max(0, math.ceil(row - reach_row)), min(rows - 1, math.floor(row + reach_row)) + 1):
        for j in range(max(0, math.ceil(col - reach_col)), min(cols - 1, math.floor(col + reach_col)) + 1):
            along = (i - row) * unit_row + (j - col) * unit_col
            across = (i - row) * unit_col - (j - col) * unit_row
            beyond = max(0.0, abs(along) - half)
            if beyond * beyond + across * across <= reach * reach:
                out[i, j] |= np.uint8(bit)


@njit(cache=True)
def _along(frame: ResidualImage, row: int, col: int, half_row: float, half_col: float) -> NDArray[np.float64]:
    """Pixels along a trail about a centre, over the noise; zeros beyond the frame."""
    rows, cols = frame.residual.shape
    values = np.zeros(2 * int(math.hypot(half_row, half_col)) + 1)
    for k in range(values.size):
        u = 2.0 * k / max(values.size - 1, 1) - 1.0
        i, j = round(row + u * half_row), round(col + u * half_col)
        if 0 <= i < rows and 0 <= j < cols:
            values[k] = frame.residual[i, j] / frame.noise_adu if frame.mask[i, j] & SATURATED == 0 else FULL_SIGMA
    return values


@njit(cache=True)
def keep_brightest(
    frame: ResidualImage,
    peaks: NDArray[np.float32],
    half: NDArray[np.float64],
    psf_sigma_px: float,
    painted: NDArray[np.uint8],
    keep: NDArray[np.bool_],
) -> None:
    """Which of the peaks (n, 3), brightest first, lie on no brighter one's trail; their S/N becomes that of the unclipped image.

    In the light around a brighter one a trail of its own is brighter than what lies on both sides of it, and has both its ends.
    half : (n, 2) half vectors. painted : zeros, becomes CORE and AROUND on the trails.
    """
    for n in range(peaks.shape[0]):
        row, col = int(peaks[n, 0]), int(peaks[n, 1])
        keep[n] = painted[row, col] & CORE == 0
        if not keep[n]:
            continue
        length = 2.0 * math.hypot(half[n, 0], half[n, 1])
        values = _along(frame, row, col, half[n, 0], half[n, 1])
        peak = float(np.median(values))
        quarter = max(1, values.size // 4)
        darkest = min(values[:quarter].mean(), values[-quarter:].mean())
        if painted[row, col] != 0:
            beside = 0.0
            for side in (-1.0, 1.0):
                across = side * (3.0 * psf_sigma_px + 1.0) / max(0.5 * length, 1e-6)
                i, j = round(row + across * half[n, 1]), round(col - across * half[n, 0])
                beside = max(beside, float(np.median(_along(frame, i, j, half[n, 0], half[n, 1]))))
            if peak < BRIGHT_SIGMA or peak < ABOVE_SIDES * beside or darkest < DARK_END * peak:
                keep[n] = False
                continue
        if values.size >= LEAST_SHAPE_PX and peak > BRIGHT_SIGMA and darkest < DARK_END * peak:
            keep[n] = False
            continue
        top = int(np.argmax(values))
        if values.size >= LEAST_SHAPE_PX and POINT_SIGMA < values[top] < FULL_SIGMA:
            others = np.concatenate((values[: max(0, top - POINT_PX)], values[top + POINT_PX + 1 :]))
            if others.sum() < LEAST_BESIDE * math.sqrt(max(1, others.size)):
                keep[n] = False
                continue
        peaks[n, 2] = max(peaks[n, 2], 1.331 * peak * math.sqrt(length * psf_sigma_px))
        reach = trail_reach_px(peak, psf_sigma_px)
        paint_trail(painted, float(row), float(col), half[n, 0], half[n, 1], reach, AROUND)
        paint_trail(painted, float(row), float(col), half[n, 0], half[n, 1], 2.0 * psf_sigma_px + 1.0, CORE)


@njit(cache=True)
def paint_trails(
    out: NDArray[np.uint8],
    row: NDArray[np.float64],
    col: NDArray[np.float64],
    half: NDArray[np.float64],
    snr: NDArray[np.float32],
    psf_sigma_px: float,
    bit: int,
) -> None:
    """Set a bit of `out` where trails (n,) of half vectors (n, 2) shine, in place."""
    for n in range(row.size):
        length = max(2.0 * math.hypot(half[n, 0], half[n, 1]), 3.5 * psf_sigma_px)
        peak = snr[n] / (1.331 * math.sqrt(length * psf_sigma_px))
        paint_trail(out, row[n], col[n], half[n, 0], half[n, 1], trail_reach_px(peak, psf_sigma_px), bit)


@njit(cache=True)
def trail_reach_px(peak_sigma: float, psf_sigma_px: float) -> float:
    """How far from a trail's line its light matters; peak_sigma : brightest pixel across, over the noise."""
    return 3.0 * psf_sigma_px + 1.0 + 1.5 * math.log2(max(1.0, peak_sigma))
