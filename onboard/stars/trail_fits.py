"""Centres and fluxes of trails of known vector, by maximum likelihood."""

import math
from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.stars.fits import BLENDED, DEFECT, EDGE, SATURATED, SATURATED_STAR
from onboard.stars.star_motion import longest_px
from sboc_e2e.icd.signals import StarMotion

FIT_STEPS: Final = 8  # of Gauss-Newton, the first for the flux alone; four are usual
FIT_WORK: Final = 250.0  # operations of a fit per pixel of the trail, in four steps ...
BOX_WORK: Final = 4.0  # ... and per pixel of the box around it


class ResidualImage(NamedTuple):
    """residual : (rows, cols) ADU above the background; mask : `PixelFlag` bits; noise_adu : of a pixel without stars."""

    residual: NDArray[np.float32]
    mask: NDArray[np.uint8]
    noise_adu: float


@njit(cache=True)
def trail_model(drow: float, dcol: float, half_row: float, half_col: float, sigma: float) -> tuple[float, float, float]:
    """A trail of unit flux at (drow, dcol) from its centre, and minus its slopes along row and col of that offset.

    half_row, half_col : from centre to end. The Gaussian PSF is integrated along the trail (error functions).
    """
    half = math.hypot(half_row, half_col)
    unit_row, unit_col = (half_row / half, half_col / half) if half > 1e-9 else (1.0, 0.0)
    half = max(half, 1e-3)
    u, v = drow * unit_row + dcol * unit_col, -drow * unit_col + dcol * unit_row
    scale = 1.0 / (sigma * math.sqrt(2.0))
    across = math.exp(-(v * v) * scale * scale) / (sigma * math.sqrt(2.0 * math.pi))
    along = (math.erf((u + half) * scale) - math.erf((u - half) * scale)) / (4.0 * half)
    ends = math.exp(-(((u + half) * scale) ** 2)) - math.exp(-(((u - half) * scale) ** 2))
    slope_u = -across * ends / (2.0 * half * sigma * math.sqrt(2.0 * math.pi))
    slope_v = across * along * v / (sigma * sigma)
    return across * along, slope_u * unit_row - slope_v * unit_col, slope_u * unit_col + slope_v * unit_row


@njit(cache=True)
def fit_trails(
    frame: ResidualImage,
    peaks: NDArray[np.float32],
    half: NDArray[np.float64],
    psf_sigma_px: float,
    gain_e_adu: float,
    out: NDArray[np.float64],
    flags: NDArray[np.uint8],
) -> None:
    """Maximum-likelihood centre and flux of trails of known vector, Gauss-Newton.

    peaks : (n, >= 2) row, col. half : (n, 2) from centre to end.
    out : (n, 4) row, col, flux ADU, S/N. flags : `StarFlag` bits SATURATED, EDGE, BLENDED and DEFECT.
    """
    residual, mask, noise_adu = frame.residual, frame.mask, frame.noise_adu
    rows, cols = residual.shape
    for n in range(peaks.shape[0]):
        half_row, half_col = half[n, 0], half[n, 1]
        length = max(2.0 * math.hypot(half_row, half_col), 1e-6)
        reach_row = int(math.ceil(abs(half_row) + 3.5 * psf_sigma_px))  # noqa: RUF046 - numba's ceil is a float
        reach_col = int(math.ceil(abs(half_col) + 3.5 * psf_sigma_px))  # noqa: RUF046 - numba's ceil is a float
        row0, col0 = int(peaks[n, 0]), int(peaks[n, 1])
        row, col, flux, squares = float(row0), float(col0), -1.0, 0.0
        flag = 0
        for step in range(FIT_STEPS):
            gf, gr, gc, ff, fr, fc, rr, rc, cc, squares = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for i in range(row0 - reach_row, row0 + reach_row + 1):
                for j in range(col0 - reach_col, col0 + reach_col + 1):
                    if abs((i - row0) * half_col - (j - col0) * half_row) > 0.5 * length * (3.5 * psf_sigma_px + 1.0):
                        continue
                    if i < 0 or j < 0 or i >= rows or j >= cols:
                        flag |= EDGE
                        continue
                    if mask[i, j] != 0:
                        flag |= SATURATED_STAR if mask[i, j] & SATURATED else DEFECT
                        continue
                    t, tr, tc = trail_model(i - row, j - col, half_row, half_col, psf_sigma_px)
                    weight = 1.0 / (noise_adu * noise_adu + max(flux, 0.0) * t / gain_e_adu)
                    misfit = (residual[i, j] - max(flux, 0.0) * t) * weight
                    tr, tc = flux * tr, flux * tc
                    gf, gr, gc = gf + misfit * t, gr + misfit * tr, gc + misfit * tc
                    ff, fr, fc = ff + weight * t * t, fr + weight * t * tr, fc + weight * t * tc
                    rr, rc, cc = rr + weight * tr * tr, rc + weight * tr * tc, cc + weight * tc * tc
                    squares += t * t
            if ff <= 0.0:
                break
            if step == 0:  # the flux first: without it the position has no gradient
                flux = max(gf / ff, 0.1 * noise_adu)
                continue
            determinant = ff * (rr * cc - rc * rc) - fr * (fr * cc - rc * fc) + fc * (fr * rc - rr * fc)
            if determinant <= 1e-9 * ff * rr * cc:
                flag |= BLENDED
                break
            step_flux = ((rr * cc - rc * rc) * gf + (fc * rc - fr * cc) * gr + (fr * rc - fc * rr) * gc) / determinant
            step_row = ((fc * rc - fr * cc) * gf + (ff * cc - fc * fc) * gr + (fr * fc - ff * rc) * gc) / determinant
            step_col = ((fr * rc - fc * rr) * gf + (fr * fc - ff * rc) * gr + (ff * rr - fr * fr) * gc) / determinant
            row, col = row + min(max(step_row, -2.0), 2.0), col + min(max(step_col, -2.0), 2.0)
            flux = max(flux + step_flux, 0.2 * flux)
            if step_row * step_row + step_col * step_col < 1e-4:
                break
        if abs(row - row0) > reach_row or abs(col - col0) > reach_col:
            row, col, flag = float(row0), float(col0), flag | 4
        out[n, 0], out[n, 1], out[n, 2] = row, col, flux
        out[n, 3] = flux * math.sqrt(squares) / noise_adu
        flags[n] = flag


def fit_work(motion: StarMotion, psf_sigma_px: float) -> float:
    """Operations of the fit of one of the longer trails: usual steps, and pixels within 3.5 sigma."""
    length = 0.7 * longest_px(motion)
    return FIT_WORK * (length + 7.0 * psf_sigma_px) * (7.0 * psf_sigma_px + 2.0) + BOX_WORK * length * length
