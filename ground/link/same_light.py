"""Streaks of one frame that are the same light: an object that came down under two track numbers has its trail in both.

One piece of light belongs to one tracklet. So what a tracklet takes, no other may take as another streak.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from ground.link.hypotheses import StreakTable

SAME_PX: Final = 4.0
"""Some four PSF widths: closer trails share light. Chosen, not measured."""

COMMON_SHARE: Final = 0.5
"""Of either trail that lies in the other. Of trails that cross, one has less."""

STEPS: Final = 32  # points of a trail; the share is good to a thirtieth


class SameLight:
    """Pairs of streaks (rows of a table) in one frame that lie on each other, one of them at least of an on-board track."""

    def __init__(self, table: StreakTable) -> None:
        tracked = np.unique(table.frame[table.track >= 0])
        self._pairs = np.concatenate([np.zeros((0, 2), dtype=np.int64), *(_pairs(table, f) for f in tracked)])

    def with_twins(self, streaks: NDArray[np.int64]) -> NDArray[np.int64]:
        """These streaks, and all that are the same light."""
        twins = self._pairs[np.isin(self._pairs[:, 0], streaks), 1]
        return np.union1d(streaks, twins)


def _pairs(table: StreakTable, frame: int) -> NDArray[np.int64]:
    """The pairs (n, 2) of a frame, in both orders."""
    low, high = np.searchsorted(table.frame, [frame, frame + 1])
    ends = np.stack([table.row[low:high, [0, 2]], table.col[low:high, [0, 2]]], axis=-1)
    tracked = np.flatnonzero(table.track[low:high] >= 0)
    same = (_covered(ends[tracked], ends) >= COMMON_SHARE) & (_covered(ends, ends[tracked]).T >= COMMON_SHARE)
    same[np.arange(len(tracked)), tracked] = False
    k, j = np.nonzero(same)
    one, other = low + tracked[k], low + j
    return np.unique(np.concatenate([np.column_stack([one, other]), np.column_stack([other, one])]), axis=0)


def _covered(trails: NDArray[np.float64], by: NDArray[np.float64]) -> NDArray[np.float64]:
    """Share (m, n) of each trail (m, 2, 2) that lies within SAME_PX of each of `by` (n, 2, 2)."""
    share = (np.arange(STEPS) + 0.5) / STEPS
    points = trails[:, None, 0] + share[:, None] * (trails[:, 1] - trails[:, 0])[:, None]
    way = by[:, 1] - by[:, 0]
    away = points[:, None] - by[:, 0][:, None]
    at = np.clip((away * way[:, None]).sum(axis=-1) / np.maximum((way**2).sum(axis=-1), 1e-12)[:, None], 0.0, 1.0)
    off = away - at[..., None] * way[:, None]
    return np.asarray((np.hypot(off[..., 0], off[..., 1]) < SAME_PX).mean(axis=-1))
