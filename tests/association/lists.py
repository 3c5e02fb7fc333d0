"""Surveys of the list simulator as the ground segment gets them, and what came of them against the truth."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ground.association.clusters import Cluster
from ground.determination.measurements import Directions
from ground.determination.propagation import propagate
from simulator.platform.all_forces import DAY_S, between
from tests.association.list_simulator import Seen, Survey, bound

Array = NDArray[np.float64]


def measured(one: Survey) -> list[Directions]:
    """Directions of every tracklet."""
    return [directions(one, seen) for seen in one.seen]


def directions(one: Survey, seen: Seen) -> Directions:
    """Directions of a tracklet, equal errors along any axes."""
    n = len(seen.t_s)
    first = np.cross(seen.direction, [0.6, 0.0, 0.8])
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return Directions(
        t_tai_ns=one.sky.t0_tai_ns + np.round(seen.t_s * 1e9).astype(np.int64),
        observer_km=seen.observer,
        direction=seen.direction,
        axes=np.stack([first, np.cross(seen.direction, first)], axis=1),
        covariance_rad2=np.tile(one.sigma_rad**2 * np.eye(2), (n, 1, 1)),
    )


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """Tracklets of objects seen twice or more, how many lie in the object's largest cluster, how many lie in clusters of others.

    linked : all tracklets in clusters. nees, error_over_bound : (n,) of pure clusters, predicted to a day after the last one.
    """

    linkable: int
    right: int
    wrong: int
    linked: int
    nees: Array
    squared_ratio: Array
    error_km: Array
    bound_km: Array


def verdict(one: Survey, found: Sequence[Cluster], *, at_days: float = 6.0, area_sigma: float = 0.01) -> Verdict:
    """Clusters against their owners."""
    owner = np.array([s.owner for s in one.seen])
    counts = {int(k): int((owner == k).sum()) for k in np.unique(owner) if k >= 0}
    best: dict[int, int] = {}
    wrong = linked = 0
    nees, squared, errors, bounds = [], [], [], []
    for cluster in found:
        mine = owner[list(cluster.members)]
        linked += len(mine)
        k = int(np.bincount(mine + 1).argmax()) - 1
        if k < 0:
            wrong += len(mine)
            continue
        wrong += int((mine != k).sum())
        best[k] = max(best.get(k, 0), int((mine == k).sum()))
        if (mine != k).any():
            continue
        s = cluster.solution
        t = np.array([one.sky.t0_tai_ns + round(at_days * DAY_S * 1e9)], dtype=np.int64)
        arc = propagate(s.state, s.t0_tai_ns, t, s.forces, parameters=s.parameters, partials=True)
        covariance = (arc.partials[0] @ s.covariance @ arc.partials[0].T)[:3, :3]
        away = arc.states[0, :3] - between(one.truth[k], np.array([at_days * DAY_S]))[0, :3]
        limit = bound(one, k, [one.seen[m] for m in cluster.members], at_days * DAY_S, area_sigma)
        nees.append(away @ np.linalg.solve(covariance, away) / 3.0)
        squared.append(away @ away / np.trace(limit))
        errors.append(np.linalg.norm(away))
        bounds.append(np.sqrt(np.trace(limit)))
    return Verdict(
        linkable=sum(n for n in counts.values() if n > 1),
        right=sum(n for n in best.values() if n > 1),
        wrong=wrong,
        linked=linked,
        nees=np.array(nees),
        squared_ratio=np.array(squared),
        error_km=np.array(errors),
        bound_km=np.array(bounds),
    )
