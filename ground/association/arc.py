"""The orbit of one arc: what some minutes of directions say of place and velocity, range and its rate included, as a Gaussian.

Coordinates: two angles in the tangent plane, the two tangential velocities over the range, range, and the velocity along the
line, all relative to the observer. In them the likelihood of an arc is near a
Gaussian, as attributables are (Milani et al. 2004, Icarus 170, 152); the range that the observer's own curved way gives is in it.
Two-body motion with J2 over the arc.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ground.determination.measurements import Directions
from ground.normal_equations import scaled_inverse
from ground.orbit.dynamics import LIGHT_KM_S, MU_KM3_S2, advance
from ground.sky.sphere import east_north
from sboc_e2e.icd import tai
from sboc_e2e.icd.errors import UserError

Array = NDArray[np.float64]

_START_KM: Final = (9_000.0, 16_000.0, 25_000.0, 36_000.0, 50_000.0)
"""Ranges from which a fit without a start begins, each less than 1.8 times the one before. Chosen, not measured."""
_PRIOR: Final = np.array([np.inf, np.inf, np.inf, np.inf, 30_000.0, 8.0])
"""One sigma about a range of 30,000 km at rest: the admissible region, softly; arcs of minutes overrule it."""
_PRIOR_MEAN: Final = np.array([0.0, 0.0, 0.0, 0.0, 30_000.0, 0.0])  # mean of that Gaussian; directions and rates have no prior
_STEP: Final = np.array([1e-7, 1e-7, 1e-9, 1e-9, 1.0, 1e-4])
"""Steps of the differences: rad, rad, rad/s, rad/s, km, km/s. They are small against the errors, large against rounding."""
_MOST_STEPS: Final = 25  # a budget of work for a fit that swings; chosen, not measured
_GOOD_CHI2_NU: Final = 2.0
"""Of a fit from a start that was given, below which no other start is tried."""
_NEAREST_KM: Final = 500.0  # keeps the range positive; chosen, not measured
_FARTHEST_KM: Final = 150_000.0
"""Upper clamp of the range, over three times that of the geostationary ring: a step cannot run off."""


_WEAK: Final = 0.05
"""Error of a range, relative. Arcs of 30 s have 0.2; of seven minutes, 0.01. Chosen."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ArcOrbit:
    """A tracklet's own orbit at its middle epoch.

    observer_km_s : (3,) that velocities are relative to. axes : (3, 3) rows e1, e2 and the direction. mean : (6,) angles (zero
    by choice of axes), tangential velocities over range rad/s, range km, velocity along the line km/s. covariance : (6, 6) with
    the soft admissible region; information : (6, 6) of the data alone. chi2_nu : of the fit.
    """

    t_tai_ns: int
    observer_km: Array
    observer_km_s: Array
    axes: Array
    mean: Array
    covariance: Array
    information: Array
    chi2_nu: float

    @property
    def state(self) -> Array:
        """State (6,) km, km/s at the middle epoch."""
        out = np.empty(6)
        state_of(self.mean, self.observer_km, self.observer_km_s, self.axes, out)
        return out

    @property
    def is_weak(self) -> bool:
        """Whether the range is so wide that an orbit found from it need not be the only one."""
        return float(self.covariance[4, 4]) > (_WEAK * float(self.mean[4])) ** 2


@njit(cache=True)
def state_of(q: Array, observer: Array, speed: Array, axes: Array, out: Array) -> None:
    """State (6,) from the six coordinates."""
    size = (1.0 + q[0] * q[0] + q[1] * q[1]) ** 0.5
    for c in range(3):
        unit = (axes[2, c] + q[0] * axes[0, c] + q[1] * axes[1, c]) / size
        out[c] = observer[c] + q[4] * unit
        out[3 + c] = speed[c] + q[4] * (q[2] * axes[0, c] + q[3] * axes[1, c]) + q[5] * axes[2, c]


def coordinates_of(state: Array, observer: Array, speed: Array, axes: Array) -> tuple[Array, Array]:
    """The six coordinates of a state (6,) and their partials (6, 6) with respect to it."""
    moving = state[3:] - speed
    line = state[:3] - observer
    depth = float(line @ axes[2])
    rho = float(np.linalg.norm(line))
    q = np.concatenate([axes[:2] @ line / depth, axes[:2] @ moving / rho, [rho, float(axes[2] @ moving)]])
    partials = np.zeros((6, 6))
    partials[:2, :3] = (axes[:2] - q[:2, None] * axes[2]) / depth
    partials[2:4, :3] = -q[2:4, None] * line / rho**2
    partials[2:4, 3:] = axes[:2] / rho
    partials[4, :3] = line / rho
    partials[5, 3:] = axes[2]
    return q, partials


@njit(cache=True)
def _modelled(
    q: Array, order: NDArray[np.int64], t_s: Array, observers: Array, speed: Array, axes: Array, whiten: Array, out: Array
) -> None:
    """Whitened directions (n, 2) that the orbit gives at times t_s (n,) after the middle, whose index is the first of `order`."""
    start = np.empty(6)
    state_of(q, observers[order[0]], speed, axes, start)
    state = start.copy()
    now = 0.0
    line = np.empty(3)
    for k in order:
        if t_s[k] == 0.0 or (t_s[k] > 0.0) != (now > 0.0):
            state[:] = start
            now = 0.0
        if t_s[k] != now:
            advance(state, t_s[k] - now)
            now = t_s[k]
        r3 = (state[0] ** 2 + state[1] ** 2 + state[2] ** 2) ** 1.5
        delay = 0.0
        rho = 1.0
        for _ in range(3):
            total = 0.0
            for c in range(3):
                pull = -MU_KM3_S2 * state[c] / r3
                line[c] = state[c] - delay * state[3 + c] + 0.5 * delay * delay * pull - observers[k, c]
                total += line[c] * line[c]
            rho = total**0.5
            delay = rho / LIGHT_KM_S
        for c in range(2):
            out[k, c] = (whiten[k, c, 0] * line[0] + whiten[k, c, 1] * line[1] + whiten[k, c, 2] * line[2]) / rho


def arc_orbit(data: Directions, start: Array | None = None) -> ArcOrbit:
    """The orbit of one arc. UserError for fewer than three directions.

    start : a state (6,) at the middle epoch that may be near; it is tried first, and alone if the directions fit it.
    """
    n = len(data.t_tai_ns)
    if n < 3:
        raise UserError(f"association: a tracklet of {n} directions; three or more at different epochs are expected")
    middle = n // 2
    t_s = (data.t_tai_ns - data.t_tai_ns[middle]) / tai.NS_PER_S
    order = np.concatenate([np.arange(middle, n), np.arange(middle - 1, -1, -1)])
    whiten = np.einsum("nij,njk->nik", np.linalg.inv(np.linalg.cholesky(data.covariance_rad2)), data.axes)
    seen = np.einsum("nij,nj->ni", whiten, data.direction)
    unit = data.direction[middle]
    axes = np.vstack([*east_north(unit), unit])
    speed = np.polynomial.polynomial.polyfit(t_s, data.observer_km, min(n - 1, 4))[1]
    slope = np.polynomial.polynomial.polyfit(t_s, data.direction @ axes[:2].T, 2)[1]

    def linear(q: Array) -> tuple[Array, Array]:
        """Residuals (2 n,) and partials (2 n, 6)."""
        low, high, here = np.empty((n, 2)), np.empty((n, 2)), np.empty((n, 2))
        _modelled(q, order, t_s, data.observer_km, speed, axes, whiten, here)
        columns = np.empty((2 * n, 6))
        for k in range(6):
            step = np.zeros(6)
            step[k] = _STEP[k]
            _modelled(q + step, order, t_s, data.observer_km, speed, axes, whiten, high)
            _modelled(q - step, order, t_s, data.observer_km, speed, axes, whiten, low)
            columns[:, k] = ((high - low) / (2.0 * _STEP[k])).reshape(-1)
        return (seen - here).reshape(-1), columns

    best: tuple[float, Array, Array] | None = None
    if start is not None and float((start[:3] - data.observer_km[middle]) @ unit) > 0.0:
        best = _fitted(linear, coordinates_of(start, data.observer_km[middle], speed, axes)[0])
    near = best is not None and best[0] < _GOOD_CHI2_NU * (2 * n - 6)
    for rho in () if near else _START_KM:
        q = np.concatenate([[0.0, 0.0], slope, [rho, 0.0]])
        found = _fitted(linear, q)
        if found is not None and (best is None or _minus_log_evidence(found) < _minus_log_evidence(best)):
            best = found
    if best is None:
        raise UserError("association: no orbit about the Earth meets the directions of a tracklet")
    cost, q, information = best
    # axes through the fitted direction, so that its angles are zero
    state = np.empty(6)
    state_of(q, data.observer_km[middle], speed, axes, state)
    line = state[:3] - data.observer_km[middle]
    unit = line / np.linalg.norm(line)
    turned = np.vstack([*east_north(unit), unit])
    _, old = coordinates_of(state, data.observer_km[middle], speed, axes)
    mean, new = coordinates_of(state, data.observer_km[middle], speed, turned)
    change = old @ np.linalg.inv(new)
    information = change.T @ information @ change
    return ArcOrbit(
        t_tai_ns=int(data.t_tai_ns[middle]),
        observer_km=data.observer_km[middle],
        observer_km_s=speed,
        axes=turned,
        mean=mean,
        covariance=scaled_inverse(information + np.diag(_PRIOR**-2)),
        information=information,
        chi2_nu=cost / max(2 * n - 6, 1),
    )


def _minus_log_evidence(found: tuple[float, Array, Array]) -> float:
    """Twice the negative logarithm of a solution's evidence (Laplace), to choose among solutions of one arc.

    Half a minute of directions from 700 km fits an object at 4,000 km as well as one at 42,000 km. The near solution is sharp:
    a small share of the admissible region meets the directions there.
    """
    cost, q, information = found
    weight = _PRIOR**-2
    precision = information + np.diag(weight)
    scale = np.sqrt(np.diag(precision))
    log_det = 2.0 * float(np.log(scale).sum()) + float(np.linalg.slogdet(precision / np.outer(scale, scale))[1])
    return cost + float(weight @ (q - _PRIOR_MEAN) ** 2) + log_det


def _fitted(linear: Callable[[Array], tuple[Array, Array]], q: Array) -> tuple[float, Array, Array] | None:
    """Cost, coordinates and information of the data by Levenberg's steps from a start; None where no orbit is left."""
    weight = _PRIOR**-2
    damping = 1e-3
    best: tuple[float, Array, Array, Array] | None = None
    for _ in range(_MOST_STEPS):
        value, slope = linear(q)
        cost = float(value @ value + weight @ (q - _PRIOR_MEAN) ** 2)
        if best is not None and not cost < best[0]:
            damping *= 10.0
            if damping > 1e6:
                break
        else:
            settled = best is not None and best[0] - cost < 1e-3
            best = (cost, q, value, slope)
            damping *= 0.1
            if settled:
                break
        _, at, value, slope = best
        normal = slope.T @ slope + np.diag(weight)
        scale = np.sqrt(np.diag(normal))
        right = slope.T @ value - weight * (at - _PRIOR_MEAN)
        q = at + np.linalg.solve(normal / np.outer(scale, scale) + damping * np.eye(6), right / scale) / scale
        q[4] = min(max(q[4], _NEAREST_KM), _FARTHEST_KM)
    if best is None:
        return None
    value, slope = best[2], best[3]
    return float(value @ value), best[1], slope.T @ slope


def arc_orbits(tracklets: Sequence[Directions], starts: Sequence[Array | None] | None = None) -> list[ArcOrbit | None]:
    """The orbit of each tracklet; None for one that has none (too few directions). starts : of each, or None."""
    out: list[ArcOrbit | None] = []
    for data, start in zip(tracklets, starts or [None] * len(tracklets), strict=True):
        try:
            out.append(arc_orbit(data, start))
        except UserError:
            out.append(None)
    return out
