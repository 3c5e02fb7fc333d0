"""Maximum-likelihood flux and position of a star at every peak, every pixel weighted by its own noise.

The weights hold the sky's and the star's own photon noise, which is what the Cramer-Rao bound asks for (King 1983,
PASP 95, 163). The PSF is a Gaussian with the covariance that `onboard.star_shape` measured at that place.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sboc_e2e.icd.flags import MaskBit, StarFlag

SATURATED = int(MaskBit.SATURATED)
EDGE, BLENDED, DEFECT = int(StarFlag.EDGE), int(StarFlag.BLENDED), int(StarFlag.DEFECT)
SATURATED_STAR = int(StarFlag.SATURATED)
BRIGHT_PEAK_SIGMA = 12.0
"""Stars with a brighter central pixel are fitted in the larger window."""

SETTLED_PX2 = 1e-4
SETTLED_VARIANCE = 0.03
"""A step shorter than 0.01 px, or than 0.17 of the error of the position, is the last one: Gauss-Newton squares it."""


@njit(cache=True, fastmath={"reassoc", "contract", "nsz", "arcp"})  # sums over a window, all finite: order is free
def _normal_equations(
    data: NDArray[np.float64],
    usable: NDArray[np.float64],
    psf: NDArray[np.float64],
    drow: NDArray[np.float64],
    dcol: NDArray[np.float64],
    flux: float,
    row: float,
    col: float,
    variance: float,
    gain_e_adu: float,
    shape_inverse: tuple[float, float, float],
) -> tuple[float, float, float, float, float, float, float, float, float, float]:
    """Gradient (flux, row, col), information matrix (ff, fr, fc, rr, rc, cc) and sum of squared PSF over the window."""
    inv_rr, inv_rc, inv_cc = shape_inverse
    gf, gr, gc, ff, fr, fc, rr, rc, cc, squares = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for q in range(data.size):
        t = psf[q]
        model = flux * t
        weight = usable[q] / (variance + model / gain_e_adu)
        u, v = drow[q] - row, dcol[q] - col
        slope_row = model * (inv_rr * u + inv_rc * v)
        slope_col = model * (inv_cc * v + inv_rc * u)
        misfit = (data[q] - model) * weight
        gf += misfit * t
        gr += misfit * slope_row
        gc += misfit * slope_col
        ff += weight * t * t
        fr += weight * t * slope_row
        fc += weight * t * slope_col
        rr += weight * slope_row * slope_row
        rc += weight * slope_row * slope_col
        cc += weight * slope_col * slope_col
        squares += usable[q] * t * t
    return gf, gr, gc, ff, fr, fc, rr, rc, cc, squares


@njit(cache=True)
def _psf_at(
    row: float,
    col: float,
    radius: int,
    shape_inverse: tuple[float, float, float],
    steps: tuple[float, float],
    factors: NDArray[np.float64],
    out: NDArray[np.float64],
) -> None:
    """Gaussian PSF of unit flux sampled in the window, for a star at (row, col) from its centre.

    steps : ``exp(-inv_rr), exp(-inv_cc)``, the second ratios of the profiles along the axes.
    """
    inv_rr, inv_rc, inv_cc = shape_inverse
    norm = math.sqrt(inv_rr * inv_cc - inv_rc * inv_rc) / (2.0 * math.pi)
    side = 2 * radius + 1
    # a Gaussian on a grid by its ratios: exp(-a (x + 1)^2) = exp(-a x^2) q, q = exp(-a (2 x + 1)), next q by exp(-2 a)
    first, ratio, change = norm * math.exp(-0.5 * inv_rr * (radius + row) ** 2), math.exp(inv_rr * (radius + row - 0.5)), steps[0]
    for k in range(side):
        factors[0, k] = first
        first, ratio = first * ratio, ratio * change
    first, ratio, change = math.exp(-0.5 * inv_cc * (radius + col) ** 2), math.exp(inv_cc * (radius + col - 0.5)), steps[1]
    for k in range(side):
        factors[1, k] = first
        first, ratio = first * ratio, ratio * change
    for i in range(side):
        for j in range(side):
            out[i * side + j] = factors[0, i] * factors[1, j]
    if abs(inv_rc) * radius * radius < 0.15:  # nearly upright: a series is exact to 6e-4 in the corners and much faster
        for i in range(side):
            for j in range(side):
                x = -inv_rc * (i - radius - row) * (j - radius - col)
                out[i * side + j] *= 1.0 + x * (1.0 + 0.5 * x)
    else:
        for i in range(side):
            for j in range(side):
                out[i * side + j] *= math.exp(-inv_rc * (i - radius - row) * (j - radius - col))


@njit(cache=True)
def _take_window(
    residual: NDArray[np.float32],
    mask: NDArray[np.uint8],
    row0: int,
    col0: int,
    radius: int,
    data: NDArray[np.float64],
    usable: NDArray[np.float64],
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
    return EDGE


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
    largest = (2 * radii[1] + 1) ** 2
    data, usable, psf = np.empty(largest), np.empty(largest), np.empty(largest)
    factors = np.empty((2, 2 * radii[1] + 1))
    for n in range(peaks.shape[0]):
        row0, col0 = int(peaks[n, 0]), int(peaks[n, 1])
        sigma = float(sigma_nodes[min(row0 // tile_px, sigma_nodes.shape[0] - 1), min(col0 // tile_px, sigma_nodes.shape[1] - 1)])
        crr, crc, ccc = covariances[n, 0], covariances[n, 1], covariances[n, 2]
        cdet = crr * ccc - crc * crc
        shape_inverse = (ccc / cdet, -crc / cdet, crr / cdet)
        steps = (math.exp(-shape_inverse[0]), math.exp(-shape_inverse[2]))
        peak_psf = 1.0 / (2.0 * math.pi * math.sqrt(cdet))
        bright = residual[row0, col0] > BRIGHT_PEAK_SIGMA * sigma
        radius = radii[1] if bright else radii[0]
        drow, dcol = offsets[1] if bright else offsets[0]
        size = drow.size
        flag = _take_window(residual, mask, row0, col0, radius, data, usable)
        row, col = float(peaks[n, 3]), float(peaks[n, 4])
        flux = 1.7 * max(float(peaks[n, 2]), 0.1 * sigma) / peak_psf
        squares = 0.0
        for _ in range(6):
            _psf_at(row, col, radius, shape_inverse, steps, factors, psf)
            gf, gr, gc, ff, fr, fc, rr, rc, cc, squares = _normal_equations(
                data[:size], usable[:size], psf[:size], drow, dcol, flux, row, col, sigma * sigma, gain_e_adu, shape_inverse
            )
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
        out[n, 5] = _misfit(data[:size], usable[:size], psf[:size], flux, sigma, gain_e_adu)
        flags[n] = flag


@njit(cache=True)
def _window_offsets(radius: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Row and col of each pixel of a square window from its centre, flattened."""
    side = 2 * radius + 1
    drow, dcol = np.empty(side * side), np.empty(side * side)
    for q in range(side * side):
        drow[q], dcol[q] = q // side - radius, q % side - radius
    return drow, dcol


@njit(cache=True)
def _misfit(
    data: NDArray[np.float64],
    usable: NDArray[np.float64],
    psf: NDArray[np.float64],
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
