"""Small debris: what was injected, what was recovered, and detections a day by size class.

Each simulated object carries the number of natural objects it stands for in the run's time span (its encounter weight
divided by the scenario's density boost), so that a short run predicts nature's rate.
"""

from collections.abc import Mapping
from itertools import pairwise
from typing import Any, Final

import numpy as np
from astropy.table import Table

from sboc_e2e.score.figures import absent, figure, rate

SIZE_EDGES_M: Final = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
SECONDS_PER_DAY: Final = 86_400.0


def detections_per_day(
    objects: Table, found: Mapping[int, int], span_s: float, n_false: int, false_frames: int, frame_rate_hz: float
) -> dict[str, Any]:
    """Real detections a day by size class from encounter weights, and false ones at the scenario's frame rate.

    found : object_id -> frames in which it was measured. Intervals hold the sampling noise of weighted counts
    (effective number (sum w)^2 / sum w^2, Poisson).
    """
    size = np.asarray(objects["size_m"], float)
    weight = np.asarray(objects["weight"], float)
    population = np.asarray([str(kind) == "population" for kind in objects["kind"]], bool)
    seen = np.array([int(o) in found for o in objects["object_id"]], bool)
    classes = []
    for low, high in pairwise(SIZE_EDGES_M):
        inside = population & (size >= low) & (size < high)
        classes.append(
            {
                "from_m": low,
                "to_m": high,
                "injected_per_day": _weighted(weight[inside], span_s),
                "detected_per_day": _weighted(weight[inside & seen], span_s),
            }
        )
    return {
        "size_classes": classes,
        "injected_slope": _slope(size[population], weight[population], span_s),
        "recovered_slope": _slope(size[population & seen], weight[population & seen], span_s),
        "false_per_day": _scaled(rate(n_false, false_frames, false_frames), SECONDS_PER_DAY * frame_rate_hz),
    }


def _scaled(f: dict[str, Any], factor: float) -> dict[str, Any]:
    return {k: v * factor if k in ("value", "low", "high") and v is not None else v for k, v in f.items()}


def _weighted(weight: Any, span_s: float) -> dict[str, Any]:
    w = np.asarray(weight, float)
    if len(w) == 0 or w.sum() <= 0:
        return absent("no object of this size", len(w))
    effective = w.sum() ** 2 / np.sum(w * w)
    counted = rate(round(effective), 1.0, len(w))
    scale = w.sum() / effective * SECONDS_PER_DAY / span_s
    return figure(w.sum() * SECONDS_PER_DAY / span_s, len(w), counted["low"] * scale, counted["high"] * scale)


def _slope(size_m: Any, weight: Any, span_s: float) -> dict[str, Any]:
    """Weighted maximum-likelihood slope of a power law N(>d) ~ d^-slope above the smallest size (Hill 1975)."""
    size, w = np.asarray(size_m, float), np.asarray(weight, float)
    if len(size) < 5 or w.sum() <= 0:
        return absent("fewer than five objects", len(size))
    log = np.log(size / size.min())
    slope = w.sum() / np.sum(w * log)
    effective = w.sum() ** 2 / np.sum(w * w)
    error = 1.645 * slope / np.sqrt(effective)
    return figure(slope, len(size), slope - error, slope + error)
