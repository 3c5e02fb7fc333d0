"""Efficiency of `sboc survey` from one worker to two: the same blocks with both, in turns, on a machine that is free.

``python -m tests.benchmarks.survey_workers [DAYS] [REPEATS]`` (16 days, three repeats: seven minutes on two free cores) prints
the load before each pair of surveys, their times by the clock, and two efficiencies with their spread. That of whole surveys is
one worker's time over twice that of two. That of the blocks between the first and the last leaves out the start of the processes,
which is a share of these short surveys and of none of a year. Kernels are compiled by a survey that is not counted.
"""

import os
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from sboc_e2e import scenario
from sboc_e2e.registry import Registry
from sboc_e2e.survey import response as responses
from sboc_e2e.survey.engine import run_survey


def main(days: float = 16.0, repeats: int = 3) -> None:
    """Print the times and the efficiency."""
    found = scenario.load("sso_antisun", registry=Registry())
    measured = responses.read(responses.shipped(found), found)
    with tempfile.TemporaryDirectory() as folder:

        def seconds(name: str, length: float, workers: int) -> tuple[float, float]:
            """Of a whole survey, and of a block once the first one is done."""
            times: list[float] = []
            out = Path(folder) / name
            result = run_survey(found, measured, length, out, workers=workers, report=lambda _: times.append(time.monotonic()))
            assert not result.failed, result.failed
            return result.wall_s, (times[-1] - times[0]) / (len(times) - 1)

        seconds("warm", 0.5, 2)
        whole, blocks = [], []
        say("| repeat | load before | one worker (s) | two workers (s) | efficiency | of blocks |\n|---|---|---|---|---|---|")
        for k in range(repeats):
            load = os.getloadavg()[0]
            one, two = (seconds(f"{workers}-{k}", days, workers) for workers in (1, 2))
            whole.append(one[0] / (2.0 * two[0]))
            blocks.append(one[1] / (2.0 * two[1]))
            say(f"| {k} | {load:.2f} | {one[0]:.1f} | {two[0]:.1f} | {whole[-1]:.3f} | {blocks[-1]:.3f} |")
    for name, values in (("whole surveys", whole), ("blocks", blocks)):
        say(f"{name}: efficiency {np.mean(values):.3f}, from {min(values):.3f} to {max(values):.3f} (n = {repeats})")
    say(f"{os.cpu_count()} cores, {days:g} days")


def say(line: str) -> None:
    """Write a line now."""
    print(line, flush=True)  # noqa: T201 - the script's result


if __name__ == "__main__":
    main(*(float(text) for text in sys.argv[1:2]), *(int(text) for text in sys.argv[2:3]))
