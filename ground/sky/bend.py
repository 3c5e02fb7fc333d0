"""The arc of a straight motion in a turning camera. It is known from the attitude, and too flat to be visible in most trails.

A camera that rolls by w sees a trail of length L and exposure T bent by ``w L T / 4`` in the middle (its Coriolis acceleration
2 w L / T over T^2 / 8). A line fitted to an arc of sagitta s lies two thirds of s beside its chord, and so do the line's ends.

Any further bend in a fit is the camera's shake; bright trails show hundredths of a pixel of it. An attitude from stars is the
mean over the exposure, and so is a line fitted to the trail. The ends of a fitted arc contain the shake at shutter open and
close. Therefore a fitted arc is converted back to its line, which then gets the arc of the attitude like all lines.
"""

from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ground.sky.apparent import mid_frame_tai_ns
from ground.sky.pixel_sky import SolvedSky
from ground.sky.rotation import matrix_of, turn
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.products import FrameSolution, StreakFit, StreakMeasurement

Array = NDArray[np.float64]

SHORTEST_PX: Final = 3.0
"""Shorter trails do not bend by anything that matters: the sagitta goes with the square of the length."""
LINE_BESIDE_CHORD: Final = 2.0 / 3.0
"""Mean height of a flat arc, in units of its sagitta."""
MOST_BY_SAGITTA: Final = 5.0 / 6.0
"""Share of the variance of an arc's ends across, both moving alike, that is the sagitta's where light is even: the arc's is six
times the line's."""
LARGEST_PX: Final = 2.0
"""Largest bend that is applied, px. A trail that bends by more than its width was not fitted by a line. A member of an on-board
track moves straight, so that a star has bent its fit."""


def bent(streak: StreakMeasurement, header: FrameHeader, solution: FrameSolution) -> StreakMeasurement:
    """The streak with its ends on the arc that a motion straight on the sky draws, whether a line or an arc was fitted to it.

    streak : ends in the order of time, with their epochs. Directions in the result are still those of the old ends.
    """
    fit = streak.fit
    unfit = StreakFlag.POINT_LIKE | StreakFlag.FIT_FAILED
    if streak.flags & unfit or not streak.flags & StreakFlag.DIRECTION_RESOLVED:
        return streak
    if fit.length_px < SHORTEST_PX:
        return streak
    sagitta = sagitta_px(fit, header, solution, streak.t_tai_ns)
    is_straight = streak.track >= 0 or abs(sagitta - fit.sagitta_px) < LARGEST_PX
    if not (is_straight and abs(sagitta) < LARGEST_PX):
        return streak
    d_row, d_col = (fit.row1 - fit.row0) / fit.length_px, (fit.col1 - fit.col0) / fit.length_px
    back = LINE_BESIDE_CHORD * (fit.sagitta_px - sagitta)
    moved = replace(
        fit,
        row0=fit.row0 + back * d_col,
        col0=fit.col0 - back * d_row,
        row1=fit.row1 + back * d_col,
        col1=fit.col1 - back * d_row,
        covariance_px2=_of_line(fit, np.array([d_col, -d_row])),
        sagitta_px=sagitta,
    )
    beside = sagitta + back - fit.sagitta_px
    return replace(streak, fit=moved, row_mid=streak.row_mid + beside * d_col, col_mid=streak.col_mid - beside * d_row)


def _of_line(fit: StreakFit, side: Array) -> Array:
    """Covariance (4, 4) of the ends of the line through a fitted arc, which lacks the error of the sagitta (even light).

    side : unit vector across, (row, col).
    """
    covariance = np.asarray(fit.covariance_px2)
    if fit.sagitta_px == 0.0:
        return covariance
    both = 0.5 * np.tile(side, 2)
    common = float(both @ covariance @ both)
    by_sagitta = min((LINE_BESIDE_CHORD * fit.sagitta_err_px) ** 2, MOST_BY_SAGITTA * common)
    return np.asarray(covariance - by_sagitta * np.outer(2.0 * both, 2.0 * both))


def sagitta_px(fit: StreakFit, header: FrameHeader, solution: FrameSolution, t_tai_ns: NDArray[np.int64]) -> float:
    """Offset from the chord's middle (sign of the contract) of a point that moves evenly on the sky between both ends.

    t_tai_ns : (3,) epochs of end 0, middle, end 1. Includes what the camera's distortion bends.
    """
    sky = SolvedSky(header=header, solution=solution)
    ends = sky.apparent(np.array([fit.row0, fit.row1]), np.array([fit.col0, fit.col1]), t_tai_ns[[0, 2]])
    half_way = ends.sum(axis=0) / np.linalg.norm(ends.sum(axis=0))
    middle_ns = int(t_tai_ns[0]) + (int(t_tai_ns[2]) - int(t_tai_ns[0])) // 2
    seconds = (middle_ns - mid_frame_tai_ns(header)) * 1e-9
    seen = turn(
        (matrix_of(np.asarray(solution.quaternion)) @ half_way)[None, :], -seconds * np.asarray(solution.rate_rad_s)[None, :]
    )
    row, col = solution.camera.project(seen)
    length = max(fit.length_px, 1e-9)
    d_row, d_col = (fit.row1 - fit.row0) / length, (fit.col1 - fit.col0) / length
    return float((row[0] - 0.5 * (fit.row0 + fit.row1)) * d_col - (col[0] - 0.5 * (fit.col0 + fit.col1)) * d_row)
