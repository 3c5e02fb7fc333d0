"""Schedules of small cases against all schedules that there are."""

import itertools

import numpy as np
import pytest

from ground.planning.greedy import Slot, best_visits
from ground.planning.information import gains, updated
from ground.planning.options import PlanOptions, SlewOptions

VISIT_S, OBSERVING_S, HALF_FIELD = 120.0, 10.0, np.radians(2.0)


def case(seed: int, *, slots: int = 5, targets: int = 4) -> tuple[list[Slot], np.ndarray]:
    """Targets scattered over 120 deg of a circle, each seen in some slots, told with random accuracy."""
    rng = np.random.default_rng(seed)
    angle = rng.uniform(0, np.radians(120), targets)
    direction = np.stack([np.cos(angle), np.sin(angle), np.zeros(targets)], axis=1)
    made = []
    for k in range(slots):
        seen = np.flatnonzero(rng.random(targets) < 0.7)
        told = rng.normal(size=(len(seen), 2, 6)) * rng.uniform(0.5, 30, (len(seen), 1, 1))
        made.append(Slot(start_s=k * VISIT_S, target=seen, direction=direction[seen], told=told))
    return made, rng.uniform(0.5, 2.0, targets)


def best_of_all(slots: list[Slot], weight: np.ndarray, options: PlanOptions) -> float:
    """Worth of the best of all sequences of fields, idle slots among them; slews that do not fit are left out."""
    best = 0.0
    for choice in itertools.product(*([None, *range(len(slot.target))] for slot in slots)):
        covariance = np.broadcast_to(np.eye(6), (len(weight), 6, 6)).copy()
        worth, at, free_s = 0.0, None, -np.inf
        for slot, place in zip(slots, choice, strict=True):
            if place is None:
                continue
            there = slot.direction[place]
            if at is not None:
                angle = float(np.arccos(np.clip(at @ there, -1, 1)))
                needed = 0.0 if angle < 1e-6 else np.degrees(angle) / options.slew.rate_deg_s + options.slew.settling_s
                if free_s + needed + OBSERVING_S > slot.start_s + VISIT_S:
                    break
            seen = np.flatnonzero(slot.direction @ there >= np.cos(HALF_FIELD))
            which = slot.target[seen]
            worth += float(weight[which] @ gains(covariance[which], slot.told[seen]))
            covariance[which] = updated(covariance[which], slot.told[seen])
            at, free_s = there, slot.start_s + VISIT_S
        else:
            best = max(best, worth)
    return best


@pytest.mark.slow
def test_schedules_are_within_five_percent_of_the_optimum() -> None:
    """Thirty cases; the slew of 1 deg/s reaches fields within 80 deg in one slot, farther ones only after an idle one."""
    options = PlanOptions(visit_s=VISIT_S, slew=SlewOptions(rate_deg_s=1.0, settling_s=30.0))
    ratios = []
    for seed in range(30):
        slots, weight = case(seed)
        found = best_visits(slots, weight, HALF_FIELD, OBSERVING_S, options)
        ratios.append(sum(float(visit.gains.sum()) for visit in found) / best_of_all(slots, weight, options))
    assert max(ratios) <= 1.0 + 1e-9
    assert min(ratios) >= 0.95, ratios


def test_a_limit_of_visits_per_day_is_kept_and_leaves_the_best() -> None:
    slots, weight = case(1, slots=40)
    free = PlanOptions(visit_s=VISIT_S, slew=SlewOptions(rate_deg_s=1.0, settling_s=30.0))
    limited = PlanOptions(visit_s=VISIT_S, slew=free.slew, daily_visits=10)
    everything = best_visits(slots, weight, HALF_FIELD, OBSERVING_S, free)
    few = best_visits(slots, weight, HALF_FIELD, OBSERVING_S, limited)
    assert 5 <= len(few) <= 10 < len(everything)
    first = sum(float(visit.gains.sum()) for visit in everything[:10])
    assert sum(float(visit.gains.sum()) for visit in few) > 0.9 * first
