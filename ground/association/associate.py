"""Uncorrelated tracklets to objects, blind: arcs -> pairs -> clusters."""

from collections.abc import Sequence

from ground.association.arc import arc_orbits
from ground.association.clusters import AssociationOptions, Cluster, clusters_of
from ground.association.returns import all_pairs
from ground.determination.measurements import Directions


def associate(tracklets: Sequence[Directions], options: AssociationOptions | None = None) -> list[Cluster]:
    """Objects with two or more of the tracklets; the rest stays uncorrelated."""
    options = options or AssociationOptions()
    arcs = arc_orbits(tracklets)
    usable = [k for k, a in enumerate(arcs) if a is not None]
    if len(usable) < 2:
        return []
    pairs = all_pairs([a for a in arcs if a is not None], options)
    found = clusters_of([tracklets[k] for k in usable], [arcs[k] for k in usable], pairs, options)
    return [
        Cluster(members=tuple(usable[m] for m in c.members), solution=c.solution, ambiguous=tuple(usable[m] for m in c.ambiguous))
        for c in found
    ]
