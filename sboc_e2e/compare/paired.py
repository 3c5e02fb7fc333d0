"""Statistics of two choices judged on the same truth: an exact test and a bootstrap, both over objects."""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.score.figures import CONFIDENCE, Figure, absent, figure

PAIR_SNR: Final = 5.0
"""Pairs are judged on truth above this S/N: below it nobody finds anything, and agreement is empty."""
DRAWS: Final = 1000
"""Of the bootstrap: an end of the 90 % interval is known to 0.07 of the standard error (sqrt(0.05 * 0.95 / 1000) over the normal
density)."""
_SEED: Final = 11  # Fixed, so that a comparison repeats; any number serves.


@dataclass(frozen=True, kw_only=True, eq=False)
class Outcomes:
    """Truth streaks of all seeds in one order, and the result of each choice for them.

    snr, length_px : (n,). cluster : (n,) object of each streak (with its seed): streaks of one object are not
    independent, so objects are resampled, not streaks. found : choice -> (n,) bool.
    """

    snr: NDArray[np.float64]
    length_px: NDArray[np.float64]
    cluster: NDArray[np.int64]
    found: dict[str, NDArray[np.bool_]]

    def select(self, chosen: NDArray[np.bool_]) -> "Outcomes":
        """The streaks of a mask."""
        found = {name: f[chosen] for name, f in self.found.items()}
        return Outcomes(snr=self.snr[chosen], length_px=self.length_px[chosen], cluster=self.cluster[chosen], found=found)


def mcnemar(one: NDArray[np.bool_], other: NDArray[np.bool_], cluster: NDArray[np.int64]) -> dict[str, Any]:
    """Streaks found by only one of two choices, and the exact two-sided probability of such an imbalance by chance.

    one, other : (n,) found. cluster : (n,) object of each streak. McNemar's test (1947, Psychometrika 12, 153) asks of each
    streak that only one choice found which of the two it was, as of a fair coin. Streaks of one object stand or fall together,
    so the coin is thrown for each object: chance exchanges the two choices on all of its streaks at once (Fisher's test by
    randomisation, 1935, The Design of Experiments, section 21; clustered pairs: Durkalski et al. 2003, Stat. Med. 22, 2417).
    With one streak for each object it is McNemar's exact test.
    """
    only_one, only_other = one & ~other, other & ~one
    _, member = np.unique(cluster, return_inverse=True)
    surplus = np.bincount(member, only_other.astype(float) - only_one.astype(float)).astype(int)
    disagreeing = np.bincount(member, only_other | only_one) > 0
    return {
        "both": int((one & other).sum()),
        "only_first": int(only_one.sum()),
        "only_second": int(only_other.sum()),
        "objects_disagreeing": int(disagreeing.sum()),
        "p_value": sign_flip_p(surplus),
    }


def sign_flip_p(surplus: NDArray[np.int_]) -> float:
    """Probability that a sum of these whole numbers with random signs is at least as far from 0 as with the signs they have."""
    sizes = np.abs(surplus[surplus != 0])
    total, reach = abs(int(surplus.sum())), int(sizes.sum())
    chance = np.zeros(2 * reach + 1)
    chance[reach] = 1.0
    for size in sizes:
        # The sum moves up or down by the object's surplus: it never leaves the table, so that rolling round brings zeros.
        chance = 0.5 * (np.roll(chance, size) + np.roll(chance, -size))
    far = np.abs(np.arange(-reach, reach + 1)) >= total
    return min(1.0, float(chance[far].sum()))


def difference(outcomes: Outcomes, first: str, second: str) -> Figure:
    """Completeness of the second choice minus that of the first, with a bootstrap interval over objects."""
    n = len(outcomes.snr)
    if n == 0:
        return absent("no truth streak")
    gain = outcomes.found[second].astype(float) - outcomes.found[first].astype(float)
    _, member = np.unique(outcomes.cluster, return_inverse=True)
    groups = int(member.max()) + 1
    total, size = np.bincount(member, gain, groups), np.bincount(member, minlength=groups)
    rng = np.random.default_rng(_SEED)
    drawn = rng.integers(0, groups, (DRAWS, groups))
    draws = total[drawn].sum(axis=1) / size[drawn].sum(axis=1)
    low, high = np.quantile(draws, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    return figure(float(gain.mean()), n, low, high)


def froc(rank_of_hits: NDArray[np.float64], rank_of_false: NDArray[np.float64], n_truth: int, n_frames: int) -> list[list[float]]:
    """Free-response curve: [false per frame, share of truth found] as the threshold on the rank falls.

    rank_of_hits : S/N, or what else detections are ordered by, of matched ones, rank_of_false : of false ones.
    """
    thresholds = np.unique(np.concatenate([rank_of_hits, rank_of_false]))[::-1]
    if len(thresholds) > 200:
        thresholds = thresholds[np.linspace(0, len(thresholds) - 1, 200).astype(int)]
    return [
        [float((rank_of_false >= t).sum() / max(n_frames, 1)), float((rank_of_hits >= t).sum() / max(n_truth, 1))]
        for t in thresholds
    ]
