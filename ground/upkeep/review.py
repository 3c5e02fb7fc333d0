"""Objects whose tracklets are looked at again, because something speaks against their being one object."""

from collections.abc import Sequence
from dataclasses import dataclass

from ground.upkeep.division import division_of
from ground.upkeep.view import MADE_BY, View, directions_of, known_orbit


@dataclass(frozen=True, kw_only=True)
class Reviewed:
    """Objects whose orbits are new ones, how many new objects there are, and tracklets that are no object's any more."""

    changed: frozenset[int] = frozenset()
    split: int = 0
    released: int = 0


def review(view: View, suspects: Sequence[int], cause: str) -> Reviewed:
    """Look at all tracklets of some objects in the window before their last one, and write what they say, object by object."""
    store, now, options = view.store, view.now_tai_ns, view.options
    total = Reviewed()
    names = {row["object_id"]: str(row["name"]) for row in store.objects()} if suspects else {}
    for object_id in suspects:
        orbits, every = store.orbits(object_id), store.tracklets_of(object_id)
        if not every:
            continue
        after = max(int(t.t_tai_ns[0]) for t in every.values()) - view.window_ns
        data = {k: directions_of(t) for k, t in every.items() if t.t_tai_ns[0] >= after}
        found = division_of(data, known_orbit(orbits[0], options) if orbits else None, options.association)
        if found is None:
            continue
        stored = [view.stored(p.cluster, object_id) for p in found.parts]
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
        total = Reviewed(
            changed=total.changed | changed,
            split=total.split + len(found.parts) - 1,
            released=total.released + len(found.loose),
        )
    return total
