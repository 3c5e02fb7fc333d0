"""Run the tasks of a campaign: local processes or a dask cluster, one shard each, resumable, failures listed.

Frames never cross a process border: a worker simulates, processes and scores its task in a folder of its own and leaves
one table of truth streaks with what became of them.
"""

import os
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

from sboc_e2e.campaign.plan import Campaign, Task
from sboc_e2e.campaign.worker import run_task
from sboc_e2e.files.atomic import UNWRITABLE, require_writable, write_text
from sboc_e2e.icd.errors import UserError


@dataclass(frozen=True, kw_only=True)
class CampaignResult:
    """What became of the tasks."""

    done: int
    skipped: int
    failed: tuple[tuple[Task, str], ...]
    wall_s: float


def shard_path(out: Path, task: Task) -> Path:
    """Result table of a task."""
    return out / "shards" / f"{task.number:06d}.ecsv"


def failure_path(out: Path, task: Task) -> Path:
    """One line that says why a task failed."""
    return out / "failed" / f"{task.number:06d}.txt"


@contextmanager
def executor(workers: int, scheduler: str | None) -> Iterator[Executor]:
    """Local processes, a dask LocalCluster ("local") or a dask scheduler, all behind the standard library's interface."""
    if scheduler is None:
        # Fresh interpreters: a forked child would inherit the parent's numba and BLAS threads.
        with ProcessPoolExecutor(max_workers=workers, mp_context=get_context("spawn")) as pool:
            yield pool
        return
    try:
        from distributed import Client, LocalCluster
    except ImportError as error:
        raise UserError('--scheduler needs the extra "distributed": pip install "sboc-e2e[distributed]"') from error
    if scheduler == "local":
        with LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None) as cluster, Client(cluster) as client:
            yield client.get_executor(pure=False)
        return
    try:
        client = Client(scheduler, timeout="10s")
    except (OSError, ValueError) as error:
        raise UserError(f"--scheduler {scheduler}: no dask scheduler answers there ({error})"[:300]) from error
    with client:
        yield client.get_executor(pure=False)


def run_campaign(
    campaign: Campaign,
    out: Path,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    report: Callable[[str], None] = lambda line: None,
) -> CampaignResult:
    """Run what is not done yet; finished shards are kept, failed tasks are tried again.

    out : folder of the campaign; it must be empty or belong to the same campaign.
    scheduler : "tcp://host:port" of a dask scheduler, "local" for a dask LocalCluster, None for local processes.
    """
    start = time.monotonic()
    tasks = campaign.tasks()
    for name in ("shards", "failed", "work"):
        require_writable(out / name)
    todo = [task for task in tasks if not shard_path(out, task).is_file()]
    failed: list[tuple[Task, str]] = []
    with executor(workers or os.cpu_count() or 1, scheduler) as pool:
        running = {pool.submit(run_task, campaign, task, str(out)): task for task in todo}
        for count, future in enumerate(as_completed(running), 1):
            task = running[future]
            failure = failure_path(out, task)
            try:
                future.result()
                failure.unlink(missing_ok=True)
                report(f"{count}/{len(todo)} {task.label}, replica {task.replica}")
            except Exception as error:  # a task that fails is listed with its reason, the rest goes on
                if isinstance(error, OSError) and error.errno in UNWRITABLE:
                    # The next tasks would meet the same: stop, and keep what is done.
                    for waiting in running:
                        waiting.cancel()
                    raise
                reason = f"{type(error).__name__}: {error}".splitlines()[0][:500]
                write_text(failure, f"{task.label}, replica {task.replica}: {reason}\n")
                failed.append((task, reason))
                report(f"{count}/{len(todo)} FAILED {task.label}, replica {task.replica}: {reason}")
    return CampaignResult(
        done=len(todo) - len(failed), skipped=len(tasks) - len(todo), failed=tuple(failed), wall_s=time.monotonic() - start
    )
