"""Small debris: injected and detected objects a day by size class.

Each simulated object carries the number of natural objects it stands for in the run's time span (its encounter weight
divided by the scenario's density boost), so that a short run predicts nature's rate.
"""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from math import exp, hypot, log
from typing import Any, Final

import numpy as np
from astropy.table import Table

from sboc_e2e.score.evaluation import Evaluation
from sboc_e2e.score.figures import absent, figure, proportion, rate, scaled
from sboc_e2e.score.recovery import SIZE_EDGES_M

SECONDS_PER_DAY: Final = 86_400.0  # Of a day of 24 h, without leap seconds: rates are scaled by it.

SLOWEST_DEG_S: Final = 0.1
"""Tracklets slower than this are in no flux (definition in products/population.ecsv)."""


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
    false = scaled(rate(n_false, false_frames, false_frames), SECONDS_PER_DAY * frame_rate_hz)
    return {"size_classes": classes, "false_per_day": false}


def with_models(classes: Sequence[Mapping[str, Any]], truth: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Size classes with `models_per_day`: detections a day with the interval that albedo and population models leave as well.

    truth : truth/population.json, whose classes hold the models' factors; logarithms of counting's and models' factors add in
    quadrature.
    """
    simulated = [c for c in truth.get("classes", ()) if "models_low" in c]
    out = []
    for row in classes:
        middle_mm = 1e3 * (row["from_m"] * row["to_m"]) ** 0.5
        of = next((c for c in simulated if c["from_mm"] <= middle_mm < c["to_mm"]), None)
        counted = row["detected_per_day"]
        value = counted["value"]
        if of is None or value is None or value <= 0.0:
            none = absent("no such class in truth/population.json" if value else "no detection of this size", counted["n"])
            out.append({**row, "models_per_day": none})
            continue
        down = hypot(log(max(counted["low"], 1e-9) / value), log(of["models_low"]))
        up = hypot(log(counted["high"] / value), log(of["models_high"]))
        out.append({**row, "models_per_day": figure(value, counted["n"], value * exp(-down), value * exp(up))})
    return out


def not_of_nature(e: Evaluation, owner: Mapping[int, int]) -> list[float]:
    """Estimated sizes (NaN without one) of tracklets that the product counts and whose object the scenario placed.

    A mission has no such objects, so the product cannot leave them out, and nature's flux does not hold them.
    """
    kind = {int(o["object_id"]): str(o["kind"]) for o in e.truth_tables["objects"]}
    size = {int(o["tracklet_id"]): float(o["size_m"]) for o in e.orbits if np.isfinite(o["size_m"])}
    return [
        size.get(int(t["tracklet_id"]), float("nan"))
        for t in e.tracklets
        if kind.get(owner.get(int(t["tracklet_id"]), -1), "population") != "population"
        and not float(t["rate_deg_s"]) < SLOWEST_DEG_S
    ]


def published_flux(product: Table | None, truth: Mapping[str, Any], placed: Sequence[float] = ()) -> dict[str, Any]:
    """Flux larger than each edge of the simulated classes as products/population.ecsv has it, and the true one.

    product : None where a run has no such table. truth : truth/population.json; true: nature's flux x each class's boost of
    density, against a sky that ends nowhere: ground does not know where a simulated one ends. placed : sizes of counted tracklets
    of objects that the scenario placed. `holds_truth` : share of those edges whose 90 % interval, systematic term included, holds
    the true flux; edges with placed objects above them are not judged.
    """
    classes = [c for c in truth.get("classes", ()) if c.get("boost") and "flux_km2_year" in c]
    if product is None or not classes:
        none = absent("no products/population.ecsv" if product is None else "no boosted class in truth/population.json")
        return {"larger_than": [], "holds_truth": none, "lacks": "" if product is None else str(product.meta.get("lacks", ""))}
    boosts = [c.get("boost_at_any_range") or c.get("density_boost") or c["boost"] for c in classes]
    true = np.cumsum([boost * c["flux_km2_year"] for boost, c in zip(boosts[::-1], classes[::-1], strict=True)])[::-1]
    edges, rows = np.asarray(product["from_m"], float), []
    for c, value in zip(classes, true, strict=True):
        at = np.flatnonzero(np.isclose(edges, 1e-3 * c["from_mm"]))
        if not len(at) or not np.isfinite(product["larger"][at[0]]):
            continue
        row = product[int(at[0])]
        n = int(np.sum(np.asarray(product["n_tracklets"])[at[0] :]))
        n_placed = sum(not size < edges[at[0]] for size in placed)
        low, high = float(row["larger_total_low"]), float(row["larger_total_high"])
        rows.append(
            {
                "larger_than_m": 1e-3 * c["from_mm"],
                "true_per_km2_year": float(value),
                "published_per_km2_year": figure(float(row["larger"]), n, low, high),
                "counting_low": float(row["larger_low"]),
                "counting_high": float(row["larger_high"]),
                "n_placed": n_placed,
                "inside": None if n_placed else bool(low <= value <= high),
            }
        )
    judged = [row["inside"] for row in rows if row["inside"] is not None]
    return {
        "larger_than": rows,
        "holds_truth": proportion(sum(judged), len(judged), "no size with an exposure and without placed objects"),
        "lacks": str(product.meta.get("lacks", "")),
    }


def _weighted(weight: Any, span_s: float) -> dict[str, Any]:
    w = np.asarray(weight, float)
    if len(w) == 0 or w.sum() <= 0:
        return absent("no object of this size", len(w))
    effective = w.sum() ** 2 / np.sum(w * w)
    counted = rate(round(effective), 1.0, len(w))
    scale = w.sum() / effective * SECONDS_PER_DAY / span_s
    return figure(w.sum() * SECONDS_PER_DAY / span_s, len(w), counted["low"] * scale, counted["high"] * scale)
