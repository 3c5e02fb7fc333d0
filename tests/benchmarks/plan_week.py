"""Time of `sboc plan` for a week and 500 objects of the geostationary ring, seen from a low orbit: 5,040 slots of two minutes.

``python -m tests.benchmarks.plan_week [OBJECTS] [DAYS]`` (500, 7) runs the command in a process of its own and prints its seconds
by the clock and of the processor, imports, pictures and the folder included. Then it makes the same plan here, with the seconds
of each part. The objects are made up: longitudes even around the ring, inclinations to 15 deg, slow drifts.
"""

import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ground.planning import plan
from sboc_e2e.planning import make, make_plan, read_request
from sboc_e2e.registry import Registry
from tests.element_lines import with_checksums

SEED = 20270129
PARTS = (
    (make, "plan_visits", "plan"), (plan, "states_of", "SGP4"), (plan, "visibility_of", "visibility"), (plan, "_views", "views"),
    (plan, "best_visits", "search"), (plan, "windows_of", "windows"), (make, "_windows", "table of windows"),
    (make, "timeline_png", "picture of the time"), (make, "sky_png", "picture of the sky"),
)  # fmt: skip
"""Functions that are timed: module, name, word."""


def elements(objects: int) -> str:
    """Three-line elements of a made-up ring."""
    rng = np.random.default_rng(SEED)
    lines = []
    for k in range(objects):
        inclination, node, perigee = rng.uniform(0.02, 15.0), rng.uniform(0.0, 360.0), rng.uniform(0.0, 360.0)
        anomaly = (360.0 * k / objects - node - perigee) % 360.0
        motion = 1.00271 + rng.normal(0.0, 0.002)
        lines += [
            f"0 RING {k}",
            f"1 {41000 + k:5d}U 16071A   27028.50000000  .00000000  00000-0  00000-0 0  9990",
            f"2 {41000 + k:5d} {inclination:8.4f} {node:8.4f} {round(rng.uniform(1e3, 9e3)):07d} {perigee:8.4f} {anomaly:8.4f} "
            f"{motion:11.8f} 4000{0}",
        ]
    return with_checksums("\n".join(lines))


def request(folder: Path, objects: int, days: float) -> Path:
    """The plan's file."""
    (folder / "ring.3le").write_text(elements(objects))
    path = folder / "week.toml"
    text = ['scenario = "geo_survey"', 'objects = "ring.3le"', "[plan]", f"days = {days}", 'visit = "120 s"', 'size = "4 m"']
    path.write_text("\n".join(text) + "\n")
    return path


def main(objects: int = 500, days: float = 7.0) -> None:
    """Print the times."""
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        path = request(folder, objects, days)
        before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
        command = [sys.executable, "-c", "from sboc_e2e.cli import main; main()", "plan", str(path), "--out", str(folder / "a")]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        wall, after = time.monotonic() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
        cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        load = os.getloadavg()[0]
        say(f"sboc plan, {objects} objects, {days:g} days: {wall:.1f} s by the clock, {cpu:.1f} CPU-s, load {load:.1f}")
        spent: dict[str, float] = {}
        for module, name, word in PARTS:
            setattr(module, name, timed(getattr(module, name), word, spent))
        asked, file = read_request(str(path), ())
        begin = time.process_time()
        schedule = make_plan(asked, file, folder / "b", Registry())
        say(
            f"here: {time.process_time() - begin:.1f} CPU-s without imports; "
            + ", ".join(f"{k} {v:.1f}" for k, v in spent.items())
        )
        windows = 0 if schedule.windows is None else len(schedule.windows.target)
        seen = np.count_nonzero(schedule.gain_nats > 0)
        say(
            f"{schedule.n_slots} slots, {len(schedule.visits)} visits, {seen} objects visited, {windows} windows; worth "
            f"{schedule.worth:.6f} nats"
        )


def timed(function: Callable[..., Any], word: str, spent: dict[str, float]) -> Callable[..., Any]:
    """The function, its seconds of the processor added up under a word."""

    def run(*values: Any, **named: Any) -> Any:
        begin = time.process_time()
        try:
            return function(*values, **named)
        finally:
            spent[word] = spent.get(word, 0.0) + time.process_time() - begin

    return run


def say(line: str) -> None:
    """Write a line now."""
    print(line, flush=True)  # noqa: T201 - the script's result


if __name__ == "__main__":
    main(*(int(text) for text in sys.argv[1:2]), *(float(text) for text in sys.argv[2:3]))
