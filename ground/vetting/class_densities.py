"""Densities of the features in each class of detections, as a table with its provenance (`class_densities.json`).

The table is made by ``python -m tests.benchmarks.derive_class_densities`` from simulated detections.
"""

import json
import math
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ground.vetting.features import Features

REAL: Final = "real"

BINS: Final[dict[str, tuple[float, ...]]] = {
    "ln_snr": tuple(math.log(s) for s in (5.0, 7.0, 7.5, 8.0, 9.0, 11.0, 15.0, 25.0, 50.0, 100.0, 200.0, 400.0, 800.0)),
    "ln_length": tuple(math.log(s) for s in (1.7, 3.0, 5.0, 8.0, 14.0, 25.0, 50.0, 100.0, 200.0, 400.0)),
    "chi2_sigmas": (-2.0, -1.0, 0.0, 1.0, 2.0, 3.0, 5.0, 10.0, 30.0, 100.0),
    "lumpiness": (0.02, 0.1, 0.2, 0.35, 0.5, 0.7, 1.0, 1.4),
}
"""Inner borders of the histograms; the outermost bins are open."""

FLAG_SHARES: Final = ("aligned", "failed")
"""Yes/no features whose share in each class the table holds."""

STATED_SHARES: Final[dict[str, dict[str, float]]] = {
    "static": {
        "real": 0.002, "noise": 0.002, "particle": 0.002, "hit_group": 0.002, "hot_line": 0.6, "star_chain": 0.4,
        "recurring": 0.9,
    },
    "spike": {
        "real": 0.005, "noise": 0.005, "particle": 0.002, "hit_group": 0.002, "hot_line": 0.05, "star_chain": 0.2,
        "recurring": 0.5,
    },
}  # fmt: skip
"""Shares of flags that depend on other frames and stars, which single simulated detections do not have: stated, not measured."""

RECURRING: Final = "recurring"
"""Class of artefacts that stay on their pixels or their star and have any shape: spikes, ghosts, glow. Stated, not simulated."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ClassDensity:
    """One class: sharpness as Gaussians (weight, mean, sigma), histograms of `BINS`, shares of `FLAG_SHARES`."""

    sharpness: tuple[tuple[float, float, float], ...]
    histograms: dict[str, NDArray[np.float64]]
    shares: dict[str, float]

    def log_density(self, name: str, features: Features) -> float:
        """ln p(features | class), features taken as independent; unknown features (NaN) are left out."""
        total = 0.0
        if math.isfinite(features.sharpness):
            density = 0.0
            for weight, mean, sigma in self.sharpness:
                spread = math.hypot(sigma, features.sharpness_err)
                density += weight / spread * math.exp(-0.5 * ((features.sharpness - mean) / spread) ** 2)
            total += math.log(density + 1e-9)
        for feature, histogram in self.histograms.items():
            value = getattr(features, feature)
            if math.isfinite(value):
                total += math.log(histogram[int(np.searchsorted(BINS[feature], value, side="right"))])
        shares = self.shares | {flag: classes[name] for flag, classes in STATED_SHARES.items()}
        for flag, share in shares.items():
            total += math.log(share if getattr(features, flag) else 1.0 - share)
        return total


def _document() -> dict[str, Any]:
    """The file's content."""
    text = resources.files("ground.vetting").joinpath("class_densities.json").read_text(encoding="utf-8")
    document: dict[str, Any] = json.loads(text)
    return document


@cache
def log_odds_calibration() -> tuple[float, float]:
    """(offset, slope) that calibrate the log odds of the independent features (Platt 1999)."""
    entry = _document()["calibration"]
    return float(entry["offset"]), float(entry["slope"])


@cache
def class_densities() -> dict[str, ClassDensity]:
    """The table, by class name."""
    table = {
        name: ClassDensity(
            sharpness=tuple((float(w), float(m), float(s)) for w, m, s in entry["sharpness"]),
            histograms={feature: np.asarray(entry["histograms"][feature], dtype=np.float64) for feature in BINS},
            shares={flag: float(entry["shares"][flag]) for flag in FLAG_SHARES},
        )
        for name, entry in _document()["classes"].items()
    }
    flat = {feature: np.full(len(borders) + 1, 1.0 / (len(borders) + 1)) for feature, borders in BINS.items()}
    table[RECURRING] = ClassDensity(sharpness=((1.0, 0.0, 0.7),), histograms=flat, shares={"aligned": 0.1, "failed": 0.1})
    return table
