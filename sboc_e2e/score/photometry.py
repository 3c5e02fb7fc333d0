"""Magnitudes against the truth and against the flux bound; zero points."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from astropy.table import Table

from sboc_e2e.score.bounds import TrailBounds
from sboc_e2e.score.figures import bootstrap, pull_width, rms
from sboc_e2e.score.matching import TruthStreak


def mean_magnitudes(streaks: Table, truth: Sequence[TruthStreak]) -> dict[int, float]:
    """V of the mean light of each trail, by truth index: the table's is that of mid-trail, where a tumbling object may flash.

    streaks : truth table of trails.
    """
    out = {}
    for t in truth:
        light = t.path.flux_e_s
        mean = float(np.trapezoid(light)) / (len(light) - 1)
        middle = float(light[len(light) // 2])
        out[t.index] = float(streaks["mag"][t.index]) - 2.5 * math.log10(max(mean, 1e-300) / max(middle, 1e-300))
    return out


def photometry(
    streaks: Table,
    pairs: Mapping[int, TruthStreak],
    truth_mag: Mapping[int, float],
    bounds: Mapping[int, TrailBounds],
    frames: Table,
    truth_frames: Table,
) -> tuple[dict[str, Any], list[dict[str, float]]]:
    """Magnitude bias, scatter, bound ratio, pulls and the zero point's error; and residual rows for plots."""
    rows: list[dict[str, float]] = []
    for index, truth in pairs.items():
        s = streaks[index]
        residual = float(s["mag"]) - truth_mag[truth.index]
        if truth.snr < 8.0 or not math.isfinite(residual):
            continue
        bound = bounds.get(truth.index)
        bound_mag = 2.5 / math.log(10) * bound.flux_relative if bound else math.nan
        rows.append(
            {"row": float(index), "snr": truth.snr, "residual_mag": residual, "ratio": residual / bound_mag,
             "pull": residual / float(s["mag_err"]) if s["mag_err"] > 0 else math.nan}
        )  # fmt: skip
    residuals = np.array([r["residual_mag"] for r in rows])
    pulls = np.array([r["pull"] for r in rows if math.isfinite(r["pull"])])
    zero = {int(t["frame"]): float(t["zero_point_mag"]) for t in truth_frames if np.isfinite(t["zero_point_mag"])}
    errors = [float(s["zero_point_mag"]) - zero[int(s["frame"])] for s in frames
              if int(s["frame"]) in zero and np.isfinite(s["zero_point_mag"])]  # fmt: skip
    return {
        "bias_mag": bootstrap(residuals, lambda v: float(np.median(v))),
        "rms_mag": bootstrap(residuals, rms),
        "crlb_ratio": bootstrap([r["ratio"] for r in rows if math.isfinite(r["ratio"])], rms),
        "pull_std": bootstrap(pulls, pull_width),
        "zero_point_error_mag": bootstrap(errors, rms, "fewer than three frames with a zero point"),
    }, rows
