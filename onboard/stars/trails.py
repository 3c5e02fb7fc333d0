"""Stars as trails, when the pointing follows something else: found and centred with the trail as template.

All stars of a frame share one trail (rotation of the field within an exposure is left to the fit's tolerance). Its vector
comes from the autocorrelation of the bright pixels, which falls linearly to zero along the trail, and is then refined on
bright stars. The centre of a trail is the position at mid-exposure, as for a point.
"""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import label
from scipy.optimize import least_squares

from onboard.stars.fits import BLENDED, DEFECT, EDGE, SATURATED, SATURATED_STAR

SAMPLE_PX = 1024
"""Side of the part of the frame whose autocorrelation is taken."""

FALL = 0.25
"""The autocorrelation is followed out to this share of its peak."""

REFINED_STARS = 9
LEAST_COMMON = 4
"""So many stars at least must show the same trail; one streak across a frame without stars is none."""
FIT_STEPS = 8


@dataclass(frozen=True, kw_only=True)
class Trail:
    """Movement of every star during the exposure, px; its sign is unknown and of no consequence."""

    drow: float
    dcol: float

    @property
    def length_px(self) -> float:
        """Length."""
        return math.hypot(self.drow, self.dcol)


def first_guess(residual: NDArray[np.float32], sigma_adu: float) -> Trail:
    """Trail from the autocorrelation of pixels above 3 sigma in the middle of the frame; zero when there is none."""
    rows, cols = residual.shape
    row0, col0 = max(0, (rows - SAMPLE_PX) // 2), max(0, (cols - SAMPLE_PX) // 2)
    bright = (residual[row0 : row0 + SAMPLE_PX, col0 : col0 + SAMPLE_PX] > 3.0 * sigma_adu).astype(np.float32)
    bright -= bright.mean()
    spectrum = np.fft.rfft2(bright)
    correlation = np.fft.fftshift(np.fft.irfft2(np.abs(spectrum) ** 2, s=bright.shape))
    centre = np.array(correlation.shape) // 2
    peak = float(correlation[centre[0] - 1 : centre[0] + 2, centre[1] - 1 : centre[1] + 2].mean())
    if peak <= 0.0:
        return Trail(drow=0.0, dcol=0.0)
    parts, _ = label(correlation > FALL * peak)
    row, col = (axis - middle for axis, middle in zip(np.nonzero(parts == parts[tuple(centre)]), centre, strict=True))
    if len(row) < 3:
        return Trail(drow=0.0, dcol=0.0)
    moments = np.cov(np.vstack((row, col)))
    _, axes = np.linalg.eigh(moments)
    along = row * axes[0, 1] + col * axes[1, 1]
    across = row * axes[0, 0] + col * axes[1, 0]
    length = max(float(np.abs(along).max()) - float(np.abs(across).max()), 0.0) / (1.0 - FALL)
    return Trail(drow=length * float(axes[0, 1]), dcol=length * float(axes[1, 1]))


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
    residual: NDArray[np.float32],
    mask: NDArray[np.uint8],
    peaks: NDArray[np.float32],
    half_row: float,
    half_col: float,
    psf_sigma_px: float,
    noise_adu: float,
    gain_e_adu: float,
    out: NDArray[np.float64],
    flags: NDArray[np.uint8],
) -> None:
    """Maximum-likelihood centre and flux of trails of known vector, Gauss-Newton.

    peaks : (n, 2) row, col. out : (n, 4) row, col, flux ADU, S/N. flags : `StarFlag` bits SATURATED, EDGE, BLENDED and DEFECT.
    """
    rows, cols = residual.shape
    reach_row = int(math.ceil(abs(half_row) + 3.5 * psf_sigma_px))  # noqa: RUF046 - numba's ceil is a float
    reach_col = int(math.ceil(abs(half_col) + 3.5 * psf_sigma_px))  # noqa: RUF046 - numba's ceil is a float
    for n in range(peaks.shape[0]):
        row0, col0 = int(peaks[n, 0]), int(peaks[n, 1])
        row, col, flux, squares = float(row0), float(col0), -1.0, 0.0
        flag = 0
        for step in range(FIT_STEPS):
            gf, gr, gc, ff, fr, fc, rr, rc, cc, squares = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for i in range(row0 - reach_row, row0 + reach_row + 1):
                for j in range(col0 - reach_col, col0 + reach_col + 1):
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


def matched_peaks(
    residual: NDArray[np.float32], trail: Trail, psf_sigma_px: float, threshold: float, sigma_adu: float
) -> NDArray[np.float32]:
    """Local maxima (n, 3: row, col, S/N), brightest first, of the image filtered with the trail."""
    half_row, half_col = 0.5 * trail.drow, 0.5 * trail.dcol
    reach = [math.ceil(abs(half) + 3.0 * psf_sigma_px) for half in (half_row, half_col)]
    kernel = np.array(
        [
            [trail_model(float(i), float(j), half_row, half_col, psf_sigma_px)[0] for j in range(-reach[1], reach[1] + 1)]
            for i in range(-reach[0], reach[0] + 1)
        ],
        dtype=np.float32,
    )
    filtered = cv2.filter2D(np.ascontiguousarray(residual), cv2.CV_32F, kernel, borderType=cv2.BORDER_CONSTANT)
    filtered = filtered * np.float32(1.0 / (sigma_adu * math.sqrt(float(np.sum(kernel**2)))))
    apart = [max(1, round(abs(half))) + 2 for half in (half_row, half_col)]
    highest = cv2.dilate(filtered, np.ones((2 * apart[0] + 1, 2 * apart[1] + 1), dtype=np.uint8))
    row, col = np.nonzero((filtered == highest) & (filtered > threshold))
    order = np.argsort(-filtered[row, col], kind="stable")
    return np.column_stack((row, col, filtered[row, col])).astype(np.float32)[order]


def refined(
    residual: NDArray[np.float32], mask: NDArray[np.uint8], peaks: NDArray[np.float32], guess: Trail, psf_sigma_px: float
) -> tuple[Trail, float] | None:
    """Trail and PSF width as medians over fits of bright usable stars with both free; None when these do not agree."""
    vectors = []
    reach = [math.ceil(abs(half) + 5.0 * psf_sigma_px) + 3 for half in (0.5 * guess.drow, 0.5 * guess.dcol)]
    for row0, col0 in peaks[:, :2].astype(int):
        part = np.s_[row0 - reach[0] : row0 + reach[0] + 1, col0 - reach[1] : col0 + reach[1] + 1]
        image = residual[part]
        if row0 < reach[0] or col0 < reach[1] or image.shape != (2 * reach[0] + 1, 2 * reach[1] + 1) or mask[part].any():
            continue
        flux = float(image.sum())
        if not flux > 0.0:  # a bright column beside a hole is no star
            continue
        start = np.array([flux, 0.0, 0.0, guess.drow, guess.dcol, psf_sigma_px])
        fit = least_squares(_misfit, start, args=(image,), x_scale=np.array([flux, 1.0, 1.0, 1.0, 1.0, 0.3]), max_nfev=15)
        light = fit.x[0] if fit.success else 0.0
        if light > 0.0 and float(np.sum(fit.fun**2)) < 0.05 * float(np.sum(image.astype(np.float64) ** 2)):
            sign = 1.0 if fit.x[3] * guess.drow + fit.x[4] * guess.dcol >= 0.0 else -1.0
            vectors.append((sign * fit.x[3], sign * fit.x[4], abs(fit.x[5])))
        if len(vectors) == REFINED_STARS:
            break
    if len(vectors) < LEAST_COMMON:
        return None
    drow, dcol, width = np.median(np.array(vectors), axis=0)
    apart = np.median(np.hypot(*(np.array(vectors)[:, :2] - (drow, dcol)).T))
    if apart > 0.2 * math.hypot(drow, dcol):
        return None
    return Trail(drow=float(drow), dcol=float(dcol)), float(min(max(width, 0.4), 3.0 * psf_sigma_px))


@njit(cache=True)
def _render(parameters: NDArray[np.float64], out: NDArray[np.float64]) -> None:
    """A trail (flux, row, col, drow, dcol, sigma) with positions from the middle of the image."""
    flux, row, col, drow, dcol, sigma = parameters
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            u, v = i - out.shape[0] // 2 - row, j - out.shape[1] // 2 - col
            out[i, j] = flux * trail_model(u, v, 0.5 * drow, 0.5 * dcol, max(abs(sigma), 0.2))[0]


def _misfit(parameters: NDArray[np.float64], image: NDArray[np.float32]) -> NDArray[np.float64]:
    """Model minus image, flattened."""
    model = np.empty(image.shape)
    _render(parameters, model)
    return (model - image).ravel()
