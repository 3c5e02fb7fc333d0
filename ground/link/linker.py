"""`ground.linker: motion`: streaks of all frames into tracklets by the evidence for one moving object against chance."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ground.link.hypotheses import FrameTable, Nodes, StreakTable, frame_table, has_sky, nodes_of, streak_table
from ground.link.motion import N_PARAMETERS
from ground.link.search import candidates, find_pairs, gain_of, grow
from ground.link.tracks import Track, tracklet_of
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.products import StreakMeasurement, Tracklet


@dataclass(frozen=True, kw_only=True)
class MotionLinker:
    """Bayesian multi-frame linking; streaks are linked on the sky where they have positions there, else in pixels."""

    max_missed_frames: int = field(default=4, metadata={"doc": "frames that may pass without a streak", "min": 0, "max": 100})
    min_log_odds: float = field(
        default=9.2, metadata={"doc": "natural log odds against chance that a tracklet needs", "min": -20.0, "max": 100.0}
    )
    new_objects_per_frame: float = field(
        default=0.01, metadata={"doc": "objects that come into view per frame, to first order", "min": 1e-9, "max": 1e3}
    )
    detection_probability: float = field(
        default=0.8, metadata={"doc": "that a linked object is seen in a frame", "min": 0.01, "max": 0.999}
    )
    sigma_floor_px: float = field(
        default=0.2, metadata={"doc": "error of ends beyond the fit's: pointing, model", "min": 0.0, "max": 100.0}
    )
    pixel_scale_arcsec: float = field(
        default=5.0, metadata={"doc": "assumed where no streak shows the scale", "min": 1e-3, "max": 1e4}
    )
    sigma_acceleration_arcsec_s2: float = field(
        default=0.6, metadata={"doc": "differential gravity, on the sky", "min": 1e-6, "max": 1e5}
    )
    sigma_acceleration_px_s2: float = field(
        default=5.0, metadata={"doc": "turning of the camera, where pixels are linked", "min": 1e-6, "max": 1e5}
    )

    def link(self, headers: Sequence[FrameHeader], streaks: Sequence[StreakMeasurement]) -> tuple[Tracklet, ...]:
        """Tracklets of two or more frames, by falling evidence; their ids count from 0."""
        frames = frame_table(headers)
        alive = [k for k, s in enumerate(streaks) if not s.flags & StreakFlag.VETOED]
        tracks: list[tuple[Track, StreakTable, bool]] = []
        for sky in (True, False):
            index = [k for k in alive if has_sky(streaks[k]) is sky]
            if len(index) < 2:
                continue
            table = streak_table(
                streaks, index, frames, sky=sky, pixel_scale_arcsec=self.pixel_scale_arcsec, sigma_floor_px=self.sigma_floor_px
            )
            tracks += [(track, table, sky) for track in self.tracks(table, frames, sky=sky)]
        tracks.sort(key=lambda entry: -entry[0].log_odds)
        return tuple(tracklet_of(number, track, table, frames, streaks, sky) for number, (track, table, sky) in enumerate(tracks))

    def tracks(self, table: StreakTable, frames: FrameTable, *, sky: bool) -> list[Track]:
        """Tracks of one group of streaks, all on the sky or all in pixels."""
        if len(table.frame) < 2:
            return []
        nodes = nodes_of(table, frames)
        scale = float(table.scale_rad_px[0])
        shape = frames.shape[table.frame[0]]
        log_area = math.log(float(shape[0]) * float(shape[1]) * scale**2)
        diagonal = math.hypot(*shape) * scale
        cadence = float(np.median(np.diff(frames.start_s))) if len(frames.start_s) > 1 else 1.0
        scale_s2 = self.sigma_acceleration_arcsec_s2 * math.pi / 648000 if sky else self.sigma_acceleration_px_s2 * scale
        search = Search(
            reach=self.max_missed_frames + 1,
            fastest_rad_s=diagonal / max(cadence - float(np.median(frames.exposure_s)), 0.1 * cadence, 1e-6),
            floor_rad=3.0 * scale,
            log_area=log_area,
            sigma_acceleration=scale_s2,
            log_seen=math.log(self.detection_probability),
            log_missed=math.log(1.0 - self.detection_probability),
            log_new=math.log(self.new_objects_per_frame),
        )
        return best_tracks(nodes, search, self.min_log_odds)


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
"""Log evidence of a pair below which no third streak has been seen to rescue it (two points alone say little)."""


def best_tracks(nodes: Nodes, search: Search, min_log_odds: float) -> list[Track]:
    """Candidates by falling evidence; each streak goes to the first that claims it, later ones are regrown without it."""
    capacity = 4 * len(nodes.frame) + 64
    while True:
        found, pairs, gains = find_pairs(
            nodes, min(search.reach, _SEED_REACH), search.fastest_rad_s, search.floor_rad, search.log_area, search.sigma_acceleration,
            _LOWEST_SEED, capacity,
        )  # fmt: skip
        if found <= capacity:
            break
        capacity = found
    order = np.argsort(-gains[:found], kind="stable")
    growth = (
        search.reach,
        search.floor_rad,
        search.log_area,
        search.sigma_acceleration,
        search.log_seen,
        search.log_missed,
    )
    flat, offsets, gains = candidates(nodes, np.ascontiguousarray(pairs[:found][order]), *growth)
    used = np.zeros(len(nodes.frame) // 2, dtype=np.bool_)
    queue = [flat[offsets[k] : offsets[k + 1]] for k in range(len(gains))]
    accepted: list[Track] = []
    for k in np.argsort(-gains, kind="stable"):
        if gains[k] + search.log_new < min_log_odds:
            break
        members, gain = queue[k], float(gains[k])
        if used[members // 2].any():
            left = members[~used[members // 2]]
            if len(left) < 2:
                continue
            members, gain = grow(nodes, left, used, *growth)
            if gain + search.log_new < min_log_odds:
                continue
        used[members // 2] = True
        accepted.append(_described(nodes, members, search))
    return accepted


def _described(nodes: Nodes, members: NDArray[np.int64], search: Search) -> Track:
    """The track of these hypotheses, with its motion."""
    centre, basis, theta = np.empty(3), np.empty((2, 3)), np.empty(N_PARAMETERS)
    factor = np.empty((N_PARAMETERS, N_PARAMETERS))
    gain, chi2, rows, t_ref = gain_of(
        nodes, members, search.log_area, search.sigma_acceleration, search.log_seen, search.log_missed, centre, basis, theta,
        factor,
    )  # fmt: skip
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
        sigma_rad=nodes.sigma_rad[members],
        units=nodes.unit[members],
    )
