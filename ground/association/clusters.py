"""Arcs of one object gathered about an orbit: two start it, its predictions find the rest, a batch fit of all judges."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ground.association.arc import ArcOrbit, coordinates_of
from ground.association.pairs import Pairs
from ground.determination.batch import FitOptions, Solution, fit
from ground.determination.forces import ForceModel
from ground.determination.impulses import PUSH_KM2_S3
from ground.determination.measurements import Directions
from ground.determination.propagation import propagate
from ground.normal_equations import scaled_inverse
from ground.orbit.dynamics import MU_KM3_S2
from ground.sky.sphere import cross
from sboc_e2e.icd import tai
from sboc_e2e.icd.errors import UserError

Array = NDArray[np.float64]

_STEPS: Final = 4  # a budget of Gauss-Newton steps; the batch that judges the orbit later iterates on. Chosen, not measured
_SETTLED: Final = 0.05  # of one sigma: a step below it changes chi2 by less than 0.02
_PLANE_COSINE: Final = 0.97
"""14 deg between the planes: wide enough for rough arcs; what is wrong goes on to the fit. Chosen, not measured."""
_ENERGY: Final = 0.2
"""Largest relative difference of energy, as wide as that of rough arcs; what is wrong goes on to the fit. Chosen."""
_SEVERAL_RAD: Final = 1.0
"""Two tracklets that are nearer along the orbit have one orbit, if a wide one. Chosen, not measured."""
_SEVERAL_SINE: Final = 0.1
"""6 deg from half turns. Arcs of 30 s of a geostationary object, 3 deg from a whole turn apart, met an orbit 25 sigma off."""
_LONG_DAYS: Final = 6.0
"""Longer spans are fitted with what the forces leave out, of which six days make 0.2 km: as much as the directions leave."""
_DOUBT_KM_PER_DAY2: Final = 0.4
"""One sigma of place after a day that radiation pressure of unknown area leaves; `doubt_of` says how it grows."""


@dataclass(frozen=True, kw_only=True)
class AssociationOptions:
    """How tracklets are brought together.

    longest_days : between the two arcs that start an orbit. pair_limit, gate : largest chi2 of six degrees of freedom of a
    pair and of an arc against a prediction. doubt_km_s : one sigma of velocity by which two bodies are wrong after a day.
    radiation_m2_kg, radiation_sigma_m2_kg : radiation coefficient times area over mass before the data speak.
    worst_chi2_nu : of a batch fit that is still one object.
    """

    longest_days: float = 5.0
    pair_limit: float = 40.0
    gate: float = 35.0
    doubt_km_s: float = 6e-4
    radiation_m2_kg: float = 0.02
    radiation_sigma_m2_kg: float = 0.01
    gravity_degree: int = 8
    worst_chi2_nu: float = 1.6


@dataclass(frozen=True, kw_only=True, eq=False)
class Cluster:
    """Tracklets (indices, in order of time) of one object, its orbit by batch fit, and which of them fit elsewhere too."""

    members: tuple[int, ...]
    solution: Solution
    ambiguous: tuple[int, ...] = field(default=())


@dataclass(frozen=True, eq=False)
class Orbit:
    """A Gaussian orbit: state (6,) and covariance (6, 6) at an epoch."""

    t0_tai_ns: int
    state: Array
    covariance: Array


def innovations(orbit: Orbit, arcs: Sequence[ArcOrbit], forces: ForceModel) -> Array:
    """Chi2 (n,), six degrees of freedom, of arcs against an orbit's predictions, both with their covariances."""
    if not arcs:
        return np.empty(0)
    epochs = np.array([a.t_tai_ns for a in arcs], dtype=np.int64)
    arc = propagate(orbit.state, orbit.t0_tai_ns, epochs, forces, partials=True)
    out = np.empty(len(arcs))
    for k, one in enumerate(arcs):
        days = abs(one.t_tai_ns - orbit.t0_tai_ns) / tai.NS_PER_DAY
        q, slope = coordinates_of(arc.states[k], one.observer_km, one.observer_km_s, one.axes)
        turn = slope @ arc.partials[k]
        total = turn @ orbit.covariance @ turn.T + doubt_of(one, days) + one.covariance
        out[k] = _chi2(q - one.mean, total)
    return out


def doubt_of(arc: ArcOrbit, days: float) -> Array:
    """Covariance (6, 6) in an arc's coordinates of what the forces leave out after some days.

    It grows with the square of days up to one day, and linearly from there on.
    """
    place = _DOUBT_KM_PER_DAY2 * min(days, 1.0) * max(days, 0.02)
    speed = 1e-4 * place
    rho = arc.mean[4]
    return np.asarray(np.diag(np.array([place / rho, place / rho, speed / rho, speed / rho, place, speed]) ** 2))


def _chi2(left: Array, covariance: Array) -> float:
    scale = np.sqrt(np.diag(covariance))
    z = np.linalg.solve(covariance / np.outer(scale, scale), left / scale)
    return float(z @ (left / scale))


def joined(start: Array, t0_tai_ns: int, arcs: Sequence[ArcOrbit], forces: ForceModel) -> tuple[Orbit, float]:
    """The orbit that meets several arcs' Gaussians best, perturbed, from a start (6,); and its chi2."""
    epochs = np.array([a.t_tai_ns for a in arcs], dtype=np.int64)
    middle = (int(epochs.min()) + int(epochs.max())) // 2
    x, cost, normal, step = np.asarray(start, dtype=float), np.inf, np.eye(6), np.zeros(6)
    for _ in range(_STEPS):
        try:
            arc = propagate(x, t0_tai_ns, epochs, forces, partials=True)
        except UserError:
            if not step.any():
                raise
            # a step onto an orbit that meets the Earth is too long; what is left of it is tried
            step = 0.5 * step
            x = x - step
            continue
        normal, right, cost = np.zeros((6, 6)), np.zeros(6), 0.0
        for k, one in enumerate(arcs):
            q, slope = coordinates_of(arc.states[k], one.observer_km, one.observer_km_s, one.axes)
            turn = slope @ arc.partials[k]
            weight = scaled_inverse(one.covariance + doubt_of(one, abs(one.t_tai_ns - middle) / tai.NS_PER_DAY))
            normal += turn.T @ weight @ turn
            right += turn.T @ weight @ (one.mean - q)
            cost += float((one.mean - q) @ weight @ (one.mean - q))
        covariance = scaled_inverse(normal)
        step = covariance @ right
        x = x + step
        if (np.abs(step) < _SETTLED * np.sqrt(np.diag(covariance))).all():
            cost -= float(right @ step)
            break
    return Orbit(t0_tai_ns, x, scaled_inverse(normal)), cost


def clusters_of(
    tracklets: Sequence[Directions], arcs: Sequence[ArcOrbit | None], pairs: Pairs, options: AssociationOptions
) -> list[Cluster]:
    """Objects found, those with the most arcs first in the making of each; every tracklet belongs to one at most."""
    forces = ForceModel(gravity_degree=options.gravity_degree, radiation=options.radiation_m2_kg)
    free = {k for k, a in enumerate(arcs) if a is not None}
    found: list[Cluster] = []
    refused: set[tuple[int, ...]] = set()
    support = np.bincount(np.concatenate([pairs.first, pairs.second]), minlength=len(arcs)) if len(pairs.chi2) else np.zeros(0)
    rank = np.argsort(-np.minimum(support[pairs.first], support[pairs.second]) + 0.01 * pairs.chi2, kind="stable")
    for k in rank:
        seed = (int(pairs.first[k]), int(pairs.second[k]))
        if not free.issuperset(seed):
            continue
        try:
            members, grown = _grown(seed, pairs.state[k], arcs, sorted(free), forces, options)
            if members in refused:
                continue
            cluster = judged(members, tracklets, pairs.state[k], grown.t0_tai_ns, options)
            if all(_arc(arcs, m).is_weak for m in members):
                # a fit along a long, bent valley of chi2 may end where it is flat
                cluster = _better(cluster, judged(members, tracklets, grown.state, grown.t0_tai_ns, options))
            if cluster is not None and _is_one_of_several(cluster, tracklets):
                cluster = None
        except UserError:
            # an orbit that meets the Earth, or data that do not hold together: no object
            continue
        if cluster is None:
            refused.add(members)
            continue
        found.append(cluster)
        free -= set(cluster.members)
    return _with_ambiguity(found, arcs, forces, options)


def _arc(arcs: Sequence[ArcOrbit | None], k: int) -> ArcOrbit:
    one = arcs[k]
    if one is None:
        raise UserError("association: a tracklet without an orbit of its own")
    return one


def _grown(
    seed: tuple[int, int], start: Array, arcs: Sequence[ArcOrbit | None], free: Sequence[int], forces: ForceModel,
    options: AssociationOptions,
) -> tuple[tuple[int, ...], Orbit]:  # fmt: skip
    """Members by index in order of time, and their orbit: the nearest arc that it predicts is added until there is none."""
    members = list(seed)
    t0 = _arc(arcs, seed[0]).t_tai_ns
    orbit, cost = joined(start, t0, [_arc(arcs, m) for m in members], forces)
    if cost > options.pair_limit:
        raise UserError("association: two arcs are of no one orbit once it is perturbed")
    others = [k for k in _alike(orbit, arcs, free) if k not in seed]
    while others:
        chi2 = innovations(orbit, [_arc(arcs, k) for k in others], forces)
        inside = [(k, c) for k, c in zip(others, chi2, strict=True) if c < options.gate]
        if not inside:
            break
        when = [_arc(arcs, m).t_tai_ns for m in members]
        # the nearest in time is predicted best; of two as near the likelier
        new, _ = min(inside, key=lambda item: (min(abs(_arc(arcs, item[0]).t_tai_ns - t) for t in when), item[1]))
        trial, cost = joined(orbit.state, t0, [_arc(arcs, m) for m in (*members, new)], forces)
        others.remove(new)
        if cost < options.pair_limit + 12.0 * (len(members) - 1):
            members.append(new)
            orbit = trial
    return tuple(sorted(members, key=lambda m: _arc(arcs, m).t_tai_ns)), orbit


def _better(one: Cluster | None, other: Cluster | None) -> Cluster | None:
    """Of two fits of the same tracklets that with the smaller chi2."""
    return min((c for c in (one, other) if c is not None), key=lambda c: c.solution.chi2_nu, default=None)


def _alike(orbit: Orbit, arcs: Sequence[ArcOrbit | None], chosen: Sequence[int]) -> list[int]:
    """Those of some arcs that are weak, or whose own plane and energy are near an orbit's: a sieve before predictions."""
    if not chosen:
        return []
    normal, energy = _plane_and_energy(np.array([_arc(arcs, k).state for k in chosen]))
    other, wanted = _plane_and_energy(orbit.state[None])
    good = (normal @ other[0] > _PLANE_COSINE) & (np.abs(energy / wanted[0] - 1.0) < _ENERGY)
    return [k for k, ok in zip(chosen, good, strict=True) if ok or _arc(arcs, k).is_weak]


def _plane_and_energy(states: Array) -> tuple[Array, Array]:
    """Unit normals (n, 3) and energies (n,) km^2/s^2 of states (n, 6)."""
    normal = cross(states[:, :3], states[:, 3:])
    normal = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    energy = 0.5 * (states[:, 3:] ** 2).sum(axis=1) - MU_KM3_S2 / np.linalg.norm(states[:, :3], axis=1)
    return normal, energy


def judged(
    members: tuple[int, ...], tracklets: Sequence[Directions], start: Array, t0_tai_ns: int, options: AssociationOptions
) -> Cluster | None:
    """The batch fit of all directions of some tracklets; None where they are not one free orbit.

    Over a long span the orbit is one that unknown accelerations push, and its epoch is the last tracklet's: what comes then
    follows from it alone.
    """
    forces = ForceModel(gravity_degree=options.gravity_degree, radiation=options.radiation_m2_kg)
    data = [tracklets[m] for m in members]
    middles = [int(d.t_tai_ns[len(d.t_tai_ns) // 2]) for d in data]
    push = PUSH_KM2_S3 if max(middles) - min(middles) > _LONG_DAYS * tai.NS_PER_DAY else 0.0
    if push:
        start = propagate(start, t0_tai_ns, np.array([max(middles)], dtype=np.int64), forces).states[0]
        t0_tai_ns = max(middles)
    choice = FitOptions(prior=(("radiation", options.radiation_sigma_m2_kg),), push_km2_s3=push)
    solution = fit(start, t0_tai_ns, data, forces, ("radiation",), choice)
    if not solution.converged or solution.manoeuvre or solution.chi2_nu > options.worst_chi2_nu:
        return None
    return Cluster(members=members, solution=solution)


def meets_all(solution: Solution, tracklets: Sequence[Directions]) -> bool:
    """Whether a fit of these tracklets, in this order, uses at least half of each one's numbers.

    Robust weights let a fit pass that leaves a whole tracklet out.
    """
    ends = np.cumsum([2 * len(t.t_tai_ns) for t in tracklets])
    return all(float((part > 0.0).mean()) >= 0.5 for part in np.split(solution.weights, ends[:-1]))


def _is_one_of_several(cluster: Cluster, tracklets: Sequence[Directions]) -> bool:
    """Whether an orbit has two tracklets alone, half turns apart: then others meet them as well, and a third has to tell."""
    if len(cluster.members) > 2:
        return False
    s = cluster.solution
    middles = [d.t_tai_ns[len(d.t_tai_ns) // 2] for d in (tracklets[m] for m in cluster.members)]
    one, other = propagate(s.state, s.t0_tai_ns, np.array(sorted(middles), dtype=np.int64), s.forces).states
    radius, speed = float(np.linalg.norm(one[:3])), float(np.linalg.norm(one[3:]))
    turned_rad = speed / radius * float(abs(middles[1] - middles[0])) * 1e-9
    sine = float(np.linalg.norm(cross(one[:3], other[:3]))) / (radius * float(np.linalg.norm(other[:3])))
    return turned_rad > _SEVERAL_RAD and sine < _SEVERAL_SINE


def _with_ambiguity(
    found: Sequence[Cluster], arcs: Sequence[ArcOrbit | None], forces: ForceModel, options: AssociationOptions
) -> list[Cluster]:
    """Clusters with the tracklets that another cluster's orbit explains nearly as well."""
    every = sorted({m for c in found for m in c.members})
    own = {m: k for k, c in enumerate(found) for m in c.members}
    doubtful: dict[int, set[int]] = {k: set() for k in range(len(found))}
    for k, cluster in enumerate(found):
        s = cluster.solution
        orbit = Orbit(s.t0_tai_ns, s.state, s.covariance[:6, :6])
        near = [m for m in _alike(orbit, arcs, every) if own[m] != k]
        model = forces.with_values(("radiation",), (s.forces.radiation,))
        try:
            every_chi2 = innovations(orbit, [_arc(arcs, m) for m in near], model)
        except UserError:
            # its orbit meets the Earth beyond its own tracklets: it explains no other one
            continue
        for m, chi2 in zip(near, every_chi2, strict=True):
            if chi2 < options.gate:
                doubtful[own[m]].add(m)
    return [
        Cluster(members=c.members, solution=c.solution, ambiguous=tuple(m for m in c.members if m in doubtful[k]))
        for k, c in enumerate(found)
    ]
