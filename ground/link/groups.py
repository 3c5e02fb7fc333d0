"""Streaks that the on-board software found as one object over several frames, before any other linking.

The evidence is the sum over all frames. The streaks alone may be too faint to support each other.
"""

from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ground.link.hypotheses import CROSSING, Nodes, StreakTable
from ground.link.motion import N_PARAMETERS
from ground.link.search import chi2_gate, gain_of

LOG_ODDS: Final = 5.0
"""Lower limit of the log odds with which a track from board claims its streaks: its joint test passes noise in one frame of
fifty. What is published are the odds of its motion, or of its light where no frame shows it by itself (`noise_tracks`)."""


def tracked_groups(
    nodes: Nodes, table: StreakTable, model: tuple[float, float, float, float], log_new: float
) -> Iterator[tuple[NDArray[np.int64], float]]:
    """Members (node numbers by time) of each on-board track whose streaks lie on one motion, and their evidence.

    If no motion fits a group, its worst streak is left out, until a motion fits or fewer than two streaks remain.
    """
    for number in np.unique(table.track[table.track >= 0]):
        streaks = np.flatnonzero(table.track == number)
        streaks = streaks[np.unique(table.frame[streaks], return_index=True)[1]]
        found = None
        while len(streaks) >= 2 and found is None:
            tried = [_fitted(nodes, members, model) for members in _both_senses(nodes, streaks)]
            good = [entry for entry in tried if entry[1] < entry[3]]
            if good:
                found = max(good, key=lambda entry: entry[2])
            else:
                less = [np.delete(streaks, k) for k in range(len(streaks))] if len(streaks) > 2 else []
                ratios = [
                    min(_fitted(nodes, m, model)[1] for m in _both_senses(nodes, rest)) if len(rest) > 1 else np.inf
                    for rest in less
                ]
                streaks = less[int(np.argmin(ratios))] if less else streaks[:0]
        if found is not None:
            yield found[0], max(found[2], LOG_ODDS - log_new)


def _both_senses(nodes: Nodes, streaks: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """The two hypotheses of all streaks (rising in time) for the two senses of one direction; a point has one hypothesis."""
    first = nodes.unit[2 * streaks[0], 1] - nodes.unit[2 * streaks[0], 0]
    way = nodes.unit[2 * streaks, 1] - nodes.unit[2 * streaks, 0]
    turned = (way @ first < 0.0).astype(np.int64)
    senses = [2 * streaks + turned, 2 * streaks + 1 - turned]
    point = nodes.kind[2 * streaks + 1] == CROSSING
    out = [np.where(point, 2 * streaks, members) for members in senses]
    return [members for members in out if (nodes.kind[members] != CROSSING).all()] or out[:1]


def _fitted(
    nodes: Nodes, members: NDArray[np.int64], model: tuple[float, float, float, float]
) -> tuple[NDArray[np.int64], float, float, float]:
    """Members, chi-square, evidence and largest chi-square of a true track."""
    centre, basis, theta = np.empty(3), np.empty((2, 3)), np.empty(N_PARAMETERS)
    gain, chi2, rows, _ = gain_of(nodes, members, model, centre, basis, theta, np.empty((N_PARAMETERS, N_PARAMETERS)))
    return members, chi2, gain, chi2_gate(rows)
