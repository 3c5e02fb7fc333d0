"""Counts of detections into the number of objects by size: response measured on injected objects, Bayesian unfolding."""

from ground.population.exposure import Exposure, cone_cross_section_km2
from ground.population.recover import Recovered, recover, slopes
from ground.population.response import NOT_DETECTED, Response, categories, n_categories, observed_counts, response_of

__all__ = [
    "NOT_DETECTED",
    "Exposure",
    "Recovered",
    "Response",
    "categories",
    "cone_cross_section_km2",
    "n_categories",
    "observed_counts",
    "recover",
    "response_of",
    "slopes",
]
