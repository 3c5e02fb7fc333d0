"""Whether two tracks show one object, or two whose trails cross in a frame."""

import math
from collections.abc import Iterable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd.signals import Detection, Track

SAME_PX: Final = 4.0  # some four PSF widths: closer trails share light. Chosen, not measured
ALONG_SHARE: Final = 0.5  # of the longer trail's length: the middle of one lies on the other
ACROSS_SHARE: Final = 0.02
"""Trails lie on each other where their middles are closer across than `SAME_PX` and this share of the longer one's length: their
directions differ by a degree. Chosen, not measured."""

STEPS: Final = 128  # of a trail when its common part with another is measured: to a hundredth, as S/N to a tenth is needed


def same_object(known: Track, track: Track, least: NDArray[np.float64] | None = None) -> bool:
    """Whether two tracks show one object: in frames that both have, their trails lie on each other.

    One frame is enough for two finds of one object, one of them with a wrong motion: that one has no light but what it shares.
    Objects whose trails cross share light as well, but each has its own besides. So a track that leaves the known one in half
    of the common frames or more, or has another trail in the only one, is another object if it reaches the joint S/N that is
    asked without the known one's light.
    least : this S/N, by the number of frames; None: it is never reached.
    """
    ends = {m.frame: m.detection for m in known.members}
    common = [m for m in track.members if m.frame in ends]
    on = sum(_on_each_other(ends[m.frame], m.detection) for m in common)
    if on == 0:
        return False
    as_known = 2 * on > len(common) if len(common) > 1 else _alike(ends[common[0].frame], common[0].detection)
    if least is None or as_known or len(track.members) >= len(least):
        return True
    own = [m.detection.snr - (light_of(ends[m.frame], m.detection) if m.frame in ends else 0.0) for m in track.members]
    # noise grows as the root of the length
    root = np.sqrt([max(m.detection.length_px, 1.0) for m in track.members])
    return float(root @ own / np.linalg.norm(root)) < float(least[len(own)])


def most_alike(known: Iterable[Track], track: Track, least: NDArray[np.float64]) -> Track | None:
    """Of the known tracks that show the same object, the one whose trails lie on the track's in most frames."""
    alike = [t for t in known if same_object(t, track, least)]
    return max(alike, key=lambda t: (shared_frames(t, track), t.snr)) if alike else None


def tells_nothing_new(known: Track, track: Track) -> bool:
    """Whether a find of a known object has no frame that this lacks, and less S/N: part of its light, or a wrong motion."""
    return track.snr < known.snr and {m.frame for m in track.members} <= {m.frame for m in known.members}


def shared_frames(known: Track, track: Track) -> int:
    """In how many frames the trails of two tracks lie on each other."""
    ends = {m.frame: m.detection for m in known.members}
    return sum(_on_each_other(ends[m.frame], m.detection) for m in track.members if m.frame in ends)


def _alike(a: Detection, b: Detection) -> bool:
    """Whether two trails have the same ends, in the same order of time."""
    length = max(a.length_px, b.length_px, 1.0)
    u = np.array([b.row1 - b.row0, b.col1 - b.col0]) / max(b.length_px, 1e-6)
    off = np.array([[a.row0 - b.row0, a.col0 - b.col0], [a.row1 - b.row1, a.col1 - b.col1]])
    along, across = np.abs(off @ u).max(), np.abs(off @ np.array([-u[1], u[0]])).max()
    return bool(along < ALONG_SHARE * length + SAME_PX and across < SAME_PX + ACROSS_SHARE * length)


def _on_each_other(a: Detection, b: Detection) -> bool:
    """Whether the middle of one trail lies on the other, along it and across. Plain numbers: hundreds of pairs in a frame."""
    d_row, d_col = b.row1 - b.row0, b.col1 - b.col0
    length_b = math.hypot(d_row, d_col)
    length = max(math.hypot(a.row1 - a.row0, a.col1 - a.col0), length_b, 1.0)
    u_row, u_col = d_row / max(length_b, 1e-6), d_col / max(length_b, 1e-6)
    row, col = 0.5 * (a.row0 + a.row1 - b.row0 - b.row1), 0.5 * (a.col0 + a.col1 - b.col0 - b.col1)
    along, across = abs(row * u_row + col * u_col), abs(col * u_row - row * u_col)
    return along < ALONG_SHARE * length + SAME_PX and across < SAME_PX + ACROSS_SHARE * length


def light_of(a: Detection, b: Detection) -> float:
    """S/N that the light of one trail gives to another: all of it where they are closer than `SAME_PX`.

    A trail of S/N s and length l px has s / root(l) per px of noise's root; so c px of it give s c / root(l l') to one of l' px.
    """
    start, way = np.array([a.row0, a.col0]), np.array([a.row1 - a.row0, a.col1 - a.col0])
    share = (np.arange(STEPS) + 0.5)[:, None] / STEPS
    points = np.array([b.row0, b.col0]) + share * np.array([b.row1 - b.row0, b.col1 - b.col0]) - start
    at = np.clip(points @ way / max(float(way @ way), 1e-12), 0.0, 1.0)
    near = np.hypot(*(points - at[:, None] * way).T) < SAME_PX
    length_a, length_b = max(a.length_px, 1.0), max(b.length_px, 1.0)
    return a.snr * float(near.mean()) * length_b / float(np.sqrt(length_a * length_b))
