"""From a scenario to its response file: runs of the pixel chain, and what they show."""

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, TypedDict, Unpack

from sboc_e2e import provenance
from sboc_e2e.files.atomic import write_text
from sboc_e2e.icd.errors import UserError
from sboc_e2e.run.workers import worker_count
from sboc_e2e.scenario import Scenario
from sboc_e2e.survey import instrument, response
from sboc_e2e.survey.engine import refuse_empty_sky
from sboc_e2e.survey.gather import IDENTITY, RESPONSE, VALIDATION, Gathered, gather, seeds_for
from sboc_e2e.survey.response import OWN_SKY
from sboc_e2e.survey.validate import kept_scene, page, validate

SAMPLES: Final = "samples"
"""Folder of the samples below the scenario's own sky; those of other skies are beside it."""


class How(TypedDict, total=False):
    """How runs are made: worker processes (0: a core each), the address of a dask scheduler, what to say on the way."""

    workers: int
    scheduler: str | None
    report: Callable[[str], None]


def _gathered(scenario: Scenario, seeds: Sequence[int], folder: Path, **how: Unpack[How]) -> Gathered:
    how["workers"] = worker_count(how.get("workers", 0))
    found = gather(scenario, seeds, folder, **how)
    if not found.samples:
        raise UserError(f"response of {scenario.name}: every run failed, the first with: {found.failed[0][1]}")
    return found


def measure_response(
    scenario: Scenario,
    runs: int,
    out: Path,
    skies: Mapping[str, Scenario] | None = None,
    **how: Unpack[How],
) -> tuple[Path, tuple[tuple[int, str], ...]]:
    """Write `response.json` in a folder from `runs` runs, those that are there already included; its path, and what failed.

    skies : the same scenario below other skies, by name. Every other run is made below one of them in turn, so that half of the
    runs have the scenario's own sky.
    UserError for a scenario in which nothing flies, for a sky with another instrument, and where every run failed.
    """
    refuse_empty_sky(scenario, "measure")
    others = list((skies or {}).items())
    for name, sky in others:
        differs = instrument.first_difference(instrument.description(sky), instrument.description(scenario))
        if differs is not None:
            raise UserError(f"--sky {name}: changes the instrument, not the sky: {differs}")
    seeds = seeds_for(scenario, RESPONSE, runs)
    below = [others[k // 2 % len(others)][0] if others and k % 2 else OWN_SKY for k in range(runs)]
    samples: dict[int, dict[str, Any]] = {}
    failed: list[tuple[int, str]] = []
    for number, (name, sky) in enumerate([(OWN_SKY, scenario), *others]):
        mine = [seed for seed, place in zip(seeds, below, strict=True) if place == name]
        if not mine:
            continue
        found = _gathered(sky, mine, out / (f"samples-sky{number}" if number else SAMPLES), **how)
        lost = {seed for seed, _ in found.failed}
        made = [seed for seed in mine if seed not in lost]
        samples |= {seed: {**sample, "sky": name} for seed, sample in zip(made, found.samples, strict=True)}
        failed += found.failed
    identity: dict[str, Any] = json.loads((out / SAMPLES / IDENTITY).read_text(encoding="utf-8"))
    kept = [seed for seed in seeds if seed in samples]
    content = response.made_of(scenario, [samples[seed] for seed in kept], identity["code"], provenance.commit(), kept)
    path = out / "response.json"
    response.write(path, content)
    return path, tuple(failed)


def judge_response(
    scenario: Scenario,
    runs: int,
    out: Path,
    **how: Unpack[How],
) -> Path:
    """Compare `response.json` of a folder with `runs` other runs of the pixel chain: `validation.md`."""
    measured = response.read(out / "response.json", scenario)  # before the runs: a file of another version ends it here
    seeds = seeds_for(scenario, VALIDATION, runs)
    found = _gathered(scenario, seeds, out / VALIDATION, **how)
    path = out / "validation.md"
    scene = kept_scene(scenario, out / VALIDATION, len(found.samples))
    write_text(path, page(validate(found.samples, scenario, measured, scene)))
    return path
