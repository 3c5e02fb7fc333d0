"""The same hours both ways: objects of pixel runs against objects that a survey's code draws for the same frames.

The runs that judge are none of those that made the response. Trails of one object are alike, so of each object one trail at
random is compared. Counts are compared in the three steps of `sboc_e2e.survey.both_ways`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from io import BytesIO
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import ks_2samp

from sboc_e2e.files.atomic import write_bytes
from sboc_e2e.scenario import Scenario
from sboc_e2e.survey.block import finds_of, tables_of
from sboc_e2e.survey.both_ways import (
    Ratio,
    counted_in_samples,
    expected_of,
    ratios,
    shown_in_samples,
    shown_in_scene,
    shown_to_survey,
)
from sboc_e2e.survey.response import Response
from sboc_e2e.survey.rows import LEAST_SNR, OBJECT_COLUMNS, STREAK_COLUMNS, columns
from simulator.bare_trails import BareTrails, bare_trails, encounters_of
from simulator.randomness import Effect, generator
from simulator.scene.encounters import expected_snr
from simulator.scene.stars import sky_catalogue
from simulator.survey.candidates import candidates, pool_of
from simulator.survey.flight import Flight, Instants, instants_of
from simulator.survey.looks import looks_of
from simulator.survey.passages import Passages, joined

Array = NDArray[np.float64]

CANDIDATES: Final = 400_000
"""Draws of each class, from which the objects of all virtual runs are taken. Chosen, not measured: fewer repeat each other."""
VIRTUAL_RUNS: Final = 20
"""For each run with pixels, so that their own scatter adds 2.5 % to that of the comparison."""
LONGEST_S: Final = 1e6
"""Keeps weights of objects that stand still in the field finite; a run lasts seconds."""
FEW_REDRAWS: Final = 8  # of what is found of 8,400 objects of a round, whose drawing scatters more. Chosen
VALIDATION_BLOCK: Final = 6_000_000
"""Number of a random stream that no survey reaches (1.5 million blocks in 1,000 years), and not that of sensitivities."""
INSTANTS: Final = 256
"""Of a run, one at random in each step. Those at its ends show shortened stays: 64 at random made counts scatter by 6 %."""
SCENE_RUNS: Final = 3
"""Runs of the pixel chain's objects for each that judges, whose true trails are held against a survey's looks at them."""
TURNS: Final = 8  # draws of how they turn in the survey's looks: what tumbles scatters more than the rest together. Chosen
SEEDS: Final = 1  # of the pixel chain's draws of candidates, for each run that judges. Chosen: time against scatter
EACH: Final = 80
"""Runs' objects that are taken out of each draw: 33,600 objects for 20 runs."""
ROUNDS: Final = 0.6
"""Draws of `ROUND_RUNS` virtual runs for each that judges, each with candidates of its own: 12 for 20 runs."""
ROUND_RUNS: Final = 400  # virtual runs of a round: so many that its candidates scatter more than they do. Chosen
FEWEST: Final = 2  # draws, rounds and runs of a scene, so that there is a scatter


def _for(each: float, runs: int) -> int:
    """How many are made for some judging runs: their time goes with the runs'."""
    return max(FEWEST, round(each * runs))


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
class Validation:
    """What was compared."""

    quantities: tuple[Quantity, ...]
    ratios: tuple[Ratio, ...]
    runs: int
    scene_runs: int


def virtual_passages(flight: Flight, runs: int, rng: np.random.Generator) -> tuple[Instants, Passages, NDArray[np.int64]]:
    """Passages that a survey's code draws for the frames of `runs` runs of a scenario, and the run of each."""
    options = flight.options
    duration = options.frames / options.frame_rate_hz
    at = instants_of(flight, (np.arange(INSTANTS) + rng.random(INSTANTS)) / INSTANTS * duration, duration)
    parts: list[Passages] = []
    run: list[NDArray[np.int64]] = []
    for size_class in options.population.classes:
        if size_class.count == 0:
            continue
        drawn = candidates(flight, at, pool_of(flight, size_class, rng), CANDIDATES, rng)
        when = at.time_s[drawn.instant]
        whole = np.minimum(drawn.leave_s - drawn.enter_s, LONGEST_S)
        # a run counts an object that is in the field at any time of it: its stay within the run decides how often it is met
        within = np.minimum(drawn.leave_s + when, duration) - np.maximum(drawn.enter_s + when, 0.0)
        at_most = np.minimum(within, whole)
        # and a run's ends may leave less of it than an exposure: it is drawn by the S/N of what they leave
        rate = np.radians(drawn.rate_deg_s)
        left, all_of_it = (expected_snr(np.ones(1), rate, stay, drawn.range_km, flight.window) for stay in (at_most, whole))
        bright = drawn.snr * left / all_of_it >= options.population.snr_min
        weight = np.where(bright, drawn.natural * whole / np.maximum(at_most, 1e-9), 0.0)
        pick = rng.choice(len(weight), size=size_class.count * runs, p=weight / weight.sum())
        parts.append(drawn.taken(pick))
        run.append(np.repeat(np.arange(runs), size_class.count))
    return at, joined(parts), np.concatenate(run)


def virtual_objects(scenario: Scenario, response: Response, runs: int) -> dict[str, Array]:
    """Objects as a survey's code draws them for `runs` runs of a scenario, one row each, true and measured."""
    options = scenario.simulator
    flight = Flight.of(options, scenario.seed)
    rng = generator(scenario.seed, Effect.SURVEY, VALIDATION_BLOCK)
    at, p, _ = virtual_passages(flight, runs, rng)
    looks = looks_of(flight, at, p, rng, only=(0, options.frames - 1))
    finds = finds_of(p.rate_deg_s, looks, response, rng)
    measured, _ = tables_of(at, p, looks, finds, response, rng)
    best = np.zeros(len(p.size_m))
    later = looks.open_s > 0.0  # trails of a run's first frame are counted on neither side; tracklets may begin with it
    np.maximum.at(best, looks.passage, np.where(later, looks.snr, 0.0))
    trail = _one_of_each(looks.passage, later & (looks.snr >= LEAST_SNR), rng)
    found = _one_of_each(looks.passage, later & finds.look, rng)
    counted = np.bincount(looks.passage, weights=later * (looks.snr >= LEAST_SNR) * looks.stands_for, minlength=len(best))
    return {
        "trail_snr": looks.snr[trail],
        "trail_length_px": looks.length_px[trail],
        "trail_mag": looks.mag[trail],
        "found_snr": looks.snr[found],
        "found_length_px": looks.length_px[found],
        "frames": counted[best >= LEAST_SNR].astype(np.float64),
        "object_size_m": p.size_m[best >= LEAST_SNR],
        "object_rate_deg_s": p.rate_deg_s[best >= LEAST_SNR],
        "linked": measured["n_frames"].astype(np.float64),
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
                "linked": objects["linked"][linked],
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


def validate(samples: Sequence[Mapping[str, Any]], scenario: Scenario, response: Response, scene: BareTrails) -> Validation:
    """Compare the samples of pixel runs with the survey's code. scene : of other runs (`kept_scene`)."""
    rng = np.random.default_rng(20270129)
    theirs = pixel_objects(samples, rng)
    mine = virtual_objects(scenario, response, VIRTUAL_RUNS * len(samples))
    quantities = []
    for name, column in COMPARED:
        a, b = (v[np.isfinite(v)] for v in (theirs[column], mine[column]))
        quantities.append(
            Quantity(
                name=name, n_pixels=len(a), n_survey=len(b), median_pixels=float(np.median(a)), median_survey=float(np.median(b)),
                p_value=float(ks_2samp(a, b).pvalue),
            )
        )  # fmt: skip
    return Validation(
        quantities=tuple(quantities),
        ratios=counts_both_ways(samples, scenario, response, scene),
        runs=len(samples),
        scene_runs=int(scene.run.max()) + 1,
    )


def kept_scene(scenario: Scenario, folder: Path, runs: int) -> BareTrails:
    """The pixel chain's scene for some judging runs, read from a file (npz) in a folder or made and written there."""
    number = _for(SCENE_RUNS, runs)
    path = folder / f"scene-{number}.npz"
    if path.is_file():
        with np.load(path) as kept:
            return BareTrails(**{field.name: kept[field.name] for field in fields(BareTrails)})
    flight = Flight.of(scenario.simulator, scenario.seed)
    made = bare_trails(flight, sky_catalogue(scenario.simulator.stars), range(number))
    stream = BytesIO()
    np.savez_compressed(stream, **{field.name: getattr(made, field.name) for field in fields(made)})
    write_bytes(path, stream.getvalue())
    return made


def counts_both_ways(
    samples: Sequence[Mapping[str, Any]], scenario: Scenario, response: Response, scene: BareTrails
) -> tuple[Ratio, ...]:
    """Counts of pixel runs over those of a survey: what is found, trails, and drawing."""
    flight = Flight.of(scenario.simulator, scenario.seed)
    options = flight.options
    only = (0, options.frames - 1)
    survey, drawn = [], []
    rounds = _for(ROUNDS, len(samples))
    for turn in range(rounds):
        rng = generator(scenario.seed, Effect.SURVEY, VALIDATION_BLOCK, 1 + turn)
        at, p, run = virtual_passages(flight, ROUND_RUNS, rng)
        shown = shown_to_survey(at, p, run, looks_of(flight, at, p, rng, only=only))
        survey.append(expected_of(shown, response, rng, redraws=FEW_REDRAWS).mean(axis=0))
    rng = generator(scenario.seed, Effect.SURVEY, VALIDATION_BLOCK, 1 + rounds)
    for seed in range(_for(SEEDS, len(samples))):
        at, p = encounters_of(flight, seed, EACH)
        shown = shown_to_survey(at, p, np.arange(len(p.size_m)) % EACH, looks_of(flight, at, p, rng, only=only))
        drawn.append(expected_of(shown, response, rng, redraws=FEW_REDRAWS).mean(axis=0))
    true = expected_of(shown_in_scene(scene, options.frame_rate_hz, int(scene.run.max()) + 1), response, rng)
    at, p = scene.as_passages(flight)
    looked = np.stack(
        [
            expected_of(shown_to_survey(at, p, scene.run, looks_of(flight, at, p, rng, only=only)), response, rng, redraws=50)
            for _ in range(TURNS)
        ]
    )
    judged = counted_in_samples(samples), expected_of(shown_in_samples(samples), response, rng)
    return ratios(judged, (true, looked), np.stack(drawn), np.stack(survey))


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
    lines += [
        "",
        f"Finds: what was found in the {found.runs} runs over what the response expects of their trails.",
        f"Trails: what it expects of the true trails in {found.scene_runs} runs of the pixel chain without noise over what it",
        "expects of a survey's looks at the same objects. Drawing: what it expects of looks at the pixel chain's encounters over",
        "a survey's passages. All: the product, pixels over survey. 90 % intervals.",
        "",
        "| count | found | expected | finds | trails | drawing | all | a run of the survey |",
        "|---|---|---|---|---|---|---|---|",
    ]
    lines += [
        f"| {r.name} | {r.found} | {r.expected:.1f} | {_with_interval(r.finds)} | {_with_interval(r.trails)} "
        f"| {_with_interval(r.drawing)} | {_with_interval(r.all)} | {r.survey:.2f} |"
        for r in found.ratios
    ]
    return "\n".join([*lines, ""])


def _with_interval(value: tuple[float, float, float]) -> str:
    return f"{value[0]:.3f} [{value[1]:.3f}, {value[2]:.3f}]"
