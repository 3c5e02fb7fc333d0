"""Features of a fit for its classification: sharpness, S/N, length, chi-square, lumpiness, alignment, flags."""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from ground.streaks.trail_model import PIXEL_VARIANCE_PX2
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.products import StreakFit

LEAST_BINS: Final = 4
"""Least number of bins of a light curve for lumpiness."""

SECOND_DIFFERENCE: Final = 6.0
"""Variance of a second difference of independent values, over theirs: 1 + 4 + 1."""

ALIGNED_DEG: Final = 0.7
"""Angle from a row or column within which a trail is aligned: a pixel in 80. Chosen, not measured."""
ALIGNED_LENGTH_PX: Final = 15.0
"""Longer trails within this angle of a row or column count as aligned."""


@dataclass(frozen=True, kw_only=True)
class Features:
    """sharpness : ln of fitted over expected width, pixel included, with its error; NaN where the fit failed.

    chi2_sigmas : (chi2/nu - 1) over its error, statistical and of the model. lumpiness : relative scatter of the light curve
    beyond the noise, NaN for short ones.
    """

    sharpness: float
    sharpness_err: float
    ln_snr: float
    ln_length: float
    chi2_sigmas: float
    lumpiness: float
    aligned: bool
    failed: bool
    static: bool
    spike: bool


def features_of(
    fit: StreakFit, psf_sigma_px: float, *, ln_psf_error: float = 0.0, model_error: float = 0.0, may_vary: bool = False
) -> Features:
    """Features of one fit, given the PSF that a real trail would have.

    ln_psf_error : one sigma of ln psf_sigma_px. model_error : share of a real trail's light that the model may miss or
    misplace. It adds (model_error * snr)^2 to the expected chi2, so chi2 has less weight for brighter trails.
    may_vary : light that changes smoothly along the trail is not lumpy.
    """
    failed = StreakFlag.FIT_FAILED in fit.flags or fit.n_pixels == 0
    seen = fit.width_px**2 + PIXEL_VARIANCE_PX2
    sharpness = 0.5 * math.log(seen / (psf_sigma_px**2 + PIXEL_VARIANCE_PX2))
    error = math.hypot(
        fit.width_err_px * fit.width_px / seen, ln_psf_error * psf_sigma_px**2 / (psf_sigma_px**2 + PIXEL_VARIANCE_PX2)
    )
    chi2_error = math.nan if failed else math.hypot(math.sqrt(2.0 / fit.n_pixels), (model_error * fit.snr) ** 2 / fit.n_pixels)
    return Features(
        sharpness=math.nan if failed else sharpness,
        sharpness_err=min(error, 3.0) if math.isfinite(error) else 3.0,
        ln_snr=math.log(max(fit.snr, 1e-3)),
        ln_length=math.log(max(fit.length_px, 0.1)),
        chi2_sigmas=math.nan if failed else (fit.chi2_nu - 1.0) / chi2_error,
        lumpiness=lumpiness_of(fit, may_vary=may_vary),
        aligned=fit.length_px > ALIGNED_LENGTH_PX and is_aligned(fit.angle_deg),
        failed=failed,
        static=StreakFlag.STATIC in fit.flags,
        spike=StreakFlag.SPIKE_LIKE in fit.flags,
    )


def is_aligned(angle_deg: float) -> bool:
    """Whether a line of this direction follows rows or columns."""
    return min(angle_deg % 90.0, 90.0 - angle_deg % 90.0) < ALIGNED_DEG


def lumpiness_of(fit: StreakFit, *, may_vary: bool) -> float:
    """Relative scatter of the bins, the noise's own part sqrt(k) / S taken out: 0 for uniform trails, > 1 for chains.

    may_vary : where less, the scatter of the second differences, which is as large for bins that know nothing of each other and
    0 for a trail that brightens evenly. Satellites brighten by a factor of thirty in a frame, by phase, range and vignetting.
    """
    curve = fit.light_curve_e_px.astype(np.float64)
    if curve.size < LEAST_BINS or not curve.mean() > 0.0:
        return math.nan
    variance = float(curve.var())
    if may_vary:
        variance = min(variance, float(np.mean(np.diff(curve, 2) ** 2)) / SECOND_DIFFERENCE)
    return math.sqrt(max(variance / curve.mean() ** 2 - curve.size / fit.snr**2, 0.0))
