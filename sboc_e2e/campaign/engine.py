"""Run the tasks of a campaign: local processes or a dask cluster, one shard each, resumable, failures listed.

Tasks with the same simulated frames are one job. Frames never cross a process border: a worker simulates, processes and scores
in a folder of its own, and of each task comes back one table of truth streaks with what became of them.
"""

import json
import shutil
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from sboc_e2e.campaign.plan import Campaign, Task
from sboc_e2e.campaign.resolve import Plan, Resolved
from sboc_e2e.campaign.worker import Job, Outcome, run_job, shard_file
from sboc_e2e.files.atomic import UNWRITABLE, remove_leftovers, require_writable, write_json, write_text
from sboc_e2e.files.identity import identity_in, refuse_strangers
from sboc_e2e.icd.errors import UserError
from sboc_e2e.registry import Registry
from sboc_e2e.run.manifest import first_difference
from sboc_e2e.run.workers import executor, worker_count

IDENTITY: Final = "identity.json"
IDENTITY_KEYS: Final = frozenset({"scenario", "set", "seed", "paired", "code", "versions"})
"""Keys by which a campaign's identity is known: those of `Plan.identity`."""
FOLDERS: Final = ("shards", "failed", "work")


@dataclass(frozen=True, kw_only=True)
class CampaignResult:
    """What became of the tasks. shards : files of all tasks that are done, in the order of the tasks."""

    done: int
    skipped: int
    failed: tuple[tuple[Task, str], ...]
    shards: tuple[Path, ...]
    wall_s: float


def failure_path(out: Path, task: Task) -> Path:
    """One line that says why a task failed."""
    return out / "failed" / f"{task.number:06d}.txt"


def run_campaign(
    campaign: Campaign,
    out: Path,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    registry: Registry | None = None,
    force: bool = False,
    here: bool = False,
    report: Callable[[str], None] = lambda line: None,
) -> CampaignResult:
    """Run what is not done yet; finished shards are kept, failed tasks are tried again.

    out : folder of the campaign; it must be empty or belong to the same campaign. Points and replicas may be added or
    left out. force : forget what another one left there. registry : with the plug-in modules that the user trusts.
    scheduler : "tcp://host:port" of a dask scheduler, "local" for a dask LocalCluster, None for local processes. here : without
    other processes.
    Raises `UserError` before the first task for a scenario that no point can have, and for another campaign's folder.
    """
    start = time.monotonic()
    plan = Plan.of(campaign, registry or Registry())
    resolution = plan.resolve()
    standing, refused = resolution.standing, resolution.refused
    _claim(out, plan.identity(), resolution.outside, force=force)
    for task, reason in refused:
        report(_noted_failure(out, task, reason))
    todo = [task for task in standing if not shard_file(out, task.fingerprint).is_file()]
    failed = list(refused)
    # A scheduler's workers may have another disk, or another working folder: they get none, and their shards travel back.
    place = None if scheduler else str(out.resolve())
    count = 0
    with executor(worker_count(workers or 0), scheduler, here=here) as (pool, slots):
        jobs = [
            Job(plan=plan, tasks=tuple(tasks), surroundings=plan.surroundings(tasks[0].task), out=place)
            for tasks in shared_frames(todo, slots)
        ]
        running = {pool.submit(run_job, job): job for job in jobs}
        for future in as_completed(running):
            error = future.exception()
            if isinstance(error, OSError) and error.errno in UNWRITABLE:
                # The next tasks would meet the same: stop, and keep what is done.
                for waiting in running:
                    waiting.cancel()
                raise error
            outcomes = _all_failed(running[future], error) if error else future.result()
            for resolved, why_not in _stored(out, running[future].tasks, outcomes):
                count += 1
                words = f"{resolved.task.label}, replica {resolved.task.replica}"
                if why_not is None:
                    failure_path(out, resolved.task).unlink(missing_ok=True)
                    report(f"{count}/{len(todo)} {words}")
                else:
                    failed.append((resolved.task, why_not))
                    report(f"{count}/{len(todo)} {_noted_failure(out, resolved.task, why_not)}")
    shards = tuple(path for task in standing if (path := shard_file(out, task.fingerprint)).is_file())
    return CampaignResult(
        done=len(todo) - (len(failed) - len(refused)),
        skipped=len(standing) - len(todo),
        failed=tuple(failed),
        shards=shards,
        wall_s=time.monotonic() - start,
    )


def shared_frames(tasks: Sequence[Resolved], slots: int) -> list[list[Resolved]]:
    """Tasks by the frames that they share, those that share packets beside each other; divided while a slot would be idle.

    slots : how many run at a time.
    """
    by_frames: dict[str, list[Resolved]] = defaultdict(list)
    for task in tasks:
        by_frames[task.frames].append(task)
    groups = [sorted(group, key=lambda task: (task.downlink, task.task.number)) for group in by_frames.values()]
    while groups and len(groups) < slots and len(largest := max(groups, key=len)) > 1:
        groups.remove(largest)
        middle = len(largest) // 2
        groups += [largest[:middle], largest[middle:]]
    return sorted(groups, key=lambda group: min(task.task.number for task in group))


def _all_failed(job: Job, error: BaseException) -> tuple[Outcome, ...]:
    """The reason why a job ended, for all of its tasks."""
    reason = (f"{type(error).__name__}: {error}".splitlines() or [""])[0][:500]
    return tuple(Outcome(fingerprint=task.fingerprint, reason=reason) for task in job.tasks)


def _stored(out: Path, tasks: Sequence[Resolved], outcomes: Sequence[Outcome]) -> Iterator[tuple[Resolved, str | None]]:
    """Each task with None when its shard is there, else with the reason why not."""
    by_fingerprint = {outcome.fingerprint: outcome for outcome in outcomes}
    for task in tasks:
        path, outcome = shard_file(out, task.fingerprint), by_fingerprint.get(task.fingerprint)
        if outcome and outcome.shard is not None and not path.is_file():
            write_text(path, outcome.shard)
        if path.is_file():
            yield task, None
        else:
            yield task, outcome.reason if outcome else "the worker sent nothing back"


def _noted_failure(out: Path, task: Task, reason: str) -> str:
    """Write down why a task failed; a line about it."""
    words = f"{task.label}, replica {task.replica}: {reason}"
    write_text(failure_path(out, task), f"{words}\n")
    return f"FAILED {words}"


def _claim(out: Path, identity: dict[str, Any], outside: dict[str, dict[str, Any]], *, force: bool) -> None:
    """Make the folder this campaign's. Raises `UserError` with what differs when it is another one's.

    outside : plug-ins and files that points name; another point may add some.
    """
    path = out / IDENTITY
    found = identity_in(path, IDENTITY_KEYS, "a campaign")
    if found is None:
        refuse_strangers(out, FOLDERS, IDENTITY, "campaign")
    if force:
        for name in FOLDERS:
            shutil.rmtree(out / name, ignore_errors=True)
        found = None
    earlier: dict[str, dict[str, Any]] = {}
    way_out = "--out goes elsewhere, --force begins anew here"
    shards = sorted((out / "shards").glob("*.ecsv"))
    if found is not None:
        earlier = {name: found.pop(name, {}) for name in outside}
        common = {name: {k: v for k, v in outside[name].items() if k in earlier[name]} for name in outside}
        known = {name: {k: v for k, v in earlier[name].items() if k in outside[name]} for name in outside}
        difference = first_difference(found | known, json.loads(json.dumps(identity | common)))
        if difference:
            raise UserError(f"{out}: holds results of another campaign ({difference}); {way_out}")
    for shard in shards:
        if _stated_fingerprint(shard) != shard.stem:
            raise UserError(f"{shard}: is the result of another task; {way_out}")
    # Before the folders: what a kill from here on leaves in them is known as this campaign's.
    write_json(path, identity | {name: earlier.get(name, {}) | outside[name] for name in outside})
    for name in FOLDERS:
        require_writable(out / name)
    shutil.rmtree(out / "work")
    (out / "work").mkdir()
    remove_leftovers(out / "shards")
    # What failed is tried again, under the numbers that tasks have now.
    for failure in (out / "failed").glob("*.txt"):
        failure.unlink()


def _stated_fingerprint(shard: Path) -> str | None:
    """The fingerprint in the header of a shard, without reading its rows."""
    with shard.open(encoding="utf-8") as stream:
        for line in stream:
            if not line.startswith("#"):
                return None
            value = line.partition("fingerprint:")[2]
            if value:
                return value.strip(" ,{}'\"\n")
    return None
