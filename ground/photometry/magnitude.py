"""Magnitude of a streak from its flux, its exposed time and the frame's zero point."""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ground.photometry.zero_point import POGSON, field_terms
from ground.sky.sphere import unit_vectors
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.products import PhotometricSolution, StreakMeasurement

LEAST_MISSING: Final = 1e-3
"""Share of the exposure from which the epochs of both ends show that a trail is a piece; those of a whole one are the
shutter's to a nanosecond."""


def exposed_time_s(streak: StreakMeasurement, header: FrameHeader, crossing_s: float | None) -> tuple[float, float] | None:
    """Time that the flux of a streak was collected in, and its relative error; None where it cannot be known.

    A mover is exposed for ``T / |1 - v_row tau|``, which is the time from the opening of the shutter on the row of end 0 to
    its closing on that of end 1 once the direction is known. crossing_s : trail length over the tracklet's rate, for trails
    cut by the frame's edge. Ends of a piece of a broken trail are dated by the motion, and the time between them is that of its
    light. Before the direction is known both travel directions count: their mean, with half their
    difference as the error.
    """
    exposure_s = header.exposure_ns * 1e-9
    cut = bool(streak.flags & (StreakFlag.EDGE0 | StreakFlag.EDGE1))
    if cut:
        return None if crossing_s is None or crossing_s <= 0.0 else (crossing_s, 0.01)
    read_out_s = header.line_time_ns * (streak.fit.row1 - streak.fit.row0) * 1e-9
    if streak.flags & StreakFlag.DIRECTION_RESOLVED:
        shutter_s = max(abs(exposure_s + read_out_s), 1e-9)
        dated_s = float(streak.t_tai_ns[2] - streak.t_tai_ns[0]) * 1e-9
        if not streak.flags & StreakFlag.FAST_ROWS and 0.0 < dated_s < (1.0 - LEAST_MISSING) * shutter_s:
            return dated_s, _length_error(streak)
        return shutter_s, 0.0
    longest, shortest = exposure_s + abs(read_out_s), abs(exposure_s - abs(read_out_s))
    return max(exposure_s, 1e-9), 0.5 * (longest - shortest) / max(exposure_s, 1e-9)


def _length_error(streak: StreakMeasurement) -> float:
    """Relative error of the length of a trail, of which its time is a share."""
    fit = streak.fit
    along = np.array([fit.row1 - fit.row0, fit.col1 - fit.col0]) / max(fit.length_px, 1e-6)
    difference = np.concatenate([-along, along])
    variance = float(difference @ np.asarray(fit.covariance_px2) @ difference)
    return math.sqrt(variance) / max(fit.length_px, 1.0) if variance >= 0.0 else 1.0


def streak_magnitude(
    streak: StreakMeasurement,
    header: FrameHeader,
    zero_point: PhotometricSolution,
    mean_flat: float,
    crossing_s: float | None,
) -> tuple[float, float]:
    """Johnson V for a solar colour and its error; NaN where the exposed time or the flux is unknown.

    mean_flat : response at the trail relative to the axis.
    """
    time = exposed_time_s(streak, header, crossing_s)
    if time is None or not streak.fit.flux_e > 0.0 or header.exposure_ns == 0:
        return float("nan"), float("nan")
    seconds, relative_error = time
    terms = field_terms(header, np.array([streak.row_mid]), np.array([streak.col_mid]))[0]
    mag = zero_point.zero_point_mag + float(terms @ np.array(zero_point.field_mag))
    mag -= 2.5 * float(np.log10(streak.fit.flux_e / (seconds * max(mean_flat, 0.01))))
    zero_point_err = 0.0 if np.isnan(zero_point.zero_point_err_mag) else zero_point.zero_point_err_mag
    flux_err = POGSON * streak.fit.flux_err_e / streak.fit.flux_e
    return mag, float(np.sqrt(flux_err**2 + zero_point_err**2 + (POGSON * relative_error) ** 2))


def crossing_time_s(streak: StreakMeasurement, rate_deg_s: float) -> float | None:
    """Time from end 0 to end 1 at a rate on the sky; None without positions or a rate."""
    if not rate_deg_s > 0.0 or streak.flags & StreakFlag.NO_SKY:
        return None
    ends = unit_vectors(np.radians(streak.ra_deg), np.radians(streak.dec_deg))
    chord = float(np.linalg.norm(ends[2] - ends[0]))
    return float(np.degrees(2.0 * np.arcsin(min(0.5 * chord, 1.0)))) / rate_deg_s


def magnitude_at_1deg_s(
    streak: StreakMeasurement, header: FrameHeader, zero_point: PhotometricSolution, mean_flat: float
) -> tuple[float, float]:
    """Magnitude of a trail that the frame's edge cuts if it moved by 1 deg/s, and its error; NaN for any other trail.

    The density of a trail is brightness over speed for any shutter. At another rate the magnitude is therefore this one minus
    2.5 log10(rate in deg/s).
    """
    if not streak.flags & (StreakFlag.EDGE0 | StreakFlag.EDGE1):
        return math.nan, math.nan
    return streak_magnitude(streak, header, zero_point, mean_flat, crossing_time_s(streak, 1.0))


def mean_magnitude(mag: NDArray[np.float64], mag_err: NDArray[np.float64]) -> tuple[float, float]:
    """Weighted mean of the magnitudes (n,) that are known and the error that their noise gives it, NaN without any.

    For linking; what a tracklet publishes is `ground.photometry.tracklet_light`.
    """
    known = np.isfinite(mag) & np.isfinite(mag_err) & (mag_err > 0.0)
    if not known.any():
        return math.nan, math.nan
    weight = 1.0 / mag_err[known] ** 2
    return float((mag[known] * weight).sum() / weight.sum()), float(1.0 / math.sqrt(weight.sum()))
