"""Movers that look like stars: entries of the star list, up to about ten pixels long, that were not there a frame earlier."""

import math
from typing import Final

import numba as nb
import numpy as np
from numpy.typing import NDArray

ANGLES: Final = 12  # directions of a first look, 15 deg apart: ends of 12 px lie 0.8 px off at most, within the PSF

LONGEST_FIT_PX: Final = 90.0
"""Trails fitted with blurred ends grow no longer: half as long again as the longest that are handed in."""

SHARP_SIGMA: Final = 5.0  # chance passes one pixel in 3.5 million of those that are looked at, 25 for each entry
SHARP_SHARE: Final = 0.05
"""A pixel is sharper than light by so many sigma, and this share of the brightest pixel near it for the PSF's own errors."""

LOOK_WORK: Final = 50  # operations of a look at a position ...
ROUGH_WORK: Final = 4_000
"""Operations of a look at a position, and of the best of `ANGLES` directions of sums through it."""

TRIALS: Final = 90  # trial templates of a usual fit
TEMPLATE_WORK: Final = 35
"""Trial templates of a usual fit, and operations of each pixel of one: two error functions and an exponential."""

MOST_MOVES: Final = 60
"""Rounds of the pattern search: 4 px away from its start it has found something else."""

ERF_STEPS: Final = 512
"""Values of the error function to the unit, up to 4: straight lines between them err by 0.97 / 8 / 512^2 at most."""
ERF_TABLE: Final = np.array([math.erf(k / ERF_STEPS) for k in range(4 * ERF_STEPS + 1)])

PEAK_FRACTION: Final = 0.57  # mean over a star's places within a pixel, 0.47 at a corner to 0.63 at the centre ...
PEAK_WIDTH_PX: Final = 0.849
"""Brightest pixel of a star over its matched-filter S/N, in sigma of a pixel, for a PSF of 2 px FWHM, `PEAK_WIDTH_PX`, on square
pixels."""


def peak_fraction(psf_sigma_px: float) -> float:
    """The same for another width: it goes as the share of the light in the middle pixel times the width with the pixel."""

    def relative(width_px: float) -> float:
        return math.erf(0.5 / (math.sqrt(2.0) * width_px)) ** 2 * math.sqrt(width_px**2 + 1.0 / 12.0)

    return PEAK_FRACTION * relative(psf_sigma_px) / relative(PEAK_WIDTH_PX)


def object_noise(psf_sigma_px: float, sigma_e: float) -> float:
    """nu in the variance 1 + nu S of a point source's matched-filter S/N S: its own Poisson noise beside the sky's.

    For a Gaussian t of unit sum the variance of sum(t x) is sigma^2 sum(t^2) + F sum(t^3), with sum(t^2) = 1/(4 pi s^2),
    sum(t^3) = 1/(12 pi^2 s^4) and F = 2 sqrt(pi) s sigma S: nu = 2 / (3 sqrt(pi) s sigma). sigma_e : noise of a pixel, e-.
    """
    return 2.0 / (3.0 * math.sqrt(math.pi) * psf_sigma_px * sigma_e) if sigma_e > 0.0 else 0.0


def rise_sigma(snr: float, before: float, psf_sigma_px: float, sigma_e: float) -> float:
    """Difference of a place's S/N now and before in its standard deviation, were it a star of constant light; NaN as before."""
    mean = max(0.0, 0.5 * (snr + before))
    return (snr - before) / math.sqrt(2.0 * (1.0 + object_noise(psf_sigma_px, sigma_e) * mean))


@nb.njit(cache=True)
def sharper_than_psf(
    residual_adu: NDArray[np.float32],
    sigma_adu: NDArray[np.float32],
    tile_px: int,
    row: NDArray[np.float64],
    col: NDArray[np.float64],
    snr: NDArray[np.float32],
    star_fraction: float,
) -> NDArray[np.bool_]:
    """Entries (n,) whose light sits in one pixel: particle hits and hot pixels, 3 sigma beyond what the PSF allows.

    star_fraction : `peak_fraction` of the PSF.
    """
    rows, cols = residual_adu.shape
    out = np.zeros(row.shape[0], np.bool_)
    for k in range(row.shape[0]):
        i0, j0 = math.floor(row[k] + 0.5), math.floor(col[k] + 0.5)
        if i0 < 0 or j0 < 0 or i0 >= rows or j0 >= cols:
            continue
        sigma = sigma_adu[min(i0 // tile_px, sigma_adu.shape[0] - 1), min(j0 // tile_px, sigma_adu.shape[1] - 1)]
        peak = 0.0
        for i in range(max(0, i0 - 1), min(rows, i0 + 2)):
            for j in range(max(0, j0 - 1), min(cols, j0 + 2)):
                peak = max(peak, residual_adu[i, j])
        if sigma > 0.0:
            peak /= sigma
            out[k] = peak - star_fraction * snr[k] > 2.5 and peak > max(0.8, star_fraction) * snr[k]
    return out


@nb.njit(cache=True)
def holds_sharp_pixel(
    residual_adu: NDArray[np.float32],
    mask: NDArray[np.uint8],
    sigma_adu: NDArray[np.float32],
    tile_px: int,
    row: NDArray[np.float64],
    col: NDArray[np.float64],
    psf_sigma_px: float,
) -> NDArray[np.bool_]:
    """Which windows of 5 x 5 px about places (n,) hold a pixel that stands out more than any light through the PSF does.

    No light exceeds the mean of its four neighbours by more than a point at a pixel's middle: exp(0.5 / s^2).
    """
    rows, cols = residual_adu.shape
    most = math.exp(0.5 / (psf_sigma_px**2 + 1.0 / 12.0))
    out = np.zeros(row.shape[0], np.bool_)
    for n in range(row.shape[0]):
        i0, j0 = math.floor(row[n] + 0.5), math.floor(col[n] + 0.5)
        if i0 < 3 or j0 < 3 or i0 >= rows - 3 or j0 >= cols - 3:
            continue
        sigma = sigma_adu[min(i0 // tile_px, sigma_adu.shape[0] - 1), min(j0 // tile_px, sigma_adu.shape[1] - 1)]
        peak = 0.0
        for i in range(i0 - 2, i0 + 3):
            for j in range(j0 - 2, j0 + 3):
                peak = max(peak, residual_adu[i, j])
        allowed = SHARP_SIGMA * sigma * math.sqrt(1.0 + 0.25 * most * most) + SHARP_SHARE * peak
        for i in range(i0 - 2, i0 + 3):
            for j in range(j0 - 2, j0 + 3):
                along = residual_adu[i, j - 1] + residual_adu[i, j + 1]
                beside = max(0.25 * (residual_adu[i - 1, j] + residual_adu[i + 1, j] + along), 0.0)
                if mask[i, j] == 0 and residual_adu[i, j] - most * beside > allowed:
                    out[n] = True
    return out


@nb.njit(cache=True)
def _erf(x: float) -> float:
    """The error function to 1e-6, between values `ERF_STEPS` to the unit."""
    at = abs(x) * ERF_STEPS
    k = int(at)
    if k >= ERF_TABLE.size - 1:
        return math.copysign(1.0, x)
    return math.copysign(ERF_TABLE[k] + (at - k) * (ERF_TABLE[k + 1] - ERF_TABLE[k]), x)


@nb.njit(cache=True)
def _short_snr(
    image: NDArray[np.int8],
    blocked: NDArray[np.uint8],
    ignored: int,
    row: float,
    col: float,
    d_row: float,
    d_col: float,
    length: float,
    psf_sigma_px: float,
) -> float:
    """Matched-filter S/N of a short trail centred at (row, col) along the unit vector (d_row, d_col), ends blurred by the PSF."""
    rows, cols = image.shape
    reach = math.ceil(0.5 * length + 2.5 * psf_sigma_px)
    i0, j0 = math.floor(row + 0.5), math.floor(col + 0.5)
    root = 1.0 / (math.sqrt(2.0) * psf_sigma_px)
    signal = power = full = 0.0
    most_u, most_v = 0.5 * length + 2.6 * psf_sigma_px, 2.6 * psf_sigma_px
    for i in range(i0 - reach, i0 + reach + 1):
        # of each row only what lies near the trail's line: a pixel more on both sides, for sums are rounded
        first, last = j0 - reach, j0 + reach
        if abs(d_row) > 1e-3:
            middle, half = col + (i - row) * d_col / d_row, most_v / abs(d_row)
            first, last = max(first, math.floor(middle - half)), min(last, math.ceil(middle + half))
        if abs(d_col) > 1e-3:
            middle, half = col - (i - row) * d_row / d_col, most_u / abs(d_col)
            first, last = max(first, math.floor(middle - half)), min(last, math.ceil(middle + half))
        # exp(-x^2) in equal steps of x: each value is the one before times a ratio, which itself changes by a constant factor
        v0, dv = ((i - row) * d_col - (first - col) * d_row) * root, -d_row * root
        across, ratio, change = math.exp(-v0 * v0), math.exp(-dv * (2.0 * v0 + dv)), math.exp(-2.0 * dv * dv)
        for j in range(first, last + 1):
            u = (i - row) * d_row + (j - col) * d_col
            v = (i - row) * d_col - (j - col) * d_row
            here = across
            across, ratio = across * ratio, ratio * change
            if abs(v) > most_v or abs(u) > most_u:
                continue
            if length > 0.0:
                t = here * (_erf((u + 0.5 * length) * root) - _erf((u - 0.5 * length) * root))
            else:
                t = here * math.exp(-((u * root) ** 2))
            full += t * t
            if 0 <= i < rows and 0 <= j < cols and (blocked[i, j] & ~ignored) == 0:
                signal += t * image[i, j]
                power += t * t
    return signal / (16.0 * math.sqrt(power)) if power > 0.6 * full else 0.0


@nb.njit(cache=True)
def fit_work(length_px: float, psf_sigma_px: float) -> int:
    """Operations of `fit_short_trail` on a trail of that length."""
    return int(TRIALS * TEMPLATE_WORK * (length_px + 5.2 * psf_sigma_px) * 5.2 * psf_sigma_px)


@nb.njit(cache=True)
def rough_short_trail(
    smooth: NDArray[np.int8], row: float, col: float, psf_sigma_px: float
) -> tuple[float, float, float, float, float]:
    """(S/N, centre row, centre col, angle rad, length px) of the best trail of 0 to 12 px through a position.

    From sums of the smoothed image along whole-pixel steps: a sum of n samples has variance n 2 sqrt(pi) s for n > 3 s.
    """
    rows, cols = smooth.shape
    i0, j0 = math.floor(row + 0.5), math.floor(col + 0.5)
    best_snr, best_row, best_col, best_angle, best_length = smooth[i0, j0] / 16.0, row, col, 0.0, 0.0
    half = 12
    samples = np.zeros(2 * half + 1)
    for k in range(ANGLES):
        angle = math.pi * k / ANGLES
        d_row, d_col = math.sin(angle), math.cos(angle)
        for t in range(-half, half + 1):
            i, j = math.floor(row + t * d_row + 0.5), math.floor(col + t * d_col + 0.5)
            samples[t + half] = smooth[i, j] / 16.0 if 0 <= i < rows and 0 <= j < cols else 0.0
        for n in (4, 7, 10, 13):
            norm = 1.0 / math.sqrt(n * 2.0 * math.sqrt(math.pi) * psf_sigma_px)
            for first in range(half - n + 1, half + 1):
                total = 0.0
                for t in range(first, first + n):
                    total += samples[t]
                if total * norm > best_snr:
                    middle = first + 0.5 * (n - 1) - half
                    best_snr, best_angle, best_length = total * norm, angle, n - 1.0
                    best_row, best_col = row + middle * d_row, col + middle * d_col
    return best_snr, best_row, best_col, best_angle, best_length


@nb.njit(cache=True)
def fit_short_trail(
    image: NDArray[np.int8],
    blocked: NDArray[np.uint8],
    ignored: int,
    rough: tuple[float, float, float, float, float],
    psf_sigma_px: float,
) -> tuple[float, float, float, float, float]:
    """Exact (S/N, centre row, centre col, angle rad, length px) by a pattern search from a rough trail.

    Pixels are usable where `blocked` holds no bit but `ignored`.
    """
    _, row, col, angle, length = rough
    snr = _short_snr(image, blocked, ignored, row, col, math.sin(angle), math.cos(angle), length, psf_sigma_px)
    point = _short_snr(image, blocked, ignored, row, col, 0.0, 1.0, 0.0, psf_sigma_px)
    # a trail has two parameters more than a point; it must earn them
    if point + 0.3 > snr:
        snr, length = point, 0.0
    step = 1.0
    for _ in range(MOST_MOVES):
        if step <= 0.2:
            break
        improved = False
        for parameter in range(4):
            if length == 0.0 and parameter == 2:
                continue
            for sign in (-1.0, 1.0):
                r = row + (sign * step if parameter == 0 else 0.0)
                c = col + (sign * step if parameter == 1 else 0.0)
                a = angle + (sign * step * 0.2 if parameter == 2 else 0.0)
                n = min(max(0.0, length + (sign * 2.0 * step if parameter == 3 else 0.0)), LONGEST_FIT_PX)
                trial = _short_snr(image, blocked, ignored, r, c, math.sin(a), math.cos(a), n, psf_sigma_px)
                if trial > snr + (0.05 if parameter == 3 and sign > 0.0 else 1e-3):
                    snr, row, col, angle, length, improved = trial, r, c, a, n, True
        if not improved:
            step *= 0.5
    return snr, row, col, angle, length


@nb.njit(cache=True)
def short_trails(
    image: NDArray[np.int8],
    smooth: NDArray[np.int8],
    blocked: NDArray[np.uint8],
    row: NDArray[np.float64],
    col: NDArray[np.float64],
    psf_sigma_px: float,
    n_sigma: float,
    found_bit: int,
    max_found: int,
    most_work: int,
) -> tuple[NDArray[np.float64], int, int]:
    """Short trails at positions (n,) in the given order: (m, 6) entry, S/N, row, col, angle rad, length px.

    Also the operations done, and how many positions were left when `most_work` of them were. Each one found is taken out of the
    image (in place), so that other entries on the same trail find nothing.
    """
    rows, cols = image.shape
    found = np.empty((max_found, 6))
    n_found = work = left = 0
    for k in range(row.shape[0]):
        if n_found == max_found or work > most_work:
            left = row.shape[0] - k
            break
        work += LOOK_WORK
        i0, j0 = math.floor(row[k] + 0.5), math.floor(col[k] + 0.5)
        if i0 < 0 or j0 < 0 or i0 >= rows or j0 >= cols or blocked[i0, j0] != 0:
            continue
        rough = rough_short_trail(smooth, row[k], col[k], psf_sigma_px)
        work += ROUGH_WORK
        if rough[0] < n_sigma - 1.2:
            continue
        work += fit_work(rough[4], psf_sigma_px)
        snr, r, c, angle, length = fit_short_trail(image, blocked, 0, rough, psf_sigma_px)
        if snr < n_sigma:
            continue
        found[n_found, 0], found[n_found, 1] = k, snr
        found[n_found, 2], found[n_found, 3], found[n_found, 4], found[n_found, 5] = r, c, angle, length
        n_found += 1
        radius = 0.5 * length + 4.0 * psf_sigma_px
        for i in range(max(0, int(r - radius)), min(rows, int(r + radius) + 2)):
            for j in range(max(0, int(c - radius)), min(cols, int(c + radius) + 2)):
                u = (i - r) * math.sin(angle) + (j - c) * math.cos(angle)
                v = (i - r) * math.cos(angle) - (j - c) * math.sin(angle)
                if abs(v) <= 4.0 * psf_sigma_px and abs(u) <= radius:
                    blocked[i, j] |= found_bit
    return found[:n_found], work, left
