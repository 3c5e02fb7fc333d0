"""From the tracklets of a survey to flux by size, altitude and inclination: counts, unfolded with what others show.

Every other block is counted and unfolded (`ground.population.recover`) with what the blocks between show: no object tells its
own efficiency. Adding the other way round would hide the scatter of both: what one half finds too many, the other lacks. The
response of a class is known only as well as the pixel runs that showed it; that, albedo, phase and orbits make the systematic
term, the same error in all cells.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ground.population.flux import MEAN_ALBEDO_SIGMA_LN, ORBITS_SIGMA_LN, PHASE_SIGMA_LN, SIZE_LAW_STEEP_BELOW_M
from ground.population.recover import recover
from ground.population.response import Response as Counts
from sboc_e2e.survey.block import CLASS_EDGES_M
from sboc_e2e.survey.shards import Survey, cells
from simulator.survey.blocks import POOL_BLOCKS

Array = NDArray[np.float64]

DRAWS: Final = 1500  # Of posteriors: an end of the 90 % interval is known to 0.05 of the standard error.
POINTS: Final = (5.0, 50.0, 95.0)  # Per cent: both ends and the middle of 90 % intervals, as in all scores.
SIZES: Final = len(CLASS_EDGES_M) - 1
FEWEST_FOUND: Final = 30
"""Tracklets of a true cell in each half below which its efficiency is not known."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Unfolded:
    """Draws (d, sizes, bands) of passages that could be seen; known (sizes, bands) : where the efficiency is."""

    draws: Array
    known: NDArray[np.bool_]
    efficiency: Array
    counted: NDArray[np.int64]


def unfolded(
    observed: NDArray[np.int64],
    detected: Array,
    crossed: Array,
    rng: np.random.Generator,
    *,
    prior: float = 0.5,
    draws: int = DRAWS,
) -> Unfolded:
    """Unfold counts (c,) of measured cells with others' response.

    detected (c, k) : tracklets by measured cell and true cell; crossed (k,) : passages of each true cell.
    """
    known = detected.sum(axis=0) >= FEWEST_FOUND
    # cells of which little is known explain their share of the counts, or others would; what they hold is not said
    use = np.flatnonzero(detected.sum(axis=0) >= 1.0)
    out = np.full((draws, len(crossed)), np.nan)
    found = detected.sum(axis=0)
    if len(use):
        # cells that no known true cell reaches hold false tracklets and strays: they cannot be explained, so they are left out
        reached = detected[:, use].sum(axis=1) > 0.0
        got = recover(
            observed[reached],
            Counts(detected=detected[np.ix_(reached, use)], missed=np.maximum(crossed[use] - found[use], 0.0)),
            np.arange(1.0, len(use) + 2.0),
            rng,
            prior=prior,
            n_draws=draws,
        )
        out[:, use] = np.where(known[use], got.draws, np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        efficiency = np.where(crossed > 0.0, found / crossed, np.nan)
    return Unfolded(draws=out, known=known, efficiency=efficiency, counted=observed)


@dataclass(frozen=True, kw_only=True, eq=False)
class Flux:
    """Objects per km^2 and year larger than each edge, by band (sizes, bands, 3): 5, 50 and 95 %, counting errors only.

    total : the same with the systematic term; true : the model's. n (sizes, bands) : tracklets estimated larger.
    """

    larger: Array
    total: Array
    true: Array
    n: NDArray[np.int64]
    efficiency: Array
    draws: Array


def flux_by_band(
    survey: Survey,
    model: Array,
    expected: Array,
    axis: str,
    systematic_ln: Array,
    rng: np.random.Generator,
    *,
    draws: int = DRAWS,
) -> Flux:
    """Flux by altitude, inclination ("altitude", "inclination") or in all ("none").

    model (sizes, bands), expected (rounds, sizes, bands) : flux of a reference population, and passages that it sends in the
    survey's time, from several pools of pieces. Only their ratio is used, the exposure; the pools' scatter is in the intervals.
    """
    size, altitude, inclination = cells(*(survey.measured[name] for name in ("size_m", "altitude_km", "i_deg")))
    t_size, t_altitude, t_inclination = cells(*(survey.true[name] for name in ("size_m", "altitude_km", "i_deg")))
    real = survey.true["kind"] == 0
    band, t_band, summed = {
        "altitude": (altitude, t_altitude, (2,)),
        "inclination": (inclination, t_inclination, (1,)),
        "none": (np.zeros_like(size), np.zeros_like(size), (1, 2)),
    }[axis]
    bands = model.shape[1]
    n_cells = SIZES * bands
    mine, other = _halves(survey)
    counted = np.isin(survey.block, mine) & (size >= 0)
    observed = np.bincount(size[counted] * bands + band[counted], minlength=n_cells)
    told = np.isin(survey.block, other) & (size >= 0) & real
    detected = np.zeros((n_cells, n_cells))
    np.add.at(detected, (size[told] * bands + band[told], t_size[told] * bands + t_band[told]), 1.0)
    got = unfolded(observed, detected, _crossed(survey, other, summed), rng, draws=draws)
    known, efficiency = got.known, got.efficiency
    totals = np.where(known, got.draws, 0.0)
    expected = expected * (len(mine) / len(survey.crossings_by_block))
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = expected.mean(axis=0)
        exposure = np.where(mean > 0.0, mean / np.maximum(model, 1e-300), np.inf).ravel()
        scatter = np.where(mean > 0.0, expected.std(axis=0, ddof=1) / mean, 0.0).ravel()
    pools = max(1.0, len(survey.crossings_by_block) / POOL_BLOCKS)
    unsure = scatter * math.sqrt(1.0 / len(expected) + 1.0 / pools)
    totals = totals * np.exp(unsure * rng.standard_normal(totals.shape))
    per_cell = np.where(known, totals / exposure, 0.0).reshape(draws, SIZES, bands)
    larger = np.cumsum(per_cell[:, ::-1], axis=1)[:, ::-1]
    wrong = np.exp(rng.standard_normal(draws)[:, None] * systematic_ln)[:, :, None]
    true = np.cumsum(np.where(known.reshape(SIZES, bands), model, 0.0)[::-1], axis=0)[::-1]
    use = known.reshape(SIZES, bands)
    quantiles = [np.moveaxis(np.percentile(v, POINTS, axis=0), 0, -1) for v in (larger, larger * wrong)]
    counts = observed.reshape(SIZES, bands)
    return Flux(
        larger=np.where(use[:, :, None], quantiles[0], np.nan),
        total=np.where(use[:, :, None], quantiles[1], np.nan),
        true=true,
        n=np.cumsum(counts[::-1], axis=0)[::-1],
        efficiency=efficiency.reshape(SIZES, bands),
        draws=larger,
    )


def _halves(survey: Survey) -> tuple[list[int], list[int]]:
    """Blocks that are counted, and those that show the response: every other one, the same where there is one only."""
    blocks = sorted(survey.crossings_by_block)
    mine, other = blocks[1::2], blocks[::2]
    return (mine, other) if mine else (other, other)


def _crossed(survey: Survey, blocks: list[int], summed: tuple[int, ...]) -> Array:
    """Passages by true size and band of some blocks."""
    tables = [survey.crossings_by_block[block] for block in blocks]
    return np.asarray(np.sum(tables, axis=0).sum(axis=summed)).ravel()


def systematic_terms(response_ln: Array) -> dict[str, Array]:
    """One sigma of ln N(> d) at each lower edge, by cause: light wrong by x makes sizes wrong by x / 2, and N falls as d^-b.

    response_ln : of the efficiency, from resampled pixel runs.
    """
    lower = np.array(CLASS_EDGES_M[:-1])
    slope = np.where(lower < SIZE_LAW_STEEP_BELOW_M, 2.10, 1.45)
    return {
        "albedo": 0.5 * slope * MEAN_ALBEDO_SIGMA_LN,
        "phase": 0.5 * slope * PHASE_SIGMA_LN,
        "orbits": np.full(SIZES, ORBITS_SIGMA_LN),
        "response": response_ln,
    }


def systematic_ln(terms: dict[str, Array]) -> Array:
    """All terms in quadrature."""
    return np.asarray(np.sqrt(sum((term**2 for term in terms.values()), np.zeros(SIZES))))


def days_to(share: float, flux: Flux, edge: int, band: int, days: float) -> float:
    """Days after which the flux larger than an edge has a 90 % interval of +- `share`, from that of a survey of `days`.

    Counting errors fall as the root of time; inf for a flux that is not known.
    """
    low, middle, high = flux.larger[edge, band]
    if not middle > 0.0:
        return math.inf
    width = 0.5 * (high - low) / middle
    return float(days * (width / share) ** 2)


def told_apart(
    survey: Survey, ratio_at: Callable[[Array], Array], days: float, rng: np.random.Generator, *, draws: int = 400
) -> tuple[float, float]:
    """Chance that a survey of `days` tells a population from one with `ratio_at(size)` times as many pieces, by counting alone.

    Likelihood ratio of the counts by estimated size at 1 % false alarms; second, the false alarms among as many of the same.
    """
    size, _, _ = cells(*(survey.measured[name] for name in ("size_m", "altitude_km", "i_deg")))
    real = (size >= 0) & (survey.true["kind"] == 0)
    scale = days / survey.watched_days
    weight = ratio_at(np.nan_to_num(survey.true["size_m"], nan=1.0))
    one = np.bincount(size[real], minlength=SIZES) * scale
    other = np.bincount(size[real], weights=weight[real], minlength=SIZES) * scale
    use = (one > 0.0) & (other > 0.0)
    one, other = one[use], other[use]

    def statistic(counts: NDArray[np.int64]) -> Array:
        return np.asarray(counts @ np.log(other / one))

    limit = np.quantile(statistic(rng.poisson(one, (20 * draws, len(one)))), 0.99)
    found = np.mean(statistic(rng.poisson(other, (draws, len(one)))) > limit)
    false = np.mean(statistic(rng.poisson(one, (draws, len(one)))) > limit)
    return float(found), float(false)
