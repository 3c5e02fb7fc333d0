"""Epochs of a trail's ends and middle: from the shutter, and from the motion of its tracklet where the shutter does not tell.

An end on the frame's edge was not made by the shutter. The middle of a trail is not passed in the middle of the exposure when
the object changes its rate.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ground.sky.measure import redated
from ground.straight_passage import StraightPassage
from ground.streaks.joint import TrackletFrame
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.products import StreakFit, StreakMeasurement

Array = NDArray[np.float64]


def timed_by_shutter(member: StreakMeasurement, header: FrameHeader) -> StreakMeasurement:
    """The streak with the shutter's epochs at both ends, except ends on the frame's edge.

    A linker dates an end that lies off the motion by the epoch at which the motion passed it. Here the place of the end is in
    doubt instead, so the shutter dates it.
    """
    epochs = member.t_tai_ns.copy()
    if not member.flags & StreakFlag.EDGE0:
        epochs[0] = header.t_start_tai_ns + round(header.line_time_ns * member.fit.row0)
    if not member.flags & StreakFlag.EDGE1:
        epochs[2] = header.t_start_tai_ns + header.exposure_ns + round(header.line_time_ns * member.fit.row1)
    epochs[1] = (epochs[0] + epochs[2]) // 2
    return redated(member, epochs)


def with_edge_epoch(
    epochs_ns: NDArray[np.int64],
    frame: TrackletFrame,
    frames: Sequence[TrackletFrame],
    joint: dict[int, StreakFit],
    passage: StraightPassage,
    zero_ns: int,
) -> NDArray[np.int64]:
    """Epochs (3,) of a trail cut by the frame: its edge was passed when the joint motion says."""
    edges = [bool(frame.fit.flags & flag) for flag in (StreakFlag.EDGE0, StreakFlag.EDGE1)]
    own = [k for k in joint if frames[k] is frame]
    if edges[0] == edges[1] or not own:
        return epochs_ns
    t_s, along, _ = _timed_ends([frames[k] for k in joint], list(joint.values()))
    if len(t_s) < 3:
        return epochs_ns
    passed_s = np.polynomial.Polynomial.fit(along, t_s, 2 if len(t_s) > 4 else 1)
    # The smooth fit predicts a difference of two places better than a single place.
    own_s, own_along, _ = _timed_ends([frame], [joint[own[0]]])
    cut_along = frame.along0 if edges[0] else frame.along1
    cut_s = own_s[0] + float(passed_s(cut_along) - passed_s(own_along[0]))
    out = epochs_ns.copy()
    out[0 if edges[0] else 2] = zero_ns + round(passage.epoch(cut_s) * 1e9)
    return out


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


def _timed_ends(frames: Sequence[TrackletFrame], joint: Sequence[StreakFit]) -> tuple[list[float], list[float], list[float]]:
    """Epoch (s), place along the path and error along the trail (px) of all ends that the shutter made."""
    t_s, along, sigma = [], [], []
    for place, fit in zip(frames, joint, strict=True):
        unit, _ = along_of(place.fit)
        for end, (flag, start, epoch) in enumerate(
            ((StreakFlag.EDGE0, place.along0, place.t_open_s), (StreakFlag.EDGE1, place.along1, place.t_close_s))
        ):
            if fit.flags & flag:
                continue
            shift_px = np.array(end_of(fit, end)) - np.array(end_of(place.fit, end))
            t_s.append(epoch + place.line_time_s * shift_px[0])
            along.append(start + place.along_per_px * float(shift_px @ unit))
            block = np.asarray(fit.covariance_px2)[2 * end : 2 * end + 2, 2 * end : 2 * end + 2]
            sigma.append(float(np.sqrt(max(float(unit @ block @ unit), 0.0))))
    return t_s, along, sigma


def along_of(fit: StreakFit) -> tuple[Array, float]:
    """Unit vector (row, col) from end 0 to end 1, and the length."""
    length = max(fit.length_px, 1e-6)
    return np.array([fit.row1 - fit.row0, fit.col1 - fit.col0]) / length, length


def end_of(fit: StreakFit, end: int) -> tuple[float, float]:
    """Row and column of end 0 or 1, px."""
    return (fit.row0, fit.col0) if end == 0 else (fit.row1, fit.col1)
