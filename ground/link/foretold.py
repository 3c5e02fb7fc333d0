"""Places of points that no frame shows: one straight track through many frames, whose members share its errors.

An on-board track of points is fitted to a window of many frames; the last come down, each with the track's place in it. With
s the error of the place in the middle of the window, along either axis, and T the window's duration, places at two epochs have
the covariance ``s^2 (1 + 12 (t1 - t_mid) (t2 - t_mid) / T^2)``: that of a straight line through evenly spaced points.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.products import StreakMeasurement

Array = NDArray[np.float64]

AT_THE_END: Final = 2.0
"""Error of a straight line's end over that of its middle; a foretold fit states this one (`ground.streaks.forced`)."""

SAME_WINDOW_FRAMES: Final = 7
"""Frames that lie farther apart were foretold by different windows: only the newest frames of a window come down."""


def with_track_errors(
    members: Sequence[StreakMeasurement], headers: Mapping[int, FrameHeader], frame_s: float, first: int = 0
) -> tuple[list[StreakMeasurement], dict[int, tuple[int, Array]]]:
    """Members, those that a track foretold with its errors at their epochs; of these the window's number and shared errors.

    members : of one tracklet, in order of time. frame_s : time from frame to frame. first : number of the first window.
    The shared errors (2, 3) are in px; both rows are alike: of the place in the window's middle, of the way since, and none.
    """
    out, shared = list(members), dict[int, tuple[int, Array]]()
    for number, window in enumerate(_windows(members), start=first):
        last = members[window[-1]]
        duration_s = max(last.fit.track_frames * frame_s, 1e-6)
        for k in window:
            member = members[k]
            middle_px = math.sqrt(max(float(np.asarray(member.fit.covariance_px2)[0, 0]), 0.0)) / AT_THE_END
            # the window ends with its last frame's exposure; frames follow each other evenly
            before_ns = headers[last.frame].t_start_tai_ns - headers[member.frame].t_start_tai_ns
            after_s = 0.5 * (duration_s - frame_s) - 1e-9 * before_ns
            errors = middle_px * np.array([1.0, math.sqrt(12.0) * after_s / duration_s, 0.0])
            variance = float(errors @ errors)
            fit = replace(
                member.fit,
                covariance_px2=np.asarray(np.kron(np.ones((2, 2)), variance * np.eye(2)), dtype=np.float64),
                end_interval_px=np.array([[-1.0, 1.0], [-1.0, 1.0]]) * math.sqrt(variance),
                sigma_cross_px=math.sqrt(variance),
            )
            out[k] = replace(member, fit=fit)
            shared[member.streak_id] = (number, np.stack([errors, errors]))
    return out, shared


def _windows(members: Sequence[StreakMeasurement]) -> list[list[int]]:
    """Places among the members of those that one window foretold."""
    out: list[list[int]] = []
    for k, member in enumerate(members):
        if not member.fit.is_foretold:
            continue
        if out and member.frame - members[out[-1][0]].frame < SAME_WINDOW_FRAMES:
            out[-1].append(k)
        else:
            out.append([k])
    return out
