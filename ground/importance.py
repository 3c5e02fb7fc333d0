"""Means and covariances of a distribution known by its density alone: importance sampling that adapts to it.

Draws come from Student's t with heavy tails, about a centre and a covariance that follow those of the weighted draws.
"""

import math
from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

Array = NDArray[np.float64]

SAMPLES: Final = 4096
"""Draws of each round (a Sobol sequence: the same numbers every time)."""
ROUNDS: Final = 5
"""A budget of work: the search stops before it once `EFFECTIVE_SAMPLES` is reached. Chosen, not measured."""
EFFECTIVE_SAMPLES: Final = 400.0
"""The proposal is re-centred until the weights are equivalent to this many independent draws."""
FEW_SAMPLES: Final = 30.0
"""Fewer effective draws understate the spread, so half of the old one is kept. Chosen, not measured."""
WIDENING: Final = 1.5
"""Of the proposal, relative to the covariance of the draws before. Chosen, not measured."""
STUDENT_FREEDOM: Final = 4.0
"""Tails of the proposal: heavier than those of the product of change-point likelihoods."""

Gaussian = tuple[Array, Array]
"""Mean (p,) and covariance (p, p)."""


class Draws(NamedTuple):
    """Points (m, p), their weights (m,) of sum 1, and the mean (p,) and covariance (p, p) of both."""

    points: Array
    weight: Array
    mean: Array
    covariance: Array


class Proposals(NamedTuple):
    """Quasi-random draws of a Student t: a normal (m, p) over the root of a gamma variable (m,) of mean one."""

    normal: Array
    gamma: Array

    @classmethod
    def of(cls, n: int) -> "Proposals":
        """In n dimensions."""
        from scipy.stats import qmc  # takes half a second, which frames without tracklets do not need

        # the first Sobol point is the corner of the cube; half a cell inwards it is a point like the others
        uniform = qmc.Sobol(n + 1, scramble=False).random(SAMPLES) + 0.5 / SAMPLES
        # the gamma variable from its Wilson-Hilferty quantiles
        nu = STUDENT_FREEDOM
        gamma = np.maximum(1.0 - 2.0 / (9.0 * nu) + ndtri(uniform[:, n]) * math.sqrt(2.0 / (9.0 * nu)), 0.05) ** 3
        return cls(ndtri(uniform[:, :n]), gamma)


def adapted(proposals: Proposals, start: Gaussian, log_density: Callable[[Array], Array]) -> Draws:
    """Draws of a distribution, from a proposal that adapts to them.

    log_density : of points (m, p), shape (m,), but for a constant.
    """
    normal, gamma = proposals
    (center, covariance), n = start, normal.shape[1]
    shape = normal / np.sqrt(gamma)[:, None]
    points, weight = np.tile(center, (SAMPLES, 1)), np.full(SAMPLES, 1.0 / SAMPLES)
    for _ in range(ROUNDS):
        factor = np.linalg.cholesky(covariance) * WIDENING
        points = center + shape @ factor.T
        log_weight = 0.5 * np.sum(normal**2, axis=1) - 0.5 * n * np.log(gamma) + log_density(points)
        weight = np.exp(log_weight - log_weight.max())
        weight /= weight.sum()
        center = weight @ points
        scatter = points - center
        estimate = (scatter * weight[:, None]).T @ scatter
        effective = 1.0 / float(np.sum(weight**2))
        keep = 0.5 if effective < FEW_SAMPLES else 0.0
        covariance = np.asarray(
            (1.0 - keep) * estimate + keep * covariance + 1e-12 * np.diag(np.diag(covariance)), dtype=np.float64
        )
        if effective > EFFECTIVE_SAMPLES:
            break
    return Draws(points, weight, center, covariance)
