"""Make ground/vetting/class_densities.json from simulated detections: ``python -m tests.benchmarks.derive_class_densities``.

Classes and their simulation: tests/streaks/impostors.py. Sharpness: two Gaussians per class, the fits' own errors taken out
(extreme deconvolution in one dimension, Bovy, Hogg & Roweis 2011, eq. 15-17). Other features: histograms with half a count
added to each bin, and a little of a flat density for what the simulation does not know.
"""

import json
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ground.streaks import TrailedPsfFitter
from ground.vetting import LikelihoodVetter
from ground.vetting.class_densities import BINS, FLAG_SHARES, REAL, class_densities, log_odds_calibration
from ground.vetting.features import Features, features_of
from tests.streaks.impostors import CLASSES, draw
from tests.streaks.trail_rendering import PSF_SIGMA_PX

SEED = 20
CASES = 2000
UNKNOWN = 0.02
TABLE = Path(__file__).resolve().parents[2] / "ground" / "vetting" / "class_densities.json"


def sample(name: str, n: int, seed: int) -> list[Features]:
    """Features of n fitted detections of one class."""
    rng = np.random.default_rng([seed, list(CLASSES).index(name)])
    fitter = TrailedPsfFitter()
    shots = (draw(name, rng) for _ in range(n))
    return [features_of(fitter.fit(shot.pixels, shot.detection), PSF_SIGMA_PX) for shot in shots]


def deconvolved(values: NDArray[np.float64], errors: NDArray[np.float64]) -> list[list[float]]:
    """Two Gaussians (weight, mean, sigma) whose convolution with each value's error explains the values."""
    low, high = np.quantile(values, (0.25, 0.75))
    weight, mean, variance = np.array([0.7, 0.3]), np.array([low, high]), np.full(2, max(np.var(values), 1e-3))
    for _ in range(300):
        total = variance + errors[:, None] ** 2
        density = weight / np.sqrt(total) * np.exp(-0.5 * (values[:, None] - mean) ** 2 / total)
        share = density / np.maximum(density.sum(axis=1, keepdims=True), 1e-300)
        shrunk = mean + variance / total * (values[:, None] - mean)
        left = variance - variance**2 / total
        count = np.maximum(share.sum(axis=0), 1e-9)
        weight = count / count.sum()
        mean = (share * shrunk).sum(axis=0) / count
        variance = np.maximum((share * ((shrunk - mean) ** 2 + left)).sum(axis=0) / count, 0.02**2)
    sigma = np.sqrt(variance)
    return [[round(float(x), 4) for x in component] for component in zip(weight, mean, sigma, strict=True)]


def entry(features: list[Features]) -> dict[str, object]:
    """Table entry of one class; a share of UNKNOWN is spread over all bins, for what the simulation does not know."""
    known = [f for f in features if math.isfinite(f.sharpness)]
    histograms = {}
    for name, borders in BINS.items():
        values = np.array([getattr(f, name) for f in features])
        bins = np.searchsorted(borders, values[np.isfinite(values)], side="right")
        counts = np.bincount(bins, minlength=len(borders) + 1) + 0.5
        shares = (1.0 - UNKNOWN) * counts / counts.sum() + UNKNOWN / counts.size
        histograms[name] = [round(float(x), 6) for x in shares]
    return {
        "sharpness": deconvolved(np.array([f.sharpness for f in known]), np.array([f.sharpness_err for f in known])),
        "histograms": histograms,
        "shares": {
            flag: round((sum(getattr(f, flag) for f in features) + 0.5) / (len(features) + 1.0), 6) for flag in FLAG_SHARES
        },
    }


def logistic(log_odds: NDArray[np.float64], real: NDArray[np.bool_]) -> tuple[float, float]:
    """Maximum-likelihood (offset, slope) of P(real) = expit(offset + slope log_odds), by Newton's method (Platt 1999)."""
    design = np.stack([np.ones_like(log_odds), log_odds], axis=1)
    coefficients = np.array([0.0, 1.0])
    for _ in range(50):
        p = 1.0 / (1.0 + np.exp(-design @ coefficients))
        hessian = (design * (p * (1.0 - p))[:, None]).T @ design
        coefficients = coefficients + np.linalg.solve(hessian, design.T @ (real - p))
    return float(coefficients[0]), float(coefficients[1])


def calibration(frames: int) -> dict[str, float]:
    """Correction of the log odds, measured on frames of fresh detections: the features are not quite independent."""
    banks = {name: sample(name, CASES // 2, SEED + 1) for name in CLASSES}
    rng = np.random.default_rng([SEED, 2])
    vetter = LikelihoodVetter()
    rates = {name: rate for name, (rate, _) in vetter.class_rates().items() if name in banks}
    log_odds, real = [], []
    for _ in range(frames):
        names = [name for name, rate in rates.items() for _ in range(rng.poisson(rate))]
        if names:
            drawn = [banks[name][rng.integers(len(banks[name]))] for name in names]
            log_odds.append(vetter.log_odds(drawn))
            real.append(np.array([name == REAL for name in names]))
    offset, slope = logistic(np.concatenate(log_odds), np.concatenate(real))
    return {"offset": round(offset, 4), "slope": round(slope, 4)}


def write(table: dict[str, object]) -> None:
    """The table to its place."""
    TABLE.write_text(json.dumps(table, indent=1) + "\n", encoding="utf-8")
    class_densities.cache_clear()
    log_odds_calibration.cache_clear()


def main() -> None:
    """Simulate, fit, write; then measure the calibration with the table in place."""
    table: dict[str, object] = {
        "provenance": f"tests/benchmarks/derive_class_densities.py, seed {SEED}, {CASES} simulated detections of each class",
        "calibration": {"offset": 0.0, "slope": 1.0},
        "classes": {name: entry(sample(name, CASES, SEED)) for name in CLASSES},
    }
    write(table)
    write(table | {"calibration": calibration(frames=30000)})


if __name__ == "__main__":
    main()
