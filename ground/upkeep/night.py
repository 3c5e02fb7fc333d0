"""One night's update of the store: worked out first, then written in one transaction, so that a kill loses nothing."""

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import chain
from multiprocessing import get_context
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ground.association.arc import ArcOrbit, arc_orbits
from ground.association.associate import associate
from ground.association.clusters import AssociationOptions, Cluster, meets_all
from ground.association.correlate import candidates_of
from ground.determination.forces import ForceModel, step_of
from ground.determination.measurements import Directions
from ground.determination.propagation import propagate
from ground.sky.sphere import east_north
from ground.store.store import Association, ObjectStore, StoredOrbit, StoredTracklet, Writer
from ground.upkeep import sequential
from ground.upkeep.division import LEAST_OF_ONE, SETTLED_TRACKLETS, division_of, one_orbit_of
from ground.upkeep.joins import Provisional, join_of
from ground.upkeep.sightings import KnownOrbit, Sighting, sightings
from sboc_e2e.icd import tai

Array = NDArray[np.float64]
_Made = tuple[tuple[int, ...], Cluster]
"""Tracklets of a new object, by number, and their orbit."""

MADE_BY: Final = "sboc objects update"
TRACKLETS_AT_ONCE: Final = 250
"""Tracklets given to a process at once: large against the cost of sending, small against a night's. Chosen, not measured."""
PARALLEL_FROM: Final = 200
"""Objects from which on further processes gain more than their start costs."""


@dataclass(frozen=True, kw_only=True)
class UpkeepOptions:
    """Rules of the catalogue.

    window_days : tracklets and fits reach so far back. accept : a tracklet is an object's from this probability on; below it
    stays ambiguous. lost_km : position error (3-D, one sigma) beyond which an object is lost; retired_days : after so many
    days without a tracklet a lost object is retired. merge_chi2 : of the difference of two orbits, six degrees of freedom.
    workers : processes that predict orbits; what comes out does not depend on it.
    """

    window_days: float = 10.0
    accept: float = 0.99
    lost_km: float = 2000.0
    retired_days: float = 60.0
    merge_chi2: float = 25.0
    workers: int = 1
    association: AssociationOptions = field(default_factory=AssociationOptions)


@dataclass(frozen=True, kw_only=True)
class NightReport:
    """Numbers of a night: tracklets correlated, ambiguous, left; objects renewed, refused (their new tracklets fit no one orbit),
    made, merged, split off; tracklets released from objects; objects found again, lost, retired."""

    correlated: int = 0
    ambiguous: int = 0
    left: int = 0
    renewed: int = 0
    refused: int = 0
    made: int = 0
    merged: int = 0
    split: int = 0
    released: int = 0
    reacquired: int = 0
    lost: int = 0
    retired: int = 0


def directions_of(stored: StoredTracklet) -> Directions:
    """A tracklet of the store as measurements."""
    unit, n = stored.rows[:, :3], len(stored.t_tai_ns)
    turned = [east_north(one) for one in unit]
    east, north = (np.array([pair[k] for pair in turned]) for k in (0, 1))
    cos, sin = np.cos(stored.rows[:, 5:6]), np.sin(stored.rows[:, 5:6])
    axes = np.stack([cos * north + sin * east, cos * east - sin * north], axis=1)
    covariance = np.zeros((n, 2, 2))
    covariance[:, 0, 0], covariance[:, 1, 1] = stored.rows[:, 3] ** 2, stored.rows[:, 4] ** 2
    return Directions(
        t_tai_ns=stored.t_tai_ns, observer_km=stored.rows[:, 6:], direction=unit, axes=axes, covariance_rad2=covariance
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Renewed:
    """An object's new orbit, the tracklets that were accepted for it, with probabilities, and objects that it is one with."""

    object_id: int
    orbit: StoredOrbit
    accepted: Mapping[int, float]
    absorbed: tuple[int, ...] = ()


def update(store: ObjectStore, now_tai_ns: int, options: UpkeepOptions | None = None) -> NightReport:
    """Bring a store up to an epoch; what was done. The same call again changes nothing.

    Divisions of objects are written first, each whole; the rest of the night follows in a transaction of its own.
    """
    options = options or UpkeepOptions()
    since = now_tai_ns - round(options.window_days * tai.NS_PER_DAY)
    divided = [
        _divide(store, store.unproven_merges(), "merged before", now_tai_ns, options),
        _divide(store, store.without_orbit(), "no orbit before", now_tai_ns, options),
    ]
    new = store.uncorrelated(since, now_tai_ns)
    data = {k: directions_of(t) for k, t in new.items()}
    status, known = _in_service(store, options)
    with _processes(options.workers if len(known) >= PARALLEL_FROM else 1) as pool:
        seen = {(s.object_id, s.tracklet_id): s for s in sightings(data, list(known.values()), pool)}
        arcs = _arcs(data, list(seen.values()), pool)
    done: dict[tuple[int, tuple[int, ...]], _Renewed | None] = {}

    def correlated() -> tuple[list[_Renewed], list[int], list[tuple[int, int, float]]]:
        """Objects with their new orbits, objects whose new tracklets fit none, and doubtful pairs with probabilities."""
        wanted: dict[int, dict[int, float]] = {}
        # a few short tracklets may have two orbits: a step from the one that was taken would never find the other
        provisional = store.with_few_tracklets(SETTLED_TRACKLETS)
        doubtful: list[tuple[int, int, float]] = []
        for tracklet, found in _candidates(arcs, list(seen.values())).items():
            if found and found[0][1] >= options.accept:
                wanted.setdefault(found[0][0], {})[tracklet] = found[0][1]
            else:
                doubtful += [(tracklet, object_id, p) for object_id, p in found]
        for object_id, accepted in sorted(wanted.items()):
            key = object_id, tuple(sorted(accepted))
            if key not in done:
                before = known[object_id]
                orbit = None
                if object_id not in provisional or not all(arcs[t].is_weak for t in accepted):
                    orbit = sequential.renewed(before, [seen[object_id, t] for t in accepted], MADE_BY, now_tai_ns)
                if orbit is not None:
                    done[key] = _Renewed(object_id=object_id, orbit=orbit, accepted=accepted)
                else:
                    done[key] = _refitted(store, before, accepted, data, since, now_tai_ns, options)
        out = {object_id: done[object_id, tuple(sorted(accepted))] for object_id, accepted in sorted(wanted.items())}
        return [one for one in out.values() if one is not None], [k for k, one in out.items() if one is None], doubtful

    renewed, refused, doubtful = correlated()
    # a tracklet that an object's orbit predicts and its tracklets refuse: they may be of two objects
    again = _divide(store, refused, "a new tracklet met its prediction and no fit", now_tai_ns, options)
    divided.append(again)
    if again.changed:
        status, known = _in_service(store, options)
        freed = {k: directions_of(t) for k, t in store.uncorrelated(since, now_tai_ns).items() if k not in data}
        fresh = [known[k] for k in sorted(again.changed) if k in known]
        seen = {pair: s for pair, s in seen.items() if pair[0] not in again.changed}
        seen |= {(s.object_id, s.tracklet_id): s for s in (*sightings(data, fresh), *sightings(freed, list(known.values())))}
        arcs |= _arcs(freed, [s for s in seen.values() if s.tracklet_id in freed], None)
        data |= freed
        done = {key: one for key, one in done.items() if key[0] not in again.changed}
        renewed, refused, doubtful = correlated()
    in_doubt = {(a.tracklet_id, a.object_id) for a in store.associations(state="ambiguous")}
    taken = {t for one in renewed for t in one.accepted} | {t for t, _, _ in doubtful}
    free = sorted(k for k in arcs if k not in taken)
    made, found = _associated(
        store, {k: data[k] for k in free}, set(known) - {one.object_id for one in renewed}, since, now_tai_ns, options
    )
    made, renewed = _joined(store, made, [*renewed, *found], known, data, since, now_tai_ns, options)
    absorbed = {k for one in renewed for k in one.absorbed}
    placed = {t for members, _ in made for t in members} | {t for one in renewed for t in one.accepted}
    current = {k: one.orbit for k, one in known.items() if k not in absorbed} | {one.object_id: one.orbit for one in renewed}
    merges = _merges(made, current, options)
    met = [*(one.object_id for one in renewed), *sorted(set(merges.values()))]
    lost, retired = _faded(current, set(met), status, now_tai_ns, options)
    with store.transaction() as writer:
        _write(writer, renewed, [d for d in doubtful if d[:2] not in in_doubt], made, merges, now_tai_ns)
        found_again = [k for k in met if status[k] == "lost"]
        for numbers, name, why in (
            (found_again, "active", "re-acquired: tracklets met its prediction or its orbit"),
            (lost, "lost", f"position error beyond {options.lost_km:g} km"),
            (retired, "retired", f"no tracklet for {options.retired_days:g} days"),
        ):
            for number in numbers:
                writer.set_status(number, name, by=MADE_BY, at_tai_ns=now_tai_ns, why=why)
    if merges or absorbed:
        divided.append(_divide(store, store.unproven_merges(), "merged before", now_tai_ns, options))
    return NightReport(
        correlated=sum(len(one.accepted) for one in renewed),
        ambiguous=len({t for t, _, _ in doubtful}),
        left=len(set(free) - placed),
        renewed=len(renewed),
        refused=len(refused),
        made=len(made) - len(merges),
        merged=len(merges) + len(absorbed),
        split=sum(one.split for one in divided),
        released=sum(one.released for one in divided),
        reacquired=len(found_again),
        lost=len(lost),
        retired=len(retired),
    )


def _in_service(store: ObjectStore, options: UpkeepOptions) -> tuple[dict[int, str], dict[int, KnownOrbit]]:
    """Status of every object, and the orbits of those that are looked for."""
    status = {row["object_id"]: str(row["status"]) for row in store.objects()}
    known = [known_orbit(o, options) for o in store.orbits() if status[o.object_id] in ("active", "lost")]
    return status, {one.orbit.object_id: one for one in known}


@dataclass(frozen=True, kw_only=True)
class _Divided:
    """Objects whose orbits are new ones, new objects, and tracklets that are no object's any more."""

    changed: frozenset[int] = frozenset()
    split: int = 0
    released: int = 0


def _divide(store: ObjectStore, suspects: Sequence[int], cause: str, now: int, options: UpkeepOptions) -> _Divided:
    """Look at all tracklets of some objects in the window before their last one, and write what they say, object by object."""
    total = _Divided()
    names = {row["object_id"]: str(row["name"]) for row in store.objects()} if suspects else {}
    for object_id in suspects:
        orbits, every = store.orbits(object_id), store.tracklets_of(object_id)
        if not every:
            continue
        after = max(int(t.t_tai_ns[0]) for t in every.values()) - round(options.window_days * tai.NS_PER_DAY)
        data = {k: directions_of(t) for k, t in every.items() if t.t_tai_ns[0] >= after}
        found = division_of(data, known_orbit(orbits[0], options) if orbits else None, options.association)
        if found is None:
            continue
        stored = [_stored(p.cluster, object_id, now) for p in found.parts]
        shares = " and ".join(f"{len(p.tracklets)} (chi2/nu {p.cluster.solution.chi2_nu:.2f})" for p in found.parts)
        changed = {object_id}
        with store.transaction() as writer:
            if found.whole:
                why = f"{cause}; one orbit meets its tracklets of the window: {shares}"
                writer.hold(object_id, stored[0], by=MADE_BY, at_tai_ns=now, why=why)
            if found.loose:
                why = f"{cause}; no orbit with the rest, which has one: {shares}"
                writer.release(object_id, found.loose, stored[0], by=MADE_BY, at_tai_ns=now, why=why)
            for part, orbit in zip(found.parts[1:], stored[1:], strict=True):
                why = f"{cause}; no one orbit meets its tracklets, these orbits do: {shares}"
                name = f"{names[object_id][:50]}-{min(part.tracklets)}"
                halves = stored[0], orbit
                changed.add(writer.split(object_id, part.tracklets, name, halves, by=MADE_BY, at_tai_ns=now, why=why))
        total = _Divided(
            changed=total.changed | changed,
            split=total.split + len(found.parts) - 1,
            released=total.released + len(found.loose),
        )
    return total


def forces_of(orbit: StoredOrbit, options: AssociationOptions) -> ForceModel:
    """Forces that an orbit was fitted with, at the gravity of the association."""
    model = ForceModel(gravity_degree=options.gravity_degree, radiation=options.radiation_m2_kg)
    return model.with_values(tuple(orbit.parameters), list(orbit.parameters.values()))


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


def known_orbit(orbit: StoredOrbit, options: UpkeepOptions) -> KnownOrbit:
    """An orbit with its forces. Where only the state has a covariance, radiation has the association's doubt, the rest none."""
    covariance = orbit.covariance
    if len(covariance) == 6 and orbit.parameters:
        of_radiation = options.association.radiation_sigma_m2_kg
        doubt = np.array([of_radiation if name == "radiation" else 1e-6 * step_of(name) for name in orbit.parameters]) ** 2
        covariance = np.block([[covariance, np.zeros((6, len(doubt)))], [np.zeros((len(doubt), 6)), np.diag(doubt)]])
    return KnownOrbit(orbit=orbit, forces=forces_of(orbit, options.association), covariance=covariance)


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


def _refitted(
    store: ObjectStore, known: KnownOrbit, accepted: Mapping[int, float], data: Mapping[int, Directions], since: int, now: int,
    options: UpkeepOptions,
) -> _Renewed | None:  # fmt: skip
    """The orbit that fits an object's tracklets of the window and the new ones; None where they are no one free orbit."""
    object_id = known.orbit.object_id
    old = {k: directions_of(t) for k, t in store.tracklets_of(object_id).items() if since <= t.t_tai_ns[0] < now}
    every = sorted([*old.values(), *(data[k] for k in accepted)], key=lambda d: int(d.t_tai_ns[0]))
    cluster = one_orbit_of(every, known, options.association)
    if cluster is None:
        return None
    return _Renewed(object_id=object_id, orbit=_stored(cluster, object_id, now), accepted=accepted)


def _associated(
    store: ObjectStore, free: Mapping[int, Directions], known: set[int], since: int, now: int, options: UpkeepOptions
) -> tuple[list[_Made], list[_Renewed]]:
    """New clusters of tracklets that are no object's, and known objects of two tracklets that clusters hold whole.

    The prediction of two tracklets is too bent for its covariance, or of another orbit that meets them.
    """
    own: dict[int, int] = {}
    every = dict(free)
    for object_id in sorted(known & store.with_few_tracklets(LEAST_OF_ONE)) if free else ():
        stored = {k: t for k, t in store.tracklets_of(object_id).items() if since <= t.t_tai_ns[0] < now}
        own |= dict.fromkeys(stored, object_id)
        every |= {k: directions_of(t) for k, t in stored.items()}
    numbers = sorted(every)
    made, found = [], []
    for cluster in associate([every[k] for k in numbers], options.association):
        members = tuple(numbers[m] for m in cluster.members)
        objects, fresh = {own[k] for k in members if k in own}, [k for k in members if k not in own]
        if not objects:
            made.append((members, cluster))
            continue
        whole = {k for k, owner in own.items() if owner in objects} <= set(members)
        if whole and (fresh or len(objects) > 1) and meets_all(cluster.solution, [every[k] for k in members]):
            kept, *absorbed = sorted(objects)
            orbit, accepted = _stored(cluster, kept, now), dict.fromkeys(fresh, 1.0)
            found.append(_Renewed(object_id=kept, orbit=orbit, accepted=accepted, absorbed=tuple(absorbed)))
    return made, found


def _joined(
    store: ObjectStore, made: Sequence[_Made], renewed: Sequence[_Renewed], known: Mapping[int, KnownOrbit],
    data: Mapping[int, Directions], since: int, now: int, options: UpkeepOptions,
) -> tuple[list[_Made], list[_Renewed]]:  # fmt: skip
    """Tonight's objects, where pairs are joined to the objects that they belong to. What was not touched tonight is not tried.

    Objects that are made tonight have the numbers below zero until they are written.
    """
    fresh = {-1 - place: one for place, one in enumerate(made)}
    tonight = {one.object_id: one for one in renewed}
    gone = {k for one in renewed for k in one.absorbed}
    if not fresh and not tonight:
        return list(made), list(renewed)
    all_of: dict[int, Provisional] = {}
    for k in sorted((set(known) & store.with_few_tracklets(SETTLED_TRACKLETS)) - gone):
        new = tonight.get(k)
        stored = [store.tracklets_of(number) for number in (k, *(new.absorbed if new else ()))]
        tracklets = {t: directions_of(d) for one in stored for t, d in one.items()}
        if any(d.t_tai_ns[0] < since for d in tracklets.values()):
            # no orbit of the window's tracklets speaks for it
            continue
        tracklets |= {t: data[t] for t in new.accepted} if new else {}
        orbit = known_orbit(new.orbit, options) if new else known[k]
        all_of[k] = Provisional(orbit=orbit, tracklets=tracklets, is_new=new is not None)
    for k, (members, cluster) in fresh.items():
        orbit = known_orbit(_stored(cluster, k, now), options)
        all_of[k] = Provisional(orbit=orbit, tracklets={t: data[t] for t in members}, is_new=True)
    while True:
        hosts = {k: one for k, one in all_of.items() if LEAST_OF_ONE <= len(one.tracklets) < SETTLED_TRACKLETS}
        pairs = {k: one for k, one in all_of.items() if len(one.tracklets) == LEAST_OF_ONE - 1}
        join = join_of(hosts, pairs, options.association) if hosts and pairs else None
        if join is None:
            return list(fresh.values()), list(tonight.values())
        host, pair = all_of.pop(join.host), all_of.pop(join.pair)
        both = {**host.tracklets, **pair.tracklets}
        old = sorted(k for k in (join.host, join.pair) if k > 0)
        kept = old[0] if old else join.host
        parts = [tonight.pop(k) for k in old if k in tonight]
        accepted = {t: p for one in parts for t, p in one.accepted.items()}
        accepted |= {t: 1.0 for k in (join.host, join.pair) if k in fresh for t in fresh.pop(k)[0]}
        common = _stored(join.cluster, kept, now)
        if old:
            absorbed = (*(k for one in parts for k in one.absorbed), *old[1:])
            tonight[kept] = _Renewed(object_id=kept, orbit=common, accepted=accepted, absorbed=absorbed)
        else:
            fresh[kept] = tuple(sorted(both)), join.cluster
        all_of[kept] = Provisional(orbit=known_orbit(common, options), tracklets=both, is_new=True)


def _stored(cluster: Cluster, object_id: int, now_tai_ns: int) -> StoredOrbit:
    s = cluster.solution
    return StoredOrbit(
        object_id=object_id, epoch_tai_ns=s.t0_tai_ns, state=s.state, covariance=s.covariance, made_tai_ns=now_tai_ns,
        made_by=MADE_BY, parameters={p: s.forces.value_of(p) for p in s.parameters}, chi2_nu=s.chi2_nu,
        n_used=int((s.weights > 0.0).sum()),
    )  # fmt: skip


def _merges(made: Sequence[_Made], current: Mapping[int, StoredOrbit], options: UpkeepOptions) -> dict[int, int]:
    """Of new clusters (by place) those whose orbit is a known object's, whose tracklets were too far off to be correlated."""
    out = {}
    for place, (_, cluster) in enumerate(made):
        s = cluster.solution
        for object_id, orbit in current.items():
            if not _near_plane(orbit.state, s.state):
                continue
            arc = propagate(
                orbit.state, orbit.epoch_tai_ns, np.array([s.t0_tai_ns], dtype=np.int64),
                forces_of(orbit, options.association), partials=True,
            )  # fmt: skip
            total = arc.partials[0] @ orbit.state_covariance @ arc.partials[0].T + s.covariance[:6, :6]
            scale = np.sqrt(np.diag(total))
            left = (arc.states[0] - s.state) / scale
            if float(left @ np.linalg.solve(total / np.outer(scale, scale), left)) < options.merge_chi2:
                out[place] = object_id
                break
    return out


def _near_plane(one: Array, other: Array) -> bool:
    first, second = np.cross(one[:3], one[3:]), np.cross(other[:3], other[3:])
    return float(np.linalg.norm(first - second)) < 0.02 * float(np.linalg.norm(first))


def _faded(
    current: Mapping[int, StoredOrbit], fresh: set[int], status: Mapping[int, str], now_tai_ns: int, options: UpkeepOptions
) -> tuple[list[int], list[int]]:
    """Objects to be called lost and to be retired."""
    lost, retired = [], []
    for object_id, orbit in sorted(current.items()):
        days = (now_tai_ns - orbit.epoch_tai_ns) / tai.NS_PER_DAY
        if object_id in fresh:
            continue
        if status[object_id] == "lost" and days > options.retired_days:
            retired.append(object_id)
        elif status[object_id] == "active" and position_error_km(orbit, now_tai_ns) > options.lost_km:
            lost.append(object_id)
    return lost, retired


def position_error_km(orbit: StoredOrbit, at_tai_ns: int) -> float:
    """One sigma of place, 3-D, at an epoch: carried by the orbit's own transition matrix."""
    arc = propagate(
        orbit.state,
        orbit.epoch_tai_ns,
        np.array([at_tai_ns], dtype=np.int64),
        forces_of(orbit, AssociationOptions()),
        partials=True,
    )
    return float(np.sqrt(np.trace((arc.partials[0] @ orbit.state_covariance @ arc.partials[0].T)[:3, :3])))


def _write(
    writer: Writer, renewed: Sequence[_Renewed], doubtful: Sequence[tuple[int, int, float]],
    made: Sequence[_Made], merges: Mapping[int, int], now: int,
) -> None:  # fmt: skip
    """All of a night within a transaction."""
    links = [_link(t, one.object_id, p, "accepted", now) for one in renewed for t, p in one.accepted.items()]
    links += [_link(t, object_id, p, "ambiguous", now) for t, object_id, p in doubtful]
    names = [f"U{members[0]:07d}" for members, _ in made]
    numbers = writer.add_objects(names, now) if names else []
    orbits = [one.orbit for one in renewed]
    for number, (members, cluster) in zip(numbers, made, strict=True):
        orbits.append(_stored(cluster, number, now))
        links += [_link(t, number, 1.0, "accepted", now) for t in members]
    writer.add_orbits(orbits)
    writer.associate(links)
    for one in renewed:
        for number in one.absorbed:
            writer.merge(one.object_id, number, by=MADE_BY, at_tai_ns=now, why="one orbit meets the tracklets of both")
    for place, object_id in merges.items():
        writer.merge(object_id, numbers[place], by=MADE_BY, at_tai_ns=now, why="a new object's orbit is that of a known one")


def _link(tracklet: int, object_id: int, probability: float, state: str, now: int) -> Association:
    return Association(
        tracklet_id=tracklet, object_id=object_id, probability=min(probability, 1.0), state=state, decided_by=MADE_BY,
        decided_tai_ns=now,
    )  # fmt: skip
