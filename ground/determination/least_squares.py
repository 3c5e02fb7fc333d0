"""Robust, damped least squares for any model that gives whitened residuals and their partial derivatives."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd.errors import UserError

Array = NDArray[np.float64]

_MOST_STEPS: Final = 25  # a budget of iterations; a fit that uses them all is published as not converged
_FAR_STEPS: Final = 3
"""Iterations with weights for a start that is far."""
_SETTLED: Final = 0.1
"""Of one sigma: the step that would follow the last iteration."""
_ROUNDING: Final = 1e-3
"""Of the cost: an increase by less is the propagation's own noise."""
_NO_STEP: Final = 1e3
"""Damping from which a step is under a thousandth of the undamped one: what the cost still changes by is noise."""
_IDLE: Final = 3
"""Steps that do not lower the cost, with ever more damping, after which the best point stands. Chosen, not measured."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Adjustment:
    """Unknowns (k,) that fit best, with covariance (k, k).

    residuals (m,), partials (m, k + c) : there, whitened, observed minus computed; columns beyond the unknowns are of numbers
    that were not estimated. weights : (m,) in [0, 1]. converged : the last step was small.
    """

    unknowns: Array
    covariance: Array
    residuals: Array
    partials: Array
    weights: Array
    converged: bool
    iterations: int


def adjusted(
    linear: Callable[[Array], tuple[Array, Array]], start: Array, prior_sigma: Array, *, huber_sigma: float, reject_sigma: float
) -> Adjustment:
    """The unknowns that fit best, from a start (k,) near enough for Gauss-Newton with damping.

    linear : from unknowns (k,) to whitened residuals (m,) and their partials (m, k or more); it may raise UserError where there
    is no model. prior_sigma : (k,) of each unknown about its start, infinite without one. huber_sigma : residuals beyond it count
    with the weight of their inverse; beyond reject_sigma they do not count. UserError for data that leave an unknown free.
    """
    prior = np.asarray(prior_sigma, dtype=float) ** -2
    x = np.asarray(start, dtype=float)
    fixed = x.copy()
    best = _Point(np.inf, x, np.empty(0), np.empty((0, 0)), np.empty(0))
    damping, converged, steps, idle = 0.0, False, 0, 0
    for steps in range(1, _MOST_STEPS + 1):
        if steps == _FAR_STEPS + 1:
            # costs before and after are of different weights
            best = _near(best, prior, fixed, huber_sigma, reject_sigma)
        try:
            value, slope = linear(x)
            weights, cost = _weights(value, huber_sigma, reject_sigma, near=steps > _FAR_STEPS)
            cost += float(prior @ (x - fixed) ** 2)
        except UserError:
            if not np.isfinite(best.cost):
                raise
            cost = np.inf
        if cost > best.cost * (1.0 + _ROUNDING):
            if damping >= _NO_STEP and _promise(best, prior, fixed) < cost - best.cost < np.inf:
                # no step lowers the cost by as much as the model's own noise moves it
                converged = True
                break
            damping = max(10.0 * damping, 1e-3)
            if damping > 1e8:
                break
            x = best.x + _step(best, prior, fixed, damping)
            continue
        # the cost falls no further than the propagation's own noise: as good as settled
        idle = idle + 1 if abs(cost - best.cost) <= _ROUNDING * cost and steps > _FAR_STEPS + 1 else 0
        best = _Point(cost, x, value, slope, weights)
        damping *= 0.1
        if idle == _IDLE:
            converged = True
            break
        if steps > _FAR_STEPS + 1:
            sigma_of = np.sqrt(np.diag(_inverse(_normal(best, prior))))
            if np.abs(_step(best, prior, fixed, 0.0) / sigma_of).max() < _SETTLED:
                converged = True
                break
        x = x + _step(best, prior, fixed, damping)
    return Adjustment(
        unknowns=best.x,
        covariance=_inverse(_normal(best, prior)),
        residuals=best.value,
        partials=best.slope,
        weights=best.weights,
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


def _near(point: _Point, prior: Array, fixed: Array, huber_sigma: float, reject_sigma: float) -> _Point:
    """A point with the weights of a start that is near."""
    weights, cost = _weights(point.value, huber_sigma, reject_sigma, near=True)
    return replace(point, weights=weights, cost=cost + float(prior @ (point.x - fixed) ** 2))


def _weights(value: Array, huber_sigma: float, reject_sigma: float, *, near: bool) -> tuple[Array, float]:
    """Weights (m,) of whitened residuals by Huber's rule with a limit, and the cost that they belong to.

    near : False while the start is far: then only the scale of the residuals is known, not which of them are wrong.
    """
    away = np.abs(value)
    size = 1.0 if near else max(float(np.median(away)) / 0.6745, 1.0)
    bend = huber_sigma * size
    limit = reject_sigma if near else np.inf
    weights = np.where(away > limit, 0.0, np.minimum(1.0, bend / np.maximum(away, 1e-300)))
    capped = np.minimum(away, limit)
    cost = np.where(capped > bend, 2.0 * bend * capped - bend**2, capped**2)
    return np.asarray(weights), float(cost.sum())


def _normal(point: _Point, prior: Array) -> Array:
    slope = point.slope[:, : len(prior)]
    return np.asarray((slope * point.weights[:, None]).T @ slope + np.diag(prior))


def _step(point: _Point, prior: Array, fixed: Array, damping: float) -> Array:
    """The damped step (k,)."""
    normal = _normal(point, prior)
    slope = point.slope[:, : len(prior)]
    right = -(slope * point.weights[:, None]).T @ point.value - prior * (point.x - fixed)
    diagonal = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    scaled = normal / np.outer(diagonal, diagonal) + damping * np.eye(len(prior))
    step, *_ = np.linalg.lstsq(scaled, right / diagonal, rcond=1e-14)
    return np.asarray(step / diagonal)


def _promise(point: _Point, prior: Array, fixed: Array) -> float:
    """By how much the undamped step lowers the cost of the linear model."""
    step = _step(point, prior, fixed, 0.0)
    return float(step @ _normal(point, prior) @ step)


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
