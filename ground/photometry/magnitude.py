"""Magnitude of a streak from its flux, its exposed time and the frame's zero point; size for an albedo and a range."""

import numpy as np

from ground.photometry.zero_point import POGSON, field_terms
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.products import PhotometricSolution, StreakMeasurement

SUN_V_MAG = -26.76
"""Apparent V of the Sun at 1 au (Willmer 2018, ApJS 236, 47)."""


def exposed_time_s(streak: StreakMeasurement, header: FrameHeader, crossing_s: float | None) -> tuple[float, float] | None:
    """Time that the flux of a streak was collected in, and its relative error; None where it cannot be known.

    A mover is exposed for ``T / |1 - v_row tau|``, which is the time from the opening of the shutter on the row of end 0 to
    its closing on that of end 1 once the direction is known. crossing_s : trail length over the tracklet's rate, for trails
    cut by the frame's edge. Before the direction is known both travel directions count: their mean, with half their
    difference as the error.
    """
    exposure_s = header.exposure_ns * 1e-9
    cut = bool(streak.flags & (StreakFlag.EDGE0 | StreakFlag.EDGE1))
    if cut:
        return None if crossing_s is None or crossing_s <= 0.0 else (crossing_s, 0.01)
    # of the shutter: where an end lies off the motion, its epoch is that of the motion
    read_out_s = header.line_time_ns * (streak.fit.row1 - streak.fit.row0) * 1e-9
    if streak.flags & StreakFlag.DIRECTION_RESOLVED:
        return max(abs(exposure_s + read_out_s), 1e-9), 0.0
    longest, shortest = exposure_s + abs(read_out_s), abs(exposure_s - abs(read_out_s))
    return max(exposure_s, 1e-9), 0.5 * (longest - shortest) / max(exposure_s, 1e-9)


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


def sphere_size_m(v_mag: float, range_km: float, albedo: float, phase_rad: float = 0.0) -> float:
    """Diameter of a Lambert sphere of this magnitude at this range, at 1 au from the Sun.

    F / F_sun = A (d/2)^2 / rho^2 * 2 / (3 pi) * [(pi - phi) cos phi + sin phi] (Russell 1916, ApJ 43, 173).
    """
    phase = 2.0 / (3.0 * np.pi) * ((np.pi - phase_rad) * np.cos(phase_rad) + np.sin(phase_rad))
    flux_ratio = 10.0 ** (-0.4 * (v_mag - SUN_V_MAG))
    return float(2.0 * range_km * 1e3 * np.sqrt(flux_ratio / (albedo * phase)))
