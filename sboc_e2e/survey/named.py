"""What a survey says of objects with names: how many of a catalogue and of constellations are seen, and whether a cloud is.

Each passage has its probability of a tracklet (the share of redraws of the response). Passages of objects with names are not
random: intervals hold what the response leaves open. Where another draw of a cloud flies is not in them: other seeds say that.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.score.figures import proportion
from sboc_e2e.survey.block import CLASS_EDGES_M
from simulator.scene.fleet import KINDS, Fleet

Array = NDArray[np.float64]

REDRAWN: Final = 2000  # Draws of what is seen of a cloud: an end of the 90 % interval is known to 0.05 of the standard error.
SIZE_EDGES_M: Final = (*CLASS_EDGES_M, 10.0, 1000.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class NamedPassages:
    """Passages (n,): object, time after the epoch, probability of a tracklet; too_slow : passages that were not judged."""

    object: NDArray[np.int64]
    time_s: Array
    linked: Array
    too_slow: int
    span_s: float


@dataclass(frozen=True, kw_only=True)
class Cloud:
    """What is seen of a cloud. first_h : 5, 50 and 95 % of the time from the break-up to the first tracklet, inf where it may

    never come. pieces : 5, 50 and 95 % of the number of pieces seen at least once; passing : pieces that pass the field.
    """

    first_h: tuple[float, float, float]
    pieces: tuple[float, float, float]
    passing: int
    drawn: int


def read_named(out: Path) -> NamedPassages:
    """The passages of all finished blocks of a survey, by time."""
    sums = [json.loads(path.read_text(encoding="utf-8")) for path in sorted((out / "sums").glob("*.json"))]
    rows = np.array([row[:3] for s in sums for row in s["named"]["passages"]], dtype=np.float64).reshape(-1, 3)
    rows = rows[np.argsort(rows[:, 1], kind="stable")]
    return NamedPassages(
        object=rows[:, 0].astype(np.int64),
        time_s=rows[:, 1],
        linked=rows[:, 2],
        too_slow=sum(int(s["named"]["too_slow"]) for s in sums),
        span_s=sum(float(s["span_s"]) for s in sums),
    )


def seen_probability(found: NamedPassages, n: int) -> Array:
    """Probability (n,) that each object has one tracklet at least."""
    missed = np.zeros(n)
    with np.errstate(divide="ignore"):
        np.add.at(missed, found.object, np.log1p(-found.linked))
    return np.asarray(-np.expm1(missed))


def cloud_of(found: NamedPassages, pieces: NDArray[np.int64], when_s: float, rng: np.random.Generator) -> Cloud:
    """What is seen of some objects after a time."""
    mine = np.isin(found.object, pieces)
    who, linked, time_s = found.object[mine], found.linked[mine], found.time_s[mine]
    hit = rng.random((REDRAWN, len(who))) < linked
    first = np.where(hit.any(axis=1), time_s[np.argmax(hit, axis=1)] if len(who) else np.inf, np.inf)
    _, number = np.unique(who, return_inverse=True)
    seen = [len(np.unique(number[row])) for row in hit]
    low, middle, high = np.quantile((first - when_s) / 3600.0, [0.05, 0.5, 0.95], method="inverted_cdf")
    few, usual, many = np.quantile(seen, [0.05, 0.5, 0.95])
    return Cloud(
        first_h=(float(low), float(middle), float(high)),
        pieces=(float(few), float(usual), float(many)),
        passing=len(np.unique(who)),
        drawn=len(pieces),
    )


def named_page(out: Path, fleet: Fleet, breakups: Sequence[Any], seed: int) -> str:
    """A page in Markdown about the objects with names of a survey."""
    found = read_named(out)
    chance = seen_probability(found, len(fleet))
    passes = np.bincount(found.object, minlength=len(fleet))
    days = found.span_s / 86_400.0
    lines = [
        "# Objects with names",
        "",
        f"{len(fleet)} objects, {len(found.object)} passages in {days:g} days; {found.too_slow} more were slower than the trails",
        "that the response was measured with, and are not judged. Expected: the sum of the probabilities of a tracklet.",
        "",
        "| kind | objects | pass the field | passages | expected tracklets | expected to be seen at least once |",
        "|---|---|---|---|---|---|",
    ]
    for k, name in enumerate(KINDS):
        mine = fleet.kind == k
        if mine.any():
            tracklets = float(np.sum(found.linked[mine[found.object]]))
            lines.append(
                f"| {name} | {int(mine.sum())} | {int((passes[mine] > 0).sum())} | {int(passes[mine].sum())} | {tracklets:.1f} | "
                f"{float(chance[mine].sum()):.1f} |"
            )
    lines += ["", "| diameter | objects | pass the field | of these expected to be seen [90 %] |", "|---|---|---|---|"]
    for low, high in pairwise(SIZE_EDGES_M):
        mine = (fleet.size_m >= low) & (fleet.size_m < high)
        there = int((passes[mine] > 0).sum())
        if there:
            share = proportion(round(float(chance[mine].sum())), there)
            lines.append(
                f"| {100 * low:g} to {100 * high:g} cm | {int(mine.sum())} | {there} | "
                f"{share['value']:.2f} [{share['low']:.2f}, {share['high']:.2f}] |"
            )
    for number, b in enumerate(breakups):
        pieces = np.flatnonzero(np.char.startswith(np.array(fleet.names), f"{b.object} piece "))
        cloud = cloud_of(found, pieces, 3600.0 * b.when_h, np.random.default_rng([seed, number]))
        first = ", ".join("never" if not np.isfinite(t) else f"{t:.1f}" for t in cloud.first_h)
        few, usual, many = cloud.pieces
        lines += [
            "",
            f"## Break-up of {b.object}, {b.when_h:g} h after the epoch",
            "",
            f"{b.cause}, {cloud.drawn} pieces above {b.smallest_mm:g} mm stay in orbit; {cloud.passing} pass the field.",
            f"Hours to the first tracklet, 5, 50 and 95 %: {first}.",
            f"Pieces seen in {days:g} days of survey: {usual:.0f} [{few:.0f}, {many:.0f}].",
        ]
    return "\n".join(lines) + "\n"
