"""Batch least squares for a state and force parameters: robust weights, parameters that are considered, a flag for manoeuvres."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from ground.determination.forces import PARAMETERS, ForceModel
from ground.determination.measurements import Measurements, Offset
from ground.determination.propagation import propagate
from sboc_e2e.icd.errors import UserError

Array = NDArray[np.float64]

_MOST_STEPS: Final = 25  # a budget of iterations; a fit that uses them all is published as not converged
_FAR_STEPS: Final = 3
"""Iterations with weights for an orbit that is far."""
_SETTLED: Final = 0.1
"""Of one sigma: the step that would follow the last iteration."""
_ROUNDING: Final = 1e-3
"""Of the cost: an increase by less is the propagation's own noise."""
_IDLE: Final = 3
"""Steps that do not lower the cost, with ever more damping, after which the best point stands. Chosen, not measured."""
_SURPRISE: Final = 1e-6
"""Probability of the cost of one free orbit below which a manoeuvre is suspected: one of a million right orbits."""
_MOST_REJECTED: Final = 0.2
"""Share of measurements with next to no weight that no sensor's outliers make; then the orbit is wrong. Chosen."""


@dataclass(frozen=True, kw_only=True)
class FitOptions:
    """How a fit treats its data.

    huber_sigma : residuals beyond it count with the weight of their inverse. reject_sigma : beyond it not at all.
    considered : parameters that are not estimated although one sigma of them is known: name and sigma; their doubt enters
    the covariance. prior : sigma of estimated parameters about their start, by name; none of a parameter means no prior.
    """

    huber_sigma: float = 3.0
    reject_sigma: float = 6.0
    considered: tuple[tuple[str, float], ...] = ()
    prior: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True, kw_only=True, eq=False)
class Solution:
    """A fitted orbit at `t0_tai_ns`: state (6,), its covariance with the estimated parameters (6 + k, 6 + k), and how it fits.

    residuals : whitened, (n,) of all measurements in the order given; weights : (n,) in [0, 1]. chi2_nu : of the weighted ones.
    surprise : probability that noise alone makes chi2 so large. manoeuvre : the data do not fit one free orbit: too many were
    rejected, or what is left does not look like their errors. converged : the last step was small.
    """

    t0_tai_ns: int
    state: Array
    forces: ForceModel
    parameters: tuple[str, ...]
    covariance: Array
    residuals: Array
    weights: Array
    chi2_nu: float
    surprise: float
    manoeuvre: bool
    converged: bool
    iterations: int = field(default=0)

    @property
    def rms(self) -> float:
        """Of whitened residuals that count."""
        used = self.weights > 0.0
        return float(np.sqrt(np.mean(self.residuals[used] ** 2))) if used.any() else float("nan")


def fit(
    state: Array,
    t0_tai_ns: int,
    data: Sequence[Measurements],
    forces: ForceModel,
    parameters: tuple[str, ...] = (),
    options: FitOptions | None = None,
) -> Solution:
    """The orbit that fits measurements best, from a start (6,) km, km/s near enough for Gauss-Newton with damping.

    parameters : force parameters to be estimated with the state, at most two of area over mass or five of the empirical ones.
    UserError for names that are unknown and for data that do not determine an orbit.
    """
    options = options or FitOptions()
    considered = tuple(name for name, _ in options.considered)
    for name in (*parameters, *considered):
        if name not in PARAMETERS:
            raise UserError(f'orbit determination: parameter "{name}" is not known; known: {", ".join(PARAMETERS)}')
    if set(parameters) & set(considered):
        raise UserError(f"orbit determination: {', '.join(set(parameters) & set(considered))}: estimated and considered at once")
    epochs = np.concatenate([d.t_tai_ns for d in data]) if data else np.empty(0, dtype=np.int64)
    unknowns = 6 + len(parameters)
    sigma = dict(options.prior)
    start = np.array([forces.value_of(name) for name in parameters])
    weight_of_prior = np.concatenate([np.zeros(6), [1.0 / sigma[n] ** 2 if n in sigma else 0.0 for n in parameters]])

    def linear(x: Array) -> tuple[Array, Array]:
        """Residuals (m,) and partials (m, unknowns + considered) at a state and parameters."""
        model = forces.with_values(parameters, x[6:])
        arc = propagate(x[:6], t0_tai_ns, epochs, model, parameters=(*parameters, *considered), partials=True)
        residuals, partials, at = [], [], 0
        for kind in data:
            n = len(kind.t_tai_ns)
            value, slope = kind.residuals(arc.states[at : at + n])
            slope = slope @ arc.partials[at : at + n]
            if isinstance(kind, Offset):
                value, slope = kind.eliminated(value, slope)
            residuals.append(value.reshape(-1))
            partials.append(slope.reshape(-1, arc.partials.shape[2]))
            at += n
        return np.concatenate(residuals), np.vstack(partials)

    x = np.concatenate([np.asarray(state, dtype=float), start])
    best = _Point(np.inf, x, np.empty(0), np.empty((0, 0)), np.empty(0))
    if len(epochs) == 0:
        raise UserError("orbit determination: no measurements")
    damping, converged, steps, idle = 0.0, False, 0, 0
    for steps in range(1, _MOST_STEPS + 1):
        try:
            value, slope = linear(x)
            weights, cost = _weights(value, options, near=steps > _FAR_STEPS)
            cost += float(weight_of_prior[6:] @ (x[6:] - start) ** 2)
        except UserError:
            if not np.isfinite(best.cost):
                raise
            cost = np.inf
        if cost > best.cost * (1.0 + _ROUNDING) and steps != _FAR_STEPS + 1:
            damping = max(10.0 * damping, 1e-3)
            if damping > 1e8:
                break
            x = best.x + _step(best, weight_of_prior, start, damping, unknowns)
            continue
        # the cost falls no further than the propagation's own noise: as good as settled
        idle = idle + 1 if abs(cost - best.cost) <= _ROUNDING * cost and steps > _FAR_STEPS + 1 else 0
        best = _Point(cost, x, value, slope, weights)
        damping *= 0.1
        if idle == _IDLE:
            converged = True
            break
        if steps > _FAR_STEPS + 1:
            sigma_of = np.sqrt(np.diag(_inverse(_normal(best, weight_of_prior, unknowns))))
            if np.abs(_step(best, weight_of_prior, start, 0.0, unknowns) / sigma_of).max() < _SETTLED:
                converged = True
                break
        x = x + _step(best, weight_of_prior, start, damping, unknowns)
    value, slope, weights = best.value, best.slope, best.weights
    covariance = _inverse(_normal(best, weight_of_prior, unknowns))
    if considered:
        doubt = np.diag([s**2 for _, s in options.considered])
        gain = covariance @ (slope[:, :unknowns] * weights[:, None]).T @ slope[:, unknowns:]
        covariance = covariance + gain @ doubt @ gain.T
    used = weights > 0.0
    nu = max(int(used.sum()) - unknowns, 1)
    total = float((np.minimum(np.abs(value[used]), options.huber_sigma) ** 2).sum())
    surprise = float(chi2.sf(total, nu))
    return Solution(
        t0_tai_ns=t0_tai_ns,
        state=best.x[:6],
        forces=forces.with_values(parameters, best.x[6:]),
        parameters=parameters,
        covariance=covariance,
        residuals=value,
        weights=weights,
        chi2_nu=total / nu,
        surprise=surprise,
        manoeuvre=bool(surprise < _SURPRISE or (~used).mean() > _MOST_REJECTED),
        converged=converged,
        iterations=steps,
    )


@dataclass(frozen=True)
class _Point:
    """Cost, unknowns, residuals, partials and weights of an iteration."""

    cost: float
    x: Array
    value: Array
    slope: Array
    weights: Array


def _weights(value: Array, options: FitOptions, *, near: bool) -> tuple[Array, float]:
    """Weights (m,) of whitened residuals by Huber's rule with a limit, and the cost that they belong to.

    near : False while the orbit is far: then only the scale of the residuals is known, not which of them are wrong.
    """
    away = np.abs(value)
    size = 1.0 if near else max(float(np.median(away)) / 0.6745, 1.0)
    bend = options.huber_sigma * size
    limit = options.reject_sigma if near else np.inf
    weights = np.where(away > limit, 0.0, np.minimum(1.0, bend / np.maximum(away, 1e-300)))
    capped = np.minimum(away, limit)
    cost = np.where(capped > bend, 2.0 * bend * capped - bend**2, capped**2)
    return np.asarray(weights), float(cost.sum())


def _normal(point: _Point, prior: Array, unknowns: int) -> Array:
    slope = point.slope[:, :unknowns]
    return np.asarray((slope * point.weights[:, None]).T @ slope + np.diag(prior))


def _step(point: _Point, prior: Array, start: Array, damping: float, unknowns: int) -> Array:
    """The damped step (unknowns,)."""
    normal = _normal(point, prior, unknowns)
    slope = point.slope[:, :unknowns]
    right = -(slope * point.weights[:, None]).T @ point.value
    right[6:] -= prior[6:] * (point.x[6:] - start)
    diagonal = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    scaled = normal / np.outer(diagonal, diagonal) + damping * np.eye(unknowns)
    step, *_ = np.linalg.lstsq(scaled, right / diagonal, rcond=1e-14)
    return np.asarray(step / diagonal)


def _inverse(normal: Array) -> Array:
    """Covariance of a normal matrix. UserError where the data leave a direction free."""
    diagonal = np.sqrt(np.diag(normal))
    if not (diagonal > 0.0).all():
        raise UserError("orbit determination: the measurements do not determine the orbit")
    scaled = normal / np.outer(diagonal, diagonal)
    value, axes = np.linalg.eigh(scaled)
    if value[0] < 1e-15 * value[-1]:
        raise UserError("orbit determination: the measurements do not determine the orbit")
    return np.asarray((axes / value) @ axes.T / np.outer(diagonal, diagonal))
