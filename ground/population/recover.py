"""The number of objects by size from counted detections: Poisson unfolding that includes all uncertainties.

Counts are ``n_c ~ Poisson(sum_i R_ci mu_i + b_c)``: R the response, mu the objects of each true class that crossed the field,
b the false detections. A Gibbs sampler splits each count among its possible causes (multinomial), draws mu (gamma), then how
many were missed (Poisson). With these it draws the efficiency (beta) and the categories of the detected (Dirichlet); both start
from finitely many injected objects. Last it draws b (gamma, from the finite measurement of the false-alarm rate).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ground.population.response import Response
from sboc_e2e.icd import validate
from sboc_e2e.icd.errors import ContractError

_JEFFREYS = 0.5
"""Shape of the gamma prior of a Poisson mean, and of the beta prior of an efficiency: a class without a detection gets an upper
limit of 1.92 (95 %) over efficiency."""
_CATEGORY_PRIOR = 0.02
"""Detected objects that each category is given before counting, so that no mixing is ruled out by few injections."""

_FEWEST = 3.0
"""Objects above an edge below which priors weigh too much for the slope."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Recovered:
    """Posterior of the objects that crossed the field: columns are 5 %, 50 % and 95 %.

    objects : (k, 3) per class. cumulative : (k, 3) larger than each class's lower edge. slope : (3,) b of
    N(> d) ~ d^-b, NaN with fewer than two classes seen. draws : (n, k) of the sampler. lower_edge_m : (k,).
    counts : (k,) medians of N(> d) as numbers of objects, the weights of the slope.
    """

    objects: NDArray[np.float64]
    cumulative: NDArray[np.float64]
    slope: NDArray[np.float64]
    draws: NDArray[np.float64]
    lower_edge_m: NDArray[np.float64]
    counts: NDArray[np.float64]

    def per(self, exposure: NDArray[np.float64]) -> "Recovered":
        """The same per unit of exposure (k,): days, km^2 years. The slope is that of the rates."""
        return _summary(self.draws / exposure, self.lower_edge_m, self.counts)

    def plus(self, other: "Recovered") -> "Recovered":
        """The sum with an independent recovery of the same classes and as many draws."""
        return _summary(self.draws + other.draws, self.lower_edge_m, self.counts + other.counts)


def recover(
    observed: NDArray[np.int64],
    response: Response,
    size_edges_m: NDArray[np.float64],
    rng: np.random.Generator,
    *,
    false_counted: NDArray[np.float64] | None = None,
    false_exposure_ratio: float = 1.0,
    prior: float = _JEFFREYS,
    n_draws: int = 4000,
) -> Recovered:
    """Unfold counts (c,).

    false_counted : (c,) false detections counted in a control sample (empty fields, injected cosmics);
    false_exposure_ratio : length of that sample over that of the run. prior : shape of each class's gamma prior; parts of a
    sample that will be added up share Jeffreys' one half. Errors: a `ContractError` for columns of other lengths.
    """
    n_categories, n_classes = response.detected.shape
    observed = validate.array("population.observed", observed, np.int64, (n_categories,))
    edges = validate.finite_array("population.size_edges_m", size_edges_m, (n_classes + 1,))
    if (np.diff(edges) <= 0.0).any() or (observed < 0).any() or false_exposure_ratio <= 0.0:
        raise ContractError("population: expected rising size edges, counts >= 0 and a positive exposure ratio")
    control = np.zeros(n_categories) if false_counted is None else np.asarray(false_counted, dtype=np.float64)
    known_false = false_counted is not None

    kinds = response.detected + _CATEGORY_PRIOR
    hits, misses = response.detected.sum(axis=0) + _JEFFREYS, response.missed + _JEFFREYS
    mu = np.full(n_classes, max(float(observed.sum()), 1.0) / n_classes)
    # shared by the categories: a whole one in each would be taken from the objects
    false_prior = _JEFFREYS / n_categories
    background = (control + false_prior) / false_exposure_ratio if known_false else np.zeros(n_categories)
    burn_in = n_draws // 4
    draws = np.empty((n_draws, n_classes))
    split = np.zeros((n_categories, n_classes + 1))
    efficiency = hits / (hits + misses)
    for step in range(-burn_in, n_draws):
        share = rng.gamma(kinds + split[:, :-1])
        missed = rng.poisson(np.minimum(mu * (1.0 - efficiency), 1e9))
        efficiency = rng.beta(hits + split[:, :-1].sum(axis=0), misses + missed)
        matrix = share / share.sum(axis=0) * efficiency
        cause = np.column_stack([matrix * mu, background])
        cause /= np.maximum(cause.sum(axis=1, keepdims=True), 1e-300)
        split = rng.multinomial(observed, cause)
        mu = rng.gamma(prior + split[:, :-1].sum(axis=0)) / np.maximum(matrix.sum(axis=0), 1e-12)
        if known_false:
            background = rng.gamma(false_prior + control + split[:, -1]) / (1.0 + false_exposure_ratio)
        if step >= 0:
            draws[step] = mu
    return _summary(draws, edges[:-1], np.median(np.cumsum(draws[:, ::-1], axis=1)[:, ::-1], axis=0))


def _summary(draws: NDArray[np.float64], lower_edge_m: NDArray[np.float64], counts: NDArray[np.float64]) -> Recovered:
    """Quantiles of classes, of sums over larger classes, and of the slope of the latter."""
    cumulative = np.cumsum(draws[:, ::-1], axis=1)[:, ::-1]
    points = [5.0, 50.0, 95.0]
    return Recovered(
        objects=np.percentile(draws, points, axis=0).T,
        cumulative=np.percentile(cumulative, points, axis=0).T,
        slope=np.percentile(slopes(cumulative, lower_edge_m, counts), points),
        draws=draws,
        lower_edge_m=lower_edge_m,
        counts=counts,
    )


def slopes(
    cumulative: NDArray[np.float64], lower_edge_m: NDArray[np.float64], counts: NDArray[np.float64]
) -> NDArray[np.float64]:
    """b (n,) of N(> d) ~ d^-b for rows of N (n, k): a straight line through ln N at the lower edges (k,), weighted by `counts`.

    Edges above which three objects or fewer were counted have no weight; NaN with fewer than two others.
    """
    weight = np.where(counts > _FEWEST, counts, 0.0)
    if (weight > 0.0).sum() < 2:
        return np.full(len(cumulative), np.nan)
    log_size = np.log(lower_edge_m)
    x = weight * (log_size - float(weight @ log_size) / weight.sum())
    return np.asarray(-(np.log(np.maximum(cumulative, 1e-12)) @ x) / float(x @ log_size))
