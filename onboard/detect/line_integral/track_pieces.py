"""Points and short detections that are pieces of something longer: of a trail of light, or of a particle's track.

A bright track leaves sharp points in the star list, a few px apart. What the line search finds between them is a rest of it.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.signals import Detection

PIECE_PX: Final = 4.0
"""Sharp points so near to a found trail are pieces of it."""

SHORT_PX: Final = 40.0
"""Longer detections tell by their own sharpness what they are."""

REACH_PX: Final = 15.0
"""How far beyond its ends a short detection's line is followed; tracks leave points 3 to 10 px apart."""

ON_LINE_PX: Final = 1.5  # points have the places of their pixels, half a pixel off at most. Chosen, not measured
BRIGHTER: Final = 3.0  # the points gave the track away, its piece did not: it is much fainter. Chosen, not measured
FEWEST: Final = 2
"""A piece of a track has so many sharp points on its line, each brighter by this factor in S/N. Of short trails among a thousand
points that are scattered over four million pixels, 0.2 % have two on their line by chance."""


def beside_trails(hits: Sequence[Detection], trails: Sequence[Detection]) -> list[Detection]:
    """The points among some hits that are no pieces of found trails."""
    row, col = np.array([(hit.row0, hit.col0) for hit in hits]).reshape(-1, 2).T
    piece = np.zeros(len(hits), np.bool_)
    for trail in trails:
        length = trail.length_px
        if length < 1.0:
            continue
        d_row, d_col = row - trail.row0, col - trail.col0
        u_row, u_col = (trail.row1 - trail.row0) / length, (trail.col1 - trail.col0) / length
        along, across = d_row * u_row + d_col * u_col, d_row * u_col - d_col * u_row
        u = np.clip(along / length, 0.0, 1.0)
        bow = 4.0 * trail.sagitta_px * u * (1.0 - u)
        piece |= (along > -PIECE_PX) & (along < length + PIECE_PX) & (np.abs(across - bow) < PIECE_PX)
    return [hit for hit, on_trail in zip(hits, piece, strict=True) if not on_trail]


def flagged(found: Sequence[Detection], hits: Sequence[Detection]) -> list[Detection]:
    """The detections, with COSMIC_LIKE set on short ones whose line carries brighter sharp points.

    hits : sharp points. The ends of tracks among `found` count as points too.
    """
    tracks = [d for d in found if d.flags & StreakFlag.COSMIC_LIKE]
    points = [(d.row0, d.col0, d.snr) for d in (*hits, *tracks)]
    points += [(d.row1, d.col1, d.snr) for d in tracks if d.length_px >= 1.0]
    if not points:
        return list(found)
    row, col, snr = np.array(points).T
    out = []
    for d in found:
        if d.flags & StreakFlag.COSMIC_LIKE or d.length_px > SHORT_PX:
            out.append(d)
            continue
        d_row, d_col = row - 0.5 * (d.row0 + d.row1), col - 0.5 * (d.col0 + d.col1)
        distance = np.hypot(d_row, d_col)
        near = (distance > ON_LINE_PX) & (distance < REACH_PX + 0.5 * d.length_px) & (snr > BRIGHTER * d.snr)
        d_row, d_col, distance = d_row[near], d_col[near], distance[near]
        # each point gives a line through the middle; of a longer detection it must also be its own
        across = np.abs(d_row[:, None] * d_col - d_col[:, None] * d_row) / distance[:, None]
        own = np.abs(d_row * (d.col1 - d.col0) - d_col * (d.row1 - d.row0)) / max(d.length_px, 1e-9)
        on_line = (across < ON_LINE_PX) & ((own < ON_LINE_PX + 0.1 * distance) | (d.length_px < 8.0))
        piece = bool(len(distance)) and int(on_line.sum(axis=1).max()) >= FEWEST
        out.append(replace(d, flags=d.flags | StreakFlag.COSMIC_LIKE) if piece else d)
    return out
