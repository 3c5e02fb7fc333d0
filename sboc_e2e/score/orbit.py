"""Coarse orbits against the true ones."""

import json
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from astropy.table import Table

from sboc_e2e.score.figures import absent, bootstrap, proportion

TRIVIAL_RANGE_SHARE: Final = 0.05
"""An interval of ranges wholly below this share of the true one has collapsed onto the observer's own orbit."""


def orbit(orbits: Table, owner: Mapping[int, int], truth_streaks: Table, objects: Table) -> dict[str, Any]:
    """Errors of posterior medians and of the best mode's range (medians of absolute values), coverage, share of trivial roots."""
    by_object = {int(o["object_id"]): o for o in objects}
    streak_object = np.asarray(truth_streaks["object_id"], int)
    streak_time = np.asarray(truth_streaks["path_t_tai_ns"], np.int64)[:, 0] if len(truth_streaks) else np.zeros(0, np.int64)
    relative, best, altitude, inclination, covered, trivial = [], [], [], [], 0, 0
    for o in orbits:
        target = owner.get(int(o["tracklet_id"]), -1)
        if target < 0 or not all(np.isfinite(o[name]) for name in ("range_km", "a_km", "i_deg")):
            continue
        mine = np.flatnonzero(streak_object == target)
        nearest = mine[np.argmin(np.abs(streak_time[mine] - int(o["t_ref_tai_ns"])))]
        true_km = float(truth_streaks["range_km"][nearest])
        truth = by_object[target]
        if not np.isfinite([true_km, float(truth["a_km"]), float(truth["i_deg"])]).all():
            continue
        relative.append(abs(float(o["range_km"]) - true_km) / true_km)
        best.append(abs(float(json.loads(str(o["modes"]))[0][0]) - true_km) / true_km)
        altitude.append(abs(float(o["a_km"]) - float(truth["a_km"])))
        inclination.append(abs(float(o["i_deg"]) - float(truth["i_deg"])))
        covered += bool(o["range_low_km"] <= true_km <= o["range_high_km"])
        trivial += bool(o["range_high_km"] < TRIVIAL_RANGE_SHARE * true_km)
    n = len(relative)
    if n == 0:
        none = absent("no orbit of a true object")
        names = (
            "range_error_median",
            "range_error_median_best_mode",
            "altitude_error_median_km",
            "inclination_error_median_deg",
            "interval_coverage_90",
        )
        return dict.fromkeys((*names, "trivial_root_rate"), none)

    def median(v: Any) -> float:
        return float(np.median(v))

    return {
        "range_error_median": bootstrap(relative, median, "fewer than three orbits"),
        "range_error_median_best_mode": bootstrap(best, median, "fewer than three orbits"),
        "altitude_error_median_km": bootstrap(altitude, median, "fewer than three orbits"),
        "inclination_error_median_deg": bootstrap(inclination, median, "fewer than three orbits"),
        "interval_coverage_90": proportion(covered, n),
        "trivial_root_rate": proportion(trivial, n),
    }
