"""Whether two tracks show one object, or two whose trails cross in a frame."""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd.signals import Detection, Track

SAME_PX: Final = 4.0  # some four PSF widths: closer trails share light. Chosen, not measured
ALONG_SHARE: Final = 0.5  # of the longer trail's length: the middle of one lies on the other
ACROSS_SHARE: Final = 0.02
"""Trails lie on each other where their middles are closer across than `SAME_PX` and this share of the longer one's length: their
directions differ by a degree. Chosen, not measured."""


def same_object(known: Track, track: Track, least: NDArray[np.float64] | None = None) -> bool:
    """Whether two tracks show one object: in frames that both have, their trails lie on each other.

    One frame is enough for two finds of one object, one of them with a wrong motion: that one has no light but what it shares.
    Objects whose trails cross share light as well, but each has its own in other frames. So a track that leaves the known one in
    half of the common frames or more is another object if the frames in which they share no light reach the joint S/N that is
    asked of so many. least : this S/N, by the number of frames; None: never.
    """
    ends = {m.frame: m.detection for m in known.members}
    common = [m for m in track.members if m.frame in ends]
    on = sum(_on_each_other(ends[m.frame], m.detection) for m in common)
    if on == 0:
        return False
    if least is None or 2 * on > len(common):
        return True
    rest = [m.detection for m in track.members if m.frame not in ends or distance_px(ends[m.frame], m.detection) > SAME_PX]
    if len(rest) < 2 or len(rest) >= len(least):
        return True
    # noise grows as the root of the length
    root = np.sqrt([max(d.length_px, 1.0) for d in rest])
    return float(root @ [d.snr for d in rest] / np.linalg.norm(root)) < float(least[len(rest)])


def _on_each_other(a: Detection, b: Detection) -> bool:
    """Whether the middle of one trail lies on the other, along it and across."""
    length = max(a.length_px, b.length_px, 1.0)
    u = np.array([b.row1 - b.row0, b.col1 - b.col0]) / max(b.length_px, 1e-6)
    middle = 0.5 * np.array([a.row0 + a.row1 - b.row0 - b.row1, a.col0 + a.col1 - b.col0 - b.col1])
    along, across = abs(float(middle @ u)), abs(float(middle @ np.array([-u[1], u[0]])))
    return along < ALONG_SHARE * length + SAME_PX and across < SAME_PX + ACROSS_SHARE * length


def distance_px(a: Detection, b: Detection) -> float:
    """Least distance between two segments; 0 where they cross."""
    p, q = ((np.array([d.row0, d.col0]), np.array([d.row1, d.col1])) for d in (a, b))
    sides = [_side(*p, end) for end in q], [_side(*q, end) for end in p]
    if all(one * other < 0.0 for one, other in sides):
        return 0.0
    return min(*(_from_segment(*p, end) for end in q), *(_from_segment(*q, end) for end in p))


def _side(start: NDArray[np.float64], stop: NDArray[np.float64], point: NDArray[np.float64]) -> float:
    """Of a point beside the line: positive on the one, negative on the other."""
    way, off = stop - start, point - start
    return float(way[0] * off[1] - way[1] * off[0])


def _from_segment(start: NDArray[np.float64], stop: NDArray[np.float64], point: NDArray[np.float64]) -> float:
    """Distance of a point from a segment."""
    way = stop - start
    share = float((point - start) @ way) / max(float(way @ way), 1e-12)
    return math.hypot(*(point - start - min(max(share, 0.0), 1.0) * way))
