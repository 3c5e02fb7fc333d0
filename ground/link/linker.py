"""`ground.linker: motion`: streaks of all frames into tracklets by the evidence for one moving object against chance."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from ground.link.hypotheses import FrameTable, StreakTable, frame_table, nodes_of, streak_tables
from ground.link.selection import Search, best_tracks
from ground.link.tracks import Track, tracklet_of
from ground.sky.sphere import ARCSEC_RAD
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.products import StreakMeasurement, Tracklet

NEW_OBJECTS_PER_FRAME: Final = 0.01
"""Objects that come into view per frame, to first order."""

DETECTION_PROBABILITY: Final = 0.8
"""Probability that a linked object is seen in a frame."""

SIGMA_FLOOR_PX: Final = 0.2
"""Error of ends beyond the fit's: pointing, model."""


@dataclass(frozen=True, kw_only=True)
class MotionLinker:
    """Bayesian multi-frame linking; streaks are linked on the sky where they have positions there, else in pixels."""

    max_missed_frames: int = field(default=4, metadata={"doc": "frames that may pass without a streak", "min": 0, "max": 100})
    min_log_odds: float = field(
        default=4.0,
        metadata={
            "doc": "natural log odds against chance that a tracklet needs, unless it is a track from board",
            "min": -20.0,
            "max": 100.0,
        },
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
        """Tracklets of two or more frames, by falling evidence; their ids count from 0. Streaks are read once."""
        frames = frame_table(headers)
        tracks: list[tuple[Track, StreakTable, bool]] = []
        for table, sky in zip(streak_tables(streaks, frames, self.pixel_scale_arcsec), (True, False), strict=True):
            tracks += [(track, table, sky) for track in self.tracks(table, frames, sky=sky)]
        tracks.sort(key=lambda entry: -entry[0].log_odds)
        return tuple(tracklet_of(number, track, table, frames, sky) for number, (track, table, sky) in enumerate(tracks))

    def tracks(self, table: StreakTable, frames: FrameTable, *, sky: bool) -> list[Track]:
        """Tracks of one group of streaks, all on the sky or all in pixels."""
        if len(table.frame) < 2:
            return []
        nodes = nodes_of(table, frames, SIGMA_FLOOR_PX)
        scale = float(table.scale_rad_px[0])
        shape = frames.shape[table.frame[0]]
        log_area = math.log(float(shape[0]) * float(shape[1]) * scale**2)
        diagonal = math.hypot(*shape) * scale
        cadence = float(np.median(np.diff(frames.start_s))) if len(frames.start_s) > 1 else 1.0
        bending = self.sigma_acceleration_arcsec_s2 * ARCSEC_RAD if sky else self.sigma_acceleration_px_s2 * scale
        search = Search(
            reach=self.max_missed_frames + 1,
            fastest_rad_s=diagonal / max(cadence - float(np.median(frames.exposure_s)), 0.1 * cadence, 1e-6),
            floor_rad=3.0 * scale,
            log_area=log_area,
            sigma_acceleration=bending,
            log_seen=math.log(DETECTION_PROBABILITY),
            log_missed=math.log(1.0 - DETECTION_PROBABILITY),
            log_new=math.log(NEW_OBJECTS_PER_FRAME),
        )
        return best_tracks(nodes, table, frames, search, self.min_log_odds)
