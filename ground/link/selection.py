"""Choice among candidate tracks: each streak goes to the track with the most evidence; then fragments and pieces.

A streak that is the same light as one that a track took is taken with it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ground.link.groups import tracked_groups
from ground.link.hypotheses import POINT, FrameTable, Nodes, StreakTable
from ground.link.merge import merged, pieces_of
from ground.link.motion import N_PARAMETERS
from ground.link.noise_tracks import joint_snr, log_odds_of_tracks
from ground.link.same_light import SameLight
from ground.link.search import candidates, find_pairs, gain_of, grow
from ground.link.tracks import Track
from ground.streaks.forced import FORCED_SNR
from sboc_e2e.icd.flags import StreakFlag


@dataclass(frozen=True, kw_only=True)
class Search:
    """Numbers that the search needs, in radians and seconds; logarithms are natural."""

    reach: int
    fastest_rad_s: float
    floor_rad: float
    log_area: float
    sigma_acceleration: float
    log_seen: float
    log_missed: float
    log_new: float


_SEED_REACH = 3
"""Frames between the two streaks that start a search; an object that is seen every third frame only is found by growth."""
_LOWEST_SEED = -12.0
"""Least log evidence of a pair. Below it, no third streak was ever seen to confirm a pair."""


def best_tracks(nodes: Nodes, table: StreakTable, frames: FrameTable, search: Search, min_log_odds: float) -> list[Track]:
    """Candidates by falling evidence; each streak goes to the first that claims it, later ones are regrown without it."""
    capacity = 4 * len(nodes.frame) + 64
    while True:
        found, pairs, gains = find_pairs(
            nodes, min(search.reach, _SEED_REACH), search.fastest_rad_s, search.floor_rad, search.log_area,
            search.sigma_acceleration, _LOWEST_SEED, capacity,
        )  # fmt: skip
        if found <= capacity:
            break
        capacity = found
    order = np.argsort(-gains[:found], kind="stable")
    model = (search.log_area, search.sigma_acceleration, search.log_seen, search.log_missed)
    growth = (search.reach, search.floor_rad, model)
    flat, offsets, gains = candidates(nodes, np.ascontiguousarray(pairs[:found][order]), *growth)
    used = np.zeros(len(nodes.frame) // 2, dtype=np.bool_)
    accepted: list[NDArray[np.int64]] = []
    accepted_gains: list[float] = []
    light = SameLight(table)
    groups: list[tuple[NDArray[np.int64], float]] = []
    for members, gain in sorted(tracked_groups(nodes, table, model, search.log_new), key=lambda g: (-g[1], -len(g[0]))):
        # The joint test on board holds for all of a track's light together: what is left of it is linked as other streaks are.
        if not used[members // 2].any():
            groups.append((members, gain))
            used[light.with_twins(members // 2)] = True  # before any grows: no track may take what another one started with
    for members, gain in groups:
        longer, longer_gain = grow(nodes, members, used, *growth)
        used[light.with_twins(longer // 2)] = True
        accepted.append(longer)
        accepted_gains.append(max(gain, longer_gain))
    for k in np.argsort(-gains, kind="stable"):
        if gains[k] + search.log_new < min_log_odds:
            break
        members, gain = flat[offsets[k] : offsets[k + 1]], float(gains[k])
        if used[members // 2].any():
            left = members[~used[members // 2]]
            if len(left) < 2:
                continue
            members, gain = grow(nodes, left, used, *growth)
            if gain + search.log_new < min_log_odds:
                continue
        if is_static(nodes, table, members):
            continue
        used[light.with_twins(members // 2)] = True
        accepted.append(members)
        accepted_gains.append(gain)
    joined, _ = merged(nodes, accepted, accepted_gains, search.reach, search.log_new, model)
    tracks = []
    for members in joined:
        track = _described(nodes, members, search)
        pieces = pieces_of(track, table, frames, nodes.kind, used)
        used[pieces] = True
        tracks.append(replace(track, pieces=pieces))
    return told_from_noise(tracks, table, frames)


def told_from_noise(tracks: Sequence[Track], table: StreakTable, frames: FrameTable) -> list[Track]:
    """The tracks without those that are rather noise's.

    Places that an on-board track foretold lie on one motion whatever they show. Where no member is seen in its own frame, the
    light of all together gives the odds.
    """
    snr = np.array([_seen_together(track.members // 2, table) for track in tracks])
    told = np.isfinite(snr)
    odds = np.array([track.log_odds for track in tracks])
    if told.any():
        shape = frames.shape[table.frame[0]]
        odds[told] = log_odds_of_tracks(snr[told], len(frames.number), (float(shape[0]), float(shape[1])))
    return [replace(track, log_odds=float(o)) for track, o, known in zip(tracks, odds, told, strict=True) if o > 0.0 or not known]


def _seen_together(streaks: NDArray[np.int64], table: StreakTable) -> float:
    """Mean of the joint S/N on board and on ground of trails that no single frame shows; NaN where one does, and of points."""
    foretold = (table.track_snr[streaks] > 0.0) & ~(table.snr[streaks] >= FORCED_SNR)
    point = (table.flags[streaks] & StreakFlag.POINT_LIKE) != 0
    if not foretold.all() or point.any():
        return math.nan
    return 0.5 * (float(table.track_snr[streaks].max()) + joint_snr(table.snr[streaks]))


_LEAST_PATH_PX = 2.0  # below this way on the sky or on the detector it is a star or a defect. Chosen, not measured


def is_static(nodes: Nodes, table: StreakTable, members: NDArray[np.int64]) -> bool:
    """Whether a track of points does not move, on the sky (a star's residual) or in the frame (a hot pixel)."""
    if (nodes.kind[members] != POINT).any():
        return False
    streak = members // 2
    first, last = streak[: max(len(streak) // 3, 1)], streak[-max(len(streak) // 3, 1) :]
    sky = np.linalg.norm(table.unit[last, 1].mean(axis=0) - table.unit[first, 1].mean(axis=0)) / table.scale_rad_px[0]
    pixels = math.hypot(*(p[last, 1].mean() - p[first, 1].mean() for p in (table.row, table.col)))
    return bool(min(float(sky), pixels) < _LEAST_PATH_PX)


def _described(nodes: Nodes, members: NDArray[np.int64], search: Search) -> Track:
    """The track of these hypotheses, with its motion."""
    centre, basis, theta = np.empty(3), np.empty((2, 3)), np.empty(N_PARAMETERS)
    factor = np.empty((N_PARAMETERS, N_PARAMETERS))
    model = (search.log_area, search.sigma_acceleration, search.log_seen, search.log_missed)
    gain, chi2, rows, t_ref = gain_of(nodes, members, model, centre, basis, theta, factor)
    lower = np.linalg.inv(np.tril(factor))
    return Track(
        members=members,
        log_odds=gain + search.log_new,
        chi2_nu=chi2 / max(rows - 4, 1),
        t_ref_s=t_ref,
        centre=centre,
        basis=basis,
        theta=theta,
        covariance=lower.T @ lower,
        points=np.array([[nodes.t_s[m, 0], nodes.t_s[m, 1]] for m in members]),
        kinds=nodes.kind[members].astype(np.int64),
        sigma_rad=nodes.measured_rad[members],
        units=nodes.unit[members],
        pieces=np.zeros(0, dtype=np.int64),
    )
