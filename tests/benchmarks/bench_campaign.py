"""Campaigns: efficiency of two workers over one, overhead of the scheduler per task, and what a million frames would cost."""

import tempfile
import time
from pathlib import Path
from typing import Any, Final

import numpy as np

from sboc_e2e.campaign import Campaign, run_campaign
from sboc_e2e.run.workers import executor
from sboc_e2e.score.figures import Figure, absent, bootstrap, exact, figure

FRAMES: Final = 3
REPEATS: Final = 4
OVERHEADS: Final = 5
FEW, MANY = 2, 6
"""Tasks of the two campaigns whose difference is timed."""
NODES: Final = 100
CORES_PER_NODE: Final = 2
MILLION: Final = 1_000_000


def nothing(_: int) -> None:
    """An empty task."""


def overhead_ms(workers: int, tasks: int) -> Figure:
    """Milliseconds for each empty task through the process pool, start of the pool excluded: median and range of some repeats.

    A single one doubles when the system is busy elsewhere.
    """
    found = []
    with executor(workers, None) as (pool, _):
        list(pool.map(nothing, range(workers * 4)))
        for _ in range(OVERHEADS):
            start = time.perf_counter()
            list(pool.map(nothing, range(tasks)))
            found.append(1000.0 * (time.perf_counter() - start) / tasks)
    return figure(float(np.median(found)), OVERHEADS, min(found), max(found))


def seconds(workers: int, tasks: int, folder: Path) -> float:
    """Wall seconds of a campaign of smoke runs."""
    campaign = Campaign(
        name="bench",
        scenario="smoke",
        seed=1,
        replicas=tasks,
        constant={"frames": FRAMES},
        vary={"instrument.aperture": ["4 cm"]},
    )
    result = run_campaign(campaign, folder, workers=workers)
    if result.failed:
        raise RuntimeError(result.failed[0][1])
    return result.wall_s


def main(quick: bool = False) -> dict[str, Any]:
    """Efficiency over repeats, overhead, and the cost of a million frames on a hundred nodes from both.

    quick : the overhead alone; an efficiency takes minutes of campaigns and one of them says nothing.
    """
    overhead = overhead_ms(2, 200 if quick else 1000)
    result: dict[str, Any] = {"overhead_ms_per_task": overhead}
    if quick:
        return result
    efficiency, per_frame = [], []
    with tempfile.TemporaryDirectory() as root:
        for repeat in range(REPEATS):
            # Differences of two sizes take the start of the interpreters out of both.
            one = [seconds(1, n, Path(root) / f"{repeat}-1-{n}") for n in (FEW, MANY)]
            two = [seconds(2, n, Path(root) / f"{repeat}-2-{n}") for n in (FEW, MANY)]
            efficiency.append((one[1] - one[0]) / max(2.0 * (two[1] - two[0]), 1e-9))
            per_frame.append((one[1] - one[0]) / ((MANY - FEW) * FRAMES))
    task_s = float(np.median(per_frame)) * FRAMES + overhead["value"] / 1000.0
    hours = MILLION / FRAMES * task_s / (NODES * CORES_PER_NODE) / 3600.0
    return result | {
        "efficiency_2_workers": bootstrap(efficiency, lambda v: float(np.median(v))),
        "smoke_wall_s_per_frame": exact(float(np.median(per_frame)), len(per_frame)),
        "million_smoke_frames_on_100_nodes_hours": exact(hours, 1) if np.isfinite(hours) else absent("not finite"),
    }
