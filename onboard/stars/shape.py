"""Shape of the star images over the field, measured on bright stars: PSF width, focus, and smear by moving pointing.

Each star's covariance comes from adaptive moments: Gaussian-weighted second moments whose weight has the covariance
that is being measured (Bernstein & Jarvis 2002, AJ 123, 583, section 3.1). They include the pixel's own 1/12 px^2.
"""

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

ENOUGH_STARS = 40
"""Fewer good stars than this give one shape for the whole field; fewer than `LEAST_STARS` the nominal one."""

LEAST_STARS = 6  # a median and a scatter of fewer say little. Chosen, not measured
MOST_STARS = 400  # the brightest; a budget of work. Chosen, not measured
LEAST_VARIANCE_PX2 = 0.15  # of the polynomials, where no star holds them: 1 / 12 of the pixel and (0.26 px)^2 of light

LIKE_NOMINAL = 1.35
"""Peaks whose width is the nominal one within this factor, and so round, have the shape of a point."""

CLIP_SIGMA = 3.5  # of moments: doubles and particles lie beyond. Chosen, not measured


@dataclass(frozen=True, kw_only=True, eq=False)
class FieldShape:
    """Covariance of star images, px^2, as quadratic polynomials of the position in the frame.

    coefficients : (3, 6) for (rr, rc, cc) and the terms 1, y, x, y^2, yx, x^2 with y, x in -1 ... 1 over the frame.
    n_stars : stars it was measured on; 0 when it is nominal.
    """

    coefficients: NDArray[np.float64]
    shape: tuple[int, int]
    n_stars: int

    @classmethod
    def nominal(cls, psf_sigma_px: float, shape: tuple[int, int]) -> "FieldShape":
        """A circular PSF of one width."""
        coefficients = np.zeros((3, 6))
        coefficients[[0, 2], 0] = psf_sigma_px**2 + 1.0 / 12.0
        return cls(coefficients=coefficients, shape=shape, n_stars=0)

    def covariance(self, peaks: NDArray[np.float32]) -> NDArray[np.float64]:
        """(n, 3) covariances rr, rc, cc at peaks (n, >= 2: row, col), px^2; never narrower than a pixel."""
        out = np.empty((len(peaks), 3))
        evaluate(self.coefficients, peaks, 2.0 / max(self.shape[0] - 1, 1), 2.0 / max(self.shape[1] - 1, 1), out)
        return out

    @property
    def sigma_px(self) -> float:
        """Width at the centre of the frame: the circular sigma of equal area, without the pixel."""
        rr, rc, cc = self.coefficients[:, 0]
        return math.sqrt(max(math.sqrt(max(rr * cc - rc * rc, 1e-6)) - 1.0 / 12.0, 1e-4))

    @property
    def smear_px(self) -> float:
        """Length of a uniform trail that explains the elongation at the centre of the frame, px."""
        rr, rc, cc = self.coefficients[:, 0]
        return math.sqrt(12.0 * math.hypot(rr - cc, 2.0 * rc))


def _terms(row: NDArray[np.float64], col: NDArray[np.float64], shape: tuple[int, int]) -> NDArray[np.float64]:
    """Terms of the polynomials, (n, 6)."""
    y = 2.0 * row / max(shape[0] - 1, 1) - 1.0
    x = 2.0 * col / max(shape[1] - 1, 1) - 1.0
    return np.column_stack((np.ones_like(y), y, x, y * y, y * x, x * x))


@njit(cache=True)
def evaluate(
    coefficients: NDArray[np.float64], peaks: NDArray[np.float32], row_unit: float, col_unit: float, out: NDArray[np.float64]
) -> None:
    """The polynomials of `FieldShape` at every peak."""
    for n in range(peaks.shape[0]):
        y, x = peaks[n, 0] * row_unit - 1.0, peaks[n, 1] * col_unit - 1.0
        for k in range(3):
            c = coefficients[k]
            out[n, k] = c[0] + y * (c[1] + c[3] * y + c[4] * x) + x * (c[2] + c[5] * x)
        out[n, 0], out[n, 2] = max(out[n, 0], LEAST_VARIANCE_PX2), max(out[n, 2], LEAST_VARIANCE_PX2)
        bound = 0.9 * math.sqrt(out[n, 0] * out[n, 2])
        out[n, 1] = min(max(out[n, 1], -bound), bound)


@njit(cache=True)
def adaptive_moments(
    residual: NDArray[np.float32],
    mask: NDArray[np.uint8],
    peaks: NDArray[np.float32],
    radius: int,
    start_px2: float,
    out: NDArray[np.float64],
) -> None:
    """Adaptive covariance (rr, rc, cc) at each peak into out (n, 3), px^2; NaN where it did not settle.

    With a Gaussian star of covariance C and a weight W the weighted covariance M obeys 1/M = 1/C + 1/W; the iteration
    sets W to the C that follows, until they agree.
    """
    rows, cols = residual.shape
    for n in range(peaks.shape[0]):
        row0, col0 = int(peaks[n, 0]), int(peaks[n, 1])
        out[n, :] = np.nan
        if row0 < radius or col0 < radius or row0 >= rows - radius or col0 >= cols - radius:
            continue
        row, col, wrr, wrc, wcc = float(row0), float(col0), start_px2, 0.0, start_px2
        for _ in range(40):
            det = wrr * wcc - wrc * wrc
            irr, irc, icc = wcc / det, -wrc / det, wrr / det
            total, sum_r, sum_c, sum_rr, sum_rc, sum_cc = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            spoilt = False
            for i in range(row0 - radius, row0 + radius + 1):
                for j in range(col0 - radius, col0 + radius + 1):
                    u, v = i - row, j - col
                    distance = irr * u * u + 2.0 * irc * u * v + icc * v * v
                    if distance > 25.0:
                        continue
                    if mask[i, j] != 0:
                        spoilt = True
                    light = math.exp(-0.5 * distance) * residual[i, j]
                    total += light
                    sum_r += light * u
                    sum_c += light * v
                    sum_rr += light * u * u
                    sum_rc += light * u * v
                    sum_cc += light * v * v
            if spoilt or total <= 0.0:
                break
            mean_r, mean_c = sum_r / total, sum_c / total
            mrr, mrc, mcc = sum_rr / total - mean_r**2, sum_rc / total - mean_r * mean_c, sum_cc / total - mean_c**2
            mdet = mrr * mcc - mrc * mrc
            if mrr <= 0.0 or mcc <= 0.0 or mdet <= 0.0:
                break
            # 1/C = 1/M - 1/W
            crr, crc, ccc = mcc / mdet - irr, -mrc / mdet - irc, mrr / mdet - icc
            cdet = crr * ccc - crc * crc
            if crr <= 0.0 or ccc <= 0.0 or cdet <= 0.0:
                break
            new_rr, new_rc, new_cc = ccc / cdet, -crc / cdet, crr / cdet
            row, col = row + 2.0 * mean_r, col + 2.0 * mean_c
            change = abs(new_rr - wrr) + abs(new_rc - wrc) + abs(new_cc - wcc)
            wrr, wrc, wcc = 0.5 * (wrr + new_rr), 0.5 * (wrc + new_rc), 0.5 * (wcc + new_cc)
            if abs(row - row0) > 2.0 or abs(col - col0) > 2.0 or wrr + wcc > 0.5 * radius * radius:
                break
            if change < 1e-4 * (wrr + wcc):
                out[n, 0], out[n, 1], out[n, 2] = wrr, wrc, wcc
                break


def measure_shape(
    residual: NDArray[np.float32], mask: NDArray[np.uint8], peaks: NDArray[np.float32], nominal: FieldShape
) -> tuple[FieldShape, float, NDArray[np.bool_]]:
    """Shape over the field from the given bright peaks (n, >= 2: row, col), robustly; else the nominal one.

    Also the share of the peaks whose moments settled (stars' do, pieces of trails do not), and which are shaped like a point.
    """
    moments = np.empty((len(peaks), 3))
    start = float(nominal.coefficients[0, 0])
    radius = max(6, math.ceil(5.0 * math.sqrt(start)))
    adaptive_moments(residual, mask, peaks, radius, start, moments)
    settled = np.isfinite(moments[:, 0])
    like_point = _like_points(moments, start)
    moments = moments[settled]
    row, col = peaks[settled, 0].astype(np.float64), peaks[settled, 1].astype(np.float64)
    share = float(settled.mean()) if len(settled) else 1.0
    if len(moments) < LEAST_STARS:
        return nominal, share, like_point
    terms = _terms(row, col, nominal.shape)
    keep = np.ones(len(moments), dtype=bool)
    for _ in range(6):
        n_terms = 6 if np.count_nonzero(keep) >= ENOUGH_STARS else 1
        fitted, *_ = np.linalg.lstsq(terms[keep, :n_terms], moments[keep], rcond=None)
        misfit = moments - terms[:, :n_terms] @ fitted
        middle = np.median(misfit[keep], axis=0)
        spread = 1.4826 * np.median(np.abs(misfit[keep] - middle), axis=0) + 1e-4
        new_keep: NDArray[np.bool_] = np.asarray((np.abs(misfit - middle) < CLIP_SIGMA * spread).all(axis=1))
        if np.count_nonzero(new_keep) < LEAST_STARS or (new_keep == keep).all():
            break
        keep = new_keep
    coefficients = np.zeros((3, 6))
    coefficients[:, :n_terms] = fitted.T
    shape = FieldShape(coefficients=coefficients, shape=nominal.shape, n_stars=int(np.count_nonzero(keep)))
    return shape, share, like_point


def _like_points(moments: NDArray[np.float64], variance_px2: float) -> NDArray[np.bool_]:
    """Mask of the covariances (n, 3), NaN where unknown, that agree with a point of the nominal variance."""
    rr, rc, cc = moments.T
    mean, apart = 0.5 * (rr + cc), np.hypot(0.5 * (rr - cc), rc)
    limit = LIKE_NOMINAL**2
    return np.asarray((mean + apart < limit * variance_px2) & (mean - apart > variance_px2 / limit))
