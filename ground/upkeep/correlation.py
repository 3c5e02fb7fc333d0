"""Which of a night's tracklets are known objects', and the orbits that those objects have with them."""

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import chain
from multiprocessing import get_context
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ground.association.arc import ArcOrbit, arc_orbits
from ground.association.correlate import candidates_of
from ground.determination.measurements import Directions
from ground.store.store import StoredOrbit
from ground.upkeep import sequential
from ground.upkeep.division import SETTLED_TRACKLETS, one_orbit_of
from ground.upkeep.sightings import KnownOrbit, Sighting, sightings
from ground.upkeep.view import MADE_BY, View, position_error_km
from sboc_e2e.icd.errors import UserError

Array = NDArray[np.float64]

TRACKLETS_AT_ONCE: Final = 250
"""Tracklets given to a process at once: large against the cost of sending, small against a night's. Chosen, not measured."""
PARALLEL_FROM: Final = 200
"""Objects from which on further processes gain more than their start costs."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Renewed:
    """An object's new orbit, the tracklets that were accepted for it, with probabilities, and objects that it is one with."""

    object_id: int
    orbit: StoredOrbit
    accepted: Mapping[int, float]
    absorbed: tuple[int, ...] = ()


@dataclass(frozen=True, kw_only=True, eq=False)
class Outcome:
    """Objects with their new orbits, objects whose new tracklets fit none, and doubtful pairs: tracklet, object, probability."""

    renewed: Sequence[Renewed]
    refused: Sequence[int]
    doubtful: Sequence[tuple[int, int, float]]


class Correlation:
    """The tracklets of a night beside the predictions of the objects in service.

    tracklets : by number, those that are no object's. status : of every object. known : the orbits of those in service.
    arcs : orbits of the tracklets' own arcs, where they have one.
    """

    def __init__(self, view: View) -> None:
        self._view = view
        self.tracklets = view.uncorrelated()
        self.status, self.known = view.in_service()
        with _processes(view.options.workers if len(self.known) >= PARALLEL_FROM else 1) as pool:
            seen = sightings(self.tracklets, list(self.known.values()), pool)
            self._seen = {(s.object_id, s.tracklet_id): s for s in seen}
            self.arcs = _arcs(self.tracklets, list(self._seen.values()), pool)
        self._done: dict[tuple[int, tuple[int, ...]], Renewed | None] = {}

    def look_again(self, changed: frozenset[int]) -> None:
        """Take in that objects have other orbits than before, and tracklets that they gave up."""
        self.status, self.known = self._view.in_service()
        freed = {k: d for k, d in self._view.uncorrelated().items() if k not in self.tracklets}
        fresh = [self.known[k] for k in sorted(changed) if k in self.known]
        found = (*sightings(self.tracklets, fresh), *sightings(freed, list(self.known.values())))
        self._seen = {pair: s for pair, s in self._seen.items() if pair[0] not in changed}
        self._seen |= {(s.object_id, s.tracklet_id): s for s in found}
        self.arcs |= _arcs(freed, [s for s in self._seen.values() if s.tracklet_id in freed], None)
        self.tracklets |= freed
        self._done = {key: one for key, one in self._done.items() if key[0] not in changed}

    def outcome(self) -> Outcome:
        """What the predictions say of the tracklets. What was fitted by an earlier call is not fitted again."""
        wanted: dict[int, dict[int, float]] = {}
        doubtful: list[tuple[int, int, float]] = []
        for tracklet, found in _candidates(self.arcs, list(self._seen.values())).items():
            if found and found[0][1] >= self._view.options.accept:
                wanted.setdefault(found[0][0], {})[tracklet] = found[0][1]
            else:
                doubtful += [(tracklet, object_id, p) for object_id, p in found]
        # a few short tracklets may have two orbits: a step from the one that was taken would never find the other
        provisional = self._view.store.with_few_tracklets(SETTLED_TRACKLETS)
        each = {k: self._renewed(k, accepted, k in provisional) for k, accepted in sorted(wanted.items())}
        return Outcome(
            renewed=[one for one in each.values() if one is not None],
            refused=[k for k, one in each.items() if one is None],
            doubtful=doubtful,
        )

    def _renewed(self, object_id: int, accepted: Mapping[int, float], is_provisional: bool) -> Renewed | None:
        """An object with tracklets of tonight; None where they and its own are no one orbit's."""
        key = object_id, tuple(sorted(accepted))
        if key not in self._done:
            before, orbit = self.known[object_id], None
            if not is_provisional or not all(self.arcs[t].is_weak for t in accepted):
                near = [self._seen[object_id, t] for t in accepted]
                orbit = sequential.renewed(before, near, MADE_BY, self._view.now_tai_ns)
            if orbit is None:
                orbit = self._refitted(before, accepted)
                if orbit is not None and any(self._seen[object_id, t].t_tai_ns < before.orbit.epoch_tai_ns for t in accepted):
                    orbit = self._surer(orbit, before.orbit)
            self._done[key] = None if orbit is None else Renewed(object_id=object_id, orbit=orbit, accepted=accepted)
        return self._done[key]

    def _surer(self, fitted: StoredOrbit, before: StoredOrbit) -> StoredOrbit:
        """The fit with a tracklet that came late, or the orbit as it was if that is better known now.

        An orbit holds tracklets that are older than the window; the fit does not.
        """
        now, rules = self._view.now_tai_ns, self._view.options.association
        try:
            is_better = position_error_km(fitted, now, rules) <= position_error_km(before, now, rules)
        except UserError:
            return fitted
        return fitted if is_better else replace(before, made_tai_ns=now)

    def _refitted(self, known: KnownOrbit, accepted: Mapping[int, float]) -> StoredOrbit | None:
        """The orbit that fits an object's tracklets of the window and the new ones; None where they are no one free orbit."""
        object_id = known.orbit.object_id
        old = self._view.tracklets_of(object_id).values()
        every = sorted([*old, *(self.tracklets[k] for k in accepted)], key=lambda d: int(d.t_tai_ns[0]))
        cluster = one_orbit_of(every, known, self._view.options.association)
        return None if cluster is None else self._view.stored(cluster, object_id)


@contextmanager
def _processes(workers: int) -> Iterator[Executor | None]:
    """Processes that predict and fit; None for one worker."""
    if workers <= 1:
        yield None
        return
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        yield pool


def _arcs(data: Mapping[int, Directions], seen: Sequence[Sighting], pool: Executor | None) -> dict[int, ArcOrbit]:
    """Orbits of the tracklets' own arcs; a fit starts from the prediction that the directions meet best."""
    best: dict[int, tuple[float, Array]] = {}
    for s in seen:
        away = float(s.residual @ s.residual)
        if s.tracklet_id not in best or away < best[s.tracklet_id][0]:
            best[s.tracklet_id] = (away, s.state)
    starts = [best[k][1] if k in best else None for k in data]
    tracklets = list(data.values())
    if pool is None:
        found = arc_orbits(tracklets, starts)
    else:
        cuts = [slice(k, k + TRACKLETS_AT_ONCE) for k in range(0, len(tracklets), TRACKLETS_AT_ONCE)]
        parts = pool.map(arc_orbits, [tracklets[c] for c in cuts], [starts[c] for c in cuts])
        found = list(chain.from_iterable(parts))
    return {k: arc for k, arc in zip(data, found, strict=True) if arc is not None}


def _candidates(arcs: Mapping[int, ArcOrbit], seen: Sequence[Sighting]) -> dict[int, list[tuple[int, float]]]:
    """Objects and probabilities for each tracklet, the likeliest first."""
    of_tracklet: dict[int, list[Sighting]] = {k: [] for k in arcs}
    for one in seen:
        if one.tracklet_id in arcs:
            of_tracklet[one.tracklet_id].append(one)
    out = {}
    for k, near in of_tracklet.items():
        states = np.array([s.state for s in near]).reshape(-1, 6)
        covariances = np.array([s.covariance for s in near]).reshape(-1, 6, 6)
        # the covariances hold what forces leave out: no further doubt grows with age
        found = candidates_of(arcs[k], states, covariances, np.zeros(len(near)))
        out[k] = [(near[c.known].object_id, c.probability) for c in found]
    return out
