"""One night's update of the store: worked out first, then written in one transaction, so that a kill loses nothing."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ground.store.schema import ACCEPTED_ONCE
from ground.store.store import Association, ObjectStore, StoredOrbit, Writer
from ground.upkeep.correlation import Correlation, Renewed
from ground.upkeep.new_objects import Made, associated, joined, merges_of
from ground.upkeep.review import review
from ground.upkeep.view import MADE_BY, UpkeepOptions, View, position_error_km
from sboc_e2e.icd import tai
from sboc_e2e.icd.errors import UserError


@dataclass(frozen=True, kw_only=True)
class NightReport:
    """Numbers of a night: tracklets correlated, ambiguous, left; objects renewed, refused (their new tracklets fit no one orbit),
    made, merged, split off; tracklets released from objects; objects found again, lost, retired.

    not_carried : a line for each object whose orbit cannot be propagated to the night, with its name and the reason. An active
    one is lost; no new object is held against it.
    """

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
    not_carried: tuple[str, ...] = ()


def update(store: ObjectStore, now_tai_ns: int, options: UpkeepOptions | None = None) -> NightReport:
    """Bring a store up to an epoch; what was done. The same call again changes nothing.

    Divisions of objects are written first, each whole; the rest of the night follows in a transaction of its own.
    """
    view = View(store=store, now_tai_ns=now_tai_ns, options=options or UpkeepOptions())
    reviews = [
        review(view, store.unproven("merge"), "merged before"),
        review(view, store.unproven(ACCEPTED_ONCE), "tracklets of it were another object's"),
        review(view, store.without_orbit(), "no orbit before"),
    ]
    night = Correlation(view)
    known = night.outcome()
    # a tracklet that an object's orbit predicts and its tracklets refuse: they may be of two objects
    reviews.append(review(view, known.refused, "a new tracklet met its prediction and no fit"))
    if reviews[-1].changed:
        night.look_again(reviews[-1].changed)
        known = night.outcome()
    in_doubt = {(a.tracklet_id, a.object_id) for a in store.associations(state="ambiguous")}
    taken = {t for one in known.renewed for t in one.accepted} | {t for t, _, _ in known.doubtful}
    free = sorted(k for k in night.arcs if k not in taken)
    not_met = set(night.known) - {one.object_id for one in known.renewed}
    made, found = associated(view, {k: night.tracklets[k] for k in free}, not_met)
    made, renewed = joined(view, made, [*known.renewed, *found], night.known, night.tracklets)
    absorbed = {k for one in renewed for k in one.absorbed}
    placed = {t for members, _ in made for t in members} | {t for one in renewed for t in one.accepted}
    current = {k: one.orbit for k, one in night.known.items() if k not in absorbed}
    current |= {one.object_id: one.orbit for one in renewed}
    merges, not_carried = merges_of(made, current, view.options)
    met = [*(one.object_id for one in renewed), *sorted(set(merges.values()))]
    lost, retired, too_far = _faded(view, current, set(met), night.status)
    not_carried |= too_far
    found_again = [k for k in met if night.status[k] == "lost"]
    with store.transaction() as writer:
        _write(view, writer, renewed, [d for d in known.doubtful if d[:2] not in in_doubt], made, merges)
        beyond = f"position error beyond {view.options.lost_km:g} km"
        for numbers, name, why in (
            (found_again, "active", "re-acquired: tracklets met its prediction or its orbit"),
            (lost, "lost", beyond),
            (retired, "retired", f"no tracklet for {view.options.retired_days:g} days"),
        ):
            for number in numbers:
                reason = too_far.get(number, why) if name == "lost" else why
                writer.set_status(number, name, by=MADE_BY, at_tai_ns=now_tai_ns, why=reason)
    if merges or absorbed:
        reviews.append(review(view, store.unproven("merge"), "merged before"))
    names = {row["object_id"]: row["name"] for row in store.objects()} if not_carried else {}
    return NightReport(
        correlated=sum(len(one.accepted) for one in renewed),
        ambiguous=len({t for t, _, _ in known.doubtful}),
        left=len(set(free) - placed),
        renewed=len(renewed),
        refused=len(known.refused),
        made=len(made) - len(merges),
        merged=len(merges) + len(absorbed),
        split=sum(one.split for one in reviews),
        released=sum(one.released for one in reviews),
        reacquired=len(found_again),
        lost=len(lost),
        retired=len(retired),
        not_carried=tuple(f"{names[number]}: {reason}" for number, reason in sorted(not_carried.items())),
    )


def _faded(
    view: View, current: Mapping[int, StoredOrbit], met: set[int], status: Mapping[int, str]
) -> tuple[list[int], list[int], dict[int, str]]:
    """Objects to be called lost, to be retired, and why the orbits of some of the lost ones cannot be propagated to the night.

    An object that becomes lost may be retired at once. An orbit of this very night stands, so that the same night again calls
    nothing lost.
    """
    lost, retired, too_far = [], [], {}
    for object_id, orbit in sorted(current.items()):
        if object_id in met or orbit.made_tai_ns == view.now_tai_ns:
            continue
        is_lost = status[object_id] == "lost"
        if status[object_id] == "active":
            try:
                is_lost = position_error_km(orbit, view.now_tai_ns, view.options.association) > view.options.lost_km
            except UserError as error:
                # nobody can say where it is
                is_lost, too_far[object_id] = True, str(error)
            if is_lost:
                lost.append(object_id)
        days = (view.now_tai_ns - orbit.epoch_tai_ns) / tai.NS_PER_DAY
        if is_lost and days > view.options.retired_days:
            retired.append(object_id)
    return lost, retired, too_far


def _write(
    view: View,
    writer: Writer,
    renewed: Sequence[Renewed],
    doubtful: Sequence[tuple[int, int, float]],
    made: Sequence[Made],
    merges: Mapping[int, int],
) -> None:
    """All of a night within a transaction."""
    now = view.now_tai_ns
    links = [_link(t, one.object_id, p, "accepted", now) for one in renewed for t, p in one.accepted.items()]
    links += [_link(t, object_id, p, "ambiguous", now) for t, object_id, p in doubtful]
    writer.require_free([*(link.tracklet_id for link in links), *(t for members, _ in made for t in members)])
    names = writer.free_names([f"U{members[0]:07d}" for members, _ in made])
    numbers = writer.add_objects(names, now) if names else []
    orbits = [one.orbit for one in renewed]
    for number, (members, cluster) in zip(numbers, made, strict=True):
        orbits.append(view.stored(cluster, number))
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
