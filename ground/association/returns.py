"""Pairs of short arcs a whole turn apart, where Lambert's problem has no plane: the second against the prediction of the first.

Half a minute of directions leaves the range wrong by a fifth, so that nothing can be predicted from it. If the orbit is nearly a
circle, the same directions give the range to a hundredth (the speed must be that of the circle). Such an orbit is only a start:
what is grown from it is fitted without a word of its eccentricity.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ground.association.arc import ArcOrbit, coordinates_of, scaled_inverse, state_of
from ground.association.clusters import AssociationOptions, Orbit, innovations
from ground.association.pairs import Pairs, pairs_of
from ground.determination.forces import ForceModel
from ground.determination.propagation import propagate
from ground.orbit.dynamics import MU_KM3_S2
from sboc_e2e.icd import tai
from sboc_e2e.icd.errors import UserError

Array = NDArray[np.float64]

_ECCENTRICITY: Final = 0.02
"""One sigma of each part of the eccentricity, along the place and across it. Chosen."""
_RANGES: Final = np.linspace(-4.0, 4.0, 9)
"""Sigmas of the range from which a fit starts. Chosen."""
_STEPS: Final = 8  # a budget of Gauss-Newton steps; chosen, not measured
_SINE: Final = 0.1
"""6 deg from a whole turn: as near as two tracklets alone are not believed (`clusters`)."""
_LEAST_TURN_NS: Final = 6 * 3600 * tai.NS_PER_S
"""Arcs that are nearer in time are a pair for Lambert's problem. Half a turn of a navigation orbit."""


def all_pairs(arcs: Sequence[ArcOrbit], options: AssociationOptions) -> Pairs:
    """Pairs by Lambert's problem, and those of weak arcs a whole turn apart."""
    found = pairs_of(arcs, longest_days=options.longest_days, chi2_limit=options.pair_limit, doubt_km_s=options.doubt_km_s)
    more = returns_of(arcs, options)
    known = set(zip(found.first.tolist(), found.second.tolist(), strict=True))
    fresh = [k for k, pair in enumerate(zip(more.first.tolist(), more.second.tolist(), strict=True)) if pair not in known]
    return Pairs(
        first=np.concatenate([found.first, more.first[fresh]]),
        second=np.concatenate([found.second, more.second[fresh]]),
        chi2=np.concatenate([found.chi2, more.chi2[fresh]]),
        state=np.vstack([found.state, more.state[fresh]]),
    )


def returns_of(arcs: Sequence[ArcOrbit], options: AssociationOptions) -> Pairs:
    """Pairs of weak arcs a whole number of turns apart, the first earlier, that one nearly circular orbit may explain."""
    forces = ForceModel(gravity_degree=options.gravity_degree, radiation=options.radiation_m2_kg)
    weak = sorted((k for k, arc in enumerate(arcs) if arc.is_weak), key=lambda k: arcs[k].t_tai_ns)
    rows: list[tuple[int, int, float, Array]] = []
    for place, i in enumerate(weak):
        later = [
            k for k in weak[place + 1 :]
            if _LEAST_TURN_NS < arcs[k].t_tai_ns - arcs[i].t_tai_ns <= options.longest_days * tai.NS_PER_DAY
        ]  # fmt: skip
        orbit = nearly_circular(arcs[i]) if later else None
        if orbit is None:
            continue
        try:
            near = _whole_turns(orbit, [arcs[k] for k in later], forces)
            chosen = [k for k, yes in zip(later, near, strict=True) if yes]
            chi2 = innovations(orbit, [arcs[k] for k in chosen], forces)
        except UserError:
            # a circle through the Earth
            continue
        rows += [(i, k, float(c), orbit.state) for k, c in zip(chosen, chi2, strict=True) if c < options.pair_limit]
    return Pairs(
        first=np.array([row[0] for row in rows], dtype=np.int64),
        second=np.array([row[1] for row in rows], dtype=np.int64),
        chi2=np.array([row[2] for row in rows], dtype=float),
        state=np.array([row[3] for row in rows], dtype=float).reshape(-1, 6),
    )


def _whole_turns(orbit: Orbit, arcs: Sequence[ArcOrbit], forces: ForceModel) -> NDArray[np.bool_]:
    """Which arcs' epochs find the orbit near the place of its own epoch."""
    there = propagate(orbit.state, orbit.t0_tai_ns, np.array([a.t_tai_ns for a in arcs], dtype=np.int64), forces).states[:, :3]
    here = orbit.state[:3] / np.linalg.norm(orbit.state[:3])
    cosine = there @ here / np.linalg.norm(there, axis=1)
    return np.asarray(cosine > np.sqrt(1.0 - _SINE**2))


def nearly_circular(arc: ArcOrbit) -> Orbit | None:
    """The orbit of an arc that is a circle but for some hundredths; None where no circle about the Earth meets the directions."""
    information = scaled_inverse(arc.covariance)
    slope_of_range = arc.covariance[:, 4] / arc.covariance[4, 4]
    starts = arc.mean + _RANGES[:, None] * np.sqrt(arc.covariance[4, 4]) * slope_of_range
    fits = [_settled(arc, information, start) for start in starts if start[4] > 0.0]
    q, normal, _ = min(fits, key=lambda one: one[2])
    state, _ = _state_and_partials(arc, q)
    if not np.isfinite(state).all() or q[4] <= 0.0:
        return None
    _, turn = coordinates_of(state, arc.observer_km, arc.observer_km_s, arc.axes)
    back = np.linalg.inv(turn)
    return Orbit(arc.t_tai_ns, state, back @ scaled_inverse(normal) @ back.T)


def _settled(arc: ArcOrbit, information: Array, start: Array) -> tuple[Array, Array, float]:
    """Coordinates (6,), their normal matrix and the cost, by Gauss-Newton steps from a start."""
    q, cost, normal = start, np.inf, information
    for _ in range(_STEPS):
        state, turn = _state_and_partials(arc, q)
        shape, slope = _eccentricity(state)
        slope = slope @ turn / _ECCENTRICITY
        away, shape = q - arc.mean, shape / _ECCENTRICITY
        cost = float(away @ information @ away + shape @ shape)
        normal = information + slope.T @ slope
        scale = np.sqrt(np.diag(normal))
        step = np.linalg.solve(normal / np.outer(scale, scale), (information @ away + slope.T @ shape) / scale) / scale
        # a step of more than a third of the range is beyond what is linear
        step *= min(1.0, q[4] / (3.0 * max(abs(step[4]), 1e-9)))
        q = q - step
    return q, normal, cost


def _state_and_partials(arc: ArcOrbit, q: Array) -> tuple[Array, Array]:
    """State (6,) of coordinates and its partials (6, 6)."""
    state = np.empty(6)
    state_of(q, arc.observer_km, arc.observer_km_s, arc.axes, state)
    partials = np.linalg.inv(coordinates_of(state, arc.observer_km, arc.observer_km_s, arc.axes)[1])
    return state, np.asarray(partials, dtype=np.float64)


def _eccentricity(state: Array) -> tuple[Array, Array]:
    """About e cos f and e sin f (2,) of a state, with partials (2, 6): r v^2 / mu - 1, and r v / (|r| |v|)."""
    r, v = state[:3], state[3:]
    size, speed = float(np.linalg.norm(r)), float(np.linalg.norm(v))
    both = float(r @ v) / (size * speed)
    value = np.array([size * speed**2 / MU_KM3_S2 - 1.0, both])
    slope = np.zeros((2, 6))
    slope[0] = np.concatenate([r / size * speed**2, 2.0 * size * v]) / MU_KM3_S2
    slope[1] = np.concatenate([v / (size * speed) - both * r / size**2, r / (size * speed) - both * v / speed**2])
    return value, slope
