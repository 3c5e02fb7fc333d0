"""Whether an object's tracklets are of one orbit, and which are of which orbit where they are not."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import chain, combinations
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ground.association.arc import ArcOrbit, arc_orbits
from ground.association.associate import associate
from ground.association.clusters import AssociationOptions, Cluster, judged, meets_all
from ground.association.gooding import starts_of
from ground.association.returns import all_pairs
from ground.determination.measurements import Directions
from ground.determination.propagation import propagate
from ground.upkeep.sightings import KnownOrbit
from sboc_e2e.icd.errors import UserError

Array = NDArray[np.float64]

LEAST_OWN: Final = 2
"""Tracklets of each orbit that no other orbit explains."""
LEAST_OF_ONE: Final = 3
"""Tracklets of at least one orbit: two tracklets alone have four numbers more than an orbit."""
MEETING_CHI2: Final = 16.3
"""Of three degrees of freedom; one meeting in a thousand is beyond it."""
MEETING_KM_S: Final = 0.3
"""Change of velocity up to which a meeting of two orbits may be a manoeuvre."""
MEETING_EPOCHS: Final = 200
"""A budget of work: between two epochs the orbits' passing counts as error, so that no meeting is missed."""
SETTLED_TRACKLETS: Final = 8
"""From so many on one orbit alone meets an object's short tracklets. Two met five of 30 s, all of two sidereal times. Chosen."""
MOST_PAIRS: Final = 6
"""A budget of fits. Of geostationary tracklets of two nights, one of the first two pairs led to the right orbit. Chosen."""
MOST_TURNS: Final = 8
"""Between the first and the last of three tracklets: four days of a navigation orbit."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Part:
    """Tracklets by number, and the orbit that was fitted to them alone."""

    tracklets: tuple[int, ...]
    cluster: Cluster


@dataclass(frozen=True, kw_only=True, eq=False)
class Division:
    """Orbits of an object's tracklets, that of the most tracklets first; `loose` are tracklets of none of them.

    One part without loose tracklets: the object is one.
    """

    parts: tuple[Part, ...]
    loose: tuple[int, ...] = field(default=())

    @property
    def whole(self) -> bool:
        """Whether one orbit meets all tracklets."""
        return len(self.parts) == 1 and not self.loose


def division_of(data: Mapping[int, Directions], known: KnownOrbit | None, options: AssociationOptions) -> Division | None:
    """How the tracklets of an object divide into orbits; None where they do not say.

    known : the object's present orbit, a start for the fit of all tracklets. Where there is none, or where that fit fails, the
    fit starts from the orbits that three of the tracklets give. Where these fail too the tracklets are associated as if nothing
    were known of them. A change of velocity between two spans of time is a manoeuvre: None.
    """
    numbers = sorted(data, key=lambda k: int(data[k].t_tai_ns[0]))
    every = [data[k] for k in numbers]
    if len(every) < LEAST_OWN:
        return None
    one = one_orbit_of(every, known, options)
    if one is not None:
        return Division(parts=(Part(tracklets=tuple(numbers), cluster=one),))
    clusters = sorted(associate(every, options), key=lambda c: (-len(c.members), c.members))
    parts = tuple(Part(tracklets=tuple(numbers[m] for m in c.members), cluster=c) for c in clusters)
    loose = tuple(sorted(set(numbers) - {t for p in parts for t in p.tracklets}))
    if not parts or (len(clusters[0].members) < LEAST_OF_ONE and len(numbers) > LEAST_OWN):
        return None
    if any(len(c.members) - len(c.ambiguous) < LEAST_OWN for c in clusters) or len(loose) >= len(parts[0].tracklets):
        return None
    if any(_may_be_a_manoeuvre(one.cluster, other.cluster, data, one.tracklets, other.tracklets)
           for one, other in combinations(parts, 2)):  # fmt: skip
        return None
    return Division(parts=parts, loose=loose)


def one_orbit_of(every: Sequence[Directions], known: KnownOrbit | None, options: AssociationOptions) -> Cluster | None:
    """The orbit that meets all of some tracklets, in order of time; None where none is.

    Fits start from the known orbit and from those that some of the tracklets give. Of a few short tracklets the best of all
    fits is taken: an orbit of twelve minutes may be too far off a day later for a fit to start from, and one of two or three
    tracklets may be the wrong one of two that meet them. Of others the first is taken.
    """
    arcs = [arc for arc in arc_orbits(every) if arc is not None] if LEAST_OF_ONE <= len(every) < SETTLED_TRACKLETS else []
    short = len(arcs) >= LEAST_OWN and all(arc.is_weak for arc in arcs)
    starts = chain(_starts(every, known), _starts_of_pairs(arcs, options) if short else ())
    fits = (_of_one_orbit(every, state, epoch, options) for state, epoch in starts)
    good = (one for one in fits if one is not None)
    return min(good, key=lambda one: one.solution.chi2_nu, default=None) if short else next(good, None)


def _starts(every: Sequence[Directions], known: KnownOrbit | None) -> Iterator[tuple[Array, int]]:
    """States and epochs to start a fit of all tracklets from."""
    if known is not None:
        epoch = int(every[-1].t_tai_ns[len(every[-1].t_tai_ns) // 2])
        # an orbit that meets the Earth on its way to the data
        with suppress(UserError):
            arc = propagate(known.orbit.state, known.orbit.epoch_tai_ns, np.array([epoch], dtype=np.int64), known.forces)
            yield arc.states[0], epoch
    if len(every) >= LEAST_OF_ONE:
        states, epoch = starts_of(every, MOST_TURNS)
        yield from ((state, epoch) for state in states)


def _starts_of_pairs(arcs: Sequence[ArcOrbit], options: AssociationOptions) -> Iterator[tuple[Array, int]]:
    """The same from the likeliest pairs of arcs."""
    pairs = all_pairs(arcs, options)
    for k in np.argsort(pairs.chi2, kind="stable")[:MOST_PAIRS]:
        yield pairs.state[k], arcs[pairs.first[k]].t_tai_ns


def _of_one_orbit(every: Sequence[Directions], state: Array, epoch_tai_ns: int, options: AssociationOptions) -> Cluster | None:
    """The fit of all tracklets from a start, where it uses all of them."""
    try:
        cluster = judged(tuple(range(len(every))), every, state, epoch_tai_ns, options)
    except UserError:
        # data that leave an element free
        return None
    return cluster if cluster is not None and meets_all(cluster.solution, every) else None


def _may_be_a_manoeuvre(
    one: Cluster, other: Cluster, data: Mapping[int, Directions], of_one: tuple[int, ...], of_other: tuple[int, ...]
) -> bool:
    """Whether all tracklets of the one lie before those of the other and both orbits meet in between, at a low speed.

    True also where one of them meets the Earth in between: such orbits decide nothing.
    """
    span = [(min(int(data[k].t_tai_ns[0]) for k in part), max(int(data[k].t_tai_ns[-1]) for k in part))
            for part in (of_one, of_other)]  # fmt: skip
    (_, first), (second, _) = sorted(span)
    if second <= first:
        return False
    t = np.linspace(first, second, MEETING_EPOCHS).astype(np.int64)
    arcs = []
    for s in (one.solution, other.solution):
        try:
            arc = propagate(s.state, s.t0_tai_ns, t, s.forces, partials=True)
        except UserError:
            return True
        arcs.append((arc.states, arc.partials @ s.covariance[:6, :6] @ arc.partials.transpose(0, 2, 1)))
    away = arcs[0][0] - arcs[1][0]
    total = (arcs[0][1] + arcs[1][1])[:, :3, :3]
    # between two epochs the orbits move past each other
    passed = 0.5 * (second - first) * 1e-9 / (MEETING_EPOCHS - 1) * away[:, 3:]
    total = total + passed[:, :, None] * passed[:, None, :]
    chi2 = np.einsum("ni,ni->n", away[:, :3], np.linalg.solve(total, away[:, :3, None])[:, :, 0])
    return bool(((chi2 < MEETING_CHI2) & (np.linalg.norm(away[:, 3:], axis=1) < MEETING_KM_S)).any())
