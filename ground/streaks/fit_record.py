"""`StreakFit` records from trail coordinates: order of the ends, covariances, and the record of a failed fit."""

import math

import numpy as np
from numpy.typing import NDArray

from ground.streaks.trail_frame import TrailFrame
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.products import StreakFit, StreakPixels
from sboc_e2e.icd.signals import Detection


def pixel_covariance(
    frame: TrailFrame, along_px2: NDArray[np.float64], across_px2: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(4, 4) covariance of (row0, col0, row1, col1) from the (2, 2) covariances of the ends along and across the trail."""
    out = np.empty((4, 4))
    along, across = np.array([frame.sin, frame.cos]), np.array([frame.cos, -frame.sin])
    for i in range(2):
        for j in range(2):
            block = along_px2[i, j] * np.outer(along, along) + across_px2[i, j] * np.outer(across, across)
            out[2 * i : 2 * i + 2, 2 * j : 2 * j + 2] = block
    return out


def swap_edge_flags(flags: StreakFlag) -> StreakFlag:
    """The flags when the ends change places."""
    edges = (StreakFlag.EDGE0 in flags, StreakFlag.EDGE1 in flags)
    flags &= ~(StreakFlag.EDGE0 | StreakFlag.EDGE1)
    if edges[0]:
        flags |= StreakFlag.EDGE1
    if edges[1]:
        flags |= StreakFlag.EDGE0
    return flags


def in_pixel_order(fit: StreakFit) -> StreakFit:
    """The fit with its ends by growing col, then row."""
    if (fit.col0, fit.row0) <= (fit.col1, fit.row1):
        return fit
    return reversed_ends(fit)


def reversed_ends(fit: StreakFit) -> StreakFit:
    """The same trail with end 0 and end 1 exchanged; signed quantities change with the direction."""
    order = [2, 3, 0, 1]
    return StreakFit(
        row0=fit.row1,
        col0=fit.col1,
        row1=fit.row0,
        col1=fit.col0,
        covariance_px2=fit.covariance_px2[np.ix_(order, order)],
        end_interval_px=fit.end_interval_px[::-1],
        sigma_cross_px=fit.sigma_cross_px,
        flux_e=fit.flux_e,
        flux_err_e=fit.flux_err_e,
        snr=fit.snr,
        sagitta_px=-fit.sagitta_px,
        sagitta_err_px=fit.sagitta_err_px,
        gradient=-fit.gradient,
        width_px=fit.width_px,
        width_err_px=fit.width_err_px,
        chi2_nu=fit.chi2_nu,
        n_pixels=fit.n_pixels,
        flags=swap_edge_flags(fit.flags),
        light_curve_e_px=fit.light_curve_e_px[::-1],
        period_fraction=fit.period_fraction,
    )


def failed_fit(detection: Detection, pixels: StreakPixels) -> StreakFit:
    """The detection's own values, flagged FIT_FAILED, with uncertainties as wide as the detection can be off."""
    length = max(detection.length_px, 1.0)
    snr = max(detection.snr, 1.0)
    width = pixels.psf_sigma_px
    along = max(4.39 * length / snr**2, math.sqrt(2.0 * math.sqrt(math.pi) * width * length) / snr) + 1.0
    frame = TrailFrame.of_chord(detection.row0, detection.col0, detection.row1, detection.col1)
    usable = np.isfinite(pixels.variance_e2) & np.isfinite(pixels.value_e)
    noise_e = math.sqrt(float(np.median(pixels.variance_e2[usable]))) if usable.any() else 1.0
    flux = snr * noise_e * math.sqrt(2.0 * math.sqrt(math.pi) * width * (length + 2.0 * math.sqrt(math.pi) * width))
    return in_pixel_order(
        StreakFit(
            row0=detection.row0,
            col0=detection.col0,
            row1=detection.row1,
            col1=detection.col1,
            covariance_px2=pixel_covariance(frame, np.eye(2) * along**2, np.eye(2)),
            end_interval_px=np.array([[-along, along], [-along, along]]),
            sigma_cross_px=1.0,
            flux_e=flux,
            flux_err_e=flux,
            snr=detection.snr,
            sagitta_px=detection.sagitta_px,
            sagitta_err_px=1.0,
            gradient=0.0,
            width_px=width,
            width_err_px=width,
            chi2_nu=math.nan,
            n_pixels=int(usable.sum()),
            flags=detection.flags | StreakFlag.FIT_FAILED | StreakFlag.ENDS_NOT_GAUSSIAN,
            light_curve_e_px=np.zeros(0, dtype=np.float32),
        )
    )
