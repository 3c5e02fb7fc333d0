"""Sources of an image: detected stars with flux and S/N, and the widths of isolated ones from Gaussian fits."""

from dataclasses import dataclass
from typing import Final

import numpy as np
import sep
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial import cKDTree

from sboc_e2e.validation.background import MIN_AREA_PX, Background

DETECT_SIGMA: Final = 1.5
"""SExtractor's default DETECT_THRESH."""
STREAK_AXIS_RATIO: Final = 3.0
"""Sources longer than this over their width are trails, not stars."""
FIT_SNR: Final = 20.0
"""A width is then known to some 5 % (1 / S/N) for each star. Chosen: fewer stars reach more."""
MOST_FITS: Final = 300
"""Brightest first; the median width of 300 with 10 % scatter is known to 0.7 %. More cost time."""
SIGMA_TO_FWHM: Final = 2.0 * np.sqrt(2.0 * np.log(2.0))


@dataclass(frozen=True, kw_only=True, eq=False)
class Sources:
    """Stars by falling S/N. row, col : (n,) windowed centroids, px; flux : (n,) in units of the noise of a pixel, inside
    `radius_px`; snr : (n,) aperture S/N, background noise only. n_trails : elongated sources left out."""

    row: NDArray[np.float64]
    col: NDArray[np.float64]
    flux: NDArray[np.float64]
    snr: NDArray[np.float64]
    peak: NDArray[np.float64]
    radius_px: float
    n_trails: int

    def __len__(self) -> int:
        return len(self.row)


def find_sources(background: Background, radius_px: float) -> Sources:
    """Stars of an image in apertures of `radius_px` (px), detected with a 3 x 3 smoothing kernel by sep."""
    image, noise = background.residual, background.noise
    found = sep.extract(image, DETECT_SIGMA, err=noise, minarea=MIN_AREA_PX)
    trail = found["a"] > STREAK_AXIS_RATIO * np.maximum(found["b"], 0.3)
    star = found[~trail & (found["npix"] > 0)]
    flux, error, _ = sep.sum_circle(image, star["x"], star["y"], radius_px, err=noise)
    col, row, _ = sep.winpos(image, star["x"], star["y"], np.full(len(star), max(0.5 * radius_px, 0.6)))
    edge = radius_px
    snr = np.asarray(flux / error, dtype=np.float64)
    rows, cols = image.shape
    good = (snr > 3.0) & (row > edge) & (row < rows - 1 - edge) & (col > edge) & (col < cols - 1 - edge)
    order = np.flatnonzero(good)[np.argsort(-snr[good], kind="stable")]
    return Sources(
        row=np.asarray(row, dtype=np.float64)[order],
        col=np.asarray(col, dtype=np.float64)[order],
        flux=np.asarray(flux / noise, dtype=np.float64)[order],
        snr=snr[order],
        peak=np.asarray(star["peak"] / noise, dtype=np.float64)[order],
        radius_px=radius_px,
        n_trails=int(trail.sum()),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Widths:
    """Gaussian fits of isolated stars. major, minor : (n,) FWHM, px; angle_deg : (n,) of the major axis from +col to +row."""

    major: NDArray[np.float64]
    minor: NDArray[np.float64]
    angle_deg: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.major)


def star_widths(background: Background, sources: Sources, ceiling: float) -> Widths:
    """Fits of elliptical Gaussians to stars above `FIT_SNR`, alone in their stamp, with peaks below `ceiling` (noise units)."""
    half = max(5, round(1.5 * sources.radius_px))
    near = 2.0 * half
    place = np.stack([sources.row, sources.col], axis=1)
    neighbours = cKDTree(place).query_ball_point(place, near, return_length=True) if len(place) else np.zeros(0)
    rows, cols = background.residual.shape
    fits: list[tuple[float, float, float]] = []
    for k in range(len(sources)):
        r, c = round(sources.row[k]), round(sources.col[k])
        inside = half <= r < rows - half and half <= c < cols - half
        if sources.snr[k] < FIT_SNR or len(fits) >= MOST_FITS:
            break
        if not inside or neighbours[k] > 1 or sources.peak[k] > ceiling:
            continue
        stamp = background.residual[r - half : r + half + 1, c - half : c + half + 1] / background.noise
        fitted = gaussian_fit(stamp.astype(np.float64))
        if fitted is not None:
            fits.append(fitted)
    table = np.array(fits).reshape(-1, 3)
    return Widths(major=table[:, 0], minor=table[:, 1], angle_deg=table[:, 2])


def gaussian_fit(stamp: NDArray[np.float64]) -> tuple[float, float, float] | None:
    """FWHM along both axes (px) and angle of the major one (deg) of a pixel-sampled elliptical Gaussian on a constant.

    stamp : (n, n). None when the fit does not converge inside the stamp.
    """
    n = stamp.shape[0]
    y, x = np.mgrid[:n, :n] - (n - 1) / 2.0
    start = np.array([float(stamp.max()), 0.0, 0.0, np.log(1.5), np.log(1.5), 0.0, float(np.median(stamp))])

    def residual(p: NDArray[np.float64]) -> NDArray[np.float64]:
        # The inverse covariance is R diag(1/s1^2, 1/s2^2) R^T with the angle p[5]; logarithms keep the widths positive.
        cos, sin = np.cos(p[5]), np.sin(p[5])
        u = (x - p[1]) * cos + (y - p[2]) * sin
        v = -(x - p[1]) * sin + (y - p[2]) * cos
        model = p[0] * np.exp(-0.5 * (u**2 * np.exp(-2 * p[3]) + v**2 * np.exp(-2 * p[4]))) + p[6]
        return np.asarray((model - stamp).ravel())

    # A starting tilt: with two equal widths the angle has no gradient.
    start[3] += 0.1
    start[5] = 0.5
    try:
        result = least_squares(residual, start, max_nfev=60, method="lm")
    except ValueError:
        return None
    p = result.x
    s1, s2 = np.exp(p[3]), np.exp(p[4])
    if not np.all(np.isfinite(p)) or max(s1, s2) > n or min(s1, s2) < 0.2 or max(abs(p[1]), abs(p[2])) > n / 4:
        return None
    angle = p[5] if s1 >= s2 else p[5] + 0.5 * np.pi
    return float(max(s1, s2) * SIGMA_TO_FWHM), float(min(s1, s2) * SIGMA_TO_FWHM), float(np.degrees(angle) % 180.0)
