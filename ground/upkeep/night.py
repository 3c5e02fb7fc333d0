"""One night's update of the store: worked out first, then written in one transaction, so that a kill loses nothing."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ground.association.arc import ArcOrbit, arc_orbits
from ground.association.associate import associate
from ground.association.clusters import AssociationOptions, Cluster, Orbit, judged
from ground.association.correlate import correlate
from ground.determination.forces import ForceModel
from ground.determination.measurements import Directions
from ground.determination.propagation import propagate
from ground.sky.sphere import east_north
from ground.store.store import Association, ObjectStore, StoredOrbit, StoredTracklet, Writer
from sboc_e2e.icd import tai
from sboc_e2e.icd.errors import UserError

Array = NDArray[np.float64]

MADE_BY: Final = "sboc objects update"


@dataclass(frozen=True, kw_only=True)
class UpkeepOptions:
    """Rules of the catalogue.

    window_days : tracklets and fits reach so far back. accept : a tracklet is an object's from this probability on; below it
    stays ambiguous. lost_km : position error (3-D, one sigma) beyond which an object is lost; retired_days : after so many
    days without a tracklet a lost object is retired. merge_chi2 : of the difference of two orbits, six degrees of freedom.
    """

    window_days: float = 10.0
    accept: float = 0.99
    lost_km: float = 2000.0
    retired_days: float = 60.0
    merge_chi2: float = 25.0
    association: AssociationOptions = field(default_factory=AssociationOptions)


@dataclass(frozen=True, kw_only=True)
class NightReport:
    """Numbers of a night: tracklets correlated, ambiguous, left; objects renewed, made, merged, found again, lost, retired."""

    correlated: int = 0
    ambiguous: int = 0
    left: int = 0
    renewed: int = 0
    refused: int = 0
    made: int = 0
    merged: int = 0
    reacquired: int = 0
    lost: int = 0
    retired: int = 0


def directions_of(stored: StoredTracklet) -> Directions:
    """A tracklet of the store as measurements."""
    unit, n = stored.rows[:, :3], len(stored.t_tai_ns)
    axes = np.empty((n, 2, 3))
    for k in range(n):
        east, north = east_north(unit[k])
        angle = stored.rows[k, 5]
        axes[k, 0] = np.cos(angle) * north + np.sin(angle) * east
        axes[k, 1] = np.cos(angle) * east - np.sin(angle) * north
    covariance = np.zeros((n, 2, 2))
    covariance[:, 0, 0], covariance[:, 1, 1] = stored.rows[:, 3] ** 2, stored.rows[:, 4] ** 2
    return Directions(
        t_tai_ns=stored.t_tai_ns, observer_km=stored.rows[:, 6:], direction=unit, axes=axes, covariance_rad2=covariance
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Renewed:
    """An object's new orbit and the tracklets that were accepted for it, with probabilities."""

    object_id: int
    orbit: StoredOrbit
    accepted: Mapping[int, float]


def update(store: ObjectStore, now_tai_ns: int, options: UpkeepOptions | None = None) -> NightReport:
    """Bring a store up to an epoch; what was done. The same call again changes nothing."""
    options = options or UpkeepOptions()
    since = now_tai_ns - round(options.window_days * tai.NS_PER_DAY)
    new = store.uncorrelated(since, now_tai_ns)
    data = {k: directions_of(t) for k, t in new.items()}
    arcs = {k: a for k, a in zip(data, arc_orbits(list(data.values())), strict=True) if a is not None}
    status = {row["object_id"]: row["status"] for row in store.objects()}
    known = [o for o in store.orbits() if status[o.object_id] in ("active", "lost")]
    candidates = _candidates(arcs, known)
    wanted: dict[int, dict[int, float]] = {}
    doubtful: list[tuple[int, int, float]] = []
    for tracklet, found in candidates.items():
        if found and found[0][1] >= options.accept:
            wanted.setdefault(found[0][0], {})[tracklet] = found[0][1]
        else:
            doubtful += [(tracklet, object_id, p) for object_id, p in found]
    renewed, refused = [], 0
    orbit_of = {o.object_id: o for o in known}
    for object_id, accepted in sorted(wanted.items()):
        one = _renewed(store, orbit_of[object_id], accepted, data, since, now_tai_ns, options)
        if one is None:
            refused += 1
        else:
            renewed.append(one)
    in_doubt = {(a.tracklet_id, a.object_id) for a in store.associations(state="ambiguous")}
    taken = {t for one in renewed for t in one.accepted} | {t for t, _, _ in doubtful}
    free = sorted(k for k in arcs if k not in taken)
    clusters = associate([data[k] for k in free], options.association)
    made = [(tuple(free[m] for m in c.members), c) for c in clusters]
    current = orbit_of | {one.object_id: one.orbit for one in renewed}
    merges = _merges(made, current, options)
    lost, retired = _faded(current, {one.object_id for one in renewed}, status, now_tai_ns, options)
    with store.transaction() as writer:
        _write(writer, renewed, [d for d in doubtful if d[:2] not in in_doubt], made, merges, now_tai_ns)
        found_again = [one.object_id for one in renewed if status[one.object_id] == "lost"]
        for numbers, name, why in (
            (found_again, "active", "re-acquired: a tracklet met its prediction"),
            (lost, "lost", f"position error beyond {options.lost_km:g} km"),
            (retired, "retired", f"no tracklet for {options.retired_days:g} days"),
        ):
            for number in numbers:
                writer.set_status(number, name, by=MADE_BY, at_tai_ns=now_tai_ns, why=why)
    return NightReport(
        correlated=sum(len(one.accepted) for one in renewed),
        ambiguous=len({t for t, _, _ in doubtful}),
        left=len(free) - sum(len(m) for m, _ in made),
        renewed=len(renewed),
        refused=refused,
        made=len(made) - len(merges),
        merged=len(merges),
        reacquired=len(found_again),
        lost=len(lost),
        retired=len(retired),
    )


def forces_of(orbit: StoredOrbit, options: AssociationOptions) -> ForceModel:
    """Forces that an orbit was fitted with, at the gravity of the association."""
    model = ForceModel(gravity_degree=options.gravity_degree, radiation=options.radiation_m2_kg)
    return model.with_values(tuple(orbit.parameters), list(orbit.parameters.values()))


def _candidates(arcs: Mapping[int, ArcOrbit], known: Sequence[StoredOrbit]) -> dict[int, list[tuple[int, float]]]:
    """Objects and probabilities for each tracklet."""
    plain = AssociationOptions()
    orbits = [(Orbit(o.epoch_tai_ns, o.state, o.covariance), forces_of(o, plain)) for o in known]
    found = correlate(list(arcs.values()), orbits)
    return {k: [(known[c.known].object_id, c.probability) for c in one] for k, one in zip(arcs, found, strict=True)}


def _renewed(
    store: ObjectStore, orbit: StoredOrbit, accepted: Mapping[int, float], data: Mapping[int, Directions], since: int, now: int,
    options: UpkeepOptions,
) -> _Renewed | None:  # fmt: skip
    """The orbit that fits an object's tracklets of the window and the new ones; None where they are no one free orbit."""
    old = {k: directions_of(t) for k, t in store.tracklets_of(orbit.object_id).items() if since <= t.t_tai_ns[0] < now}
    every = sorted([*old.values(), *(data[k] for k in accepted)], key=lambda d: int(d.t_tai_ns[0]))
    epoch = int(every[-1].t_tai_ns[len(every[-1].t_tai_ns) // 2])
    start = propagate(
        orbit.state, orbit.epoch_tai_ns, np.array([epoch], dtype=np.int64), forces_of(orbit, options.association)
    ).states[0]
    try:
        cluster = judged(tuple(range(len(every))), every, start, epoch, options.association)
    except UserError:
        # the directions leave an element free: the orbit that is there stays
        return None
    if cluster is None:
        return None
    return _Renewed(object_id=orbit.object_id, orbit=_stored(cluster, orbit.object_id, now), accepted=accepted)


def _stored(cluster: Cluster, object_id: int, now_tai_ns: int) -> StoredOrbit:
    s = cluster.solution
    return StoredOrbit(
        object_id=object_id, epoch_tai_ns=s.t0_tai_ns, state=s.state, covariance=s.covariance[:6, :6], made_tai_ns=now_tai_ns,
        made_by=MADE_BY, parameters={p: s.forces.value_of(p) for p in s.parameters}, chi2_nu=s.chi2_nu,
        n_used=int((s.weights > 0.0).sum()),
    )  # fmt: skip


def _merges(
    made: Sequence[tuple[tuple[int, ...], Cluster]], current: Mapping[int, StoredOrbit], options: UpkeepOptions
) -> dict[int, int]:
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
            total = arc.partials[0] @ orbit.covariance @ arc.partials[0].T + s.covariance[:6, :6]
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
    return float(np.sqrt(np.trace((arc.partials[0] @ orbit.covariance @ arc.partials[0].T)[:3, :3])))


def _write(
    writer: Writer, renewed: Sequence[_Renewed], doubtful: Sequence[tuple[int, int, float]],
    made: Sequence[tuple[tuple[int, ...], Cluster]], merges: Mapping[int, int], now: int,
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
    for place, object_id in merges.items():
        writer.merge(object_id, numbers[place], by=MADE_BY, at_tai_ns=now, why="a new object's orbit is that of a known one")


def _link(tracklet: int, object_id: int, probability: float, state: str, now: int) -> Association:
    return Association(
        tracklet_id=tracklet, object_id=object_id, probability=min(probability, 1.0), state=state, decided_by=MADE_BY,
        decided_tai_ns=now,
    )  # fmt: skip
