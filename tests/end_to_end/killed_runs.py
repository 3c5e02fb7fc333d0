"""Runs that are killed: what the nursery calls, without what no test of killed runs compares."""

from functools import wraps
from typing import Any

from ground.population import flux
from sboc_e2e.cli import run
from sboc_e2e.report import plots
from sboc_e2e.run import states
from sboc_e2e.score import figures, recovery
from simulator.chain import Simulator


def quick(arguments: list[str]) -> int:
    """`sboc` with empty plots, few random draws, and one summary of the population for all runs of a scenario and seed.

    Forks of a warm process spend their time on what they write. Score and report are written all the same; their bytes are
    not compared. Those of the population are, with runs of as few draws. The summary depends on nothing that a run leaves on
    disk. Together these take three quarters of the time of a small run.

    A state is kept after every frame. How many a run keeps by the clock differs from run to run, and the changes it is killed
    at are counted.
    """
    states.WORK_PER_COST = 0.0  # type: ignore[misc]
    plots.svg = lambda _: "<svg></svg>"
    flux.CANDIDATES = 500  # type: ignore[misc]
    flux.DRAWS = recovery.DRAWS = figures.BOOTSTRAP_DRAWS = 20  # type: ignore[misc]
    if not hasattr(Simulator.population_summary, "__wrapped__"):
        Simulator.population_summary = _once(Simulator.population_summary)  # type: ignore[method-assign]
    return run(arguments)


def _once(summary: Any) -> Any:
    known: dict[str, Any] = {}

    @wraps(summary)
    def found(simulator: Simulator) -> Any:
        key = f"{simulator.options!r} {simulator.seed}"
        if key not in known:
            known[key] = summary(simulator)
        return known[key]

    return found
