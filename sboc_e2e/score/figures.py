"""A figure of a score: value, how many it rests on, its interval; or no value and the reason why not.

Intervals hold 90 %. Proportions use Wilson's interval (Wilson 1927, JASA 22, 209), rates of rare events the exact
Poisson interval (Garwood 1936, Biometrika 28, 437), everything else the percentile bootstrap (Efron 1979) over the
items that were measured, with a fixed seed so that a score repeats.
"""

from collections.abc import Callable
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import optimize, stats

Figure = dict[str, Any]
"""``{"value", "n", "low", "high"}``, or ``{"value": None, "n", "reason"}``."""

CONFIDENCE: Final = 0.90
BOOTSTRAP_DRAWS: Final = 400
_SEED: Final = 20270129


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
    return figure(share, n, max(0.0, centre - half), min(1.0, centre + half))


def rate(events: int, exposure: float, n: int, reason: str = "no exposure") -> Figure:
    """Events for each unit of exposure with the exact Poisson interval; for no event, `high` is the upper limit."""
    if exposure <= 0:
        return absent(reason)
    tail = (1 - CONFIDENCE) / 2
    low = stats.chi2.ppf(tail, 2 * events) / 2 if events else 0.0
    high = stats.chi2.ppf(1 - tail, 2 * events + 2) / 2
    return figure(events / exposure, n, low / exposure, high / exposure)


def bootstrap(values: ArrayLike, statistic: Callable[[NDArray[np.float64]], float], reason: str = "too few to measure") -> Figure:
    """A statistic of independent items, resampled over axis 0; needs at least three of them."""
    items = np.asarray(values, dtype=np.float64)
    n = len(items)
    if n < 3:
        return absent(reason, n)
    rng = np.random.default_rng(_SEED)
    draws = np.array([statistic(items[rng.integers(0, n, n)]) for _ in range(BOOTSTRAP_DRAWS)])
    low, high = np.quantile(draws, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    return figure(statistic(items), n, low, high)


def rms(values: NDArray[np.float64]) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(values * values)))


def pull_width(z: NDArray[np.float64]) -> float:
    """Robust width of pulls: 1 for a unit normal, sqrt(median(z^2) / 0.4549), the median of chi-square with one degree."""
    return float(np.sqrt(np.median(z * z) / 0.4549))


def half_point(snr: ArrayLike, detected: ArrayLike) -> Figure:
    """S/N at which a logistic curve in log S/N fitted to detections crosses one half, with a bootstrap interval."""
    x = np.log(np.maximum(np.asarray(snr, dtype=np.float64), 1e-3))
    y = np.asarray(detected, dtype=bool)
    if len(x) < 10:
        return absent("fewer than 10 streaks", len(x))
    if y.all() or not y.any():
        return absent("all detected" if y.all() else "none detected", len(x))

    def crossing(chosen: NDArray[np.intp]) -> float:
        xs, ys = x[chosen], y[chosen]
        if ys.all() or not ys.any():
            return float("nan")
        sign = np.where(ys, 1.0, -1.0)

        def loss(p: NDArray[np.float64]) -> float:
            # The weak prior on the slope (width 3 to 30 per unit of ln S/N) keeps separable samples finite.
            margin = np.exp(p[1]) * (xs - p[0]) * sign
            return float(np.sum(np.logaddexp(0.0, -margin)) + 0.5 * ((p[1] - np.log(10.0)) / 1.0) ** 2)

        return float(np.exp(optimize.minimize(loss, [np.median(xs), np.log(10.0)], method="Nelder-Mead").x[0]))

    everyone = np.arange(len(x))
    rng = np.random.default_rng(_SEED)
    draws = np.array([crossing(rng.integers(0, len(x), len(x))) for _ in range(100)])
    draws = draws[np.isfinite(draws)]
    if len(draws) < 20:
        return absent("nearly all or nearly none detected", len(x))
    low, high = np.quantile(draws, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    return figure(crossing(everyone), len(x), low, high)
