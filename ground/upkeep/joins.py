"""Pairs of short tracklets beside the object that they belong to.

Two tracklets of half a minute make an object of their own as long as nothing longer is known. When an object of three or more is
there, its orbit is held against the tracklets of the pair. A common fit of all tracklets decides.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ground.association.arc import arc_orbits
from ground.association.clusters import AssociationOptions, Cluster
from ground.determination.measurements import Directions
from ground.upkeep.division import one_orbit_of
from ground.upkeep.sightings import KnownOrbit, sightings


@dataclass(frozen=True, kw_only=True, eq=False)
class Provisional:
    """An object with few tracklets: its orbit, the tracklets by number, and whether either is new tonight."""

    orbit: KnownOrbit
    tracklets: Mapping[int, Directions]
    is_new: bool

    @property
    def in_order(self) -> list[Directions]:
        """Its tracklets in order of time."""
        return sorted(self.tracklets.values(), key=lambda d: int(d.t_tai_ns[0]))


@dataclass(frozen=True, kw_only=True, eq=False)
class Join:
    """An object, a pair that is one with it, and the orbit that meets the tracklets of both; all by the callers' numbers."""

    host: int
    pair: int
    cluster: Cluster


def join_of(hosts: Mapping[int, Provisional], pairs: Mapping[int, Provisional], options: AssociationOptions) -> Join | None:
    """The first pair of short tracklets that is one with exactly one of the hosts; None where there is none.

    Both tracklets have to lie near the host's way. One orbit has to meet all tracklets, and two orbits, one for each, must not
    meet them better than the six numbers that they have more allow. A pair that two hosts would take stays.
    """
    tracklets = {t: d for one in pairs.values() for t, d in one.tracklets.items()}
    near = {(s.object_id, s.tracklet_id) for s in sightings(tracklets, [one.orbit for one in hosts.values()])}
    for pair, two in pairs.items():
        about = [k for k, one in hosts.items() if (one.is_new or two.is_new) and all((k, t) in near for t in two.tracklets)]
        if not about or not _is_short(two.in_order):
            continue
        alone = one_orbit_of(two.in_order, two.orbit, options)
        if alone is None:
            continue
        found = [(k, cluster) for k in about if (cluster := _common(hosts[k], two, alone, options)) is not None]
        if len(found) == 1:
            return Join(host=found[0][0], pair=pair, cluster=found[0][1])
    return None


def _is_short(tracklets: Sequence[Directions]) -> bool:
    """Whether no tracklet has an orbit of its own that is the only one; others are told apart by their own planes and periods."""
    return all(arc is not None and arc.is_weak for arc in arc_orbits(tracklets))


def _common(host: Provisional, pair: Provisional, alone: Cluster, options: AssociationOptions) -> Cluster | None:
    """The orbit of all tracklets of both, unless two orbits are the better explanation."""
    own = one_orbit_of(host.in_order, host.orbit, options)
    if own is None:
        return None
    both = replace(host, tracklets={**host.tracklets, **pair.tracklets})
    cluster = one_orbit_of(both.in_order, host.orbit, options)
    if cluster is None or _chi2(cluster) - _chi2(own) - _chi2(alone) > options.gate:
        return None
    return cluster


def _chi2(cluster: Cluster) -> float:
    """Of all directions at their stated errors: a tracklet that robust weights leave out counts in full."""
    return float(np.sum(cluster.solution.residuals**2))
