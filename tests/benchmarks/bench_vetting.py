"""Vetting: is the probability calibrated, how many real streaks are lost, how many false ones pass.

Frames mix simulated detections of all classes (tests/streaks/impostors.py, other seeds than the vetter's table) at the rates
that the vetter expects, and in a particle storm that it does not.
"""

import itertools
import json
import math
import sys
import time
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import beta, chi2

from ground.frame_streaks import LEAST_SNR_ALONE
from ground.streaks import TrailedPsfFitter
from ground.vetting import LikelihoodVetter
from sboc_e2e.icd.products import StreakFit
from tests.benchmarks import rare_impostors
from tests.downlink import frame_of_psf
from tests.streaks.impostors import (
    CHAIN_LENGTHS_PX,
    CLASSES,
    THRESHOLD_SNR,
    chain_of_unlisted,
    chains_per_frame,
    draw,
    noise_of_statistic,
)
from tests.streaks.trail_rendering import PSF_SIGMA_PX

SEED = 77
VETO_BELOW = (0.5, 0.1, 0.02)
"""Probabilities below which a chain may drop a streak."""

QUIET = {"real": 0.5, "noise": 0.1, "particle": 0.1, "hit_group": 0.005, "hot_line": 0.02, "star_chain": 0.05}
STORM = QUIET | {"particle": 20.0, "hit_group": 1.0}
"""Detections per frame; a storm is what the rates' expectation knows nothing of."""

NOISE_SNR = (THRESHOLD_SNR, 12.0)
"""Statistics of noise maxima injected conditionally: at the upper end one frame in 1e12 has one."""

CHAIN_STARS = (2, 3, 4, 5, 6)
"""Stars in a row that are injected; each further one is a tenth as frequent, seven and eight are 1e-3 of what passes."""

CHAIN_SHARES = {3: 8, 4: 16, 5: 4}
"""Attempts for these numbers of stars, over those for the others: few reach the threshold, and those are most of what passes."""

FALSE_PER_FRAME = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)


Noise = tuple[list[StreakFit], NDArray[np.float64]]
"""Fits, and how many of each a frame has."""

Chains = tuple[list[StreakFit], NDArray[np.float64], NDArray[np.int64]]
"""The same, and numbers of stars."""


def bank(n: int) -> dict[str, list[StreakFit]]:
    """Fitted detections: n of each false class, four times as many real ones, of which a hundredth is what matters."""
    fitter = TrailedPsfFitter()
    out = {}
    for k, name in enumerate(CLASSES):
        rng = np.random.default_rng([SEED, k])
        shots = (draw(name, rng) for _ in range(4 * n if name == "real" else n))
        out[name] = [fitter.fit(shot.pixels, shot.detection) for shot in shots]
    return out


class Judged(NamedTuple):
    """Detections of simulated frames: probability, truth, and which detection of the bank each is."""

    probability: NDArray[np.float64]
    real: NDArray[np.bool_]
    identity: NDArray[np.int64]


def judge(fits: dict[str, list[StreakFit]], rates: dict[str, float], frames: int) -> Judged:
    """All detections of simulated frames; a detection of the bank comes again only when all of its class have been seen."""
    rng = np.random.default_rng([SEED, 99])
    vetter, frame = LikelihoodVetter(), frame_of_psf(PSF_SIGMA_PX)
    places = {name: np.concatenate([[0], np.cumsum([len(f) for f in fits.values()])])[k] for k, name in enumerate(fits)}
    decks: dict[str, list[int]] = {name: [] for name in fits}
    judged = []
    for _ in range(frames):
        drawn = []
        for name, rate in rates.items():
            for _ in range(rng.poisson(rate)):
                decks[name] = decks[name] or rng.permutation(len(fits[name])).tolist()
                drawn.append((name, decks[name].pop()))
        if drawn:
            probability = vetter.probability([fits[name][k] for name, k in drawn], frame)
            judged += [(p, name == "real", places[name] + k) for p, (name, k) in zip(probability, drawn, strict=True)]
    return Judged(*(np.array(column) for column in zip(*judged, strict=True)))


def share(k: float, n: int) -> dict[str, Any]:
    """A proportion with its 90 % Clopper-Pearson interval."""
    if n == 0:
        return {"value": None, "n": 0, "low": None, "high": None, "reason": "no case"}
    low = 0.0 if k == 0 else float(beta.ppf(0.05, k, n - k + 1))
    high = 1.0 if k == n else float(beta.ppf(0.95, k + 1, n - k))
    return {"value": k / n, "n": n, "low": low, "high": high}


def share_of(hit: NDArray[np.bool_], identity: NDArray[np.int64]) -> dict[str, Any]:
    """The same for detections of which some came more than once: only as many count as are different."""
    n = len(np.unique(identity))
    return share(float(hit.mean()) * n if n else 0.0, n)


def figures_of(judged: Judged) -> dict[str, Any]:
    """Reliability by decades of the probability and of its complement, Brier score, losses and passes."""
    probability, real, identity = judged
    borders = (0.0, 1e-3, 0.01, 0.1, 0.3, 0.5, 0.7, 0.9, 0.99, 0.999, 1.0 + 1e-9)
    reliability = []
    for low, high in itertools.pairwise(borders):
        chosen = (probability >= low) & (probability < high)
        mean = float(probability[chosen].mean()) if chosen.any() else None
        reliability.append({"from": low, "to": high, "mean_probability": mean, **share_of(real[chosen], identity[chosen])})
    out: dict[str, Any] = {"reliability": reliability, "brier_error": float(np.mean((probability - real) ** 2))}
    for veto in VETO_BELOW:
        out[f"veto_below_{veto:g}"] = {
            "veto_loss": share_of(probability[real] < veto, identity[real]),
            "false_passed": share_of(probability[~real] >= veto, identity[~real]),
        }
    return out


def alone(fits: list[StreakFit]) -> NDArray[np.float64]:
    """Probability of each fit as the only detection of its frame."""
    vetter, frame = LikelihoodVetter(), frame_of_psf(PSF_SIGMA_PX)
    return np.array([vetter.probability([fit], frame)[0] for fit in fits])


def conditional_noise(n: int) -> Noise:
    """Noise maxima of statistics spread evenly over NOISE_SNR, and how many of each a frame has (QUIET's rate of noise).

    p(S) ~ S^3 exp(-S^2 / 2), the expected Euler characteristic, carries the rate to where no simulation of frames gets.
    """
    fitter, rng = TrailedPsfFitter(), np.random.default_rng([SEED, 7])
    snr = NOISE_SNR[0] + (np.arange(n) + 0.5) / n * (NOISE_SNR[1] - NOISE_SNR[0])
    shots = (noise_of_statistic(rng, float(s)) for s in snr)
    fits = [fitter.fit(shot.pixels, shot.detection) for shot in shots]
    density = snr**3 * np.exp(-0.5 * (snr**2 - NOISE_SNR[0] ** 2))
    return fits, QUIET["noise"] * density / density.sum()


def conditional_chains(n: int) -> Chains:
    """Rows of unlisted stars that reach the detector's threshold: fits, how many of each a frame has, number of stars.

    n attempts for each number of stars (more by CHAIN_SHARES), lengths spread evenly in their logarithm; the density of faint
    stars carries the rate to where no simulation of frames gets. A detector with a predecessor frame drops nearly all of them,
    because they do not move: these are the rates of single frames.
    """
    fitter, rng = TrailedPsfFitter(), np.random.default_rng([SEED, 8])
    low, high = (math.log(x) for x in CHAIN_LENGTHS_PX)
    fits, weights, counts = [], [], []
    for count in CHAIN_STARS:
        attempts = n * CHAIN_SHARES.get(count, 1)
        for k in range(attempts):
            length = math.exp(low + (k + 0.5) / attempts * (high - low))
            shot = chain_of_unlisted(rng, count, length)
            if shot.snr < THRESHOLD_SNR:
                continue
            fits.append(fitter.fit(shot.pixels, shot.detection))
            weights.append(chains_per_frame(count, length) * length * (high - low) / attempts)
            counts.append(count)
    return fits, np.array(weights), np.array(counts)


def published_alone(real: list[StreakFit], noise: Noise, chains: Chains, rare: dict[str, Any]) -> dict[str, Any]:
    """What is published of single frames at limits of the probability, S/N LEAST_SNR_ALONE or more: real share, false per frame.

    Particle hits and bad lines stand in `rare`; rows of stars are those of a frame without a predecessor.
    """
    snr = [np.array([fit.snr for fit in found]) for found in (real, noise[0], chains[0])]
    odds = [alone(found) for found in (real, noise[0], chains[0])]
    out = {}
    for level in rare_impostors.LEVELS:
        kept, *false = ((p >= level) & (s >= LEAST_SNR_ALONE) for p, s in zip(odds, snr, strict=True))
        out[f"above_{level:g}"] = {
            "real_kept": share(int(kept.sum()), kept.size),
            "noise": false_per_frame(noise[1][false[0]]),
            "rows_of_stars": false_per_frame(chains[1][false[1]]),
            "hot_lines": rare["hot_lines"][f"above_{level:g}"],
            "hits": {name: levels[f"above_{level:g}"] for name, levels in rare["hits"].items()},
        }
    return out


def chain_alarms(levels: list[dict[str, Any]], chains: Chains) -> dict[str, Any]:
    """False alarms of rows of unlisted stars in frames without a predecessor, above the thresholds of `levels`."""
    fits, weights, counts = chains
    probability = alone(fits)
    return {
        "detected_per_frame": false_per_frame(weights),
        "by_stars": {
            f"{count}": {
                "detected_per_frame": float(weights[counts == count].sum()),
                "largest_probability": float(probability[counts == count].max(initial=0.0)),
                "n": int(np.count_nonzero(counts == count)),
            }
            for count in CHAIN_STARS
        },
        "levels": [
            {
                "probability_above": level["probability_above"],
                "measured_per_frame": false_per_frame(weights[probability >= level["probability_above"]]),
                "smallest_weight": float(weights.min()) if weights.size else None,
            }
            for level in levels
        ],
    }


def false_per_frame(weights: NDArray[np.float64]) -> dict[str, Any]:
    """Sum of weighted events with a 90 % interval: Poisson in the number of events of equal weight that are worth as much."""
    if weights.size == 0:
        return {"value": 0.0, "n": 0, "low": 0.0}
    mean = float((weights**2).sum() / weights.sum())
    worth = float(weights.sum()) / mean
    low, high = 0.5 * chi2.ppf(0.05, 2.0 * worth), 0.5 * chi2.ppf(0.95, 2.0 * worth + 2.0)
    return {"value": float(weights.sum()), "n": int(weights.size), "low": float(low * mean), "high": float(high * mean)}


def false_alarms(fits: dict[str, list[StreakFit]], noise_cases: Noise) -> dict[str, Any]:
    """False alarms per frame that the vetter states and that injection measures, above thresholds of the probability.

    Stated: the sum of 1 - P over everything above the threshold, real and false. Noise maxima are injected conditionally;
    of the other classes a share below one in the number injected is not seen: `unseen_high` is their joint 95 % upper limit.
    """
    probability = {name: alone(found) for name, found in fits.items() if name != "noise"}
    weight = {name: np.full(p.size, QUIET[name] / p.size) for name, p in probability.items()}
    noise, weight["noise"] = noise_cases
    probability["noise"] = alone(noise)
    p, w = (np.concatenate([each[name] for name in probability]) for each in (probability, weight))
    order = np.argsort(-p)
    stated = np.cumsum(w[order] * (1.0 - p[order]))
    rows = []
    for level in FALSE_PER_FRAME:
        above = order[: int(np.searchsorted(stated, level))]
        least = float(p[above].min()) if above.size else 1.0
        passed = {name: weight[name][q >= least] for name, q in probability.items()}
        false = np.concatenate([passed[name] for name in passed if name != "real"])
        unseen = sum(
            3.0 * QUIET[name] / len(fits[name]) for name in passed if name not in ("real", "noise") and not passed[name].size
        )
        rows.append(
            {
                "stated_per_frame": float((w[above] * (1.0 - p[above])).sum()),
                "probability_above": least,
                "measured_per_frame": false_per_frame(false),
                "noise_per_frame": float(passed["noise"].sum()),
                "unseen_high": unseen,
                "real_kept": share(passed["real"].size, probability["real"].size),
            }
        )
    return {
        "levels": rows,
        "passed_at_0.1": {n: share(int((q >= 0.1).sum()), q.size) for n, q in probability.items() if n != "noise"},
    }


def main(quick: bool = False) -> dict[str, Any]:
    """Figures in quiet frames and in a storm."""
    fits = bank(150 if quick else 1000)
    noise, chains = conditional_noise(400 if quick else 4000), conditional_chains(60 if quick else 800)
    injected = false_alarms(fits, noise)
    injected["unlisted_chains"] = chain_alarms(injected["levels"], chains)
    rare = rare_impostors.main(quick)
    frames = 1200 if quick else 8000
    start = time.process_time()
    quiet = figures_of(judge(fits, QUIET, frames))
    cost_ms = 1e3 * (time.process_time() - start) / frames
    return {
        "quiet": quiet,
        "storm": figures_of(judge(fits, STORM, frames // 20)),
        "false_alarms": injected,
        "published_alone": published_alone(fits["real"], noise, chains, rare),
        "more_hits": {name: figures for name, figures in rare.items() if name.startswith("hits_")},
        "cost_ms_per_frame": cost_ms,
    }


if __name__ == "__main__":
    print(json.dumps(main(quick="--quick" in sys.argv), indent=1))  # noqa: T201  a script's output
