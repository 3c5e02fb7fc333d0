"""How often a particle or a bad line is published on its own: multilevel splitting carries the rates to 1e-6 per frame and below.

Particle tracks by length, groups of hits, and rows of hits (tests/streaks/particle_hits.py), each at its closed-form rate,
through the same fit and vetter. Each is judged as the only detection of its frame, and as if the detector on board sent them
all: a storm around it lowers its odds, and `line_integral` sends one group of hits in a hundred without COSMIC_LIKE.
"""

import itertools
import json
import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ground.frame_streaks import LEAST_SNR_ALONE
from ground.streaks import TrailedPsfFitter
from ground.vetting import LikelihoodVetter
from ground.vetting.features import features_of
from tests.benchmarks.rare_events import Tail, tail_of
from tests.downlink import frame_of_psf
from tests.streaks.impostors import GROUP_PX, THRESHOLD_SNR, hot_line_of
from tests.streaks.particle_hits import NUMBERS, Hits
from tests.streaks.trail_rendering import PSF_SIGMA_PX, Exposure

LEVELS: Final = (0.5, 0.9, 0.99, 0.995, 0.999)
"""Probabilities above which a streak of a single frame may be published."""

FRAME_PX2: Final = 4096.0**2
HITS_PER_FRAME: Final = {"quiet": 3.3, "storm_1000": 1000.0, "storm_5000": 5000.0}
"""Cosmic rays of `sso_antisun` (docs/physics.md); trapped protons of the South Atlantic Anomaly, up to its heart."""

HOT_LINES_PER_FRAME: Final = 0.02
LENGTHS_PX: Final = (0.0, 3.0, 10.0, 30.0, 100.0, math.inf)
ROW_PX: Final = (GROUP_PX, 120.0)
STRIP_PX: Final = 2.0
RAREST_PER_FRAME: Final = 1e-8
NEVER: Final = -1e3
NONE_SEEN: Final = 2.3
"""Expected events of which none is seen once in ten times."""

SEED: Final = 78


@dataclass(frozen=True, kw_only=True)
class Case:
    """A kind of hits, and how many of it a frame has at so many hits."""

    name: str
    hits: Hits
    per_frame: Callable[[float], float]


def groups_per_frame(hits: float, count: int) -> float:
    """Groups of hits in a circle of GROUP_PX about one of them: Poisson, and each group once."""
    mean = hits / FRAME_PX2 * math.pi * GROUP_PX**2
    return hits * mean ** (count - 1) * math.exp(-mean) / math.factorial(count - 1) / count


def rows_per_frame(hits: float, count: int) -> float:
    """Rows of hits: pairs at distances within ROW_PX, and the others in a strip of STRIP_PX between the two."""
    density = hits / FRAME_PX2
    low, high = ROW_PX
    between = (STRIP_PX * density) ** (count - 2) / math.factorial(count - 2)
    return FRAME_PX2 * math.pi * density**2 * between * (high**count - low**count) / count


def cases(spread_px: float, *, trapped: bool, unevenness: float) -> list[Case]:
    """Single tracks by length, groups and rows."""
    kind = Hits(spread_px=spread_px, trapped=trapped, unevenness=unevenness)
    out = []
    for low, high in itertools.pairwise(LENGTHS_PX):
        single = replace(kind, lengths_px=(low, high))
        share = single.shares[1] - single.shares[0]
        out.append(Case(name=f"track_{low:g}_to_{high:g}_px", hits=single, per_frame=lambda n, share=share: n * share))
    for count in (2, 3, 4):
        group = replace(kind, count=count, within_px=GROUP_PX)
        out.append(Case(name=f"group_of_{count}", hits=group, per_frame=lambda n, k=count: groups_per_frame(n, k)))
    for count in (2, 3, 4, 5):
        row = replace(kind, count=count, row_px=ROW_PX)
        out.append(Case(name=f"row_of_{count}", hits=row, per_frame=lambda n, k=count: rows_per_frame(n, k)))
    return out


def log_odds(probability: float) -> float:
    """ln P / (1 - P)."""
    return math.log(max(probability, 1e-300)) - math.log1p(-min(probability, 1.0 - 1e-15))


class Judge:
    """Guide and log odds of an exposure: NEVER where it is not detected or not published at any probability."""

    def __init__(self, exposure: Callable[[NDArray[np.float64]], Exposure]) -> None:
        self.exposure = exposure
        self.fitter, self.vetter, self.frame = TrailedPsfFitter(), LikelihoodVetter(), frame_of_psf(PSF_SIGMA_PX)

    def __call__(self, z: NDArray[np.float64]) -> tuple[float, float]:
        """Of NUMBERS standard normal numbers. The guide tells apart what the vetter's histograms do not."""
        shot = self.exposure(z)
        if shot.snr < THRESHOLD_SNR:
            return NEVER + shot.snr, NEVER
        fit = self.fitter.fit(shot.pixels, shot.detection)
        odds = log_odds(float(self.vetter.probability([fit], self.frame)[0]))
        seen = features_of(fit, PSF_SIGMA_PX)
        ugliness = (math.asinh(max(seen.chi2_sigmas, 0.0)), seen.ln_snr, 2.0 * seen.lumpiness)
        faint = max(LEAST_SNR_ALONE - fit.snr, 0.0)
        return odds - 0.1 * sum(x for x in ugliness if math.isfinite(x)) - 2.0 * faint, NEVER if faint > 0.0 else odds


def above(tails: Sequence[Tail], level: float, rate: float) -> dict[str, Any]:
    """Events per frame at or above a probability: mean of independent tails, 90 % interval of their scatter (bootstrap).

    Where no tail came so far, 2.3 times what one sample of the last level stands for is the upper limit.
    """
    found = np.array([rate * tail.above(log_odds(level)) for tail in tails])
    rng = np.random.default_rng([SEED, 3])
    means = found[rng.integers(0, found.size, (2000, found.size))].mean(axis=1)
    low, high = np.quantile(means, (0.05, 0.95))
    if not found.any():
        high = NONE_SEEN * rate * float(np.mean([tail.weight.min() for tail in tails]))
    return {"value": float(found.mean()), "n": sum(tail.n for tail in tails), "low": float(low), "high": float(high)}


def total(parts: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Sum of independent rates, their intervals added in quadrature."""
    value = sum(part["value"] for part in parts)
    below = math.sqrt(sum((part["value"] - part["low"]) ** 2 for part in parts))
    beyond = math.sqrt(sum((part["high"] - part["value"]) ** 2 for part in parts))
    n = sum(part["n"] for part in parts)
    return {"value": value, "n": n, "low": max(value - below, 0.0), "high": value + beyond}


def injected(case: Case, most_hits: float, n: int, repeats: int, seed: int) -> list[Tail]:
    """Independent tails of one case, down to RAREST_PER_FRAME in the worst environment."""
    judge = Judge(case.hits.exposure)
    rarest = min(RAREST_PER_FRAME / case.per_frame(most_hits), 0.1)
    last = log_odds(LEVELS[-1])
    rngs = [np.random.default_rng([SEED, seed, k]) for k in range(repeats)]
    return [tail_of(judge, NUMBERS, n, rng, last=last, rarest=rarest) for rng in rngs]


def hits_published(n: int, repeats: int, spread_px: float, *, unevenness: float, environments: Sequence[str]) -> dict[str, Any]:
    """Particle hits published per frame by environment and probability, in all and the largest contributions."""
    out: dict[str, Any] = {}
    for trapped in sorted({name != "quiet" for name in environments}):
        wanted = [name for name in environments if (name != "quiet") == trapped]
        most = max(HITS_PER_FRAME[name] for name in wanted)
        listed = cases(spread_px, trapped=trapped, unevenness=unevenness)
        tails = {case.name: injected(case, most, n, repeats, k) for k, case in enumerate(listed)}
        for name in wanted:
            out[name] = {}
            for level in LEVELS:
                parts = {case.name: above(tails[case.name], level, case.per_frame(HITS_PER_FRAME[name])) for case in listed}
                largest = max(parts, key=lambda part: parts[part]["value"])
                out[name][f"above_{level:g}"] = total(list(parts.values())) | {"largest": largest}
    return out


def hot_lines_published(n: int, repeats: int) -> dict[str, Any]:
    """Bad rows and columns published per frame without a defect map or a second frame that names them, by probability."""
    judge = Judge(hot_line_of)
    last = log_odds(LEVELS[-1])
    tails = [tail_of(judge, NUMBERS, n, np.random.default_rng([SEED, 50, k]), last=last, rarest=1e-7) for k in range(repeats)]
    rate = HOT_LINES_PER_FRAME / float(np.mean([tail.above(0.5 * NEVER) for tail in tails]))
    return {f"above_{level:g}": above(tails, level, rate) for level in LEVELS}


def main(quick: bool = False) -> dict[str, Any]:
    """The default silicon at all environments; tracks as even as trails, and silicon whose charge spreads as far as light."""
    n, repeats = (60, 1) if quick else (200, 3)
    everywhere, heart = list(HITS_PER_FRAME), ["storm_5000"]
    uneven = Hits().unevenness
    out = {
        "hits": hits_published(n, repeats, Hits().spread_px, unevenness=uneven, environments=heart if quick else everywhere),
        "hot_lines": hot_lines_published(n, repeats),
    }
    if not quick:
        out["hits_even_tracks"] = hits_published(n, 1, Hits().spread_px, unevenness=0.0, environments=heart)
        out["hits_spread_5_um"] = hits_published(n, 1, 5.0 / 9.0, unevenness=uneven, environments=heart)
    return out


if __name__ == "__main__":
    sys.stdout.write(json.dumps(main(quick="--quick" in sys.argv), indent=1) + "\n")
