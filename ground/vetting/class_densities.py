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
        "recurring": 0.9, "structure": 0.002,
    },
    "spike": {
        "real": 0.005, "noise": 0.005, "particle": 0.002, "hit_group": 0.002, "hot_line": 0.05, "star_chain": 0.2,
        "recurring": 0.5, "structure": 0.005,
    },
}  # fmt: skip
"""Shares of flags that depend on other frames and stars, which single simulated detections do not have: stated, not measured."""

RECURRING: Final = "recurring"
"""Class of artefacts that stay on their pixels or their star and have any shape: spikes, ghosts, glow. Stated, not simulated."""

STRUCTURE: Final = "structure"
"""Class of faint broad lines of sky and flat: shadows of dust, wings of stars in a row, slopes. See `STRUCTURE_SHARPNESS`."""

STRUCTURE_SHARPNESS: Final = tuple((0.25, mean, 0.2) for mean in (0.7, 1.0, 1.3, 1.6))
"""Any width from 1.6 to 6 times that of the stars alike (weight, mean and sigma of ln width). Of 409 lines of 25 px and more in
60 raw frames of two telescopes that were no trails and did not run along rows or columns, 336 were more than 1.6 times as wide
as stars, about as many from one ln width to the next up to 5.5 times; the other 73 were as wide as stars or narrower."""
STRUCTURE_SNR: Final = (5.0, 50.0)
"""Any S/N in between alike (in its logarithm). Of the same 336 lines 272 are. Brighter ones are judged by sides and look-alikes
and by their evenness, and this class does not compete for them."""
STRUCTURE_LENGTH_PX: Final = (25.0, 400.0)
"""Any length in between alike (in its logarithm): 325 of the 336."""
ELSEWHERE: Final = 1e-5
"""Share of the density in each bin beyond: next to nothing, so that this class is silent there."""


def _flat_between(borders: tuple[float, ...], low: float, high: float) -> NDArray[np.float64]:
    """Histogram (len(borders) + 1,) of a logarithm that is uniform from ln low to ln high, `ELSEWHERE` in the bins beyond."""
    edges = np.clip((-math.inf, *borders, math.inf), math.log(low), math.log(high))
    share = np.maximum(np.diff(edges) / math.log(high / low), ELSEWHERE)
    return np.asarray(share / share.sum(), dtype=np.float64)


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
    structure = {"ln_snr": STRUCTURE_SNR, "ln_length": STRUCTURE_LENGTH_PX}
    table[STRUCTURE] = ClassDensity(
        sharpness=STRUCTURE_SHARPNESS,
        histograms=flat | {feature: _flat_between(BINS[feature], *limits) for feature, limits in structure.items()},
        shares={"aligned": 0.1, "failed": 0.1},
    )
    return table
