"""Pairs of short arcs a whole number of turns apart, where Lambert's problem has no plane.

Half a minute of directions leaves the range wrong by a fifth, so that nothing can be predicted from it. But an object that comes
back to its place has a period that divides the time between the arcs. With that semi-major axis, and an orbit not far from a
circle, each arc alone gives place and velocity: the speed must be that of the orbit. Two such arcs are a pair if they have the
same angular momentum. What is grown from the pair is fitted without a word of its eccentricity.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ground.association.arc import ArcOrbit, coordinates_of, state_of
from ground.association.clusters import AssociationOptions
from ground.association.pairs import Pairs, pairs_of
from ground.normal_equations import scaled_inverse
from ground.orbit.dynamics import MU_KM3_S2
from sboc_e2e.icd import tai

Array = NDArray[np.float64]

_ECCENTRICITY: Final = 0.05
"""One sigma of each part of the eccentricity, along the place and across it. Chosen."""
_AXIS: Final = 0.01
"""One sigma of the semi-major axis over that of a whole turn: 5 deg of a turn. Chosen."""
_AXES_KM: Final = (15_000.0, 60_000.0)
"""Semi-major axes that are looked for: navigation orbits and beyond the geostationary ring."""
_STEPS: Final = 12  # a budget of damped Gauss-Newton steps; chosen, not measured
_ARC_CHI2: Final = 20.0
"""Of an arc and the three numbers that the shape of its orbit adds; a right one in 6,000 is beyond it."""
_MOMENTUM_CHI2: Final = 20.0  # of the three numbers of the angular momentum; the same
_LEAST_TURN_NS: Final = 6 * 3600 * tai.NS_PER_S
"""Half a turn of a navigation orbit: arcs that are nearer in time are a pair for Lambert's problem."""


def all_pairs(arcs: Sequence[ArcOrbit], options: AssociationOptions) -> Pairs:
    """Pairs by Lambert's problem, and those of weak arcs a whole number of turns apart."""
    found = pairs_of(arcs, longest_days=options.longest_days, chi2_limit=options.pair_limit, doubt_km_s=options.doubt_km_s)
    more = returns_of(arcs, options.longest_days)
    known = set(zip(found.first.tolist(), found.second.tolist(), strict=True))
    fresh = [k for k, pair in enumerate(zip(more.first.tolist(), more.second.tolist(), strict=True)) if pair not in known]
    return Pairs(
        first=np.concatenate([found.first, more.first[fresh]]),
        second=np.concatenate([found.second, more.second[fresh]]),
        chi2=np.concatenate([found.chi2, more.chi2[fresh]]),
        state=np.vstack([found.state, more.state[fresh]]),
    )


def returns_of(arcs: Sequence[ArcOrbit], longest_days: float) -> Pairs:
    """Pairs of weak arcs a whole number of turns apart, the first earlier, with chi2 (nine degrees of freedom) and its state."""
    weak = sorted((k for k, arc in enumerate(arcs) if arc.is_weak), key=lambda k: arcs[k].t_tai_ns)
    known: dict[tuple[int, int], OfShape | None] = {}
    rows: list[tuple[int, int, float, Array]] = []
    for i, j in combinations(weak, 2):
        dt_ns = arcs[j].t_tai_ns - arcs[i].t_tai_ns
        if not _LEAST_TURN_NS < dt_ns <= longest_days * tai.NS_PER_DAY:
            continue
        best: tuple[float, Array] | None = None
        for axis_km in _axes(dt_ns / tai.NS_PER_S):
            # visits at equal times ask for the same axis again and again
            kept = round(2e3 * np.log(axis_km))
            for k in (i, j):
                if (k, kept) not in known:
                    known[k, kept] = of_shape(arcs[k], axis_km)
            one, other = known[i, kept], known[j, kept]
            if one is None or other is None:
                continue
            apart = one.momentum - other.momentum
            chi2 = float(apart @ np.linalg.solve(one.of_momentum + other.of_momentum, apart))
            total = chi2 + one.chi2 + other.chi2
            if chi2 < _MOMENTUM_CHI2 and (best is None or total < best[0]):
                best = total, one.state
        if best is not None:
            rows.append((i, j, *best))
    return Pairs(
        first=np.array([row[0] for row in rows], dtype=np.int64),
        second=np.array([row[1] for row in rows], dtype=np.int64),
        chi2=np.array([row[2] for row in rows], dtype=float),
        state=np.array([row[3] for row in rows], dtype=float).reshape(-1, 6),
    )


def _axes(dt_s: float) -> list[float]:
    """Semi-major axes whose periods divide a time."""
    longest = 2.0 * np.pi * np.sqrt(_AXES_KM[1] ** 3 / MU_KM3_S2)
    shortest = 2.0 * np.pi * np.sqrt(_AXES_KM[0] ** 3 / MU_KM3_S2)
    turns = np.arange(np.ceil(dt_s / longest), np.floor(dt_s / shortest) + 1.0)
    return [float((MU_KM3_S2 * (dt_s / (2.0 * np.pi * n)) ** 2) ** (1.0 / 3.0)) for n in turns if n > 0]


@dataclass(frozen=True, kw_only=True, eq=False)
class OfShape:
    """An arc's state (6,) km, km/s on an orbit of a given size and nearly round; chi2 of arc and shape.

    momentum (3,), of_momentum (3, 3) : angular momentum and its covariance, over that of a circle of that size.
    """

    state: Array
    chi2: float
    momentum: Array
    of_momentum: Array


def of_shape(arc: ArcOrbit, axis_km: float) -> OfShape | None:
    """The orbit of an arc that has a semi-major axis and is not far from a circle; None where the directions do not allow one."""
    information = scaled_inverse(arc.covariance)
    q = _round(arc, axis_km)
    if q is None:
        return None
    best: tuple[float, Array, Array, Array] | None = None
    damping = 1e-3
    for _ in range(_STEPS):
        state, turn = _state_and_partials(arc, q)
        shape, slope = _shape(state, axis_km)
        slope, away = slope @ turn, q - arc.mean
        cost = float(away @ information @ away + shape @ shape)
        if best is not None and not cost < best[0]:
            damping *= 10.0
        else:
            settled = best is not None and best[0] - cost < 1e-3
            best = cost, q, information + slope.T @ slope, information @ away + slope.T @ shape
            damping *= 0.1
            if settled:
                break
        _, at, normal, right = best
        scale = np.sqrt(np.diag(normal))
        q = at - np.linalg.solve(normal / np.outer(scale, scale) + damping * np.eye(6), right / scale) / scale
        q[4] = max(q[4], 0.5 * at[4])
    if best is None or best[0] > _ARC_CHI2:
        return None
    cost, q, normal, _ = best
    state, turn = _state_and_partials(arc, q)
    r, v = state[:3], state[3:]
    size = np.sqrt(MU_KM3_S2 * axis_km)
    columns = np.vstack([-np.cross(v, np.eye(3)), np.cross(r, np.eye(3))])
    slope = columns.T @ turn / size
    return OfShape(state=state, chi2=cost, momentum=np.cross(r, v) / size, of_momentum=slope @ scaled_inverse(normal) @ slope.T)


def _round(arc: ArcOrbit, axis_km: float) -> Array | None:
    """Coordinates (6,) of a start: as far from the Earth's centre as the axis, moving across, with the arc's own directions."""
    line, here = arc.axes[2], arc.observer_km
    along = float(here @ line)
    inside = axis_km**2 - float(here @ here) + along**2
    if inside <= 0.0 or np.sqrt(inside) <= along:
        return None
    rho = float(np.sqrt(inside)) - along
    place = here + rho * line
    across = arc.observer_km_s + rho * (arc.mean[2] * arc.axes[0] + arc.mean[3] * arc.axes[1])
    return np.array([0.0, 0.0, arc.mean[2], arc.mean[3], rho, -float(across @ place) / float(line @ place)])


def _state_and_partials(arc: ArcOrbit, q: Array) -> tuple[Array, Array]:
    """State (6,) of coordinates and its partials (6, 6)."""
    state = np.empty(6)
    state_of(q, arc.observer_km, arc.observer_km_s, arc.axes, state)
    partials = np.linalg.inv(coordinates_of(state, arc.observer_km, arc.observer_km_s, arc.axes)[1])
    return state, np.asarray(partials, dtype=np.float64)


def _shape(state: Array, axis_km: float) -> tuple[Array, Array]:
    """Whitened numbers (3,) that are zero on the circle, with partials (3, 6).

    About e cos f and e sin f (r v^2 / mu - 1, and r v / (|r| |v|)), and the axis over the semi-major axis less one.
    """
    r, v = state[:3], state[3:]
    size, speed = float(np.linalg.norm(r)), float(np.linalg.norm(v))
    both = float(r @ v) / (size * speed)
    value = np.array([size * speed**2 / MU_KM3_S2 - 1.0, both, axis_km * (2.0 / size - speed**2 / MU_KM3_S2) - 1.0])
    slope = np.zeros((3, 6))
    slope[0] = np.concatenate([r / size * speed**2, 2.0 * size * v]) / MU_KM3_S2
    slope[1] = np.concatenate([v / (size * speed) - both * r / size**2, r / (size * speed) - both * v / speed**2])
    slope[2] = -2.0 * axis_km * np.concatenate([r / size**3, v / MU_KM3_S2])
    sigma = np.array([_ECCENTRICITY, _ECCENTRICITY, _AXIS])
    return value / sigma, slope / sigma[:, None]
