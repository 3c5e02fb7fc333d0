"""Weighted orbits over an adaptive grid of ranges, and their reported summary."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from ground.orbit.prior import PriorTable
from ground.orbit.scan import N_COLUMNS, Problem, rows_per_range, scan_range

_COARSE_STEPS = 240  # first scan, 6 % apart from 50 m to 60,000 km; ranges that hold density are refined. Chosen, not measured
_MOST_RANGES = 900  # a budget of work: refinement ends here. Chosen, not measured
_LOG_CUT = 14.0
"""Ranges whose density is exp(-14) of the best are left coarse; together they hold less than 1e-5."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Posterior:
    """Weighted orbits: weight (n,) sums to one; range_km, a_km, e, i_rad (n,). log_range (k,) and density (k,) per ln range.

    range_rate_km_s, rate_width_km_s : (n,) range rate, and the interval of range rate that each orbit represents.
    rate_shift_rad_s : (n, 2) correction of the nominal transverse rate.
    """

    weight: NDArray[np.float64]
    range_km: NDArray[np.float64]
    a_km: NDArray[np.float64]
    e: NDArray[np.float64]
    i_rad: NDArray[np.float64]
    range_rate_km_s: NDArray[np.float64]
    rate_width_km_s: NDArray[np.float64]
    rate_shift_rad_s: NDArray[np.float64]
    log_range: NDArray[np.float64]
    density: NDArray[np.float64]


@lru_cache(maxsize=4)
def _draws(n: int) -> NDArray[np.float64]:
    """Pairs (2 _MOST_RANGES, n, 2) for every range that a scan may try: a round of refinement at most doubles their number."""
    return normal_pairs(0, 2 * _MOST_RANGES * n).reshape(-1, n, 2)


def normal_pairs(start: int, n: int) -> NDArray[np.float64]:
    """Members start ... start + n - 1 of a quasi-random sequence of standard normal pairs (Roberts' R2 sequence)."""
    golden = 1.324717957244746
    index = np.arange(start, start + n)[:, None]
    return np.asarray(ndtri(np.clip((0.5 + index * np.array([1.0 / golden, 1.0 / golden**2])) % 1.0, 1e-9, 1.0 - 1e-9)))


def scan(
    problem: Problem,
    law_of_range: Callable[[float], tuple[PriorTable, float]],
    limits_km: tuple[float, float],
    n_draws: int,
) -> Posterior | None:
    """Scan, then refine until no cell of the range grid holds more than a hundredth of the mass; None without any bound orbit.

    law_of_range : range (km) -> density of orbits there, and natural log of volume and size law per ln(range).
    """
    log_range = list(np.linspace(np.log(limits_km[0]), np.log(limits_km[1]), _COARSE_STEPS))
    buffer = np.empty((rows_per_range(n_draws), N_COLUMNS))
    rows: dict[float, NDArray[np.float64]] = {}
    log_density: dict[float, float] = {}
    range_rate_ratio: dict[float, float] = {}
    draws = _draws(n_draws)

    def evaluate(x: float, ratio: float) -> None:
        rho = float(np.exp(x))
        prior, log_weight = law_of_range(rho)
        count, total, rate = scan_range(problem, prior, rho, ratio * rho, draws[len(rows)], log_weight, buffer)
        rows[x], log_density[x], range_rate_ratio[x] = buffer[:count].copy(), total, rate / rho

    ratio = 0.0
    for x in log_range:
        evaluate(x, ratio)
        ratio = range_rate_ratio[x]
    while len(log_range) < _MOST_RANGES:
        density = np.array([log_density[x] for x in log_range])
        if not np.isfinite(density.max()):
            return None
        value = np.exp(density - density.max())
        step = np.diff(log_range)
        mass = 0.5 * (value[1:] + value[:-1]) * step
        higher = np.maximum(density[1:], density[:-1])
        floor = np.maximum(density, density.max() - 1e3)
        steep = np.abs(np.diff(floor)) > 1.5
        split = (mass > 0.01 * mass.sum()) | (steep & (higher > density.max() - _LOG_CUT) & (mass > 1e-4 * mass.sum()))
        split &= step > 1e-7
        if not split.any():
            break
        for k in np.flatnonzero(split):
            evaluate(0.5 * (log_range[k] + log_range[k + 1]), range_rate_ratio[log_range[k]])
        log_range = sorted(rows)
    return _collected(log_range, rows, log_density)


def _collected(log_range: list[float], rows: dict[float, NDArray[np.float64]], log_density: dict[float, float]) -> Posterior:
    """Rows of all ranges with the widths of their cells."""
    x = np.array(log_range)
    width = np.gradient(x)
    width[0], width[-1] = 0.5 * (x[1] - x[0]), 0.5 * (x[-1] - x[-2])
    width[1:-1] = 0.5 * (x[2:] - x[:-2])
    density = np.array([log_density[k] for k in log_range])
    top = density.max()
    table = np.vstack([np.column_stack([rows[k], np.full(len(rows[k]), w)]) for k, w in zip(log_range, width, strict=True)])
    weight = np.exp(table[:, 0] - top) * table[:, N_COLUMNS]
    keep = weight > 1e-9 * weight.max()
    table, weight = table[keep], weight[keep] / weight[keep].sum()
    value = np.exp(density - top)
    return Posterior(
        weight=weight,
        range_km=table[:, 1],
        a_km=table[:, 2],
        e=table[:, 3],
        i_rad=table[:, 4],
        range_rate_km_s=table[:, 5],
        rate_width_km_s=table[:, 6],
        rate_shift_rad_s=table[:, 7:9],
        log_range=x,
        density=value / float(value @ width),
    )


def quantiles(values: NDArray[np.float64], weight: NDArray[np.float64]) -> NDArray[np.float64]:
    """5 %, 50 % and 95 % points (3,) of weighted values, interpolated between the middles of their steps."""
    order = np.argsort(values, kind="stable")
    cumulative = np.cumsum(weight[order])
    return np.interp([0.05, 0.5, 0.95], (cumulative - 0.5 * weight[order]) / cumulative[-1], values[order])


def modes(posterior: Posterior, medians_of_all: Sequence[float]) -> NDArray[np.float64]:
    """Range modes (k, 5) by falling weight: range (km) at the peak, weight, and medians of a (km), e, i (deg) around it.

    A mode is a peak of the density per ln(range), running mean over five ranges, together with everything up to the valleys
    next to it. A valley does not divide if it is higher than half of the lower peak, or if it leaves less than 2 % on a side.
    The weights sum to one. medians_of_all : medians of a, e, i over the whole posterior, used for a single mode.
    """
    density = np.convolve(np.pad(posterior.density, 2, mode="edge"), np.full(5, 0.2), mode="valid")
    peaks = np.flatnonzero(np.diff(np.sign(np.diff(np.concatenate([[-1.0], density, [-1.0]])))) < 0)
    valleys = [int(a + np.argmin(density[a : b + 1])) for a, b in pairwise(peaks)]
    dividing: list[int] = []
    top = float(density[: valleys[0] + 1].max()) if valleys else 0.0
    for k, valley in enumerate(valleys):
        following = float(density[valley : valleys[k + 1] + 1 if k + 1 < len(valleys) else None].max())
        if density[valley] < 0.5 * min(top, following):
            dividing.append(valley)
            top = following
        else:
            top = max(top, following)
    log_range = np.log(posterior.range_km)
    while True:
        cell = np.searchsorted(posterior.log_range[dividing], log_range, side="left")
        mass = np.bincount(cell, weights=posterior.weight, minlength=len(dividing) + 1)
        if mass.min() >= 0.02 or not dividing:
            break
        least = int(np.argmin(mass))
        beside = [k for k in (least - 1, least) if 0 <= k < len(dividing)]
        del dividing[max(beside, key=lambda k: density[dividing[k]])]
    bounds = [0, *dividing, len(density) - 1]
    columns = (posterior.a_km, posterior.e, np.degrees(posterior.i_rad))
    out = []
    for k, (low, high) in enumerate(pairwise(bounds)):
        inside = cell == k
        medians = [quantiles(column[inside], posterior.weight[inside])[1] for column in columns] if dividing else medians_of_all
        peak = low + int(np.argmax(density[low : high + 1]))
        out.append((float(np.exp(posterior.log_range[peak])), float(mass[k]), *medians))
    return np.array(sorted(out, key=lambda mode: -mode[1])).reshape(-1, 5)
