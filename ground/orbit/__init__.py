"""Tracklets into posteriors of range and orbit; known objects, and the biases of clock and pointing from them."""

from ground.orbit.bias import Bias, estimate_bias
from ground.orbit.catalogue_match import CatalogueMatch, KnownObjects, match_catalogue, read_elements
from ground.orbit.range_scan import RangeScan
from ground.orbit.reference import PreciseOrbit

__all__ = [
    "Bias",
    "CatalogueMatch",
    "KnownObjects",
    "PreciseOrbit",
    "RangeScan",
    "estimate_bias",
    "match_catalogue",
    "read_elements",
]
