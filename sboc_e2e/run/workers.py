"""How many processes a run, a campaign or a survey uses, and those that do its tasks, here or on a dask cluster."""

import os
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context
from typing import Final

from sboc_e2e.icd.errors import UserError
from sboc_e2e.scenario import Scenario

SMALL_PX: Final = 20_000_000
"""Starting processes takes longer than simulating fewer pixels than this."""


def worker_count(wanted: int) -> int:
    """Processes to use: as asked, or one for each processor this process may run on."""
    if wanted < 0:
        raise UserError(f"--workers: expected 0 (one for each processor) or more, got {wanted}")
    available = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return wanted or available


def simulation_processes(wanted: int, scenario: Scenario) -> int:
    """Processes that simulate a scenario's frames: as asked, or (0) one for each processor, and one alone for few pixels."""
    camera = scenario.simulator.instrument
    if wanted == 0 and scenario.simulator.frames * camera.rows * camera.cols < SMALL_PX:
        return 1
    return worker_count(wanted)


@contextmanager
def executor(workers: int, scheduler: str | None, *, here: bool = False) -> Iterator[tuple[Executor, int]]:
    """Local processes, a dask LocalCluster ("local") or a dask scheduler, all behind the standard library's interface.

    Beside it: how many tasks it runs at a time. here : in this process, one task after the other.
    """
    if here:
        with ThreadPoolExecutor(max_workers=1) as pool:
            yield pool, 1
        return
    if scheduler is None:
        # Fresh interpreters: a forked child would inherit the parent's numba and BLAS threads.
        with ProcessPoolExecutor(max_workers=workers, mp_context=get_context("spawn")) as processes:
            yield processes, workers
        return
    try:
        from distributed import Client, LocalCluster
    except ImportError as error:
        raise UserError('--scheduler needs the extra "distributed": pip install "sboc-e2e[distributed]"') from error
    if scheduler == "local":
        # without a dashboard dask's scheduler still opens port 8787, which another cluster of this machine may have
        any_port = {"dashboard_address": "127.0.0.1:0"}
        cluster = LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None, scheduler_kwargs=any_port)
        with cluster, Client(cluster) as client:
            yield client.get_executor(pure=False), workers
        return
    try:
        client = Client(scheduler, timeout="10s")
    except (OSError, ValueError) as error:
        raise UserError(f"--scheduler {scheduler}: no dask scheduler answers there ({error})"[:300]) from error
    with client:
        yield client.get_executor(pure=False), max(1, sum(client.nthreads().values()))
