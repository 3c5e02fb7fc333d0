"""`ground.photometry: zero_point`: zero point, colour term and field term of a frame from its identified stars."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd.downlink import DownlinkFrame
from sboc_e2e.icd.flags import StarFlag
from sboc_e2e.icd.frame import Calibration, FrameHeader
from sboc_e2e.icd.products import FrameSolution, PhotometricSolution

Array = NDArray[np.float64]

SUN_B_V: Final = 0.653
"""The Sun's B-V (Ramirez et al. 2012, ApJ 752, 5). The contract defines the zero point for this colour."""
POGSON: Final = 2.5 / np.log(10.0)
"""mag for a relative change of flux (1.0857)."""

UNUSABLE: Final = int(
    StarFlag.SATURATED | StarFlag.EDGE | StarFlag.DEFECT | StarFlag.BLENDED | StarFlag.TRAILED | StarFlag.COSMIC_LIKE
)
CLIP_SIGMA: Final = 3.5
"""One star in 2,000 of a normal distribution is beyond it; variables, blends and wrong matches are."""
N_ITERATIONS: Final = 8
"""Rounds of clipping, after which the set has settled; chosen, not measured."""

PRIOR_COLOUR_TERM: Final = 0.05
"""Error of the nominal colour term."""

PRIOR_COLOUR_SQUARE: Final = 0.1
"""Size of the term in colour squared."""

PRIOR_FIELD_MAG: Final = 0.02
"""Error of the flat over the field."""

CATALOGUE_ERROR_MAG: Final = 0.02
"""Error of catalogue magnitudes and star fluxes beyond their noise."""

MIN_STARS: Final = 5
"""Fewest stars that make a zero point."""


@dataclass(frozen=True, kw_only=True)
class ZeroPoint:
    """Robust linear fit; priors keep colour and field terms at the calibration's values where stars are few.

    A square of the colour is fitted too: a wide band bends with colour, and a straight line would move the zero point of
    solar colours by 0.02 mag.
    """

    def calibrate(self, frame: DownlinkFrame, solution: FrameSolution, calibration: Calibration) -> PhotometricSolution:
        """Zero point of a frame; when stars are too few the calibration's own, with NaN as its error, or NaN if it has none."""
        camera, header = calibration.camera, frame.header
        nominal_mag = 2.5 * float(np.log10(camera.zero_point_e_s)) if camera.zero_point_e_s else float("nan")
        stars = np.asarray(solution.star_index, dtype=np.intp)
        clean = (frame.stars.flags[stars] & UNUSABLE) == 0
        measured = np.isfinite(solution.star_v_mag) & np.isfinite(solution.star_b_v) & (frame.stars.flux_e[stars] > 0.0)
        keep = clean & measured
        if keep.sum() < MIN_STARS:
            keep = measured
        if keep.sum() < MIN_STARS or header.exposure_ns == 0:
            return PhotometricSolution(
                frame=header.frame,
                zero_point_mag=nominal_mag,
                zero_point_err_mag=float("nan"),
                colour_term=-camera.colour_term,
                n_stars=0,
                rms_mag=float("nan"),
            )
        stars = stars[keep]
        row, col = frame.stars.row[stars], frame.stars.col[stars]
        rate = frame.stars.flux_e[stars].astype(np.float64) / (header.exposure_ns * 1e-9) / flat_at(calibration, row, col)
        colour = solution.star_b_v[keep].astype(np.float64) - SUN_B_V
        design = np.column_stack((np.ones(len(stars)), colour, colour**2, field_terms(header, row, col)))
        sigma = np.hypot(POGSON / np.maximum(frame.stars.snr[stars].astype(np.float64), 1.0), CATALOGUE_ERROR_MAG)
        # the contract's camera has the term in its flux, this solution in its magnitude: opposite signs
        prior_mean = np.array([0.0, -camera.colour_term, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
        prior_sigma = np.array([np.inf, PRIOR_COLOUR_TERM, PRIOR_COLOUR_SQUARE] + [PRIOR_FIELD_MAG] * 5)
        fit, covariance, rms, n_used = robust_linear_fit(
            design, solution.star_v_mag[keep] + 2.5 * np.log10(rate), sigma, prior_mean, prior_sigma
        )
        return PhotometricSolution(
            frame=header.frame,
            zero_point_mag=float(fit[0]),
            zero_point_err_mag=float(np.sqrt(covariance[0, 0])),
            colour_term=float(fit[1]),
            n_stars=n_used,
            rms_mag=rms,
            field_mag=(float(fit[3]), float(fit[4]), float(fit[5]), float(fit[6]), float(fit[7])),
        )


def robust_linear_fit(
    design: Array, value: Array, sigma: Array, prior_mean: Array, prior_sigma: Array
) -> tuple[Array, Array, float, int]:
    """Weighted least squares with Gaussian priors, outliers beyond `CLIP_SIGMA` (by the MAD) dropped until they stay.

    design : (n, k). Returns parameters (k,), covariance (k, k) scaled by the residuals, their rms, and stars used.
    """
    prior_weight = np.where(np.isfinite(prior_sigma), 1.0 / prior_sigma**2, 0.0)
    parameters = prior_mean.copy()
    parameters[0] = np.median(value - design[:, 1:] @ prior_mean[1:])
    used = np.ones(len(value), dtype=bool)
    covariance = np.eye(len(prior_mean))
    for _ in range(N_ITERATIONS):
        residual = (value - design @ parameters) / sigma
        spread = max(1.4826 * float(np.median(np.abs(residual - np.median(residual)))), 0.3)
        used = np.abs(residual) < CLIP_SIGMA * spread
        weighted = design[used] / sigma[used, None]
        normal = weighted.T @ weighted / spread**2 + np.diag(prior_weight)
        covariance = np.linalg.inv(normal)
        parameters = covariance @ (weighted.T @ (value[used] / sigma[used]) / spread**2 + prior_weight * prior_mean)
    rms = float(np.sqrt(np.mean((value - design @ parameters)[used] ** 2)))
    return parameters, covariance, rms, int(used.sum())


def field_terms(header: FrameHeader, row: Array, col: Array) -> Array:
    """x, y, x2, x y, y2 (n, 5) of pixels, in half diagonals from the frame's middle; x along cols, y along rows."""
    half = 0.5 * np.hypot(header.rows, header.cols)
    x, y = (col - 0.5 * (header.cols - 1)) / half, (row - 0.5 * (header.rows - 1)) / half
    return np.stack((x, y, x * x, x * y, y * y), axis=-1)


def flat_at(calibration: Calibration, row: Array, col: Array) -> Array:
    """Mean flat of the 3 x 3 pixels around each position, never below 0.01."""
    rows, cols = calibration.flat.shape
    r = np.clip(np.rint(row).astype(np.intp), 0, rows - 1)
    c = np.clip(np.rint(col).astype(np.intp), 0, cols - 1)
    total = np.zeros(len(r))
    for d_row in (-1, 0, 1):
        for d_col in (-1, 0, 1):
            total += calibration.flat[np.clip(r + d_row, 0, rows - 1), np.clip(c + d_col, 0, cols - 1)]
    return np.maximum(total / 9.0, 0.01)
