"""Which measured streak is which truth streak: one rule, one to one, best first (docs/scoring.md)."""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.score.trail import TruePath

SNR_IGNORED: Final = 3.0
"""Truth below this S/N counts neither as missed nor, when matched, as false."""

POINT_LENGTH_PX: Final = 10.0  # Definition of the match (docs/scoring.md): of shorter trails the angle is not judged.
POINT_RADIUS_PX: Final = 3.0  # Definition of the match (docs/scoring.md): three and a half PSF sigmas of `sboc_like`.


@dataclass(frozen=True, kw_only=True, eq=False)
class TruthStreak:
    """One truth streak of one frame with what the scores need of it.

    snr, rate_deg_s : NaN where truth from elsewhere does not give them. flux_known : whether `path` carries electrons.
    """

    index: int
    frame: int
    object_id: int
    path: TruePath
    snr: float
    length_px: float
    rate_deg_s: float
    attainable_end_px: float
    flux_known: bool = True

    @property
    def counted(self) -> bool:
        """Whether missing it counts: not below the S/N that is ignored; an unknown S/N counts."""
        return not self.snr < SNR_IGNORED

    @property
    def ends(self) -> NDArray[np.float64]:
        """(2, 2) row and col of both ends, clipped to the frame."""
        return np.array([[self.path.row[0], self.path.col[0]], [self.path.row[-1], self.path.col[-1]]])


@dataclass(frozen=True, kw_only=True, eq=False)
class MeasuredStreak:
    """Ends of one measured streak; `index` is its row in the products table.

    middle : (row, col) on the trail; of a curved one, off the middle of its chord by the sagitta.
    """

    index: int
    frame: int
    ends: NDArray[np.float64]
    middle: NDArray[np.float64]

    @property
    def length_px(self) -> float:
        """Length of the chord."""
        return float(np.hypot(*(self.ends[1] - self.ends[0])))


def distance_to_path(point: NDArray[np.float64], path: TruePath) -> tuple[float, NDArray[np.float64]]:
    """Signed distance (px) of a point across a polyline extended at both ends, and the unit tangent there.

    Positive to the side that is the tangent turned from (drow, dcol) to (-dcol, drow).
    """
    nodes = np.stack([path.row, path.col], axis=1)
    start, step = nodes[:-1], np.diff(nodes, axis=0)
    norm2 = np.maximum(np.einsum("ij,ij->i", step, step), 1e-18)
    share = np.einsum("ij,ij->i", point - start, step) / norm2
    low, high = np.zeros(len(step)), np.ones(len(step))
    low[0], high[-1] = -np.inf, np.inf
    foot = start + np.clip(share, low, high)[:, None] * step
    nearest = int(np.argmin(np.einsum("ij,ij->i", point - foot, point - foot)))
    if norm2[nearest] <= 1e-18:
        offset = point - nodes[0]
        return float(np.hypot(*offset)), np.array([0.0, 1.0])
    tangent = step[nearest] / math.sqrt(norm2[nearest])
    offset = point - start[nearest]
    return float(-offset[0] * tangent[1] + offset[1] * tangent[0]), tangent


def _agreement(measured: MeasuredStreak, truth: TruthStreak) -> float:
    """How well a pair agrees, 0 (no match) to 1."""
    true_ends = truth.ends
    if truth.length_px < POINT_LENGTH_PX:
        apart = float(np.hypot(*(measured.middle - true_ends.mean(axis=0))))
        if apart > POINT_RADIUS_PX or measured.length_px > 4 * POINT_LENGTH_PX:
            return 0.0
        return 1.0 - apart / (2 * POINT_RADIUS_PX)
    across, _ = distance_to_path(measured.middle, truth.path)
    allowed_px = min(max(3.0, 3.0 * truth.attainable_end_px), 10.0)
    if abs(across) > allowed_px:
        return 0.0
    chord = true_ends[1] - true_ends[0]
    length = float(np.hypot(*chord))
    along = chord / length
    mine = measured.ends[1] - measured.ends[0]
    turn_deg = math.degrees(math.atan2(abs(along[0] * mine[1] - along[1] * mine[0]), abs(float(along @ mine))))
    if turn_deg > max(3.0, math.degrees(math.atan2(6.0, length))):
        return 0.0
    reach = np.sort((measured.ends - true_ends[0]) @ along)
    shared = min(reach[1], length) - max(reach[0], 0.0)
    share = shared / max(length, measured.length_px)
    if share < 0.5:
        return 0.0
    return float(share * (1.0 - 0.5 * abs(across) / allowed_px))


def match_frame(measured: list[MeasuredStreak], truth: list[TruthStreak]) -> dict[int, int]:
    """Measured position in its list -> truth position in its list, one to one, best agreement first."""
    pairs = [(_agreement(m, t), i, j) for i, m in enumerate(measured) for j, t in enumerate(truth)]
    matched: dict[int, int] = {}
    taken: set[int] = set()
    for agreement, i, j in sorted(pairs, key=lambda p: (-p[0], p[1], p[2])):
        if agreement > 0.0 and i not in matched and j not in taken:
            matched[i] = j
            taken.add(j)
    return matched


def match_all(measured: list[MeasuredStreak], truth: list[TruthStreak]) -> dict[int, int]:
    """Row of the products table -> index of the truth streak, over all frames."""
    by_frame: dict[int, tuple[list[MeasuredStreak], list[TruthStreak]]] = {}
    for m in measured:
        by_frame.setdefault(m.frame, ([], []))[0].append(m)
    for t in truth:
        by_frame.setdefault(t.frame, ([], []))[1].append(t)
    out: dict[int, int] = {}
    for mine, true in by_frame.values():
        for i, j in match_frame(mine, true).items():
            out[mine[i].index] = true[j].index
    return out
