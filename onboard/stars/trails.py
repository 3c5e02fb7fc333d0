"""Stars as trails, when the pointing follows something else or rolls: found and centred with the trail as template.

The motion of the stars (`star_motion`) gives the shape of each trail. Sums of the PSF-smoothed image along this shape have maxima
at the trails (`trail_peaks`). Those that lie on no brighter one's trail (`trail_map`) are listed, and the brightest are fitted
(`trail_fits`). The centre of a trail is the position at mid-exposure, as for a point.
"""

import math

import numpy as np
from numpy.typing import NDArray

from onboard.stars.fits import BLENDED
from onboard.stars.trail_fits import ResidualImage, fit_trails
from onboard.stars.trail_map import keep_brightest
from onboard.stars.trail_peaks import matched_peaks
from sboc_e2e.icd.flags import StarFlag
from sboc_e2e.icd.signals import DetectorView, StarMotion


def matched_trails(
    view: DetectorView, motion: StarMotion, psf_sigma_px: float, threshold: float, most: int, noise_adu: float
) -> tuple[NDArray[np.float32], NDArray[np.float64], NDArray[np.uint8]]:
    """Trails of the stars' motion (n, 3: row, col, S/N), brightest first, each once; their half vectors (n, 2); a map of them."""
    found = matched_peaks(view, motion, psf_sigma_px, threshold, most)
    half = 0.5 * np.column_stack(motion.at(found[:, 0].astype(np.float64), found[:, 1].astype(np.float64)))
    painted, keep = np.zeros(view.mask.shape, np.uint8), np.zeros(len(found), np.bool_)
    keep_brightest(ResidualImage(view.residual_adu, view.mask, noise_adu), found, half, psf_sigma_px, painted, keep)
    order = np.flatnonzero(keep)
    order = order[np.argsort(-found[order, 2], kind="stable")]
    return found[order], half[order], painted


def listed(
    view: DetectorView,
    peaks: NDArray[np.float32],
    half: NDArray[np.float64],
    psf_sigma_px: float,
    noise_adu: float,
    gain_e_adu: float,
    chosen: NDArray[np.bool_],
) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """Fits (n, 4: row, col, flux ADU, S/N) and flags of trails at peaks (n, 3); those not chosen keep their pixel, BLENDED.

    The flux of a trail of S/N S is S sigma sqrt(sum(t^2))^-1, with sum(t^2) = 1 / hypot(2 sqrt(pi) s L, 4 pi s^2) for a length L.
    """
    fits, flags = np.empty((len(peaks), 4)), np.full(len(peaks), BLENDED, dtype=np.uint8)
    length = 2.0 * np.hypot(half[:, 0], half[:, 1])
    light = np.sqrt(np.hypot(2.0 * math.sqrt(math.pi) * psf_sigma_px * length, 4.0 * math.pi * psf_sigma_px**2))
    fits[:, :2], fits[:, 3] = peaks[:, :2], peaks[:, 2]
    fits[:, 2] = peaks[:, 2] * noise_adu * light
    some, some_flags = np.empty((np.count_nonzero(chosen), 4)), np.zeros(np.count_nonzero(chosen), dtype=np.uint8)
    frame = ResidualImage(view.residual_adu, view.mask, noise_adu)
    fit_trails(frame, peaks[chosen], half[chosen], psf_sigma_px, gain_e_adu, some, some_flags)
    fits[chosen], flags[chosen] = some, some_flags
    return fits, flags | np.uint8(StarFlag.TRAILED)
