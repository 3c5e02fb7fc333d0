"""What linking says of each streak: order of its ends by time, true epochs, tracklet."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ground.link.hypotheses import unit_vectors
from sboc_e2e.icd.errors import ContractError
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.products import StreakFit, StreakMeasurement, Tracklet


def reversed_fit(fit: StreakFit) -> StreakFit:
    """The same trail with end 0 and end 1 exchanged."""
    swap = [2, 3, 0, 1]
    return replace(
        fit,
        row0=fit.row1,
        col0=fit.col1,
        row1=fit.row0,
        col1=fit.col0,
        covariance_px2=fit.covariance_px2[np.ix_(swap, swap)],
        end_interval_px=fit.end_interval_px[::-1],
        sagitta_px=-fit.sagitta_px,
        gradient=-fit.gradient,
        light_curve_e_px=fit.light_curve_e_px[::-1],
        flags=_edges_exchanged(fit.flags),
    )


def _edges_exchanged(flags: StreakFlag) -> StreakFlag:
    """EDGE0 for EDGE1 and the other way round."""
    edges = StreakFlag.EDGE0 | StreakFlag.EDGE1
    out = flags & ~edges
    if flags & StreakFlag.EDGE0:
        out |= StreakFlag.EDGE1
    if flags & StreakFlag.EDGE1:
        out |= StreakFlag.EDGE0
    return out


def reversed_streak(streak: StreakMeasurement) -> StreakMeasurement:
    """The same streak with its ends exchanged."""
    return replace(
        streak,
        fit=reversed_fit(streak.fit),
        ra_deg=streak.ra_deg[::-1],
        dec_deg=streak.dec_deg[::-1],
        t_tai_ns=streak.t_tai_ns[::-1],
        flags=_edges_exchanged(streak.flags),
    )


def apply_links(
    streaks: Sequence[StreakMeasurement], tracklets: Sequence[Tracklet], headers: Sequence[FrameHeader]
) -> tuple[StreakMeasurement, ...]:
    """Streaks with tracklet id, ends by time, true epochs and DIRECTION_RESOLVED; the unlinked ones with SINGLE_FRAME.

    Any linker's tracklets will do: the direction of a member is that of the tracklet's regression on time, on the sky, or in
    pixels when the tracklet has no sky positions. Errors: a `ContractError` for a tracklet whose streak or frame is not given.
    """
    by_frame = {header.frame: header for header in headers}
    at = {(s.frame, s.streak_id): k for k, s in enumerate(streaks)}
    out = [replace(s, tracklet_id=-1, flags=s.flags | StreakFlag.SINGLE_FRAME) for s in streaks]
    for tracklet in tracklets:
        keys = list(zip(tracklet.frames.tolist(), tracklet.streak_ids.tolist(), strict=True))
        for key in keys:
            if key not in at or key[0] not in by_frame:
                raise ContractError(f"tracklet {tracklet.tracklet_id}: streak {key[1]} of frame {key[0]} is not given")
        members = [streaks[at[key]] for key in keys]
        sky = not tracklet.flags & StreakFlag.NO_SKY
        motion = _sky_rate(tracklet) if sky else _pixel_rate(members, [by_frame[key[0]] for key in keys])
        for key, member in zip(keys, members, strict=True):
            out[at[key]] = _resolved(member, tracklet, by_frame[key[0]], motion, sky)
    return tuple(out)


def _slope(t_ns: NDArray[np.int64], position: NDArray[np.float64]) -> NDArray[np.float64]:
    """Least-squares rate (per second) of positions (m, k)."""
    t_s = (t_ns - t_ns[0]) * 1e-9
    t_s = t_s - t_s.mean()
    return np.asarray(t_s @ (position - position.mean(axis=0)) / max(float(t_s @ t_s), 1e-30))


def _sky_rate(tracklet: Tracklet) -> NDArray[np.float64]:
    """Mean rate of the unit vector (rad/s)."""
    return _slope(tracklet.t_tai_ns, unit_vectors(tracklet.ra_deg, tracklet.dec_deg))


def _pixel_rate(members: Sequence[StreakMeasurement], headers: Sequence[FrameHeader]) -> NDArray[np.float64]:
    """Mean rate (rows, cols per second)."""
    t_ns = np.array(
        [h.t_start_tai_ns + h.exposure_ns // 2 + round(h.line_time_ns * s.row_mid) for s, h in zip(members, headers, strict=True)]
    )
    return _slope(t_ns, np.array([(s.row_mid, s.col_mid) for s in members]))


def _resolved(
    streak: StreakMeasurement, tracklet: Tracklet, header: FrameHeader, motion: NDArray[np.float64], sky: bool
) -> StreakMeasurement:
    """One member with its ends in the order of the motion, and the epochs of both ends and the middle."""
    flags = streak.flags & ~StreakFlag.SINGLE_FRAME
    if not tracklet.direction_resolved or flags & StreakFlag.POINT_LIKE:
        return replace(streak, tracklet_id=tracklet.tracklet_id, flags=flags)
    chord = _chord(streak, sky)
    if float(motion @ chord) < 0.0:
        streak, chord = reversed_streak(streak), -chord
    speed = float(np.linalg.norm(motion))
    crossing_ns = float(np.linalg.norm(chord)) / max(speed, 1e-15) * 1e9
    epochs, fast = _epochs_ns(streak, header, crossing_ns)
    flags = streak.flags & ~StreakFlag.SINGLE_FRAME | StreakFlag.DIRECTION_RESOLVED
    if fast:
        flags |= StreakFlag.FAST_ROWS
    return replace(streak, t_tai_ns=np.array(epochs, dtype=np.int64), tracklet_id=tracklet.tracklet_id, flags=flags)


def _chord(streak: StreakMeasurement, sky: bool) -> NDArray[np.float64]:
    """End 1 minus end 0: unit vectors on the sky, or rows and cols."""
    if not sky:
        return np.array([streak.fit.row1 - streak.fit.row0, streak.fit.col1 - streak.fit.col0])
    ends = unit_vectors(streak.ra_deg, streak.dec_deg)
    return np.asarray(ends[2] - ends[0])


def _epochs_ns(streak: StreakMeasurement, header: FrameHeader, crossing_ns: float) -> tuple[tuple[int, int, int], bool]:
    """Epochs of end 0, middle, end 1 of a streak whose ends are in time order, and whether it overtook the read-out.

    crossing_ns : time the object needs from end 0 to end 1 at the tracklet's speed; it chooses between the two speeds of a
    streak that may have overtaken the read-out, and dates an end that the frame's edge cut off.
    """
    t0, line, exposure = header.t_start_tai_ns, header.line_time_ns, header.exposure_ns
    row0, row1 = streak.fit.row0, streak.fit.row1
    along_rows_ns = line * (row1 - row0)
    slow_ns, fast_ns = exposure + along_rows_ns, along_rows_ns - exposure
    fast = fast_ns > 0.0 and abs(np.log(fast_ns / crossing_ns)) < abs(np.log(max(slow_ns, 1.0) / crossing_ns))
    first_ns = t0 + round(line * row0) + (exposure if fast else 0)
    last_ns = t0 + round(line * row1) + (0 if fast else exposure)
    cut0, cut1 = bool(streak.flags & StreakFlag.EDGE0), bool(streak.flags & StreakFlag.EDGE1)
    if cut0 and not cut1:
        first_ns = last_ns - round(crossing_ns)
    elif cut1 and not cut0:
        last_ns = first_ns + round(crossing_ns)
    return (first_ns, (first_ns + last_ns) // 2, last_ns), fast
