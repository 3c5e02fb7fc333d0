"""Schedules of `sboc plan` against the best of all, found by SciPy's HiGHS: 30 cases that are too large to try all schedules.

``python -m tests.benchmarks.plan_optimum [SEEDS] [LIMIT_S]`` prints a row for each case (10 seeds, 60 s for the solver) and the
distribution. A ratio is that to the solver's bound, which is the optimum unless the row says that the time was up.
"""

import sys
import time
from dataclasses import replace

import numpy as np

from ground.planning.greedy import Chosen, best_visits
from ground.planning.options import PlanOptions, SlewOptions
from tests.planning.exact import best_of_all, windows_case

SIZES = ((20, 6), (40, 12), (60, 16))
"""Slots and targets."""

OPTIONS = PlanOptions(visit_s=120.0, slew=SlewOptions(rate_deg_s=0.5, settling_s=30.0))
HALF_FIELD, OBSERVING_S = np.radians(2.0), 10.0


def main(seeds: int = 10, limit_s: float = 60.0) -> None:
    """Write the table."""
    greedy_options = replace(OPTIONS, look_ahead=1, choices=1)
    say("| slots | targets | seed | planner / bound | greedy / bound | planner (s) | solver (s) | |")
    say("|---|---|---|---|---|---|---|---|")
    ratios, greedy_ratios = [], []
    for slots, targets in SIZES:
        for seed in range(seeds):
            case, weight = windows_case(seed, slots=slots, targets=targets, visit_s=OPTIONS.visit_s)
            times = [time.perf_counter()]
            found = worth(best_visits(case, weight, HALF_FIELD, OBSERVING_S, OPTIONS))
            times.append(time.perf_counter())
            best = best_of_all(case, weight, HALF_FIELD, OBSERVING_S, OPTIONS, limit_s)
            times.append(time.perf_counter())
            greedy = worth(best_visits(case, weight, HALF_FIELD, OBSERVING_S, greedy_options))
            ratios.append(found / best.bound)
            greedy_ratios.append(greedy / best.bound)
            gap = 1.0 - best.worth / best.bound
            note = f"time was up, gap {gap:.4f}" if gap > 1e-4 else ""
            planned, solved = np.diff(times)
            say(
                f"| {slots} | {targets} | {seed} | {ratios[-1]:.4f} | {greedy_ratios[-1]:.4f} | {planned:.2f} | {solved:.1f} "
                f"| {note} |"
            )
    for name, values in (("planner", ratios), ("greedy", greedy_ratios)):
        low, median, high = np.quantile(values, [0.05, 0.5, 0.95])
        say(
            f"{name}: n = {len(values)}, least {min(values):.4f}, 5 % {low:.4f}, median {median:.4f}, 95 % {high:.4f}, "
            f"{sum(value >= 0.95 for value in values)} within 5 %"
        )


def say(line: str) -> None:
    """Write a line now."""
    print(line, flush=True)  # noqa: T201 - the script's result


def worth(visits: list[Chosen]) -> float:
    """Sum of the gains (nats)."""
    return sum(float(visit.gains.sum()) for visit in visits)


if __name__ == "__main__":
    main(*(int(text) for text in sys.argv[1:2]), *(float(text) for text in sys.argv[2:3]))
