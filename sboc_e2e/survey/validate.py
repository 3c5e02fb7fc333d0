"""The same hours both ways: objects of pixel runs against objects that a survey's code draws for the same frames.

The runs that judge are none of those that made the response. Trails of one object are alike, so of each object one trail at
random is compared.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import ks_2samp

from sboc_e2e.scenario import Scenario
from sboc_e2e.score.figures import Figure, bootstrap
from sboc_e2e.survey.block import finds_of, tables_of
from sboc_e2e.survey.response import Response
from sboc_e2e.survey.rows import LEAST_SNR, OBJECT_COLUMNS, STREAK_COLUMNS, columns
from simulator.randomness import Effect, generator
from simulator.survey import Flight, Passages, candidates, instants_of, joined, looks_of, pool_of

Array = NDArray[np.float64]

CANDIDATES: Final = 400_000
"""Draws of each class, from which the objects of all virtual runs are taken. Chosen, not measured: fewer repeat each other."""
VIRTUAL_RUNS: Final = 400
"""Twenty times the 20 runs with pixels, so that their own scatter adds 2.5 % to that of the comparison."""
LONGEST_S: Final = 1e6
"""Keeps weights of objects that stand still in the field finite; a run lasts seconds."""
VALIDATION_BLOCK: Final = 6_000_000
"""Number of a random stream that no survey reaches (1.5 million blocks in 1,000 years), and not that of sensitivities."""
CLASSES: Final = ((0.0, 0.01), (0.01, 0.1), (0.1, 3.0))
"""Of true diameters (m), for counts."""

SNR_CLASSES: Final = ((3.0, 7.0), (7.0, 10.0), (10.0, 1e9))  # Below the half point (7.26), about it, and above; for counts.
LENGTH_CLASSES_PX: Final = ((0.0, 30.0), (30.0, 100.0), (100.0, 1e9))
"""Short, usual and long trails, half a decade wide; for counts."""
LARGER_M: Final = (0.003, 0.01, 0.03, 0.1, 0.3)
"""Estimated diameters, for recovered numbers."""


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """One comparison of distributions."""

    name: str
    n_pixels: int
    n_survey: int
    median_pixels: float
    median_survey: float
    p_value: float


@dataclass(frozen=True, kw_only=True)
class Count:
    """Objects of a run in pixels, with the bootstrap interval over runs, and in the survey."""

    name: str
    pixels: Figure
    survey: float


@dataclass(frozen=True, kw_only=True)
class Validation:
    """What was compared."""

    quantities: tuple[Quantity, ...]
    counts: tuple[Count, ...]
    runs: int


def virtual_objects(scenario: Scenario, response: Response, runs: int = VIRTUAL_RUNS) -> dict[str, Array]:
    """Objects as a survey's code draws them for `runs` runs of a scenario, one row each, true and measured."""
    options = scenario.simulator
    flight = Flight.of(options, scenario.seed)
    duration = options.frames / options.frame_rate_hz
    rng = generator(scenario.seed, Effect.SURVEY, VALIDATION_BLOCK)
    at = instants_of(flight, np.sort(rng.random(64)) * duration, duration)
    parts: list[Passages] = []
    for size_class in options.population.classes:
        if size_class.count == 0:
            continue
        drawn = candidates(flight, at, pool_of(options.population, size_class, rng), CANDIDATES, rng)
        when = at.time_s[drawn.instant]
        whole = np.minimum(drawn.leave_s - drawn.enter_s, LONGEST_S)
        # a run counts an object that is in the field at any time of it: its stay within the run decides how often it is met
        within = np.minimum(drawn.leave_s + when, duration) - np.maximum(drawn.enter_s + when, 0.0)
        at_most = np.minimum(within, whole)
        weight = np.where(drawn.snr >= options.population.snr_min, drawn.natural * whole / np.maximum(at_most, 1e-9), 0.0)
        pick = rng.choice(len(weight), size=size_class.count * runs, p=weight / weight.sum())
        parts.append(drawn.taken(pick))
    p = joined(parts)
    looks = looks_of(flight, at, p, rng, only=(1, options.frames - 1))
    finds = finds_of(p, looks, response, rng)
    measured, _ = tables_of(at, p, looks, finds, response, rng)
    best = np.zeros(len(p.size_m))
    np.maximum.at(best, looks.passage, looks.snr)
    trail = _one_of_each(looks.passage, looks.snr >= LEAST_SNR, rng)
    found = _one_of_each(looks.passage, finds.look, rng)
    counted = np.bincount(looks.passage, weights=(looks.snr >= LEAST_SNR) * looks.stands_for, minlength=len(best))
    return {
        "trail_snr": looks.snr[trail],
        "trail_length_px": looks.length_px[trail],
        "trail_mag": looks.mag[trail],
        "found_snr": looks.snr[found],
        "found_length_px": looks.length_px[found],
        "frames": counted[best >= LEAST_SNR].astype(np.float64),
        "object_size_m": p.size_m[best >= LEAST_SNR],
        "object_rate_deg_s": p.rate_deg_s[best >= LEAST_SNR],
        "all_snr": looks.snr,
        "all_length_px": looks.length_px,
        "all_stands_for": looks.stands_for,
        "all_found": finds.look.astype(np.float64),
        "linked": measured["n_frames"].astype(np.float64),
        "linked_size_m": p.size_m[finds.linked],
        "rate_deg_s": measured["rate_deg_s"].astype(np.float64),
        "mag": measured["mag"].astype(np.float64),
        "range_km": p.range_km[finds.linked],
        "size_estimate_m": measured["size_m"].astype(np.float64),
    }


def _one_of_each(owner: NDArray[np.int64], use: NDArray[np.bool_], rng: np.random.Generator) -> NDArray[np.int64]:
    """One used item of each owner, at random."""
    rows = rng.permutation(np.flatnonzero(use))
    _, first = np.unique(owner[rows], return_index=True)
    return np.asarray(rows[first], dtype=np.int64)


def pixel_objects(samples: Sequence[Mapping[str, Any]], rng: np.random.Generator) -> dict[str, Array]:
    """The same columns of pixel runs."""
    parts: list[dict[str, Array]] = []
    for sample in samples:
        trails, objects = columns(sample["streaks"], STREAK_COLUMNS), columns(sample["objects"], OBJECT_COLUMNS)
        kept = (trails["frame"] > 0) & np.isin(trails["object"], objects["object"])
        trails = {name: values[kept] for name, values in trails.items()}
        owner, found = trails["object"].astype(np.int64), trails["ground"] > 0.5
        one, one_found = _one_of_each(owner, np.ones(len(owner), bool), rng), _one_of_each(owner, found, rng)
        here = np.isin(objects["object"], owner)
        linked = objects["linked"] >= 2
        parts.append(
            {
                "trail_snr": trails["snr"][one],
                "trail_length_px": trails["length_px"][one],
                "trail_mag": trails["mag"][one],
                "found_snr": trails["snr"][one_found],
                "found_length_px": trails["length_px"][one_found],
                "frames": np.array([float((owner == o).sum()) for o in objects["object"][here]]),
                "object_size_m": objects["size_m"][here],
                "object_rate_deg_s": objects["rate_deg_s"][here],
                "all_snr": trails["snr"],
                "all_length_px": trails["length_px"],
                "all_stands_for": np.ones(len(owner)),
                "all_found": found.astype(np.float64),
                "linked": objects["linked"][linked],
                "linked_size_m": objects["size_m"][linked],
                "rate_deg_s": (objects["rate_deg_s"] * np.exp(objects["ln_rate_error"]))[linked],
                "mag": (objects["mag"] + objects["mag_error"])[linked],
                "range_km": objects["range_km"][linked],
                "size_estimate_m": objects["size_estimate_m"][linked],
            }
        )
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


COMPARED: Final = (
    ("S/N of trails", "trail_snr"),
    ("length of trails (px)", "trail_length_px"),
    ("magnitude of trails", "trail_mag"),
    ("S/N of found trails", "found_snr"),
    ("length of found trails (px)", "found_length_px"),
    ("frames of a passage", "frames"),
    ("frames of a tracklet", "linked"),
    ("rate of tracklets (deg/s)", "rate_deg_s"),
    ("magnitude of tracklets", "mag"),
    ("estimated size of tracklets (m)", "size_estimate_m"),
    ("range of tracklets (km)", "range_km"),
)


def validate(samples: Sequence[Mapping[str, Any]], scenario: Scenario, response: Response) -> Validation:
    """Compare the samples of pixel runs with the survey's code."""
    rng = np.random.default_rng(20270129)
    theirs = pixel_objects(samples, rng)
    mine = virtual_objects(scenario, response)
    quantities = []
    for name, column in COMPARED:
        a, b = (v[np.isfinite(v)] for v in (theirs[column], mine[column]))
        quantities.append(
            Quantity(
                name=name, n_pixels=len(a), n_survey=len(b), median_pixels=float(np.median(a)), median_survey=float(np.median(b)),
                p_value=float(ks_2samp(a, b).pvalue),
            )
        )  # fmt: skip
    single = [pixel_objects([sample], rng) for sample in samples]
    counts = []

    def compare(name: str, of: Callable[[dict[str, Array]], float]) -> None:
        per_run = np.array([of(part) for part in single])
        counts.append(Count(name=name, pixels=bootstrap(per_run, lambda v: float(v.mean())), survey=of(mine) / VIRTUAL_RUNS))

    for low, high in SNR_CLASSES:
        compare(f"trails found, S/N {low:g} to {high:g}", lambda o, a=low, b=high: _found(o, "all_snr", a, b))  # type: ignore[misc]
    for low, high in LENGTH_CLASSES_PX:
        compare(f"trails found, {low:g} to {high:g} px", lambda o, a=low, b=high: _found(o, "all_length_px", a, b))  # type: ignore[misc]
    for low, high in CLASSES:
        compare(
            f"tracklets of {1e3 * low:g} to {1e3 * high:g} mm",
            lambda o, a=low, b=high: float(((o["linked_size_m"] >= a) & (o["linked_size_m"] < b)).sum()),  # type: ignore[misc]
        )
    for size in LARGER_M:
        compare(f"tracklets estimated above {1e3 * size:g} mm", lambda o, a=size: float((o["size_estimate_m"] > a).sum()))  # type: ignore[misc]
    compare("tracklets", lambda o: float(len(o["linked"])))
    return Validation(quantities=tuple(quantities), counts=tuple(counts), runs=len(samples))


def _found(o: Mapping[str, Array], column: str, low: float, high: float) -> float:
    inside = (o[column] >= low) & (o[column] < high)
    return float(np.sum(o["all_found"][inside] * o["all_stands_for"][inside]))


def page(found: Validation) -> str:
    """A page in Markdown."""
    lines = [
        f"# The same hours with pixels and without: {found.runs} runs",
        "",
        "| quantity | n, pixels | n, survey | median, pixels | median, survey | KS p |",
        "|---|---|---|---|---|---|",
    ]
    lines += [
        f"| {q.name} | {q.n_pixels} | {q.n_survey} | {q.median_pixels:.4g} | {q.median_survey:.4g} | {q.p_value:.3g} |"
        for q in found.quantities
    ]
    lines += ["", "| a run's count | pixels | 90 % interval | survey | ratio |", "|---|---|---|---|---|"]
    for c in found.counts:
        value = c.pixels["value"]
        if value is None:
            continue
        ratio = c.survey / value if value > 0.0 else float("nan")
        lines.append(
            f"| {c.name} | {value:.3g} | {c.pixels['low']:.3g} to {c.pixels['high']:.3g} | {c.survey:.3g} | {ratio:.3f} |"
        )
    return "\n".join([*lines, ""])
