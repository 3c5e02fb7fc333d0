"""Flux of small debris from a run's tracklets: exposure, efficiency, unfolding, and systematic errors.

Tracklets are counted by their estimated size. `encounters` gives the contribution of one object in orbit to a run, and
`injection` the probability that its streaks are found. The counts are unfolded into crossings by true size (`recover`) and
divided by the exposure. Detections in a single frame are listed, not counted, because false ones cannot be recognised without a
second frame.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr

from ground.population.encounters import SLOWEST_DEG_S, Crossings, Watch, crossings, effective_number
from ground.population.exposure import YEAR_S
from ground.population.injection import Efficiency
from ground.population.recover import recover
from ground.population.response import Response

Array = NDArray[np.float64]

SIZE_EDGES_M: Final = (0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0)
"""Edges of the classes, two to a decade: sizes by light are good to a factor of 1.3, so that classes share few objects."""
ALBEDO: Final = 0.13
"""Median albedo of debris: about the geometric mean of the range that `MEAN_ALBEDO_SIGMA_LN` stands for."""
ALBEDO_SIGMA_LN: Final = 0.5
"""Median and scatter of the albedo, those that sizes of tracklets are made with (`ground.orbit: range_scan`)."""

MEAN_ALBEDO_SIGMA_LN: Final = 0.3
"""How well the median albedo of debris is known: 0.1 to 0.175 in the literature (Mulrooney et al. 2008, AMOS)."""

PHASE_SIGMA_LN: Final = 0.2
"""Light of a Lambert sphere against a mirror-like one of the same albedo at small phase angles: 1.5, taken as two sigma."""

ORBITS_SIGMA_LN: Final = 0.1
"""Error of density and speed along the line of sight by the prior, for pieces too small to be catalogued."""

RESPONSE_SIGMA_LN: Final = 0.05
"""Losses that neither injection nor gaps of tracklets show: regions lost in all frames alike, objects that never made a pair."""

KEPT_PRIOR: Final = (9.5, 0.5)
"""Prior numbers of frames kept and lost: 0.95 of the filter's finds are fitted, accepted and linked."""

KEPT_POWER: Final = 1.5
"""d ln(tracklets) / d ln(share kept): 2 for what crosses in two frames, 0 for what is in many."""

COULD_BE_SEEN_SNR: Final = 5.0
"""Crossings are those that reach this S/N in their best frame and last two frames; exposure and efficiency both refer to them."""

CANDIDATES: Final = 30_000
"""Objects drawn for each class: a budget of work. Chosen, not measured."""
DRAWS: Final = 1500
"""Of the posterior: its 16 and 84 % points are then good to 0.04 sigma."""
LEAST_EFFICIENCY: Final = 1e-3
"""Classes seen in a smaller share of crossings have no flux: the error of the efficiency would be all of it. Chosen."""
FAINTEST_SEEN: Final = 0.05
"""Least measured light over the true one."""

SIZE_LAW_STEEP_BELOW_M: Final = 0.01
"""Where the size law changes its slope from -1.45 to -2.10 (docs/physics.md)."""
RANGE_SIGMA_LN: Final = 0.1
"""Error of ln(range) in sizes if no orbit of the run gives it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Counted:
    """Tracklets of a run but those slower than the limit: size_m (n,) estimates, NaN for none; probability (n,) of being real.

    range_sigma_ln : typical error of ln(range). n_single : accepted detections of one frame, and how many of them are expected to
    be false by their own probabilities. n_vetoed : streaks that were rejected. n_slow : tracklets left out. n_tracked : tracklets
    left out because fewer than two of their frames had the object above the threshold: the efficiency does not describe them.
    frames_seen, frames_expected : between the first and the last member of each tracklet, those with a member, and those in
    which the filter would have found it: their ratio is the share that region, fit, vetting and linking keep of a frame's finds.
    """

    size_m: Array
    probability: Array
    range_sigma_ln: float
    n_single: int
    n_single_false: float
    n_vetoed: int
    n_slow: int
    frames_seen: float = 0.0
    frames_expected: float = 0.0
    n_tracked: int = 0

    @property
    def kept(self) -> tuple[float, float]:
        """Share of a frame's finds that end in a tracklet, and one sigma of its logarithm: beta posterior."""
        kept = KEPT_PRIOR[0] + min(self.frames_seen, self.frames_expected)
        lost = KEPT_PRIOR[1] + max(self.frames_expected - self.frames_seen, 0.0)
        share = kept / (kept + lost)
        return share, math.sqrt(share * (1.0 - share) / (kept + lost + 1.0)) / share


@dataclass(frozen=True, kw_only=True, eq=False)
class Flux:
    """Per class (k,) and larger than each lower edge; (k, 3) are 5 %, 50 % and 95 %; NaN where there is no exposure.

    flux, flux_larger : per km^2 and year, counting errors only. total, total_larger : with the systematic term. systematic_ln :
    (k,) one sigma of ln(flux larger than the edge), its terms by name. exposure_km2_year : effective, efficiency included.
    """

    n_tracklets: NDArray[np.int64]
    false_expected: Array
    efficiency: Array
    exposure_km2_year: Array
    range_km: Array
    flux: Array
    total: Array
    flux_larger: Array
    total_larger: Array
    systematic_ln: Array
    terms_ln: dict[str, Array]


def found_shares(candidates: Crossings, efficiency: Efficiency, kept: float = 1.0) -> Array:
    """Probability (n,) of each candidate to be found, and kept, in two frames or more."""
    p = kept * np.where(candidates.snr > 0.0, efficiency.share(candidates.snr, candidates.length_px), 0.0)
    p = np.clip(p, 0.0, 1.0 - 1e-9)
    looked = (candidates.snr > 0.0).sum(axis=1)
    scale = candidates.frames_lit / np.maximum(looked, 1)
    none = np.exp(scale * np.log1p(-p).sum(axis=1))
    one = none * scale * (p / (1.0 - p)).sum(axis=1)
    return np.clip(1.0 - none - one, 0.0, 1.0)


def light_seen(candidates: Crossings, efficiency: Efficiency, rng: np.random.Generator) -> Array:
    """Measured over true light (n,) of candidates that are found: noise, and that near the threshold only bright noise is.

    The mean of normal noise above the threshold T at a signal s is phi(T - s) / Phi(s - T).
    """
    s = candidates.snr
    there = s > 0.0
    p = np.where(there, efficiency.share(s, candidates.length_px), 0.0)
    above = np.exp(-0.5 * (efficiency.threshold - s) ** 2 - log_ndtr(s - efficiency.threshold)) / math.sqrt(2.0 * math.pi)
    weight = np.sum(p * s * s, axis=1)
    shift = np.sum(p * s * np.where(there, above, 0.0), axis=1) / np.maximum(weight, 1e-30)
    frames = np.sum(p, axis=1)
    # At least two are found, for any probability.
    sigma = np.sqrt(frames / (np.maximum(weight, 1e-30) * np.maximum(frames, 2.0)))
    light = np.where(weight > 0.0, 1.0 + shift + sigma * rng.standard_normal(len(shift)), 1.0)
    return np.asarray(np.maximum(light, FAINTEST_SEEN))


def flux_of(counted: Counted, watch: Watch, efficiency: Efficiency, rng: np.random.Generator) -> Flux:
    """Unfold the counts of a run."""
    edges = np.array(SIZE_EDGES_M)
    k = len(edges) - 1
    category = _category(counted.size_m, edges)
    observed = np.bincount(category, minlength=k + 1)
    kept, kept_sigma_ln = counted.kept
    unknown = (observed[k] + 0.5) / (observed.sum() + 1.0)
    detected, missed = np.zeros((k + 1, k)), np.zeros(k)
    share, seen_km2_s, exposed, reach = np.zeros(k), np.zeros(k), np.zeros(k), np.full(k, np.nan)
    for j in range(k):
        drawn = crossings(watch, (edges[j], edges[j + 1]), CANDIDATES, rng, albedo=ALBEDO, albedo_sigma_ln=ALBEDO_SIGMA_LN)
        if not len(drawn.weight):
            continue
        could = (drawn.snr.max(axis=1) >= COULD_BE_SEEN_SNR) & (drawn.frames_lit >= 2)
        weight = np.where(could, drawn.weight, 0.0)
        if not (weight.sum() > 0.0 and drawn.flux_km2_s > 0.0):
            continue
        found = found_shares(drawn, efficiency, kept)
        estimate = (
            drawn.size_m
            * np.sqrt(drawn.albedo / ALBEDO * light_seen(drawn, efficiency, rng))
            * np.exp(counted.range_sigma_ln * rng.standard_normal(len(drawn.weight)))
        )
        n = effective_number(weight)
        into = np.bincount(_category(estimate, edges), weights=weight * found, minlength=k + 1) / weight.sum()
        detected[:, j] = n * into * (1.0 - unknown)
        detected[k, j] += n * into.sum() * unknown
        missed[j] = n * (1.0 - into.sum())
        share[j] = into.sum()
        seen_km2_s[j] = weight.sum() / drawn.flux_km2_s
        exposed[j] = share[j] * seen_km2_s[j]
        reach[j] = _weighted_quantile(drawn.range_km, weight * found, 0.9)
    use = np.flatnonzero((share > LEAST_EFFICIENCY) & (exposed > 0.0))
    false = np.bincount(category, weights=1.0 - counted.probability, minlength=k + 1).astype(np.float64)
    nothing = np.full((k, 3), np.nan)
    systematic, terms = _systematics(edges[:-1], kept_sigma_ln)
    flux, total, larger, total_larger = nothing.copy(), nothing.copy(), nothing.copy(), nothing.copy()
    if len(use):
        got = recover(
            observed.astype(np.int64),
            Response(detected=detected[:, use], missed=missed[use]),
            np.append(edges[use], edges[use[-1] + 1]),
            rng,
            false_counted=false,
            n_draws=DRAWS,
        )
        draws = got.draws / seen_km2_s[use] * YEAR_S
        sums = np.cumsum(draws[:, ::-1], axis=1)[:, ::-1]
        # One error for all classes, because they share albedo, phase function and orbits.
        wrong = np.exp(rng.standard_normal(len(draws))[:, None] * systematic[use])
        for out, values in ((flux, draws), (total, draws * wrong), (larger, sums), (total_larger, sums * wrong)):
            out[use] = np.percentile(values, [5.0, 50.0, 95.0], axis=0).T
    return Flux(
        n_tracklets=observed[:k].astype(np.int64),
        false_expected=false[:k],
        efficiency=np.where(seen_km2_s > 0.0, share, np.nan),
        exposure_km2_year=exposed / YEAR_S,
        range_km=reach,
        flux=flux,
        total=total,
        flux_larger=larger,
        total_larger=total_larger,
        systematic_ln=systematic,
        terms_ln=terms,
    )


def _systematics(lower_edge_m: Array, kept_sigma_ln: float) -> tuple[Array, dict[str, Array]]:
    """One sigma of ln N(> d) (k,), and its terms: light wrong by x makes sizes wrong by x / 2, and N(> d) falls as d^-b."""
    slope = np.where(lower_edge_m < SIZE_LAW_STEEP_BELOW_M, 2.10, 1.45)
    terms = {
        "albedo": 0.5 * slope * MEAN_ALBEDO_SIGMA_LN,
        "phase": 0.5 * slope * PHASE_SIGMA_LN,
        "orbits": np.full(len(slope), ORBITS_SIGMA_LN),
        "response": np.full(len(slope), math.hypot(RESPONSE_SIGMA_LN, KEPT_POWER * kept_sigma_ln)),
    }
    return np.sqrt(sum((term**2 for term in terms.values()), np.zeros(len(slope)))), terms


def _category(size_m: Array, edges: Array) -> NDArray[np.int64]:
    """Class of each size (n,), sizes beyond the edges in the outermost, NaN in the last category of its own."""
    k = len(edges) - 1
    return np.where(np.isfinite(size_m), np.clip(np.searchsorted(edges, size_m, side="right") - 1, 0, k - 1), k).astype(np.int64)


def _weighted_quantile(values: Array, weight: Array, share: float) -> float:
    if not weight.sum() > 0.0:
        return math.nan
    order = np.argsort(values, kind="stable")
    return float(np.interp(share * weight.sum(), np.cumsum(weight[order]), values[order]))


def counted_of(
    sizes: Sequence[tuple[float, float, float]],
    ranges: Sequence[tuple[float, float]],
    singles: Sequence[float],
    n_vetoed: int,
    gaps: Sequence[tuple[float, float]] = (),
    n_tracked: int = 0,
) -> Counted:
    """sizes : (size_m, probability, rate_deg_s) of tracklets. ranges : 5 % and 95 % points. singles : probabilities.

    gaps : frames seen and expected between the ends of each tracklet. n_tracked : tracklets left out, not in `sizes`.
    """
    table = np.array(sizes, dtype=np.float64).reshape(-1, 3)
    kept = ~(table[:, 2] < SLOWEST_DEG_S)
    spread = [math.log(high / low) / 3.29 for low, high in ranges if 0.0 < low < high < math.inf]
    return Counted(
        size_m=table[kept, 0],
        probability=np.clip(table[kept, 1], 0.0, 1.0),
        range_sigma_ln=float(np.median(spread)) if spread else RANGE_SIGMA_LN,
        n_single=len(singles),
        n_single_false=float(sum(1.0 - p for p in singles)),
        n_vetoed=n_vetoed,
        n_slow=int((~kept).sum()),
        frames_seen=float(sum(min(seen, expected) for seen, expected in gaps)),
        frames_expected=float(sum(expected for _, expected in gaps)),
        n_tracked=n_tracked,
    )
