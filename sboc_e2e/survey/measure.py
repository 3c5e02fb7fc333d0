"""From a scenario to its response file: runs of the pixel chain, and what they show."""

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypedDict, Unpack

from sboc_e2e import provenance
from sboc_e2e.files.atomic import write_text
from sboc_e2e.icd.errors import UserError
from sboc_e2e.run.pipeline import worker_count
from sboc_e2e.scenario import Scenario
from sboc_e2e.survey import response
from sboc_e2e.survey.engine import refuse_empty_sky
from sboc_e2e.survey.gather import IDENTITY, RESPONSE, VALIDATION, Gathered, gather, seeds_for
from sboc_e2e.survey.validate import page, validate


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
    **how: Unpack[How],
) -> tuple[Path, tuple[tuple[int, str], ...]]:
    """Write `response.json` in a folder from `runs` runs, those that are there already included; its path, and what failed.

    UserError for a scenario in which nothing flies, and where every run failed.
    """
    refuse_empty_sky(scenario, "measure")
    seeds = seeds_for(scenario, RESPONSE, runs)
    folder = out / "samples"
    found = _gathered(scenario, seeds, folder, **how)
    failed = {seed for seed, _ in found.failed}
    identity: dict[str, Any] = json.loads((folder / IDENTITY).read_text(encoding="utf-8"))
    content = response.made_of(
        scenario, found.samples, identity["code"], provenance.commit(), [seed for seed in seeds if seed not in failed]
    )
    path = out / "response.json"
    response.write(path, content)
    return path, found.failed


def judge_response(
    scenario: Scenario,
    runs: int,
    out: Path,
    **how: Unpack[How],
) -> Path:
    """Compare `response.json` of a folder with `runs` other runs of the pixel chain: `validation.md`."""
    seeds = seeds_for(scenario, VALIDATION, runs)
    found = _gathered(scenario, seeds, out / VALIDATION, **how)
    path = out / "validation.md"
    write_text(path, page(validate(found.samples, scenario, response.read(out / "response.json", scenario))))
    return path
