"""What linking says of each streak: order of its ends by time, true epochs, tracklet."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ground.sky.sphere import unit_vectors
from ground.streaks.fit_record import reversed_ends, swap_edge_flags
from sboc_e2e.icd.errors import ContractError
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.products import StreakMeasurement, Tracklet


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
    """Streaks with tracklet id, ends by time, true epochs and DIRECTION_RESOLVED; the unlinked ones with SINGLE_FRAME.

    A member that the vetter had rejected is rehabilitated: VETOED goes. Any linker's tracklets will do: the direction of a
    member is that of the tracklet's regression on time, on the sky, or in pixels when the tracklet has no sky positions.
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


def _members_resolved(
    members: Sequence[StreakMeasurement], tracklet: Tracklet, headers: Sequence[FrameHeader]
) -> list[StreakMeasurement]:
    """The members of one tracklet: ends in the order of the motion, and the epochs of both ends and the middle."""
    undone = StreakFlag.SINGLE_FRAME | StreakFlag.VETOED
    members = [replace(s, tracklet_id=tracklet.tracklet_id, flags=s.flags & ~undone) for s in members]
    if not tracklet.direction_resolved:
        return members
    sky = not tracklet.flags & StreakFlag.NO_SKY
    motion = _sky_rate(tracklet) if sky else _pixel_rate(members, headers)
    speed = max(float(np.linalg.norm(motion)), 1e-15)
    heading = motion / speed
    ordered = [s if float(np.diff(_ends(s, sky) @ heading)[0]) >= 0.0 else reversed_streak(s) for s in members]
    along = np.array([_ends(s, sky) @ heading for s in ordered])
    epochs_ns, fast, timed = [], [], []
    for s, header, (first, last) in zip(ordered, headers, along, strict=True):
        epochs, overtakes = _shutter_epochs_ns(s, header, max((last - first) / speed * 1e9, 1.0))
        epochs_ns.append(epochs)
        fast.append(overtakes)
        timed.append(_timed_ends(s, epochs, tracklet.t_tai_ns, header.exposure_ns // 50))
    clock = _clock(along, np.array(epochs_ns), np.array(timed), tracklet.t_ref_tai_ns)
    return [
        s if s.flags & StreakFlag.POINT_LIKE else _dated(s, places, epochs, known, overtakes, clock)
        for s, places, epochs, known, overtakes in zip(ordered, along, epochs_ns, timed, fast, strict=True)
    ]


def _dated(
    streak: StreakMeasurement,
    along: NDArray[np.float64],
    epochs_ns: tuple[int, int],
    timed: tuple[bool, bool],
    overtakes: bool,
    clock: Callable[[float], float],
) -> StreakMeasurement:
    """A member with its epochs: the shutter's where it acted, else those at which the motion passed the end."""
    ends = [epoch if known else 0 for epoch, known in zip(epochs_ns, timed, strict=True)]
    for k in (0, 1):
        if not timed[k]:
            # the clock is a smooth fit: what it says between two places is better than what it says at one
            anchor_ns = ends[1 - k] - clock(along[1 - k]) if timed[1 - k] else 0.0
            ends[k] = round(clock(along[k]) + anchor_ns)
    flags = streak.flags | StreakFlag.DIRECTION_RESOLVED
    if overtakes:
        flags |= StreakFlag.FAST_ROWS
    return replace(streak, t_tai_ns=np.array([ends[0], (ends[0] + ends[1]) // 2, ends[1]], dtype=np.int64), flags=flags)


def _clock(
    along: NDArray[np.float64], epochs_ns: NDArray[np.int64], timed: NDArray[np.bool_], t_ref_ns: int
) -> Callable[[float], float]:
    """Epoch (ns) as a quadratic of the place along the motion, through the ends (n, 2) at which the shutter acted."""
    place = along[timed]
    t_ns = (epochs_ns[timed] - t_ref_ns).astype(np.float64)
    if len(np.unique(place)) < 2:
        return lambda s: float(t_ref_ns)
    centre, spread = float(place.mean()), float(np.ptp(place))
    coefficients = np.polynomial.polynomial.polyfit((place - centre) / spread, t_ns, 2 if len(np.unique(place)) > 3 else 1)
    return lambda s: t_ref_ns + float(np.polynomial.polynomial.polyval((s - centre) / spread, coefficients))


def _timed_ends(
    streak: StreakMeasurement, epochs_ns: tuple[int, int], listed_ns: NDArray[np.int64], slack_ns: int
) -> tuple[bool, bool]:
    """Which ends are where the shutter opened or closed: not those on an edge, and none of a piece of a broken trail.

    A tracklet lists epochs of its whole members' ends or middles; a streak with none of these (to `slack_ns`) is a piece.
    """
    middle = (epochs_ns[0] + epochs_ns[1]) // 2
    whole = any(int(np.abs(listed_ns - epoch).min()) <= slack_ns for epoch in (*epochs_ns, middle))
    return whole and not streak.flags & StreakFlag.EDGE0, whole and not streak.flags & StreakFlag.EDGE1


def _slope(t_ns: NDArray[np.int64], position: NDArray[np.float64]) -> NDArray[np.float64]:
    """Least-squares rate (per second) of positions (m, k)."""
    t_s = (t_ns - t_ns[0]) * 1e-9
    t_s = t_s - t_s.mean()
    return np.asarray(t_s @ (position - position.mean(axis=0)) / max(float(t_s @ t_s), 1e-30))


def _sky_rate(tracklet: Tracklet) -> NDArray[np.float64]:
    """Mean rate of the unit vector (rad/s)."""
    return _slope(tracklet.t_tai_ns, unit_vectors(np.radians(tracklet.ra_deg), np.radians(tracklet.dec_deg)))


def _pixel_rate(members: Sequence[StreakMeasurement], headers: Sequence[FrameHeader]) -> NDArray[np.float64]:
    """Mean rate (rows, cols per second)."""
    t_ns = np.array(
        [h.t_start_tai_ns + h.exposure_ns // 2 + round(h.line_time_ns * s.row_mid) for s, h in zip(members, headers, strict=True)]
    )
    return _slope(t_ns, np.array([(s.row_mid, s.col_mid) for s in members]))


def _ends(streak: StreakMeasurement, sky: bool) -> NDArray[np.float64]:
    """Both ends: unit vectors (2, 3) or rows and cols (2, 2)."""
    if not sky:
        return np.array([[streak.fit.row0, streak.fit.col0], [streak.fit.row1, streak.fit.col1]])
    return unit_vectors(np.radians(streak.ra_deg[[0, 2]]), np.radians(streak.dec_deg[[0, 2]]))


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
