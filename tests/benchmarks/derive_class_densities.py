"""Make ground/vetting/class_densities.json from simulated detections: ``python -m tests.benchmarks.derive_class_densities``.

Classes and their simulation: tests/streaks/impostors.py. Sharpness: two Gaussians per class, the fits' own errors taken out
(extreme deconvolution in one dimension, Bovy, Hogg & Roweis 2011, eq. 15-17). Other features: histograms with half a count
added to each bin, and a little of a flat density for what the simulation does not know. The S/N of noise maxima needs no such
allowance: it is Gaussian noise, injected conditionally, and p(S) ~ S^3 exp(-S^2 / 2) carries the rate to where one in 1e15 is.
"""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ground.streaks import TrailedPsfFitter
from ground.vetting import LikelihoodVetter
from ground.vetting.class_densities import BINS, FLAG_SHARES, REAL, class_densities, log_odds_calibration
from ground.vetting.features import Features, features_of
from tests.streaks.impostors import CLASSES, THRESHOLD_SNR, draw, noise_of_statistic
from tests.streaks.trail_rendering import PSF_SIGMA_PX

SEED = 41
"""Not that of the benchmark (77) nor of the tests (31)."""
CASES = 2000
TAIL_CASES = 500
CALIBRATION_CASES = 400
UNKNOWN = 0.02
TAIL_SNR = (THRESHOLD_SNR, 12.0)
RARE_SNR = 9.0
NEVER = 1e-12
"""Share of a bin that no noise maximum of these statistics reaches."""
TABLE = Path(__file__).resolve().parents[2] / "ground" / "vetting" / "class_densities.json"


def sample(name: str, n: int, seed: int) -> list[Features]:
    """Features of n fitted detections of one class."""
    rng = np.random.default_rng([seed, list(CLASSES).index(name)])
    fitter = TrailedPsfFitter()
    shots = (draw(name, rng) for _ in range(n))
    return [features_of(fitter.fit(shot.pixels, shot.detection), PSF_SIGMA_PX) for shot in shots]


def with_rare_noise(histogram: list[float], rare: list[Features], statistic: NDArray[np.float64]) -> list[float]:
    """The histogram of noise maxima's S/N, beyond RARE_SNR from those that were injected with these statistics.

    Their weights are the expected Euler characteristic of the noise. Fits stray by less than 1.1 from the statistic.
    """
    weight = statistic**3 * np.exp(-0.5 * (statistic**2 - TAIL_SNR[0] ** 2))
    bins = np.searchsorted(BINS["ln_snr"], [f.ln_snr for f in rare], side="right")
    seldom = np.bincount(bins, weight / weight.sum(), minlength=len(histogram)) + NEVER
    beyond = np.arange(len(histogram)) > np.searchsorted(BINS["ln_snr"], math.log(RARE_SNR))
    shares = np.where(beyond, seldom, histogram)
    return [float(f"{x:.4g}") for x in shares / shares.sum()]


def noise_tail(n: int, seed: int) -> tuple[list[Features], NDArray[np.float64]]:
    """Features of noise maxima of statistics spread evenly over TAIL_SNR, and the statistics."""
    fitter, rng = TrailedPsfFitter(), np.random.default_rng([seed, 98])
    statistic = TAIL_SNR[0] + (np.arange(n) + 0.5) / n * (TAIL_SNR[1] - TAIL_SNR[0])
    shots = (noise_of_statistic(rng, float(s)) for s in statistic)
    return [features_of(fitter.fit(shot.pixels, shot.detection), PSF_SIGMA_PX) for shot in shots], statistic


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


def entry(features: list[Features]) -> dict[str, Any]:
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


def logistic(design: NDArray[np.float64], real: NDArray[np.bool_], weight: NDArray[np.float64]) -> NDArray[np.float64]:
    """Maximum-likelihood coefficients of P(real) = expit(design @ coefficients), by Newton's method (Platt 1999)."""
    coefficients = np.zeros(design.shape[1])
    for _ in range(50):
        p = 1.0 / (1.0 + np.exp(-design @ coefficients))
        hessian = (design * (weight * p * (1.0 - p))[:, None]).T @ design
        coefficients = coefficients + np.linalg.solve(hessian, design.T @ (weight * (real - p)))
    return coefficients


def calibration(banks: dict[str, list[Features]]) -> dict[str, float]:
    """Correction of the log odds on fresh detections, in proportion to the vetter's rates: features are not quite independent."""
    vetter = LikelihoodVetter()
    rates = {name: rate for name, (rate, _) in vetter.class_rates().items() if name in banks}
    log_odds = np.array([vetter.log_odds([f])[0] for name in rates for f in banks[name]])
    real = np.array([name == REAL for name in rates for _ in banks[name]])
    weight = np.array([rate / len(banks[name]) for name, rate in rates.items() for _ in banks[name]])
    design = np.stack([np.ones_like(log_odds), log_odds], axis=1)
    # millions of frames: the likelihood's maximum does not depend on the sum of the weights
    offset, slope = logistic(design, real, weight / weight.mean())
    return {"offset": round(float(offset), 4), "slope": round(float(slope), 4)}


def write(table: dict[str, object]) -> None:
    """The table to its place."""
    TABLE.write_text(json.dumps(table, indent=1) + "\n", encoding="utf-8")
    class_densities.cache_clear()
    log_odds_calibration.cache_clear()


def tables(
    banks: dict[str, list[Features]], tail: tuple[list[Features], NDArray[np.float64]], fresh: dict[str, list[Features]]
) -> None:
    """Write the table from detections, then measure the calibration on fresh ones with it in place."""
    classes = {name: entry(features) for name, features in banks.items()}
    common = classes["noise"]["histograms"]
    common["ln_snr"] = with_rare_noise(common["ln_snr"], *tail)
    table: dict[str, object] = {
        "provenance": f"tests/benchmarks/derive_class_densities.py, seed {SEED}, {CASES} simulated detections of each class",
        "calibration": {"offset": 0.0, "slope": 1.0},
        "classes": classes,
    }
    write(table)
    write(table | {"calibration": calibration(fresh)})


def main() -> None:
    """Simulate, fit, write."""
    banks = {name: sample(name, CASES, SEED) for name in CLASSES}
    fresh = {name: sample(name, CALIBRATION_CASES, SEED + 1) for name in CLASSES}
    tables(banks, noise_tail(TAIL_CASES, SEED), fresh)


if __name__ == "__main__":
    main()
