"""Probabilities of rare events by multilevel splitting: subset simulation (Au & Beck 2001, Prob. Eng. Mech. 16, 263).

Samples are functions of standard normal numbers. Level after level, the best fifth is kept and moved by preconditioned
Crank-Nicolson steps that stay above the level, so that 1e-8 costs some thousand evaluations instead of 1e10.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

KEPT: Final = 0.2
WANTED_ACCEPTANCE: Final = 0.35
LEAST_STEP: Final = 0.003

Score = Callable[[NDArray[np.float64]], tuple[float, float]]
"""(guide, value) of a sample: levels rise in the guide, which is continuous where it is low; the value is counted."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Tail:
    """Weighted samples: value, guide and weight (k,), the weights of all adding up to 1; n evaluations were needed."""

    value: NDArray[np.float64]
    weight: NDArray[np.float64]
    n: int

    def above(self, level: float) -> float:
        """P(value >= level)."""
        return float(self.weight[self.value >= level].sum())


def tail_of(score: Score, numbers: int, n: int, rng: np.random.Generator, *, last: float, rarest: float) -> Tail:
    """Tail of the value of `numbers` standard normal numbers, n samples a level, up to a guide of `last` or down to `rarest`."""
    z = rng.standard_normal((n, numbers)).astype(np.float32)
    guide, value = _scored(score, z)
    evaluations, probability, step = n, 1.0, 0.5
    values, weights = [], []
    while True:
        best = np.sort(guide)[::-1]
        level = float(best[round(KEPT * n) - 1])
        if level <= best[-1]:  # no fifth, but all of them: a plateau, which only what is above it leaves
            level = float(best[0])
        seeds = guide >= level
        share = float(seeds.mean())
        done = level >= last or share == 1.0 or probability * share < rarest
        counted = np.ones(n, dtype=bool) if done else ~seeds
        values.append(value[counted])
        weights.append(np.full(int(counted.sum()), probability / n))
        if done:
            return Tail(value=np.concatenate(values), weight=np.concatenate(weights), n=evaluations)
        probability *= share
        start = rng.permutation(np.flatnonzero(seeds))
        z, guide, value, step = _moved(score, z[start], guide[start], value[start], level, n, step, rng)
        evaluations += n - start.size


def _scored(score: Score, z: NDArray[np.float32]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Guides and values of samples (n, numbers)."""
    pairs = np.array([score(each.astype(np.float64)) for each in z])
    return pairs[:, 0], pairs[:, 1]


def _moved(
    score: Score,
    now: NDArray[np.float32],
    guide: NDArray[np.float64],
    value: NDArray[np.float64],
    level: float,
    n: int,
    step: float,
    rng: np.random.Generator,
) -> tuple[NDArray[np.float32], NDArray[np.float64], NDArray[np.float64], float]:
    """n samples above a level: the seeds `now`, and a chain from each; and the step, by the share of accepted ones."""
    states, guides, values = [now], [guide], [value]
    while sum(map(len, guides)) < n:
        moved = (math.sqrt(1.0 - step**2) * now + step * rng.standard_normal(now.shape)).astype(np.float32)
        new_guide, new_value = _scored(score, moved)
        better = new_guide >= level
        now = np.where(better[:, None], moved, now)
        guide, value = np.where(better, new_guide, guide), np.where(better, new_value, value)
        step = float(np.clip(step * math.exp(1.5 * (better.mean() - WANTED_ACCEPTANCE)), LEAST_STEP, 1.0))
        states.append(now)
        guides.append(guide)
        values.append(value)
    return np.concatenate(states)[:n], np.concatenate(guides)[:n], np.concatenate(values)[:n], step
