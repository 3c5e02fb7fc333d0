"""Many runs of the pixel chain, each with its own seed, as samples in a folder; what is there already is kept."""

import hashlib
import json
from collections.abc import Callable, Sequence
from concurrent.futures import as_completed
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

from sboc_e2e import provenance
from sboc_e2e.files.atomic import UNWRITABLE, require_writable, write_json
from sboc_e2e.icd.errors import UserError
from sboc_e2e.run.manifest import versions
from sboc_e2e.run.workers import executor
from sboc_e2e.scenario import Scenario
from sboc_e2e.survey import instrument
from sboc_e2e.survey.sample import sample_run

IDENTITY: Final = "identity.json"
RESPONSE: Final = "response"
VALIDATION: Final = "validation"
"""What runs are for: those that judge a response are none of those that made it."""


@dataclass(frozen=True, kw_only=True)
class Gathered:
    """Samples in the order of the seeds, and what failed with the reason."""

    samples: tuple[dict[str, Any], ...]
    failed: tuple[tuple[int, str], ...]


def seeds_for(scenario: Scenario, purpose: str, n: int) -> list[int]:
    """n seeds for a purpose; more of them leave the first ones as they are."""
    text = f"{scenario.seed} {purpose}"
    return [int.from_bytes(hashlib.sha256(f"{text} {k}".encode()).digest()[:6], "big") for k in range(n)]


def gather(
    scenario: Scenario,
    seeds: Sequence[int],
    folder: Path,
    *,
    workers: int = 1,
    scheduler: str | None = None,
    here: bool = False,
    report: Callable[[str], None] = lambda line: None,
) -> Gathered:
    """Samples of a scenario for each seed; `folder` keeps them. Raises `UserError` for another scenario's or code's folder."""
    require_writable(folder)
    folder.mkdir(parents=True, exist_ok=True)
    _claim(folder, scenario)
    files = {seed: folder / f"{seed:015d}.json" for seed in seeds}
    todo = [seed for seed in seeds if not files[seed].is_file()]
    failed: list[tuple[int, str]] = []
    with executor(workers, scheduler, here=here) as (pool, _):
        running = {pool.submit(sample_run, replace(scenario, seed=seed)): seed for seed in todo}
        for count, future in enumerate(as_completed(running), 1):
            seed, error = running[future], future.exception()
            if isinstance(error, OSError) and error.errno in UNWRITABLE:
                for waiting in running:
                    waiting.cancel()
                raise error
            if error:
                failed.append((seed, (f"{type(error).__name__}: {error}".splitlines() or [""])[0][:300]))
                report(f"{count}/{len(todo)} FAILED seed {seed}: {failed[-1][1]}")
                continue
            write_json(files[seed], future.result())
            report(f"{count}/{len(todo)} seed {seed}: {len(future.result()['streaks'])} trails")
    made = tuple(json.loads(files[seed].read_text(encoding="utf-8")) for seed in seeds if files[seed].is_file())
    return Gathered(samples=made, failed=tuple(failed))


def _claim(folder: Path, scenario: Scenario) -> None:
    """Make the folder this scenario's, or refuse it."""
    document = {**scenario.document(), "seed": 0, "description": "", "output": {}}
    identity = {
        "scenario": instrument.fingerprint(document),
        "code": provenance.code_digest("score"),
        "versions": versions(),
    }
    path = folder / IDENTITY
    if path.is_file():
        found = json.loads(path.read_text(encoding="utf-8"))
        if found != identity:
            which = next(name for name in identity if found.get(name) != identity[name])
            raise UserError(f"{folder}: holds samples of another {which}; --out goes elsewhere, or remove the folder")
    else:
        write_json(path, identity)
