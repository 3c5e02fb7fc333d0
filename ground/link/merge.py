"""After the search: fragments of one object are joined, and pieces of broken trails are added to the track they lie on."""

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ground.link.hypotheses import CROSSING, ENTERING, LEAVING, FrameTable, Nodes, StreakTable
from ground.link.motion import N_PARAMETERS, position_on_plane, to_plane, velocity_on_plane
from ground.link.search import chi2_gate, gain_of
from ground.link.tracks import Track
from sboc_e2e.icd.flags import StreakFlag

_GAP_FACTOR = 4
"""Fragments may be this many times farther apart than the reach of the search, because two motions predict better than one
streak."""
_PIECE_SIGMA = 6.0  # across the motion: a right piece in 5e8 lies beyond it, and the track's errors are not Gaussian
_VETOED = int(StreakFlag.VETOED)
_SHORTEST_PIECE_PX = 8.0
"""As short as that, streaks are chance; one of 8 px has its direction to some 10 deg. Chosen, not measured."""


def merged(
    nodes: Nodes,
    tracks: list[NDArray[np.int64]],
    gains: list[float],
    reach: int,
    log_new: float,
    model: tuple[float, float, float, float],
) -> tuple[list[NDArray[np.int64]], list[float]]:
    """Join tracks that one motion explains better than two objects do, best first, until none is left to join.

    model : log_area, sigma_acceleration, log_seen, log_missed as for `gain_of`.
    """
    centre, basis, theta = np.empty(3), np.empty((2, 3)), np.empty(N_PARAMETERS)
    factor = np.empty((N_PARAMETERS, N_PARAMETERS))
    order = np.argsort([nodes.frame[t[0]] for t in tracks], kind="stable")
    tracks, gains = [tracks[k] for k in order], [gains[k] for k in order]
    first = np.array([nodes.frame[t[0]] for t in tracks], dtype=np.int64)
    motion = np.array([_mean_motion(nodes, t) for t in tracks]).reshape(-1, 7)
    alive = np.ones(len(tracks), dtype=np.bool_)
    for k in range(len(tracks)):
        while alive[k] and nodes.kind[tracks[k][-1]] != LEAVING:
            last = int(nodes.frame[tracks[k][-1]])
            low, high = np.searchsorted(first, [last + 1, last + 1 + _GAP_FACTOR * reach])
            best, best_gain, joined = -1, gains[k] + log_new, tracks[k]
            for j in low + np.flatnonzero(alive[low:high] & _suits(motion[k], motion[low:high])):
                if nodes.kind[tracks[j][0]] == ENTERING:
                    continue
                trial = np.concatenate([tracks[k], tracks[j]])
                gain, chi2, rows, _ = gain_of(nodes, trial, model, centre, basis, theta, factor)
                if gain - gains[j] > best_gain and chi2 < chi2_gate(rows):
                    best, best_gain, joined = int(j), gain - gains[j], trial
            if best < 0:
                break
            tracks[k], gains[k], motion[k] = joined, best_gain + gains[best], _mean_motion(nodes, joined)
            alive[best] = False
    keep = np.flatnonzero(alive)
    return [tracks[k] for k in keep], [gains[k] for k in keep]


def _mean_motion(nodes: Nodes, members: NDArray[np.int64]) -> NDArray[np.float64]:
    """Mean epoch (s), mean direction and mean rate (rad/s) of a track: (7,)."""
    t, unit = nodes.t_s[members].ravel(), nodes.unit[members].reshape(-1, 3)
    centred = t - t.mean()
    slope = centred @ (unit - unit.mean(axis=0)) / max(float(centred @ centred), 1e-12)
    return np.concatenate([[t.mean()], unit.mean(axis=0), slope])


def _suits(one: NDArray[np.float64], others: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Mask (n,) of the other tracks (n, 7) that lie where the mean of both motions leads, within half of the distance."""
    dt = others[:, 0] - one[0]
    way = 0.5 * (one[4:] + others[:, 4:]) * dt[:, None]
    off = np.linalg.norm(others[:, 1:4] - one[1:4] - way, axis=1)
    return np.asarray(off < 0.5 * np.linalg.norm(way, axis=1) + 1e-4)


def pieces_of(
    track: Track, table: StreakTable, frames: FrameTable, kind: NDArray[np.int8], used: NDArray[np.bool_]
) -> NDArray[np.int64]:
    """Unused streaks (rows of the table) that are pieces of the track's trail, in frames where it has no whole one."""
    members = table.frame[track.members // 2]
    first, last = max(int(members.min()) - 1, 0), min(int(members.max()) + 1, len(frames.number) - 1)
    open_frames = np.ones(len(frames.number), dtype=np.bool_)
    open_frames[members] = False
    if not open_frames[first : last + 1].any():
        return np.zeros(0, dtype=np.int64)
    return np.asarray(_pieces(track_motion(track), table, frames, kind, used, open_frames, first, last))


class Motion(NamedTuple):
    """The numbers of a track's motion (see `motion.fit_motion`)."""

    centre: NDArray[np.float64]
    basis: NDArray[np.float64]
    theta: NDArray[np.float64]
    t_ref_s: float


def track_motion(track: Track) -> Motion:
    """Motion of a track for compiled code."""
    return Motion(centre=track.centre, basis=track.basis, theta=track.theta, t_ref_s=track.t_ref_s)


@njit(cache=True)
def cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Vector product (3,)."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


@njit(cache=True)
def _pieces(
    motion: Motion,
    table: StreakTable,
    frames: FrameTable,
    kind: NDArray[np.int8],
    used: NDArray[np.bool_],
    open_frames: NDArray[np.bool_],
    first: int,
    last: int,
) -> NDArray[np.int64]:
    """Streaks whose both ends the object passed while the shutter of their rows was open."""
    low, high = np.searchsorted(table.frame, first), np.searchsorted(table.frame, last + 1)
    found = np.empty(high - low, dtype=np.int64)
    n = 0
    for k in range(low, high):
        f = table.frame[k]
        vetoed = (table.flags[k] & _VETOED) != 0
        if used[k] or vetoed or kind[2 * k] == CROSSING or not open_frames[f]:
            continue
        scale, exposure = table.scale_rad_px[k], frames.exposure_s[f]
        inside = True
        length = 0.0
        for c in range(3):
            length += (table.unit[k, 2, c] - table.unit[k, 0, c]) ** 2
        length = math.sqrt(length)
        for end in (0, 2):
            here, drift = table.unit[k, end], cross(table.turn_rad_s[k], table.unit[k, end])
            x, y = to_plane(here, motion.centre, motion.basis)
            opened = frames.start_s[f] + frames.line_time_s[f] * table.row[k, end] - motion.t_ref_s
            t = opened + 0.5 * exposure
            vx, vy = velocity_on_plane(motion.theta, t)
            speed = max(math.hypot(vx, vy), 1e-12)
            px, py = position_on_plane(motion.theta, t)
            # short ones may be chance; and most streaks are far from the track
            shortest = max(_SHORTEST_PIECE_PX * scale, 0.1 * speed * exposure)
            if length < shortest or math.hypot(x - px, y - py) > speed * exposure + 5.0 * scale:
                inside = False
                break
            middle = t
            for _ in range(3):
                x, y = to_plane(here + drift * (t - middle), motion.centre, motion.basis)
                t += ((x - px) * vx + (y - py) * vy) / speed**2
                px, py = position_on_plane(motion.theta, t)
            slack = 3.0 * scale / speed
            across = math.hypot(x - px, y - py)
            if across > _PIECE_SIGMA * table.sigma_cross_rad[k] + scale or not opened - slack < t < opened + exposure + slack:
                inside = False
                break
        if inside:
            found[n] = k
            n += 1
    return found[:n]
