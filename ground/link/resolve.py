"""Result of linking for each streak: order of its ends by time, true epochs, tracklet."""

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ground.sky.measure import redated
from ground.sky.sphere import unit_vectors
from ground.streaks.fit_record import reversed_ends, swap_edge_flags
from sboc_e2e.icd.errors import ContractError
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.products import StreakMeasurement, Tracklet

DATING_ROUNDS: Final = 3
"""Rounds that date an end cut by the frame's edge. The camera turns by about a hundredth of the length of such a trail, so three
rounds date its end to 1e-6 of that length."""


def reversed_streak(streak: StreakMeasurement) -> StreakMeasurement:
    """The same streak with its ends exchanged."""
    return replace(
        streak,
        fit=reversed_ends(streak.fit),
        ra_deg=streak.ra_deg[::-1],
        dec_deg=streak.dec_deg[::-1],
        t_tai_ns=streak.t_tai_ns[::-1],
        flags=swap_edge_flags(streak.flags),
    )


def apply_links(
    streaks: Sequence[StreakMeasurement], tracklets: Sequence[Tracklet], headers: Sequence[FrameHeader]
) -> tuple[StreakMeasurement, ...]:
    """Streaks with tracklet id, ends by time, true epochs and DIRECTION_RESOLVED. Unlinked streaks get SINGLE_FRAME.

    VETOED is removed from members that the vetter had rejected. The tracklets may come from any linker. Of their fields only
    members and pieces are used, and the motion where all members are of one frame.
    Errors: a `ContractError` for a tracklet whose streak or frame is not given.
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
        for key, member in zip(keys, _members_resolved(members, tracklet, [by_frame[key[0]] for key in keys]), strict=True):
            out[at[key]] = member
    return tuple(out)


def pieces_among(members: Sequence[StreakMeasurement], tracklet: Tracklet) -> list[bool]:
    """Which members are pieces of a broken trail: those the linker names, and those that share a frame."""
    named, often = set(tracklet.pieces.tolist()), Counter(s.frame for s in members)
    return [s.streak_id in named or often[s.frame] > 1 for s in members]


def _members_resolved(
    members: Sequence[StreakMeasurement], tracklet: Tracklet, headers: Sequence[FrameHeader]
) -> list[StreakMeasurement]:
    """The members of one tracklet: ends in the order of the motion, and the epochs of both ends and the middle."""
    undone = StreakFlag.SINGLE_FRAME | StreakFlag.VETOED
    members = [replace(s, tracklet_id=tracklet.tracklet_id, flags=s.flags & ~undone) for s in members]
    sky = not any(s.flags & StreakFlag.NO_SKY for s in members)
    motion = _motion_of(members, tracklet, headers, sky) if tracklet.direction_resolved else None
    if motion is None or not float(np.linalg.norm(motion)) > 0.0:
        return members
    ordered, epochs_ns, fast = [], [], []
    for s, header in zip(members, headers, strict=True):
        # The motion relative to a turning camera differs from the motion over the sky.
        passing = motion - np.cross(s.turn_rad_s, _places(s, sky)[1]) if sky else motion
        length = float((_places(s, sky)[2] - _places(s, sky)[0]) @ passing)
        s = s if length >= 0.0 else reversed_streak(s)
        crossing_s = abs(length) / max(float(passing @ passing), 1e-30)
        epochs, overtakes = _shutter_epochs_ns(s, header, max(crossing_s * 1e9, 1.0))
        ordered.append(s)
        epochs_ns.append(epochs)
        fast.append(overtakes)
    # The shutter made an end, unless the end is on the frame's edge or belongs to a piece of a broken trail.
    timed = np.array(
        [
            (not piece and not s.flags & StreakFlag.EDGE0, not piece and not s.flags & StreakFlag.EDGE1)
            for s, piece in zip(ordered, pieces_among(ordered, tracklet), strict=True)
        ]
    )
    heading = motion / float(np.linalg.norm(motion))

    def along_of(s: StreakMeasurement, epochs: Sequence[int]) -> NDArray[np.float64]:
        """Places of both ends along the motion, as they were seen at these epochs."""
        dated = redated(s, np.array([epochs[0], s.t_tai_ns[1], epochs[1]])) if sky else s
        return np.asarray(_places(dated, sky)[[0, 2]] @ heading)

    along = np.array([along_of(s, epochs) for s, epochs in zip(ordered, epochs_ns, strict=True)])
    clock = _clock(along, np.array(epochs_ns), timed)
    return [
        s if s.flags & StreakFlag.POINT_LIKE else _dated(s, along_of, epochs, known, overtakes, clock, sky)
        for s, epochs, known, overtakes in zip(ordered, epochs_ns, timed.tolist(), fast, strict=True)
    ]


def _motion_of(
    members: Sequence[StreakMeasurement], tracklet: Tracklet, headers: Sequence[FrameHeader], sky: bool
) -> NDArray[np.float64] | None:
    """Mean rate per second, of unit vectors or of rows and cols; the rate of the tracklet if all members are of one frame."""
    if len({s.frame for s in members}) > 1:
        t_ns = np.array(
            [
                h.t_start_tai_ns + h.exposure_ns // 2 + round(h.line_time_ns * s.row_mid)
                for s, h in zip(members, headers, strict=True)
            ]
        )
        return _slope(t_ns, np.array([_places(s, sky)[1] for s in members]))
    known = np.isfinite(tracklet.ra_deg) & np.isfinite(tracklet.dec_deg)
    if not sky or len(np.unique(tracklet.t_tai_ns[known])) < 2:
        return None
    unit = unit_vectors(np.radians(tracklet.ra_deg[known]), np.radians(tracklet.dec_deg[known]))
    return _slope(tracklet.t_tai_ns[known], unit)


def _dated(
    streak: StreakMeasurement,
    along_of: Callable[[StreakMeasurement, Sequence[int]], NDArray[np.float64]],
    epochs_ns: tuple[int, int],
    timed: Sequence[bool],
    overtakes: bool,
    clock: Callable[[float], float] | None,
    sky: bool,
) -> StreakMeasurement:
    """A member with its epochs, and its directions at these epochs.

    An end that the shutter made has the shutter's epoch. Another end has the epoch at which the motion passed it. Without a clock
    (`_clock`) such an end has no epoch, and its streak does not change.
    """
    ends = list(epochs_ns)
    if clock is None and not all(timed):
        return streak
    for _ in range(0 if all(timed) else DATING_ROUNDS):
        along = along_of(streak, ends)
        for k in (0, 1):
            if clock is not None and not timed[k]:
                # The clock is a smooth fit. It predicts a difference of two places better than the epoch of one.
                anchor_ns = ends[1 - k] - clock(along[1 - k]) if timed[1 - k] else 0.0
                ends[k] = round(clock(along[k]) + anchor_ns)
    flags = streak.flags | StreakFlag.DIRECTION_RESOLVED
    if overtakes:
        flags |= StreakFlag.FAST_ROWS
    epochs = np.array([ends[0], (ends[0] + ends[1]) // 2, ends[1]], dtype=np.int64)
    return replace(redated(streak, epochs) if sky else replace(streak, t_tai_ns=epochs), flags=flags)


def _clock(along: NDArray[np.float64], epochs_ns: NDArray[np.int64], timed: NDArray[np.bool_]) -> Callable[[float], float] | None:
    """Epoch (ns) as a quadratic of the place along the motion, through the ends (n, 2) at which the shutter acted; None where
    fewer than two places are dated."""
    zero_ns = int(epochs_ns.mean())
    place = along[timed]
    t_ns = (epochs_ns[timed] - zero_ns).astype(np.float64)
    if len(np.unique(place)) < 2:
        return None
    centre, spread = float(place.mean()), float(np.ptp(place))
    coefficients = np.polynomial.polynomial.polyfit((place - centre) / spread, t_ns, 2 if len(np.unique(place)) > 3 else 1)
    return lambda s: zero_ns + float(np.polynomial.polynomial.polyval((s - centre) / spread, coefficients))


def _slope(t_ns: NDArray[np.int64], position: NDArray[np.float64]) -> NDArray[np.float64]:
    """Least-squares rate (per second) of positions (m, k)."""
    t_s = (t_ns - t_ns[0]) * 1e-9
    t_s = t_s - t_s.mean()
    return np.asarray(t_s @ (position - position.mean(axis=0)) / max(float(t_s @ t_s), 1e-30))


def _places(streak: StreakMeasurement, sky: bool) -> NDArray[np.float64]:
    """End 0, middle, end 1: unit vectors (3, 3) or rows and cols (3, 2)."""
    fit = streak.fit
    if not sky:
        return np.array([[fit.row0, fit.col0], [streak.row_mid, streak.col_mid], [fit.row1, fit.col1]])
    return unit_vectors(np.radians(streak.ra_deg), np.radians(streak.dec_deg))


def _shutter_epochs_ns(streak: StreakMeasurement, header: FrameHeader, crossing_ns: float) -> tuple[tuple[int, int], bool]:
    """Epochs of end 0 and end 1 of a streak with ends in time order, and whether the object overtook the read-out.

    crossing_ns : time from end 0 to end 1 at the tracklet's speed; it chooses between the two speeds that a streak has whose
    object may have overtaken the read-out (then the shutter closes on end 0 before it opens on end 1).
    """
    t0, line, exposure = header.t_start_tai_ns, header.line_time_ns, header.exposure_ns
    row0, row1 = streak.fit.row0, streak.fit.row1
    along_rows_ns = line * (row1 - row0)
    slow_ns, fast_ns = exposure + along_rows_ns, along_rows_ns - exposure
    fast = fast_ns > 0.0 and abs(math.log(fast_ns / crossing_ns)) < abs(math.log(max(slow_ns, 1.0) / crossing_ns))
    first_ns = t0 + round(line * row0) + (exposure if fast else 0)
    last_ns = t0 + round(line * row1) + (0 if fast else exposure)
    return (first_ns, last_ns), fast
