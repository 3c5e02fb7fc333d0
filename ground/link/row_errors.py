"""Common errors of a tracklet's directions: of the jointly fitted motion and line, of a frame's pointing and of its turning."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd.products import Tracklet

Array = NDArray[np.float64]


MIDDLE: Final = 1
"""Row point of a place in the middle of an exposure."""


def common_errors(
    shared: Array,
    group: NDArray[np.int64],
    pointing: Array,
    turning: Array,
    frame: NDArray[np.int64],
    point: NDArray[np.int64],
    shared_cross: Array,
) -> tuple[Array, Array]:
    """Covariances (m, m) along and across the motion, of rows as `Tracklet` has them, in the square of their unit.

    Ends of a joint fit share errors along the motion. Middles of a track of points share them along both axes. Ends on one line
    share errors across, shared_cross (m, 3).
    """
    turned_together = np.where(frame[:, None] == frame, np.outer(turning, turning), 0.0)
    pointed_together = np.where(frame[:, None] == frame, np.outer(pointing, pointing), 0.0)
    fitted_together = (group[:, None] == group) & (group >= 0)
    fitted = np.where(fitted_together, shared @ shared.T, 0.0)
    middles = (point[:, None] == MIDDLE) & (point == MIDDLE)
    line = shared_cross @ shared_cross.T
    return fitted + pointed_together, np.where(middles, fitted, 0.0) + line + pointed_together + turned_together


def common_errors_arcsec2(tracklet: Tracklet) -> tuple[Array, Array]:
    """The same for a tracklet's directions; zero where the tracklet has no such fields."""
    m = len(tracklet.t_tai_ns)
    if len(tracklet.row_streak_ids) != m:
        return np.zeros((m, m)), np.zeros((m, m))
    frame_of = dict(zip(tracklet.streak_ids.tolist(), tracklet.frames.tolist(), strict=True))
    frame = np.array([frame_of[k] for k in tracklet.row_streak_ids.tolist()], dtype=np.int64)
    return common_errors(
        tracklet.shared_arcsec, tracklet.shared_group, tracklet.pointing_arcsec, tracklet.turning_arcsec, frame,
        tracklet.row_points, tracklet.shared_cross_arcsec,
    )  # fmt: skip
