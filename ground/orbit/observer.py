"""Orbit of the camera: one orbit through all fixes of a run. All ground software uses it, and the OEM publishes it.

The error of GPS fixes has one part that changes from fix to fix and one part that is constant. The stated sigma is of both
together. The scatter of the fixes about a smooth orbit gives the first part. The second part is the rest of the stated variance.
It is estimated together with the orbit, so that averaging does not reduce it in the covariance.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Final

import erfa
import numpy as np
from numpy.typing import NDArray

from ground.orbit.dynamics import propagate
from ground.orbit.smoothing import ArcModel, smooth_arc
from ground.sky.apparent import EARTH_SPIN_RAD_S
from sboc_e2e.icd import tai
from sboc_e2e.icd.frame import FrameHeader, ObserverState

Array = NDArray[np.float64]

REACH_S: Final = 60.0
"""The orbit is given this far before the first fix and beyond the last."""
_LONGEST_GAP_S: Final = 1200.0
"""Fixes further apart belong to arcs of their own: the model is not trusted over a quarter of a revolution."""
_LONGEST_ARC: Final = 10_000
"""Fixes of one arc at most, for the sake of memory (4 kB each)."""
_NODE_STEP_S: Final = 10.0
"""Between nodes a cubic Hermite polynomial is 0.2 mm and 0.1 mm/s off in a low orbit."""
_PUSHES_KM_S2: Final = (1e-5, 1e-7)
"""Unmodelled acceleration tried, one sigma: the size of the J2 term itself, for orbits that are no solutions of the equations of
motion; and that of the next terms of the Earth's field. The first is used unless the fixes prefer the second."""
_PUSH_TIME_S: Final = 600.0
"""Correlation time: a tenth of a low revolution, in which unmodelled terms of the field change. Chosen, not measured."""
_CLEARLY_BETTER: Final = 2.0
"""Of the natural log likelihood: e^2, a hint but no more, for the sake of the larger push when undecided."""
_REJECTED_SIGMA: Final = 6.0  # a right number in 5e8 is beyond it: what is beyond is damage in the telemetry
_SMALLEST_SIGMA: Final = np.array([1e-4] * 3 + [1e-6] * 3)
"""Of a fix, km and km/s, for telemetry that states none."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ObserverArc:
    """The camera's smoothed motion over one arc, GCRS axes, geocentric.

    t_tai_ns : (n,) nodes, rising, from `REACH_S` before the first fix to as much after the last. state : (n, 6) km, km/s;
    covariance : (n, 6, 6). kind : "orbit" or "site". first_tai_ns, last_tai_ns : epochs of the first and last fix.
    n_fixes, n_rejected : used and left out as outliers. scatter : (2,) fresh errors of positions and of velocities by the
    stated ones. push_km_s2 : unmodelled acceleration allowed for.
    """

    t_tai_ns: NDArray[np.int64]
    state: Array
    covariance: Array
    kind: str
    first_tai_ns: int
    last_tai_ns: int
    n_fixes: int
    n_rejected: int
    scatter: Array
    push_km_s2: float

    def states(self, t_tai_ns: NDArray[np.int64]) -> Array:
        """States (m, 6), NaN outside the arc."""
        from scipy.interpolate import CubicHermiteSpline  # takes a fifth of a second, which an observer at rest does not need

        origin = int(self.t_tai_ns[0])
        spline = CubicHermiteSpline((self.t_tai_ns - origin) * 1e-9, self.state[:, :3], self.state[:, 3:], extrapolate=False)
        t_s = (np.asarray(t_tai_ns) - origin) * 1e-9
        return np.hstack([spline(t_s), spline(t_s, 1)])

    def covariances(self, t_tai_ns: NDArray[np.int64]) -> Array:
        """Covariances (m, 6, 6) km, km/s: those of the nodes beside, weighted by nearness; NaN outside."""
        t_ns = np.asarray(t_tai_ns)
        after = np.clip(np.searchsorted(self.t_tai_ns, t_ns), 1, len(self.t_tai_ns) - 1)
        low, high = self.t_tai_ns[after - 1], self.t_tai_ns[after]
        share = ((t_ns - low) / (high - low))[:, None, None]
        mixed = (1.0 - share) * self.covariance[after - 1] + share * self.covariance[after]
        mixed[(t_ns < self.t_tai_ns[0]) | (t_ns > self.t_tai_ns[-1])] = np.nan
        return np.asarray(mixed)


@dataclass(frozen=True, kw_only=True, eq=False)
class ObserverOrbit:
    """The arcs of a run in order of time."""

    arcs: tuple[ObserverArc, ...]

    def states(self, t_tai_ns: NDArray[np.int64]) -> Array:
        """States (m, 6) km, km/s; NaN where no fix is near."""
        t_ns = np.asarray(t_tai_ns)
        out = np.full((len(t_ns), 6), np.nan)
        for arc, inside in self._shares(t_ns):
            out[inside] = arc.states(t_ns[inside])
        return out

    def covariances(self, t_tai_ns: NDArray[np.int64]) -> Array:
        """Covariances (m, 6, 6); NaN where no fix is near."""
        t_ns = np.asarray(t_tai_ns)
        out = np.full((len(t_ns), 6, 6), np.nan)
        for arc, inside in self._shares(t_ns):
            out[inside] = arc.covariances(t_ns[inside])
        return out

    def _shares(self, t_ns: NDArray[np.int64]) -> list[tuple[ObserverArc, NDArray[np.bool_]]]:
        """For each arc the mask (m,) of its epochs: up to the middle between its fixes and those of its neighbours."""
        turns = [(one.last_tai_ns + two.first_tai_ns) // 2 for one, two in pairwise(self.arcs)]
        owner = np.searchsorted(np.array(turns, dtype=np.int64), t_ns, side="right")
        return [(arc, owner == k) for k, arc in enumerate(self.arcs)]


def observer_orbit(headers: Sequence[FrameHeader]) -> ObserverOrbit | None:
    """The camera's orbit through the states of all headers; None when none has one.

    It is fitted once for the same states, however many consumers ask.
    """
    return _fitted(tuple(header.observer for header in headers if header.observer is not None))


@lru_cache(maxsize=4)
def _fitted(fixes: tuple[ObserverState, ...]) -> ObserverOrbit | None:
    """The orbit through the fixes, one for each epoch."""
    if not fixes:
        return None
    by_time = {fix.tai_ns: fix for fix in fixes}
    ordered = [by_time[t] for t in sorted(by_time)]
    t_ns = np.array([fix.tai_ns for fix in ordered], dtype=np.int64)
    far = np.diff(t_ns) > _LONGEST_GAP_S * 1e9
    borders = [0, *(np.flatnonzero(far) + 1).tolist(), len(ordered)]
    arcs = []
    for low, high in pairwise(borders):
        n_parts = -(-(high - low) // _LONGEST_ARC)
        parts = np.array_split(np.arange(low, high), n_parts)
        arcs += [_arc([ordered[k] for k in part]) for part in parts]
    return ObserverOrbit(arcs=tuple(arcs))


def _arc(fixes: Sequence[ObserverState]) -> ObserverArc:
    """One arc: outliers left out, the share of steady errors and the unmodelled acceleration found from the fixes."""
    fix_ns = np.array([fix.tai_ns for fix in fixes], dtype=np.int64)
    state = np.array([np.concatenate([fix.position_m, fix.velocity_m_s]) * 1e-3 for fix in fixes])
    stated = np.array([[fix.sigma_position_m] * 3 + [fix.sigma_velocity_m_s] * 3 for fix in fixes]) * 1e-3
    stated = np.maximum(stated, _SMALLEST_SIGMA)
    spin = _spin_of(int(fix_ns[0]), state, stated)
    good = _agreeing((fix_ns - fix_ns[0]) * 1e-9, state, stated, spin)
    node_ns = _nodes(fix_ns)
    place = np.searchsorted(node_ns, fix_ns)
    t_s = (node_ns - node_ns[0]) * 1e-9
    all_fixes, all_sigma = np.zeros((len(node_ns), 6)), np.ones((len(node_ns), 6))
    all_fixes[place] = state
    first = int(np.flatnonzero(good)[0])
    start = _propagated(state[first : first + 1], np.array([-(fix_ns[first] - node_ns[0]) * 1e-9]), spin)[0]
    doubt = stated[first] * 100.0
    doubt[:3] += doubt[3:] * abs(t_s[place[first]])
    tried: list[tuple[float, float, Array, Array, Array, NDArray[np.bool_]]] = []
    for push in (0.0,) if spin.any() else _PUSHES_KM_S2:
        scatter, kept = np.ones(2), good.copy()
        for _ in range(4):
            fresh = stated * np.repeat(scatter, 3)
            all_sigma[place] = fresh
            used = np.zeros(len(node_ns), dtype=bool)
            used[place[kept]] = True
            steady = np.median(stated, axis=0) * np.sqrt(np.maximum(1.0 - np.repeat(scatter, 3) ** 2, 0.0))
            model = ArcModel(spin, max(push, 1e-15), _PUSH_TIME_S, steady)
            smoothed, covariance, fitness = smooth_arc(t_s, all_fixes, all_sigma, used, start, doubt, model)
            pull = (state - smoothed[place, :6] - smoothed[place, 9:]) / stated
            scatter = _scatter(pull, covariance[place], stated, kept)
            kept = good & (np.abs(pull / np.repeat(scatter, 3)).max(axis=1) < _REJECTED_SIGMA)
            if not kept.any():
                kept = good.copy()
        tried.append((fitness, push, smoothed, covariance, scatter, kept))
    best = tried[-1] if tried[-1][0] > tried[0][0] + _CLEARLY_BETTER else tried[0]
    _, push, smoothed, covariance, scatter, kept = best
    return ObserverArc(
        t_tai_ns=node_ns,
        state=smoothed[:, :6],
        covariance=covariance[:, :6, :6],
        kind="site" if spin.any() else "orbit",
        first_tai_ns=int(fix_ns[0]),
        last_tai_ns=int(fix_ns[-1]),
        n_fixes=int(kept.sum()),
        n_rejected=int((~kept).sum()),
        scatter=scatter,
        push_km_s2=push,
    )


def _nodes(fix_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """Epochs of the fixes, of the reach beyond them, and as many between as keep nodes 10 s apart or less."""
    reach = round(REACH_S * 1e9)
    marks = np.concatenate([[fix_ns[0] - reach], fix_ns, [fix_ns[-1] + reach]])
    parts = np.maximum(1, np.ceil(np.diff(marks) / (_NODE_STEP_S * 1e9)).astype(np.int64))
    inner = [low + (high - low) * np.arange(n) // n for low, high, n in zip(marks[:-1], marks[1:], parts, strict=True)]
    return np.concatenate([*inner, marks[-1:]]).astype(np.int64)


def _spin_of(t_tai_ns: int, state: Array, sigma: Array) -> Array:
    """The Earth's spin (3,) rad/s about the pole of date, GCRS axes, if the fixes are of a point of the Earth; else zeros."""
    day, fraction = tai.to_jd_parts(t_tai_ns)
    spin = EARTH_SPIN_RAD_S * np.asarray(erfa.pnm06a(*erfa.taitt(day, fraction)))[2]
    slip = np.linalg.norm(state[:, 3:] - np.cross(spin, state[:, :3]), axis=1)
    near_ground = 6340.0 < float(np.median(np.linalg.norm(state[:, :3], axis=1))) < 6400.0
    fixed = near_ground and float(np.median(slip / sigma[:, 3])) < 6.0
    return spin if fixed else np.zeros(3)


def _propagated(state: Array, dt_s: Array, spin: Array) -> Array:
    """States (n, 6) propagated by dt_s (n,), each on its own."""
    if not spin.any():
        return np.array([propagate(one, np.array([dt]))[0] for one, dt in zip(state, dt_s, strict=True)])
    rate = float(np.linalg.norm(spin))
    axis = spin / rate
    angle = (rate * dt_s)[:, None]

    def turned(vector: Array) -> Array:
        along = (vector @ axis)[:, None] * axis
        return np.asarray(along + np.cos(angle) * (vector - along) + np.sin(angle) * np.cross(axis, vector))

    return np.hstack([turned(state[:, :3]), turned(state[:, 3:])])


def _agreeing(t_s: Array, state: Array, sigma: Array, spin: Array) -> NDArray[np.bool_]:
    """Mask of the fixes near the median of the predictions of up to eight neighbours; all fixes if none would remain."""
    n = len(t_s)
    if n < 3:
        return np.ones(n, dtype=bool)
    offsets = [k for k in range(-4, 5) if 0 < abs(k) < n]
    predicted = np.full((n, len(offsets), 6), np.nan)
    spread = np.full((n, len(offsets), 6), np.nan)
    for column, offset in enumerate(offsets):
        at = np.arange(max(0, -offset), n - max(0, offset))
        dt = t_s[at] - t_s[at + offset]
        predicted[at, column] = _propagated(state[at + offset], dt, spin)
        spread[at, column] = sigma[at + offset]
        spread[at, column, :3] += np.abs(dt)[:, None] * sigma[at + offset, 3:] + 0.5e-5 * dt[:, None] ** 2
        spread[at, column, 3:] += 1e-5 * np.abs(dt)[:, None]
    middle, width = np.nanmedian(predicted, axis=1), np.nanmedian(spread, axis=1)
    good = np.asarray((np.abs(state - middle) < 2.0 * _REJECTED_SIGMA * (width + sigma)).all(axis=1))
    return good if good.any() else np.ones(n, dtype=bool)


def _scatter(pull: Array, covariance: Array, stated: Array, kept: NDArray[np.bool_]) -> Array:
    """Fresh errors (2,) of positions and velocities in units of the stated ones, from the residuals and the fit's own.

    Three numbers that say one are added, for arcs of few fixes.
    """
    observed = covariance[:, :6, :6] + covariance[:, 9:, 9:] + covariance[:, :6, 9:] + covariance[:, 9:, :6]
    taken = np.diagonal(observed, axis1=1, axis2=2) / stated**2
    out = np.empty(2)
    for k, part in enumerate((slice(0, 3), slice(3, 6))):
        square = pull[kept, part] ** 2 + taken[kept, part]
        out[k] = np.sqrt((square.sum() + 3.0) / (square.size + 3.0))
    return np.maximum(out, 0.05)
