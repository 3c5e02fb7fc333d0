"""Schedules of cases that are too large to try all of them, against HiGHS; HiGHS against all schedules of small ones."""

import itertools

import numpy as np
import pytest

from ground.planning.greedy import best_visits
from ground.planning.options import PlanOptions, SlewOptions
from tests.planning.exact import best_of_all, windows_case
from tests.planning.test_greedy import HALF_FIELD, OBSERVING_S, VISIT_S, case
from tests.planning.test_greedy import best_of_all as best_tried

OPTIONS = PlanOptions(visit_s=VISIT_S, slew=SlewOptions(rate_deg_s=0.5, settling_s=30.0))


@pytest.mark.parametrize("seed", range(4))
def test_the_solver_finds_the_best_of_all_schedules(seed: int) -> None:
    slots, weight = case(seed)
    found = best_of_all(slots, weight, HALF_FIELD, OBSERVING_S, OPTIONS, 60.0)
    assert found.worth == pytest.approx(best_tried(slots, weight, OPTIONS), rel=1e-6)
    assert found.bound == pytest.approx(found.worth, rel=1e-5)


@pytest.mark.parametrize(
    ("slots", "targets", "seed"),
    [
        (20, 6, 0),
        (20, 6, 1),
        (20, 6, 2),
        pytest.param(40, 12, 1, marks=pytest.mark.slow),
        pytest.param(60, 16, 0, marks=pytest.mark.slow),
    ],
)
def test_schedules_are_within_five_percent_of_the_solvers_bound(slots: int, targets: int, seed: int) -> None:
    made, weight = windows_case(seed, slots=slots, targets=targets, visit_s=VISIT_S)
    best = best_of_all(made, weight, HALF_FIELD, OBSERVING_S, OPTIONS, 60.0)
    visits = best_visits(made, weight, HALF_FIELD, OBSERVING_S, OPTIONS)
    worth = sum(float(visit.gains.sum()) for visit in visits)
    assert worth <= best.bound * (1.0 + 1e-6)
    assert worth >= 0.95 * best.bound


def test_gains_of_an_improved_schedule_add_up_and_its_slews_fit() -> None:
    """What is known at the end is the sum of what visits tell; the camera reaches every field."""
    made, weight = windows_case(5, slots=40, targets=12, visit_s=VISIT_S)
    visits = best_visits(made, weight, HALF_FIELD, OBSERVING_S, OPTIONS)
    known = np.broadcast_to(np.eye(6), (12, 6, 6)).copy()
    for visit in visits:
        told = made[visit.slot].told[visit.members]
        known[made[visit.slot].target[visit.members]] += np.swapaxes(told, 1, 2) @ told
    want = float(weight @ (0.5 * np.linalg.slogdet(known)[1]))
    assert sum(float(visit.gains.sum()) for visit in visits) == pytest.approx(want, rel=1e-6)
    for one, other in itertools.pairwise(visits):
        angle = np.degrees(np.arccos(np.clip(one.boresight @ other.boresight, -1.0, 1.0)))
        needed_s = 0.0 if angle < 1e-4 else angle / 0.5 + 30.0
        assert (other.slot - one.slot) * VISIT_S >= needed_s + OBSERVING_S
