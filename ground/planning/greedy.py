"""The schedule, one visit after another: the best fields now are tried, the best schedules so far are kept. Then it is improved.

With one schedule and one choice this is the greedy one, which for worths that only fall (they are submodular) and free slews
is never below 1 - 1/e of the optimum (Nemhauser, Wolsey & Fisher 1978, Math. Program. 14, 265). Schedules kept side by side see
a poor slew some visits ahead. They do not see what later visits will tell. What visits tell does not depend on their order, so
that a short run of slots can be searched again with everything known that the visits before and after it tell.
"""

from bisect import bisect_left
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ground.planning.information import Knowledge, gains, updated
from ground.planning.options import PlanOptions

Array = NDArray[np.float64]

_SAME_FIELD_RAD: Final = 1e-6  # 0.2 arcsec: the same field up to rounding needs no slew
_LEAST_GAIN: Final = 1e-9  # of the worth: smaller gains are rounding, and would keep the search going
_RUN: Final = 12
"""Slots that are searched again together; each slot stands in two runs."""
_SWEEPS: Final = 4
"""Searches over all runs, fewer where nothing improves."""
_WIDEST: Final = 64  # schedules kept side by side at most: a limit of memory. Chosen, not measured
_IDLE: Final = -1
"""In place of a field: the slot is left out."""
_SIGHTINGS: Final = 2_000_000
"""Targets in slots times schedules kept side by side: plans with fewer are searched again with wider beams."""


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
class _Case:
    """What is to be planned. weight : (m,) of targets; observing_s : of a visit, without slew and settling."""

    slots: list[Slot]
    weight: Array
    half_field_rad: float
    observing_s: float
    options: PlanOptions


@dataclass(frozen=True, kw_only=True, eq=False)
class _Branch:
    """One schedule so far. places (m,) : of what is known of the targets; visits : its last visit and those before it."""

    places: NDArray[np.int64]
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
    case = _Case(slots=slots, weight=weight, half_field_rad=half_field_rad, observing_s=observing_s, options=options)
    visits = _searched(case, 0.0)
    limit = options.daily_visits
    if limit == 0:
        return _improved(case, visits, 0.0)
    if _busiest_day(visits, slots) <= limit:
        return _improved_within(case, visits, 0.0, limit)
    low, high = 0.0, max(float(visit.gains.sum()) for visit in visits)
    kept: list[Chosen] = []
    for _ in range(8):
        price = 0.5 * (low + high)
        found = _searched(case, price)
        if _busiest_day(found, slots) <= limit:
            high, kept = price, found
        else:
            low, visits = price, found
    if not kept:
        return _best_of_days(visits, slots, weight, limit)
    return _improved_within(case, kept, high, limit)


def _improved_within(case: _Case, visits: list[Chosen], price: float, limit: int) -> list[Chosen]:
    """The improved schedule, or the given one where the improved one has more than `limit` visits in a day."""
    better = _improved(case, visits, price)
    return better if _busiest_day(better, case.slots) <= limit else visits


def _best_of_days(visits: list[Chosen], slots: list[Slot], weight: Array, limit: int) -> list[Chosen]:
    """The visits of each day with the largest gains, worth what they are without the others.

    A camera that leaves out a field is not later at the next: slews obey the triangle inequality.
    """
    by_day: dict[int, list[Chosen]] = {}
    for visit in visits:
        by_day.setdefault(int(slots[visit.slot].start_s // 86400.0), []).append(visit)
    best = [visit for day in by_day.values() for visit in sorted(day, key=lambda one: -float(one.gains.sum()))[:limit]]
    return _in_turn(sorted(best, key=lambda one: one.slot), slots, weight, _nothing_known(len(weight)))


def _in_turn(visits: list[Chosen], slots: list[Slot], weight: Array, covariance: Array) -> list[Chosen]:
    """The same visits with what each adds to those before it; covariance : (m, 6, 6) before the first."""
    covariance = covariance.copy()
    out = []
    for visit in visits:
        slot = slots[visit.slot]
        seen, told = slot.target[visit.members], slot.told[visit.members]
        out.append(replace(visit, gains=weight[seen] * gains(covariance[seen], told)))
        covariance[seen] = updated(covariance[seen], told)
    return out


def _nothing_known(n_targets: int) -> Array:
    """Covariances (m, 6, 6) at the start of the plan, in units of themselves."""
    return np.broadcast_to(np.eye(6), (n_targets, 6, 6)).copy()


def _busiest_day(visits: list[Chosen], slots: list[Slot]) -> int:
    """Most visits in a day of the plan."""
    days = [int(slots[visit.slot].start_s // 86400.0) for visit in visits]
    return int(np.bincount(days).max()) if days else 0


def _searched(case: _Case, price: float) -> list[Chosen]:
    """The best of the schedules that a beam search over all slots finds."""
    found = _beam(case, range(len(case.slots)), _nothing_known(len(case.weight)), None, price)
    return _path(max(found, key=lambda branch: branch.worth))


def _improved(case: _Case, visits: list[Chosen], price: float) -> list[Chosen]:
    """The schedule with better visits in short runs of slots; as it is where one schedule alone is looked at (greedy)."""
    options = case.options
    if options.look_ahead == 1:
        return visits
    sightings = max(1, sum(len(slot.target) for slot in case.slots))
    width = min(_WIDEST, max(options.look_ahead, _SIGHTINGS // sightings))
    wide = replace(case, options=replace(options, look_ahead=width))
    for _ in range(_SWEEPS if width > options.look_ahead else 1):
        before = visits
        known = _told(visits, case.slots, len(case.weight))
        for first in range(-_RUN // 2, len(case.slots), _RUN // 2):
            run = range(max(first, 0), min(first + _RUN, len(case.slots)))
            visits, known = _searched_again(wide, run, visits, known, price)
        if visits is before:
            break
    return _in_turn(visits, case.slots, case.weight, _nothing_known(len(case.weight)))


def _told(visits: list[Chosen], slots: list[Slot], n_targets: int) -> Array:
    """What visits tell of each target (m, 6, 6), in units of what is known at the start."""
    out = np.zeros((n_targets, 6, 6))
    for visit in visits:
        slot = slots[visit.slot]
        told = slot.told[visit.members]
        out[slot.target[visit.members]] += np.swapaxes(told, 1, 2) @ told
    return out


def _searched_again(case: _Case, run: range, visits: list[Chosen], known: Array, price: float) -> tuple[list[Chosen], Array]:
    """The schedule with better visits in a run of slots, or as it is where none are found, and what it tells.

    known : (m, 6, 6), what all visits tell.
    """
    slots, weight = case.slots, case.weight
    low, high = (bisect_left(visits, slot, key=lambda visit: visit.slot) for slot in (run.start, run.stop))
    of_others = known - _told(visits[low:high], slots, len(weight))
    seen = np.unique(np.concatenate([slots[number].target for number in run]))
    covariance = np.zeros((len(weight), 6, 6))  # of targets that the run does not show nobody asks
    covariance[seen] = np.linalg.inv(np.eye(6) + of_others[seen])
    branches = _beam(case, run, covariance, visits[low - 1] if low else None, price)
    if high < len(visits):
        after = visits[high]
        fits = _reachable(case, branches, slots[after.slot], after.boresight[None])[:, 0]
        branches = [branch for branch, good in zip(branches, fits, strict=True) if good]
    best = max(branches, key=lambda branch: branch.worth, default=None)
    worth = sum(float(visit.gains.sum()) - price for visit in _in_turn(visits[low:high], slots, weight, covariance))
    if best is None or best.worth <= worth + _LEAST_GAIN * max(1.0, worth):
        return visits, known
    found = _path(best)
    return visits[:low] + found + visits[high:], of_others + _told(found, slots, len(weight))


def _beam(case: _Case, run: range, covariance: Array, before: Chosen | None, price: float) -> list[_Branch]:
    """The best schedules of a run of slots. covariance : (m, 6, 6) at its start; before : the visit before it."""
    weight, options = case.weight, case.options
    known = Knowledge(covariance)
    start = _Branch(
        places=np.arange(len(weight)),
        worth=0.0,
        boresight=None if before is None else before.boresight,
        free_s=-np.inf if before is None else case.slots[before.slot].start_s + options.visit_s,
        visits=None,
    )
    branches = [start]
    for number in run:
        slot = case.slots[number]
        if not len(slot.target):
            continue
        together = (slot.direction @ slot.direction.T >= np.cos(case.half_field_rad)).astype(np.float64)
        places = known.packed(np.stack([branch.places for branch in branches]))
        gain = weight[slot.target] * known.gains(places, slot.target, slot.told)
        sums = np.where(_reachable(case, branches, slot, slot.direction), gain @ together, 0.0)
        best = np.argsort(-sums, axis=1, kind="stable")[:, : options.choices]
        children: list[tuple[float, int, int]] = []
        for k, branch in enumerate(branches):
            children.append((branch.worth, k, _IDLE))
            children.extend(
                (branch.worth + float(sums[k, place]) - price, k, int(place))
                for place in best[k]
                if sums[k, place] - price > _LEAST_GAIN
            )
        children.sort(key=lambda child: -child[0])
        grown = []
        for worth, k, place in _unlike(children, options):
            branch = branches[k]
            if place == _IDLE:
                grown.append(replace(branch, places=places[k]))
                continue
            members = np.flatnonzero(together[place])
            visit = Chosen(slot=number, boresight=slot.direction[place], members=members, gains=gain[k, members])
            grown.append(
                _Branch(
                    places=known.after(places[k], slot.target[members], slot.told[members]),
                    worth=worth,
                    boresight=visit.boresight,
                    free_s=slot.start_s + options.visit_s,
                    visits=(branch.visits, visit),
                )
            )
        branches = grown
    return branches


def _unlike(children: list[tuple[float, int, int]], options: PlanOptions) -> list[tuple[float, int, int]]:
    """The best children whose worths differ: the same visits in another order would fill the beam."""
    kept: list[tuple[float, int, int]] = []
    for child in children:
        if len(kept) == options.look_ahead:
            break
        if all(abs(child[0] - other[0]) > 1e-9 * max(1.0, other[0]) for other in kept):
            kept.append(child)
    return kept


def _reachable(case: _Case, branches: list[_Branch], slot: Slot, direction: Array) -> NDArray[np.bool_]:
    """Which directions (v, 3) the camera can rest on in time, after each schedule (b, v)."""
    options = case.options
    last = np.array([direction[0] if branch.boresight is None else branch.boresight for branch in branches])
    free_s = np.array([branch.free_s for branch in branches])  # minus infinity where nothing was visited before
    angle = np.arccos(np.clip(last @ direction.T, -1.0, 1.0))
    needed_s = np.where(angle < _SAME_FIELD_RAD, 0.0, np.degrees(angle) / options.slew.rate_deg_s + options.slew.settling_s)
    return np.asarray(free_s[:, None] + needed_s + case.observing_s <= slot.start_s + options.visit_s)


def _path(branch: _Branch) -> list[Chosen]:
    """Visits of a schedule, first to last."""
    visits: list[Chosen] = []
    chain = branch.visits
    while chain is not None:
        chain, visit = chain
        visits.append(visit)
    return visits[::-1]
