"""Run the blocks of a survey: local processes or a dask cluster, two parquet shards for each block, resumable."""

import shutil
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any, Final

from sboc_e2e import provenance
from sboc_e2e.files.atomic import UNWRITABLE, remove_leftovers, require_writable, write_bytes, write_json, write_text
from sboc_e2e.files.identity import identity_in, refuse_strangers
from sboc_e2e.icd.errors import UserError
from sboc_e2e.run.manifest import versions
from sboc_e2e.run.workers import executor
from sboc_e2e.scenario import Scenario
from sboc_e2e.survey import instrument
from sboc_e2e.survey.block import BlockJob, BlockTables, pilot, run_block
from sboc_e2e.survey.response import Response
from simulator.platform import earth
from simulator.scene.fleet import is_given
from simulator.survey.flight import BLOCK_S, refuse_unwatched

IDENTITY: Final = "survey.json"
IDENTITY_KEYS: Final = frozenset({"identity", "days", "block_s", "epoch_utc", "candidates"})
"""Keys by which a survey's own file is known: those that every survey writes."""
FOLDERS: Final = ("tracklets", "truth", "sums", "failed")
EPHEMERIS_END: Final = 2100.0
"""Of ERFA's Earth ephemeris. A camera in orbit needs no orientation of the Earth, whose predictions reach a year only."""
AHEAD: Final = 3
"""Jobs handed out for each worker, so that none waits and results do not pile up."""


@dataclass(frozen=True, kw_only=True)
class SurveyResult:
    """What became of the blocks."""

    done: int
    skipped: int
    failed: tuple[tuple[int, str], ...]
    wall_s: float


def block_count(days: float) -> int:
    """Whole blocks that hold a number of days."""
    return int(-(-days * earth.DAY_S // BLOCK_S))


def refuse_empty_sky(scenario: Scenario, verb: str) -> None:
    """UserError for a scenario in which nothing flies; `verb` is what was to be done with it."""
    options = scenario.simulator
    if not any(c.count for c in options.population.classes) and not is_given(options.objects):
        raise UserError(
            f"scenario {scenario.name}: population.classes: none has a count above 0, and no satellites, constellation, orbit "
            f"or break-up is given, so there is nothing to {verb}"
        )


def run_survey(
    scenario: Scenario,
    response: Response,
    days: float,
    out: Path,
    *,
    workers: int = 1,
    scheduler: str | None = None,
    here: bool = False,
    force: bool = False,
    report: Callable[[str], None] = lambda line: None,
) -> SurveyResult:
    """Make the blocks that are not there yet; failed ones are tried again.

    Raises `UserError` for what cannot be surveyed and for another survey's folder.
    """
    start = time.monotonic()
    if not days > 0.0:
        raise UserError(f"--days: expected more than 0, got {days:g}")
    options = scenario.simulator
    refuse_empty_sky(scenario, "survey")
    epoch = earth.tai_ns_of_utc(options.epoch_utc)
    if earth.jyear(epoch) + days / 365.25 > EPHEMERIS_END:
        raise UserError(f"--days: {days:g} days end after {EPHEMERIS_END:.0f}, where the ephemeris of the Sun ends")
    if options.objects.satellites.file:
        earth.refuse_outside_data(epoch + round(days * earth.DAY_S * 1e9))
    refuse_unwatched(options)
    numbers = _known(out, scenario, response, days, force=force)
    blocks = range(block_count(days))
    todo = [b for b in blocks if not _done(out, b)]
    failed: list[tuple[int, str]] = []
    with executor(workers, scheduler, here=here) as (pool, slots):
        if numbers is None:
            # by the workers, a class each, while they get ready for blocks
            counted = [pool.submit(pilot, options, scenario.seed, k) for k in range(len(options.population.classes))]
            numbers = _begun(out, scenario, response, days, tuple(found.result() for found in counted))
        job = BlockJob(
            flight_options=options,
            seed=scenario.seed,
            numbers=numbers,
            response=response.content,
            frames_lost=scenario.faults.frames.dropped,
            packets_lost=scenario.faults.packets.lost,
            block=0,
        )
        jobs = (replace(job, block=b) for b in todo)
        for count, (block, made, error) in enumerate(_streamed(pool, jobs, slots * AHEAD), 1):
            if error is not None:
                if isinstance(error, OSError) and error.errno in UNWRITABLE:
                    raise error
                if isinstance(error, UserError):
                    raise error
                failed.append((block, (f"{type(error).__name__}: {error}".splitlines() or [""])[0][:300]))
                write_text(out / "failed" / f"{block:06d}.txt", failed[-1][1] + "\n")
                report(f"{count}/{len(todo)} FAILED block {block}: {failed[-1][1]}")
                continue
            if made is not None:
                _store(out, block, made)
                (out / "failed" / f"{block:06d}.txt").unlink(missing_ok=True)
                spent = time.monotonic() - start
                left = spent / count * (len(todo) - count)
                report(f"{count}/{len(todo)} block {block}: {made.sums['tracklets']} tracklets, {left:.0f} s left")
    return SurveyResult(
        done=len(todo) - len(failed),
        skipped=len(blocks) - len(todo),
        failed=tuple(failed),
        wall_s=time.monotonic() - start,
    )


def _streamed(
    pool: Executor, jobs: Iterator[BlockJob], ahead: int
) -> Iterator[tuple[int, BlockTables | None, BaseException | None]]:
    """Results as they come, with a limited number of jobs under way."""
    running: dict[Future[BlockTables], int] = {}
    for job in islice(jobs, ahead):
        running[pool.submit(run_block, job)] = job.block
    try:
        while running:
            finished, _ = wait(running, return_when=FIRST_COMPLETED)
            for future in finished:
                block = running.pop(future)
                for job in islice(jobs, 1):
                    running[pool.submit(run_block, job)] = job.block
                error = future.exception()
                yield block, None if error else future.result(), error
    finally:
        for future in running:
            future.cancel()


def _file(out: Path, kind: str, block: int) -> Path:
    return out / kind / f"{block:06d}.{'json' if kind == 'sums' else 'parquet'}"


def _done(out: Path, block: int) -> bool:
    """The sums are written last."""
    return _file(out, "sums", block).is_file()


def _store(out: Path, block: int, made: BlockTables) -> None:
    write_bytes(_file(out, "tracklets", block), made.tracklets)
    write_bytes(_file(out, "truth", block), made.truth)
    write_json(_file(out, "sums", block), made.sums)


def identity_of(scenario: Scenario, response: Response) -> dict[str, Any]:
    """What decides the rows of a survey; its length is not in it."""
    document = {**scenario.document(), "description": "", "seed": 0, "frames": 0, "output": {}}
    return {
        "scenario": scenario.name,
        "options": instrument.fingerprint(document),
        "seed": scenario.seed,
        "response": instrument.fingerprint(response.content),
        "code": provenance.code_digest("simulate"),
        "versions": versions(),
    }


def _known(out: Path, scenario: Scenario, response: Response, days: float, *, force: bool) -> tuple[int, ...] | None:
    """Candidates of each class of the survey in a folder, None where there is none yet; another one is refused.

    A longer survey goes on in the folder of a shorter one.
    """
    path = out / IDENTITY
    found = identity_in(path, IDENTITY_KEYS, "a survey")
    if found is None:
        # such as the truth/ of a run
        refuse_strangers(out, FOLDERS, IDENTITY, "survey")
        return None
    if force:
        for name in FOLDERS:
            shutil.rmtree(out / name, ignore_errors=True)
        path.unlink(missing_ok=True)
        return None
    wanted = identity_of(scenario, response)
    way_out = "--out goes elsewhere, --force begins anew here"
    try:
        numbers = tuple(int(n) for n in found["candidates"])
        stated, longest = dict(found["identity"]), float(found["days"])
    except (ValueError, TypeError) as error:
        raise UserError(f"{path}: not readable; {way_out}") from error
    differs = next((name for name in wanted if stated.get(name) != wanted[name]), None)
    if differs:
        raise UserError(f"{out}: holds a survey with another {differs}; {way_out}")
    if days > longest:
        write_json(path, found | {"days": days})
    return numbers


def _begun(out: Path, scenario: Scenario, response: Response, days: float, numbers: tuple[int, ...]) -> tuple[int, ...]:
    """Make the folder this survey's; its candidates of each class."""
    require_writable(out)
    for name in FOLDERS:
        (out / name).mkdir(parents=True, exist_ok=True)
        remove_leftovers(out / name)
    content: Mapping[str, Any] = {
        "identity": identity_of(scenario, response),
        "days": days,
        "block_s": BLOCK_S,
        "epoch_utc": scenario.simulator.epoch_utc,
        "candidates": list(numbers),
        "response_runs": response.content["runs"],
        "response_code": response.content["code"],
        "commit": provenance.commit(),
        "document": scenario.document(),
    }
    write_json(out / IDENTITY, content)
    return numbers
