"""Completeness of each choice by S/N and by length: where a difference comes from."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, Final

from sboc_e2e.compare.paired import PAIR_SNR, Outcomes
from sboc_e2e.score.figures import proportion

SNR_EDGES: Final = (3.0, 6.0, 8.0, 12.0, 25.0, 100.0, float("inf"))
LENGTH_EDGES: Final = (0.0, 10.0, 20.0, 50.0, 150.0, float("inf"))


def splits(outcomes: Outcomes, names: Sequence[str]) -> list[dict[str, Any]]:
    """One entry for each bin that holds truth: what it is of, its ends, n, and a proportion for each choice.

    Lengths are of streaks with S/N >= 5: below it nobody finds anything.
    """
    out = []
    judged = outcomes.snr >= PAIR_SNR
    for quantity, values, edges in (
        ("S/N", outcomes.snr, SNR_EDGES),
        ("length, px (S/N >= 5)", outcomes.length_px, LENGTH_EDGES),
    ):
        for low, high in pairwise(edges):
            chosen = (values >= low) & (values < high)
            if quantity != "S/N":
                chosen &= judged
            n = int(chosen.sum())
            if n:
                found = {name: proportion(int(outcomes.found[name][chosen].sum()), n) for name in names}
                words = f"{low:g} to {high:g}" if high < float("inf") else f"above {low:g}"
                out.append({"quantity": quantity, "bin": words, "n": n, "choices": found})
    return out
