"""A figure of a score: value, number of items behind it, and interval; or no value and the reason.

Intervals hold 90 %. Proportions use Wilson's interval (Wilson 1927, JASA 22, 209), rates of rare events the exact
Poisson interval (Garwood 1936, Biometrika 28, 437), points of half completeness the profile likelihood, everything else the
percentile bootstrap (Efron 1979) over the items that were measured, with a fixed seed so that a score repeats.
"""

from collections.abc import Callable
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import interpolate, optimize, special, stats

Figure = dict[str, Any]
"""``{"value", "n", "low", "high"}``, or ``{"value": None, "n", "reason"}``."""

CONFIDENCE: Final = 0.90  # Content of all intervals, a convention of the scores (docs/scoring.md).
BOOTSTRAP_DRAWS: Final = 400
"""An end of a 90 % interval is known to 0.11 of the standard error (sqrt(0.05 * 0.95 / 400) over the normal density). More cost
time."""
VAGUE: Final = 2.0
"""Largest ratio of the ends of an S/N interval for which `half_point` gives a value."""
LAPSES: Final = (0.0, 0.02, 0.05, 0.1, 0.2, 0.3)
"""Shares of trials lost whatever the S/N. A grid of 31 from 0 to 0.3 changes no end of eight synthetic intervals by over 0.4
%."""
HALVES: Final = 101
"""Points of the grid; with 51 or 201 no end of eight synthetic intervals moves by more than 4e-5 in ln S/N."""
HALF_REACH: Final = 1.5
"""The grid begins so far outside the samples (ln S/N); half and twice as much move no end of eight intervals by more than
3e-5."""
NEWTON_STEPS: Final = 60
"""A budget: steps end when they fall below 1e-5. 15 and 120 give the same numbers for eight synthetic samples."""
SEED: Final = 20270129
"""Of all that scores draw at random, so that they repeat; the day of the shipped scenarios' epoch, any number serves."""
MEDIAN_OF_CHI2: Final = 0.4549
"""Median of chi-square with one degree of freedom: `scipy.stats.chi2.ppf(0.5, 1)` = 0.45494."""


def figure(value: float, n: int, low: float, high: float) -> Figure:
    """A figure with its interval; JSON has no NaN, so a value or interval that is not finite is an absent figure."""
    if not np.isfinite([value, low, high]).all():
        return absent("not a finite number", n)
    return {"value": float(value), "n": int(n), "low": float(low), "high": float(high)}


def absent(reason: str, n: int = 0) -> Figure:
    """No value, and why."""
    return {"value": None, "n": int(n), "reason": reason}


def exact(value: float, n: int) -> Figure:
    """A count or a deterministic number: its interval has no width."""
    return figure(value, n, value, value)


def proportion(successes: int, n: int, reason: str = "nothing to count") -> Figure:
    """A share with Wilson's interval."""
    if n == 0:
        return absent(reason)
    z = stats.norm.ppf(0.5 + CONFIDENCE / 2)
    share = successes / n
    centre = (share + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * np.sqrt(share * (1 - share) / n + z * z / (4 * n * n))
    # Wilson's interval of none (or all) ends at 0 (or 1): the formula leaves the last digit of a float there.
    low = 0.0 if successes == 0 else max(0.0, centre - half)
    return figure(share, n, low, 1.0 if successes == n else min(1.0, centre + half))


def rate(events: int, exposure: float, n: int, reason: str = "no exposure") -> Figure:
    """Events for each unit of exposure with the exact Poisson interval; for no event, `high` is the upper limit."""
    if exposure <= 0:
        return absent(reason)
    tail = (1 - CONFIDENCE) / 2
    low = stats.chi2.ppf(tail, 2 * events) / 2 if events else 0.0
    high = stats.chi2.ppf(1 - tail, 2 * events + 2) / 2
    return figure(events / exposure, n, low / exposure, high / exposure)


def scaled(f: Figure, factor: float) -> Figure:
    """The figure in a unit `1 / factor` as large."""
    return {k: v * factor if k in ("value", "low", "high") and v is not None else v for k, v in f.items()}


def bootstrap(values: ArrayLike, statistic: Callable[[NDArray[np.float64]], float], reason: str = "too few to measure") -> Figure:
    """A statistic of independent items, resampled over axis 0; needs at least three of them."""
    items = np.asarray(values, dtype=np.float64)
    n = len(items)
    if n < 3:
        return absent(reason, n)
    rng = np.random.default_rng(SEED)
    draws = np.array([statistic(items[rng.integers(0, n, n)]) for _ in range(BOOTSTRAP_DRAWS)])
    low, high = np.quantile(draws, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    return figure(statistic(items), n, low, high)


def bootstrap_by_owner(
    values: ArrayLike, owners: ArrayLike, statistic: Callable[[NDArray[np.float64]], float], reason: str = "too few to measure"
) -> Figure:
    """A statistic of items that belong to objects: objects are resampled, each with all its items, which share errors.

    values : items over axis 0. owners : (n,) object of each item. Needs three objects; `n` of the figure counts items.
    """
    items, whose = np.asarray(values, dtype=np.float64), np.asarray(owners)
    n = len(items)
    if n == 0:
        return absent(reason, n)
    names, place = np.unique(whose, return_inverse=True)
    if len(names) < 3:
        return absent(f"of fewer than three objects: {reason}", n)
    groups = np.split(np.argsort(place, kind="stable"), np.cumsum(np.bincount(place))[:-1])
    rng = np.random.default_rng(SEED)
    picks = rng.integers(0, len(names), (BOOTSTRAP_DRAWS, len(names)))
    draws = np.array([statistic(items[np.concatenate([groups[k] for k in pick])]) for pick in picks])
    low, high = np.quantile(draws, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    return figure(statistic(items), n, low, high)


def rms(values: NDArray[np.float64]) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(values * values)))


def pull_width(z: NDArray[np.float64]) -> float:
    """Robust width of pulls: 1 for a unit normal, sqrt(median(z^2) / 0.4549), the median of chi-square with one degree."""
    return float(np.sqrt(np.median(z * z) / MEDIAN_OF_CHI2))


def half_point(snr: ArrayLike, detected: ArrayLike) -> Figure:
    """S/N at which a logistic curve in log S/N fitted to detections crosses one half, with a profile-likelihood interval.

    A share of the streaks of any S/N may be lost for other reasons (stars, edges). Where no streak lies between the
    missed and the detected ones the interval is that gap; where it spans a factor of more than `VAGUE`, there is no value.
    """
    x = np.log(np.maximum(np.asarray(snr, dtype=np.float64), 1e-3))
    y = np.asarray(detected, dtype=bool)
    n = len(x)
    if n < 10:
        return absent("fewer than 10 streaks", n)
    if y.all() or not y.any():
        return absent("all detected" if y.all() else "none detected", n)
    centre, low, high = np.exp(logistic_half(x, y))
    if high > VAGUE * low:
        return absent(f"too few streaks near it: anywhere between S/N {low:.3g} and {high:.3g}", n)
    return figure(centre, n, low, high)


def logistic_half(x: NDArray[np.float64], y: NDArray[np.bool_]) -> tuple[float, float, float]:
    """Where the curve (1 - lapse)/(1 + exp(-slope (x - c))) through successes crosses one half, and its 90 % interval.

    x : (n,). y : (n,) success. The interval is where the likelihood, at the best slope and lapse for each place, stays above
    exp(-2.706/2) of its maximum (Wilks 1938, Ann. Math. Statist. 9, 60). Lapses (Wichmann & Hill 2001, Perception & Psychophysics
    63, 1293) take one of `LAPSES` with the weak prior (1 - lapse)^19; ln slope is normal around ln 10 with width 1, slopes of 3
    to 30 per unit of x, which keeps separable samples finite.
    """
    place, which = np.unique(np.round(x, 3 if len(x) <= 500 else 2), return_inverse=True)
    hits = np.bincount(which, weights=y).astype(np.float64)
    misses = np.bincount(which) - hits
    limit = stats.chi2.ppf(CONFIDENCE, 1) / 2
    low, high = float(place[0]) - HALF_REACH, float(place[-1]) + HALF_REACH
    for _ in range(3):  # each grid covers the interval that the one before it found, and one step more
        grid = np.linspace(low, high, HALVES)
        loss = np.min([_best_loss(grid, lapse, place, hits, misses) for lapse in LAPSES], axis=0)
        inside = np.flatnonzero(loss <= loss.min() + limit)
        low, high = float(grid[max(inside[0] - 1, 0)]), float(grid[min(inside[-1] + 1, HALVES - 1)])
    best, first, last = int(np.argmin(loss)), int(inside[0]), int(inside[-1])
    curve = interpolate.CubicSpline(grid, loss - loss.min() - limit)
    around = grid[max(best - 1, 0)], grid[min(best + 1, HALVES - 1)]
    centre = optimize.minimize_scalar(curve, bounds=around, method="bounded").x
    below = optimize.brentq(curve, low, grid[first]) if first else low
    above = optimize.brentq(curve, grid[last], high) if last < HALVES - 1 else high
    return float(centre), float(below), float(above)


def _best_loss(
    half: NDArray[np.float64], lapse: float, place: NDArray[np.float64], hits: NDArray[np.float64], misses: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Negative log posterior at the best slope for each point of half success (m,), by Newton's steps in q = ln slope.

    place : (n,) abscissae with numbers of successes and failures.
    """
    offset, at_half = place - half[:, None], special.logit(0.5 / (1.0 - lapse))
    q = np.full(len(half), np.log(10.0))
    for _ in range(NEWTON_STEPS):
        rise = np.clip(np.exp(q)[:, None] * offset, -500.0, 500.0)
        share, rest = special.expit(at_half + rise), special.expit(-at_half - rise)
        failing = (1.0 - lapse) * share * rest / (lapse + (1.0 - lapse) * rest)
        first = misses * failing - hits * rest  # derivatives of the loss by the logistic's argument
        second = misses * failing * (rest - share + failing) + hits * share * rest
        slope = q - np.log(10.0) + (first * rise).sum(axis=1)
        bend = 1.0 + ((second * rise + first) * rise).sum(axis=1)
        step = np.clip(slope / np.maximum(bend, 1.0), -0.5, 0.5)
        q -= step
        if np.abs(step).max() < 1e-5:
            break
    rise = np.clip(np.exp(q)[:, None] * offset, -500.0, 500.0)
    found = (1.0 - lapse) * special.expit(at_half + rise)
    lost = lapse + (1.0 - lapse) * special.expit(-at_half - rise)
    cost = -(hits * np.log(found) + misses * np.log(lost)).sum(axis=1)
    return np.asarray(cost + 0.5 * (q - np.log(10.0)) ** 2 - 19.0 * np.log1p(-lapse))
