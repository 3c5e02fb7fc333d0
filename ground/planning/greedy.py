"""The schedule, one visit after another: the best fields now are tried, the best schedules so far are kept.

With one schedule and one choice this is the greedy one, which for worths that only fall (they are submodular) and free slews
is never below 1 - 1/e of the optimum (Nemhauser, Wolsey & Fisher 1978, Math. Program. 14, 265). Schedules kept side by side see
a poor slew some visits ahead.
"""

from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ground.planning.options import PlanOptions
from ground.planning.worth import gains, updated

Array = NDArray[np.float64]

_SAME_FIELD_RAD: Final = 1e-6
_LEAST_GAIN: Final = 1e-9


@dataclass(frozen=True, kw_only=True, eq=False)
class Slot:
    """What can be seen in one slot: target : (v,) numbers, direction : (v, 3), told : (v, 2, 6)."""

    start_s: float
    target: NDArray[np.int64]
    direction: Array
    told: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Chosen:
    """A field that was visited: slot, boresight (3,), its place among the slot's targets, gains (c,)."""

    slot: int
    boresight: Array
    members: NDArray[np.int64]
    gains: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class _Branch:
    """One schedule so far. visits : its last visit and the chain of those before it."""

    covariance: Array
    worth: float
    boresight: Array | None
    free_s: float
    visits: tuple[Any, Chosen] | None


def best_visits(
    slots: list[Slot], weight: Array, half_field_rad: float, observing_s: float, options: PlanOptions
) -> list[Chosen]:
    """Visits in their order. weight : (m,) of targets; observing_s : of a visit, without slew and settling.

    A limit of visits per day is met by a price: fields that are worth less are left out. Where no price leaves few enough, the
    best of each day are kept.
    """
    visits = _searched(slots, weight, half_field_rad, observing_s, options, 0.0)
    limit = options.daily_visits
    if limit == 0 or _busiest_day(visits, slots) <= limit:
        return visits
    low, high = 0.0, max(float(visit.gains.sum()) for visit in visits)
    kept: list[Chosen] = []
    for _ in range(8):
        price = 0.5 * (low + high)
        found = _searched(slots, weight, half_field_rad, observing_s, options, price)
        if _busiest_day(found, slots) <= limit:
            high, kept = price, found
        else:
            low, visits = price, found
    return kept or _best_of_days(visits, slots, weight, limit)


def _best_of_days(visits: list[Chosen], slots: list[Slot], weight: Array, limit: int) -> list[Chosen]:
    """The visits of each day with the largest gains, worth what they are without the others.

    A camera that leaves out a field is not later at the next: slews obey the triangle inequality.
    """
    by_day: dict[int, list[Chosen]] = {}
    for visit in visits:
        by_day.setdefault(int(slots[visit.slot].start_s // 86400.0), []).append(visit)
    best = [visit for day in by_day.values() for visit in sorted(day, key=lambda one: -float(one.gains.sum()))[:limit]]
    covariance = np.broadcast_to(np.eye(6), (len(weight), 6, 6)).copy()
    out = []
    for visit in sorted(best, key=lambda one: one.slot):
        slot = slots[visit.slot]
        seen, told = slot.target[visit.members], slot.told[visit.members]
        out.append(replace(visit, gains=weight[seen] * gains(covariance[seen], told)))
        covariance[seen] = updated(covariance[seen], told)
    return out


def _busiest_day(visits: list[Chosen], slots: list[Slot]) -> int:
    """Most visits in a day of the plan."""
    days = [int(slots[visit.slot].start_s // 86400.0) for visit in visits]
    return int(np.bincount(days).max()) if days else 0


def _searched(
    slots: list[Slot], weight: Array, half_field_rad: float, observing_s: float, options: PlanOptions, price: float
) -> list[Chosen]:
    """Beam search over the slots."""
    start = np.broadcast_to(np.eye(6), (len(weight), 6, 6)).copy()
    branches = [_Branch(covariance=start, worth=0.0, boresight=None, free_s=-np.inf, visits=None)]
    for number, slot in enumerate(slots):
        if not len(slot.target):
            continue
        together = slot.direction @ slot.direction.T >= np.cos(half_field_rad)
        children: list[tuple[float, int, Chosen | None]] = []
        for k, branch in enumerate(branches):
            children.append((branch.worth, k, None))
            gain = weight[slot.target] * gains(branch.covariance[slot.target], slot.told)
            sums = np.where(_reachable(branch, slot, observing_s, options), together @ gain, 0.0)
            for place in np.argsort(-sums, kind="stable")[: options.choices]:
                if sums[place] - price > _LEAST_GAIN:
                    members = np.flatnonzero(together[place])
                    visit = Chosen(slot=number, boresight=slot.direction[place], members=members, gains=gain[members])
                    children.append((branch.worth + float(sums[place]) - price, k, visit))
        children.sort(key=lambda child: -child[0])
        branches = [_grown(branches[k], slots, visit, worth, options) for worth, k, visit in _unlike(children, options)]
    return _path(max(branches, key=lambda branch: branch.worth))


def _unlike(children: list[tuple[float, int, Chosen | None]], options: PlanOptions) -> list[tuple[float, int, Chosen | None]]:
    """The best children whose worths differ: the same visits in another order would fill the beam."""
    kept: list[tuple[float, int, Chosen | None]] = []
    for child in children:
        if len(kept) == options.look_ahead:
            break
        if all(abs(child[0] - other[0]) > 1e-9 * max(1.0, other[0]) for other in kept):
            kept.append(child)
    return kept


def _reachable(branch: _Branch, slot: Slot, observing_s: float, options: PlanOptions) -> NDArray[np.bool_]:
    """Which targets (v,) the camera can rest on in time."""
    if branch.boresight is None:
        return np.ones(len(slot.target), dtype=np.bool_)
    angle = np.arccos(np.clip(slot.direction @ branch.boresight, -1.0, 1.0))
    needed_s = np.where(angle < _SAME_FIELD_RAD, 0.0, np.degrees(angle) / options.slew.rate_deg_s + options.slew.settling_s)
    return np.asarray(branch.free_s + needed_s + observing_s <= slot.start_s + options.visit_s)


def _grown(branch: _Branch, slots: list[Slot], visit: Chosen | None, worth: float, options: PlanOptions) -> _Branch:
    """A schedule with one more visit, or with an idle slot."""
    if visit is None:
        return branch
    slot = slots[visit.slot]
    seen = slot.target[visit.members]
    covariance = branch.covariance.copy()
    covariance[seen] = updated(covariance[seen], slot.told[visit.members])
    return replace(
        branch,
        covariance=covariance,
        worth=worth,
        boresight=visit.boresight,
        free_s=slot.start_s + options.visit_s,
        visits=(branch.visits, visit),
    )


def _path(branch: _Branch) -> list[Chosen]:
    """Visits of a schedule, first to last."""
    visits: list[Chosen] = []
    chain = branch.visits
    while chain is not None:
        chain, visit = chain
        visits.append(visit)
    return visits[::-1]
