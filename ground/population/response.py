"""Response to objects of a size class: efficiency and mixing of classes, counted on injected objects.

A detection falls into one of the observed categories: tracklets by estimated size, and single-frame detections, whose size is
unknown, by magnitude if they have one. Injected objects without any detection lower the efficiency.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd import validate
from sboc_e2e.icd.errors import ContractError

NOT_DETECTED = -1
"""No category: categories count from 0."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Response:
    """Injected objects counted: detected (c, k) by observed category and true class, missed (k,) without any detection."""

    detected: NDArray[np.float64]
    missed: NDArray[np.float64]

    def __post_init__(self) -> None:
        object.__setattr__(self, "detected", validate.finite_array("response.detected", self.detected, (None, None)))
        shape = (self.detected.shape[1],)
        object.__setattr__(self, "missed", validate.finite_array("response.missed", self.missed, shape))
        if (self.detected < 0.0).any() or (self.missed < 0.0).any():
            raise ContractError("response: expected counts of injected objects, got negative ones")

    @property
    def efficiency(self) -> NDArray[np.float64]:
        """Detected share (k,) of each true class, NaN where nothing was injected."""
        injected = self.detected.sum(axis=0) + self.missed
        return np.where(injected > 0.0, self.detected.sum(axis=0) / np.where(injected > 0.0, injected, 1.0), np.nan)


def n_categories(size_edges_m: NDArray[np.float64], mag_edges: NDArray[np.float64]) -> int:
    """How many observed categories there are: classes of size, of magnitude, and the one of detections that have neither."""
    return len(size_edges_m) + len(mag_edges) - 1


def categories(
    size_m: NDArray[np.float64], mag: NDArray[np.float64], size_edges_m: NDArray[np.float64], mag_edges: NDArray[np.float64]
) -> NDArray[np.int64]:
    """Observed category (n,) of detections: class of size where it is known, else (single frame) class of magnitude after those.

    size_m : (n,) estimated diameter, NaN without one. mag : (n,), NaN without one. Values beyond the edges fall into the
    outermost classes. The last category holds detections with neither, most of them trails from edge to edge of one frame.
    """
    n_size, n_mag = len(size_edges_m) - 1, len(mag_edges) - 1
    by_size = np.clip(np.searchsorted(size_edges_m, size_m, side="right") - 1, 0, n_size - 1)
    by_mag = n_size + np.clip(np.searchsorted(mag_edges, mag, side="right") - 1, 0, n_mag - 1)
    return np.where(np.isfinite(size_m), by_size, np.where(np.isfinite(mag), by_mag, n_size + n_mag)).astype(np.int64)


def observed_counts(category: NDArray[np.int64], n_observed: int) -> NDArray[np.int64]:
    """Detections (c,) per category."""
    return np.bincount(category[category >= 0], minlength=n_observed).astype(np.int64)


def response_of(
    true_size_m: NDArray[np.float64],
    category: NDArray[np.int64],
    size_edges_m: NDArray[np.float64],
    n_observed: int,
) -> Response:
    """Count injected objects; category : (n,) of the detection of each one, NOT_DETECTED if there was none."""
    k = len(size_edges_m) - 1
    true_class = np.searchsorted(size_edges_m, true_size_m, side="right") - 1
    inside = (true_class >= 0) & (true_class < k)
    true_class, category = true_class[inside], category[inside]
    seen = category >= 0
    detected = np.zeros((n_observed, k))
    np.add.at(detected, (category[seen], true_class[seen]), 1.0)
    return Response(detected=detected, missed=np.bincount(true_class[~seen], minlength=k).astype(np.float64))
