"""Maximum-likelihood flux and position of a star at every peak, every pixel weighted by its own noise.

The weights hold the sky's and the star's own photon noise, which is what the Cramer-Rao bound asks for (King 1983,
PASP 95, 163). The PSF is a Gaussian with the covariance that `onboard.star_shape` measured at that place.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.prefetch import ask_for
from sboc_e2e.icd.flags import MaskBit, StarFlag

SATURATED = int(MaskBit.SATURATED)
EDGE, BLENDED, DEFECT = int(StarFlag.EDGE), int(StarFlag.BLENDED), int(StarFlag.DEFECT)
SATURATED_STAR = int(StarFlag.SATURATED)
BRIGHT_PEAK_SIGMA = 12.0
"""Stars with a brighter central pixel are fitted in the larger window."""

STARS_AHEAD = 4  # whose memory is asked for: some 3 us before it is read

WHOLE_VECTORS = 32
"""Windows are padded to a multiple of this many pixels: four vectors of eight, as compilers unroll them."""

SETTLED_PX2 = 1e-4  # (0.01 px)^2; a star of S/N 5 is known to 0.2 px, one of S/N 100 to 0.01 px
SETTLED_VARIANCE = 0.03
"""A step shorter than 0.01 px, or than 0.17 of the error of the position, is the last one: Gauss-Newton squares it."""


# sums over a window, all finite: order is free; Python's check of each divisor would keep the loop out of vector instructions
@njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract", "nsz", "arcp"})
def _normal_equations(
    data: NDArray[np.float32],
    usable: NDArray[np.float32],
    psf: NDArray[np.float32],
    drow: NDArray[np.float32],
    dcol: NDArray[np.float32],
    star: tuple[np.float32, np.float32, np.float32],
    noise: tuple[np.float32, np.float32],
    shape: tuple[np.float32, np.float32, np.float32, np.float32],
) -> tuple[np.float32, ...]:
    """Gradient (flux, row, col), information matrix (ff, fr, fc, rr, rc, cc) and sum of squared PSF over the window.

    star : flux, row, col. noise : variance of the sky, ADU per electron. shape : inverse covariance (rr, rc, cc) and central
    value of the PSF, which is left in psf. Single precision and no call: eight pixels in one instruction.
    """
    flux, row, col = star
    variance, per_electron = noise
    inv_rr, inv_rc, inv_cc, central = shape
    one, half, third = np.float32(1.0), np.float32(0.5), np.float32(1.0 / 3.0)
    sixty_fourth, least, zero = np.float32(-0.5 / 64.0), np.float32(-0.6), np.float32(0.0)
    gf, gr, gc, ff, fr, fc, rr, rc, cc, squares = zero, zero, zero, zero, zero, zero, zero, zero, zero, zero
    for q in range(data.size):
        u, v = drow[q] - row, dcol[q] - col
        across, along = inv_rr * u + inv_rc * v, inv_cc * v + inv_rc * u
        # exp(x) = exp(x / 64)^64 with three terms of its series: good to x^4 1.6e-7 of itself, 1e-6 of the centre
        x = max(sixty_fourth * (u * across + v * along), least)
        t = one + x * (one + half * x * (one + third * x))
        t *= t
        t *= t
        t *= t
        t *= t
        t *= t
        t *= t
        t *= central
        psf[q] = t
        model = flux * t
        weight = usable[q] / (variance + model * per_electron)
        slope_row, slope_col = model * across, model * along
        misfit = (data[q] - model) * weight
        gf += misfit * t
        gr += misfit * slope_row
        gc += misfit * slope_col
        weighted = weight * t
        ff += weighted * t
        fr += weighted * slope_row
        fc += weighted * slope_col
        rr += weight * slope_row * slope_row
        rc += weight * slope_row * slope_col
        cc += weight * slope_col * slope_col
        squares += usable[q] * t * t
    return gf, gr, gc, ff, fr, fc, rr, rc, cc, squares


@njit(cache=True)
def _take_window(
    residual: NDArray[np.float32],
    mask: NDArray[np.uint8],
    row0: int,
    col0: int,
    radius: int,
    data: NDArray[np.float32],
    usable: NDArray[np.float32],
) -> int:
    """Pixels around a peak; unusable ones get weight 0. Returns `StarFlag` bits EDGE, DEFECT and SATURATED."""
    rows, cols = residual.shape
    side, flag = 2 * radius + 1, 0
    if radius <= row0 < rows - radius and radius <= col0 < cols - radius:
        for i in range(side):
            for j in range(side):
                q, r, c = i * side + j, row0 - radius + i, col0 - radius + j
                data[q] = residual[r, c]
                usable[q] = 1.0
                if mask[r, c] != 0:
                    usable[q] = 0.0
                    flag |= SATURATED_STAR if mask[r, c] & SATURATED else DEFECT
        return flag
    for i in range(side):
        for j in range(side):
            q, r, c = i * side + j, row0 - radius + i, col0 - radius + j
            inside = 0 <= r < rows and 0 <= c < cols
            data[q] = residual[r, c] if inside else 0.0
            usable[q] = 1.0 if inside and mask[r, c] == 0 else 0.0
            if inside and mask[r, c] != 0:
                flag |= SATURATED_STAR if mask[r, c] & SATURATED else DEFECT
    return flag | EDGE


@njit(cache=True)
def fit_stars(
    residual: NDArray[np.float32],
    mask: NDArray[np.uint8],
    sigma_nodes: NDArray[np.float32],
    tile_px: int,
    peaks: NDArray[np.float32],
    covariances: NDArray[np.float64],
    radii: tuple[int, int],
    gain_e_adu: float,
    out: NDArray[np.float64],
    flags: NDArray[np.uint8],
) -> None:
    """Gauss-Newton maximum likelihood of flux and position at every peak.

    covariances : (n, 3) covariance (rr, rc, cc) of the Gaussian PSF at each peak, px^2. radii : half sides of the window of
    faint (sky noise rules, the information is in the core) and of bright stars. out : (n, 6) row, col, flux ADU, S/N,
    contrast of the central pixel over the PSF's, relative misfit beyond noise; flags : `StarFlag` bits.
    """
    offsets = (_window_offsets(radii[0]), _window_offsets(radii[1]))
    largest = max(offsets[0][0].size, offsets[1][0].size)
    data, usable, psf = np.zeros(largest, np.float32), np.zeros(largest, np.float32), np.zeros(largest, np.float32)
    per_electron = np.float32(1.0 / gain_e_adu)
    for n in range(peaks.shape[0]):
        later = min(n + STARS_AHEAD, peaks.shape[0] - 1)
        for i in range(int(peaks[later, 0]) - radii[0], int(peaks[later, 0]) + radii[0] + 1):
            ask_for(residual, (i, int(peaks[later, 1])))
            ask_for(mask, (i, int(peaks[later, 1])))
        row0, col0 = int(peaks[n, 0]), int(peaks[n, 1])
        sigma = float(sigma_nodes[min(row0 // tile_px, sigma_nodes.shape[0] - 1), min(col0 // tile_px, sigma_nodes.shape[1] - 1)])
        crr, crc, ccc = covariances[n, 0], covariances[n, 1], covariances[n, 2]
        cdet = crr * ccc - crc * crc
        peak_psf = 1.0 / (2.0 * math.pi * math.sqrt(cdet))
        shape = (np.float32(ccc / cdet), np.float32(-crc / cdet), np.float32(crr / cdet), np.float32(peak_psf))
        noise = (np.float32(sigma * sigma), per_electron)
        bright = residual[row0, col0] > BRIGHT_PEAK_SIGMA * sigma
        radius = radii[1] if bright else radii[0]
        drow, dcol = offsets[1] if bright else offsets[0]
        size, used = drow.size, (2 * radius + 1) ** 2
        usable[used:size] = np.float32(0.0)
        flag = _take_window(residual, mask, row0, col0, radius, data, usable)
        row, col = float(peaks[n, 3]), float(peaks[n, 4])
        flux = 1.7 * max(float(peaks[n, 2]), 0.1 * sigma) / peak_psf
        squares = 0.0
        for _ in range(6):
            star = (np.float32(flux), np.float32(row), np.float32(col))
            sums = _normal_equations(data[:size], usable[:size], psf[:size], drow, dcol, star, noise, shape)
            gf, gr, gc = float(sums[0]), float(sums[1]), float(sums[2])
            ff, fr, fc = float(sums[3]), float(sums[4]), float(sums[5])
            rr, rc, cc, squares = float(sums[6]), float(sums[7]), float(sums[8]), float(sums[9])
            minor_f, minor_r, minor_c = rr * cc - rc * rc, ff * cc - fc * fc, ff * rr - fr * fr
            det = ff * minor_f - fr * (fr * cc - rc * fc) + fc * (fr * rc - rr * fc)
            if det <= 1e-9 * ff * rr * cc:
                flag |= BLENDED
                break
            mixed_fr, mixed_fc, mixed_rc = fc * rc - fr * cc, fr * rc - fc * rr, fr * fc - ff * rc
            step_flux = (minor_f * gf + mixed_fr * gr + mixed_fc * gc) / det
            step_row = (mixed_fr * gf + minor_r * gr + mixed_rc * gc) / det
            step_col = (mixed_fc * gf + mixed_rc * gr + minor_c * gc) / det
            step_row, step_col = min(max(step_row, -0.7), 0.7), min(max(step_col, -0.7), 0.7)
            row, col, flux = row + step_row, col + step_col, max(flux + step_flux, 0.2 * flux)
            if step_row * step_row + step_col * step_col < max(SETTLED_PX2, SETTLED_VARIANCE / rr) and (
                abs(step_flux) < 0.05 * flux
            ):
                break
        if abs(row) > 1.2 or abs(col) > 1.2:
            row, col, flag = 0.0, 0.0, flag | BLENDED
        out[n, 0], out[n, 1], out[n, 2] = row0 + row, col0 + col, flux
        out[n, 3] = flux * math.sqrt(squares) / sigma
        out[n, 4] = _contrast(residual, row0, col0) / (peak_psf * flux)
        out[n, 5] = _misfit(data[:used], usable[:used], psf[:used], flux, sigma, gain_e_adu)
        flags[n] = flag


@njit(cache=True)
def _window_offsets(radius: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Row and col of each pixel of a square window from its centre, flattened, filled up with zeros to whole vectors."""
    side = 2 * radius + 1
    filled = -(-side * side // WHOLE_VECTORS) * WHOLE_VECTORS
    drow, dcol = np.zeros(filled, dtype=np.float32), np.zeros(filled, dtype=np.float32)
    for q in range(side * side):
        drow[q], dcol[q] = q // side - radius, q % side - radius
    return drow, dcol


@njit(cache=True)
def _misfit(
    data: NDArray[np.float32],
    usable: NDArray[np.float32],
    psf: NDArray[np.float32],
    flux: float,
    sigma: float,
    gain_e_adu: float,
) -> float:
    """Light that the PSF does not explain over that which it does, both as root sum of squares, beyond three times the noise."""
    misfit, expected, light = 0.0, 0.0, 0.0
    for q in range(data.size):
        model = flux * psf[q]
        misfit += usable[q] * (data[q] - model) ** 2
        expected += usable[q] * (sigma * sigma + model / gain_e_adu)
        light += usable[q] * model * model
    return math.sqrt(max(misfit - 3.0 * expected, 0.0) / max(light, 1e-30))


@njit(cache=True)
def _contrast(residual: NDArray[np.float32], row: int, col: int) -> float:
    """Central pixel minus the mean of its four neighbours."""
    rows, cols = residual.shape
    around = residual[max(row - 1, 0), col] + residual[min(row + 1, rows - 1), col]
    around += residual[row, max(col - 1, 0)] + residual[row, min(col + 1, cols - 1)]
    return residual[row, col] - 0.25 * around
