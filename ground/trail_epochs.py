"""Epochs of a trail's ends and middle: from the shutter, and from the motion of its tracklet where the shutter does not tell.

An end on the frame's edge was not made by the shutter. The middle of a trail is not passed in the middle of the exposure when
the object changes its rate.
"""

from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ground.sky.measure import redated
from ground.straight_passage import StraightPassage
from ground.streaks.fit_record import edges_of
from ground.streaks.joint_evidence import TrackletFrame
from ground.streaks.joint_motion import Motion
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.products import StreakFit, StreakMeasurement

Array = NDArray[np.float64]

NEWTON_STEPS: Final = 8
"""Of the epoch at which a motion passes a place: it changes its rate by little within an exposure. Chosen, not measured."""


def timed_by_shutter(member: StreakMeasurement, header: FrameHeader) -> StreakMeasurement:
    """The streak with the shutter's epochs at both ends; one that crosses the whole frame is left as it is.

    A linker dates an end that lies off the motion by the epoch at which the motion passed it. Here the place of the end is in
    doubt instead, so the shutter dates it. An end on the frame's edge was passed before the shutter closed, or after it opened.
    """
    if all(edges_of(member.flags)):
        return member
    epochs = member.t_tai_ns.copy()
    epochs[0] = header.t_start_tai_ns + round(header.line_time_ns * member.fit.row0)
    epochs[2] = header.t_start_tai_ns + header.exposure_ns + round(header.line_time_ns * member.fit.row1)
    epochs[1] = (epochs[0] + epochs[2]) // 2
    return redated(member, epochs)


def cut_end(fit: StreakFit) -> int | None:
    """Which end of a trail, 0 or 1, is on the frame's edge; None if none or both are."""
    edges = edges_of(fit.flags)
    return None if edges[0] == edges[1] else int(edges[1])


def edge_passed_s(frame: TrackletFrame, end: int, motion: Motion, passage: StraightPassage, turning_arcsec_s: float) -> float:
    """When a motion passes the end of a trail that lies on the frame's edge. Within the exposure.

    motion : in the time and the place of the passage. turning_arcsec_s : rate at which that pixel moves along the path, as the
    camera turns.
    """
    along, dated_s = (frame.along0, frame.t_open_s) if end == 0 else (frame.along1, frame.t_close_s)
    t_s = dated_s
    for _ in range(NEWTON_STEPS):
        edge = along + turning_arcsec_s * (t_s - dated_s)
        place, rate = motion.at(passage.time(t_s))
        approach = rate * passage.pace(t_s) - turning_arcsec_s * passage.stretch(edge)
        if not approach > 0.0:
            return dated_s
        t_s = min(max(t_s + (passage.place(edge) - place) / approach, frame.t_open_s), frame.t_close_s)
    return t_s


def with_middle_epoch(t_tai_ns: NDArray[np.int64], frame: TrackletFrame, passage: StraightPassage) -> NDArray[np.int64]:
    """Epochs (3,) of a trail whose middle is dated by the passage between its ends.

    What passes close by changes its rate w by 2 kappa w within a second. In the middle of T seconds it is kappa w T^2 / 4 away
    from the middle of its trail: 20 ms for one second at 0.08 per second.
    """
    span_s = frame.t_close_s - frame.t_open_s
    way = frame.along_per_px * frame.fit.length_px  # as seen at once: without what the camera turned meanwhile
    if not (span_s > 0.0 and way > 0.0):
        return t_tai_ns
    ahead = passage.ahead((frame.t_open_s, frame.t_close_s), (frame.along0, frame.along1))
    out = t_tai_ns.copy()
    out[1] = (out[0] + out[2]) // 2 - round(ahead / way * span_s * 1e9)
    return out


def with_ends(frame: TrackletFrame, fit: StreakFit, t_tai_ns: NDArray[np.int64], zero_ns: int) -> TrackletFrame:
    """The frame with other ends on the line of its trail."""
    unit, _ = along_of(frame.fit)
    shift0, shift1 = (float((np.array(end_of(fit, k)) - np.array(end_of(frame.fit, k))) @ unit) for k in range(2))
    return replace(
        frame,
        fit=fit,
        along0=frame.along0 + frame.along_per_px * shift0,
        along1=frame.along1 + frame.along_per_px * shift1,
        t_open_s=float(t_tai_ns[0] - zero_ns) * 1e-9,
        t_close_s=float(t_tai_ns[2] - zero_ns) * 1e-9,
    )


def along_of(fit: StreakFit) -> tuple[Array, float]:
    """Unit vector (row, col) from end 0 to end 1, and the length."""
    length = max(fit.length_px, 1e-6)
    return np.array([fit.row1 - fit.row0, fit.col1 - fit.col0]) / length, length


def end_of(fit: StreakFit, end: int) -> tuple[float, float]:
    """Row and column of end 0 or 1, px."""
    return (fit.row0, fit.col0) if end == 0 else (fit.row1, fit.col1)
