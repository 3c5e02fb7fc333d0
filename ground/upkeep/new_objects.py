"""Objects that tonight's tracklets make among themselves, and those of them that are known objects after all."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ground.association.associate import associate
from ground.association.clusters import Cluster, meets_all
from ground.determination.measurements import Directions
from ground.store.forces import carried
from ground.store.store import StoredOrbit
from ground.upkeep.correlation import Renewed
from ground.upkeep.division import LEAST_OF_ONE, SETTLED_TRACKLETS
from ground.upkeep.joins import Provisional, join_of
from ground.upkeep.sightings import KnownOrbit
from ground.upkeep.view import UpkeepOptions, View, directions_of, known_orbit
from sboc_e2e.icd.errors import UserError

Array = NDArray[np.float64]
Made = tuple[tuple[int, ...], Cluster]
"""Tracklets of a new object, by number, and their orbit."""


def associated(view: View, free: Mapping[int, Directions], known: set[int]) -> tuple[list[Made], list[Renewed]]:
    """New clusters of tracklets that are no object's, and known objects of two tracklets that clusters hold whole.

    The prediction of two tracklets is too bent for its covariance, or of another orbit that meets them.
    """
    own: dict[int, int] = {}
    every = dict(free)
    for object_id in sorted(known & view.store.with_few_tracklets(LEAST_OF_ONE)) if free else ():
        tracklets = view.tracklets_of(object_id)
        own |= dict.fromkeys(tracklets, object_id)
        every |= tracklets
    numbers = sorted(every)
    made, found = [], []
    for cluster in associate([every[k] for k in numbers], view.options.association):
        members = tuple(numbers[m] for m in cluster.members)
        objects, fresh = {own[k] for k in members if k in own}, [k for k in members if k not in own]
        if not objects:
            made.append((members, cluster))
            continue
        whole = {k for k, owner in own.items() if owner in objects} <= set(members)
        if whole and (fresh or len(objects) > 1) and meets_all(cluster.solution, [every[k] for k in members]):
            kept, *absorbed = sorted(objects)
            orbit, accepted = view.stored(cluster, kept), dict.fromkeys(fresh, 1.0)
            found.append(Renewed(object_id=kept, orbit=orbit, accepted=accepted, absorbed=tuple(absorbed)))
    return made, found


def joined(
    view: View,
    made: Sequence[Made],
    renewed: Sequence[Renewed],
    known: Mapping[int, KnownOrbit],
    data: Mapping[int, Directions],
) -> tuple[list[Made], list[Renewed]]:
    """Tonight's objects, where pairs are joined to the objects that they belong to. What was not touched tonight is not tried.

    Objects that are made tonight have the numbers below zero until they are written.
    """
    fresh = {-1 - place: one for place, one in enumerate(made)}
    tonight = {one.object_id: one for one in renewed}
    if not fresh and not tonight:
        return list(made), list(renewed)
    all_of = _provisional(view, tonight, known, data)
    for k, (members, cluster) in fresh.items():
        orbit = known_orbit(view.stored(cluster, k), view.options)
        all_of[k] = Provisional(orbit=orbit, tracklets={t: data[t] for t in members}, is_new=True)
    while True:
        hosts = {k: one for k, one in all_of.items() if LEAST_OF_ONE <= len(one.tracklets) < SETTLED_TRACKLETS}
        pairs = {k: one for k, one in all_of.items() if len(one.tracklets) == LEAST_OF_ONE - 1}
        join = join_of(hosts, pairs, view.options.association) if hosts and pairs else None
        if join is None:
            return list(fresh.values()), list(tonight.values())
        host, pair = all_of.pop(join.host), all_of.pop(join.pair)
        both = {**host.tracklets, **pair.tracklets}
        old = sorted(k for k in (join.host, join.pair) if k > 0)
        kept = old[0] if old else join.host
        parts = [tonight.pop(k) for k in old if k in tonight]
        accepted = {t: p for one in parts for t, p in one.accepted.items()}
        accepted |= {t: 1.0 for k in (join.host, join.pair) if k in fresh for t in fresh.pop(k)[0]}
        common = view.stored(join.cluster, kept)
        if old:
            absorbed = (*(k for one in parts for k in one.absorbed), *old[1:])
            tonight[kept] = Renewed(object_id=kept, orbit=common, accepted=accepted, absorbed=absorbed)
        else:
            fresh[kept] = tuple(sorted(both)), join.cluster
        all_of[kept] = Provisional(orbit=known_orbit(common, view.options), tracklets=both, is_new=True)


def _provisional(
    view: View, tonight: Mapping[int, Renewed], known: Mapping[int, KnownOrbit], data: Mapping[int, Directions]
) -> dict[int, Provisional]:
    """Known objects with few tracklets, all of them in the window, with what tonight added."""
    gone = {k for one in tonight.values() for k in one.absorbed}
    out: dict[int, Provisional] = {}
    for k in sorted((set(known) & view.store.with_few_tracklets(SETTLED_TRACKLETS)) - gone):
        new = tonight.get(k)
        stored = [view.store.tracklets_of(number) for number in (k, *(new.absorbed if new else ()))]
        tracklets = {t: directions_of(d) for one in stored for t, d in one.items()}
        if any(d.t_tai_ns[0] < view.since_tai_ns for d in tracklets.values()):
            # no orbit of the window's tracklets speaks for it
            continue
        tracklets |= {t: data[t] for t in new.accepted} if new else {}
        orbit = known_orbit(new.orbit, view.options) if new else known[k]
        out[k] = Provisional(orbit=orbit, tracklets=tracklets, is_new=new is not None)
    return out


def merges_of(
    made: Sequence[Made], current: Mapping[int, StoredOrbit], options: UpkeepOptions
) -> tuple[dict[int, int], dict[int, str]]:
    """Of new clusters (by place) those whose orbit is a known object's, whose tracklets were too far off to be correlated.

    Also known objects whose orbits cannot be propagated to a new one that lies near their plane, with the reason.
    """
    out: dict[int, int] = {}
    not_carried: dict[int, str] = {}
    for place, (_, cluster) in enumerate(made):
        s = cluster.solution
        for object_id, orbit in current.items():
            if not _near_plane(orbit.state, s.state):
                continue
            try:
                states, covariances = carried(orbit, np.array([s.t0_tai_ns], dtype=np.int64), options.association)
            except UserError as error:
                not_carried[object_id] = str(error)
                continue
            total = covariances[0] + s.covariance[:6, :6]
            scale = np.sqrt(np.diag(total))
            left = (states[0] - s.state) / scale
            if float(left @ np.linalg.solve(total / np.outer(scale, scale), left)) < options.merge_chi2:
                out[place] = object_id
                break
    return out, not_carried


def _near_plane(one: Array, other: Array) -> bool:
    first, second = np.cross(one[:3], one[3:]), np.cross(other[:3], other[3:])
    return float(np.linalg.norm(first - second)) < 0.02 * float(np.linalg.norm(first))
