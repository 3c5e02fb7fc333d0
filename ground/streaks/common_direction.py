"""Directions of the trails of one motion: the same in all its frames, so each line is known better than from its own pixels."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ground.streaks.trail_frame import TrailFrame
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.products import StreakFit

DIRECTION_SCATTER_RAD: Final = 1e-3
"""Scatter of the directions of one motion from frame to frame by the camera's distortion."""

LARGEST_SCATTER: Final = 4.0
"""Largest median of (difference / error)^2 of one common direction; chance gives 0.45."""


def common_turns(fits: Sequence[StreakFit]) -> NDArray[np.float64]:
    """(n,) angles (rad) by which each trail's line should be turned: towards the direction that all of them share.

    A path is straight in a camera that does not roll, apart from distortion. Ends of a faint trail are found along its line, so a
    line turned by noise gives wrong ends. The angle is zero where the lines differ by more than chance, and for failed fits.
    """
    turns = np.zeros(len(fits))
    used = [i for i, f in enumerate(fits) if not f.flags & (StreakFlag.FIT_FAILED | StreakFlag.POINT_LIKE) and f.length_px > 1.0]
    if len(used) < 2:
        return turns
    angles, variances = np.transpose([_direction(fits[i]) for i in used])
    # ends are in time order, so directions of one motion are near each other
    angles = angles[0] + np.angle(np.exp(1j * (angles - angles[0])))
    total = variances + DIRECTION_SCATTER_RAD**2
    off = np.average(angles, weights=1.0 / total) - angles
    if float(np.median(off**2 / total)) > LARGEST_SCATTER:
        return turns
    turns[used] = off * variances / total
    return turns


def _direction(fit: StreakFit) -> tuple[float, float]:
    """Angle of the chord, atan2(drow, dcol), and its variance (rad^2)."""
    trail = TrailFrame.of_chord(fit.row0, fit.col0, fit.row1, fit.col1)
    across = np.array([trail.cos, -trail.sin])
    difference = np.concatenate([-across, across])
    return trail.angle_rad, float(difference @ fit.covariance_px2 @ difference) / fit.length_px**2
