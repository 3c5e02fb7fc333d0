"""A figure of a score: value, how many it rests on, its interval; or no value and the reason why not.

Intervals hold 90 %. Proportions use Wilson's interval (Wilson 1927, JASA 22, 209), rates of rare events the exact
Poisson interval (Garwood 1936, Biometrika 28, 437), everything else the percentile bootstrap (Efron 1979) over the
items that were measured, with a fixed seed so that a score repeats.
"""

from collections.abc import Callable
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special, stats

Figure = dict[str, Any]
"""``{"value", "n", "low", "high"}``, or ``{"value": None, "n", "reason"}``."""

CONFIDENCE: Final = 0.90
BOOTSTRAP_DRAWS: Final = 400
HALF_POINT_DRAWS: Final = 100
NEWTON_STEPS: Final = 60
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


def scaled(f: Figure, factor: float) -> Figure:
    """The figure in a unit `1 / factor` as large."""
    return {k: v * factor if k in ("value", "low", "high") and v is not None else v for k, v in f.items()}


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
    n = len(x)
    if n < 10:
        return absent("fewer than 10 streaks", n)
    if y.all() or not y.any():
        return absent("all detected" if y.all() else "none detected", n)
    rng = np.random.default_rng(_SEED)
    drawn = rng.integers(0, n, (HALF_POINT_DRAWS, n))
    weight = np.stack([np.bincount(indices, minlength=n) for indices in drawn]).astype(np.float64)
    mixed = (weight @ y > 0) & (weight @ ~y > 0)
    if mixed.sum() < 20:
        return absent("nearly all or nearly none detected", n)
    fitted = np.exp(logistic_centres(x, y, np.vstack([np.ones(n), weight[mixed]])))
    low, high = np.quantile(fitted[1:], [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    return figure(float(fitted[0]), n, low, high)


def logistic_centres(x: NDArray[np.float64], y: NDArray[np.bool_], weight: NDArray[np.float64]) -> NDArray[np.float64]:
    """Centres c of logistic curves 1/(1 + exp(-exp(q) (x - c))), one fit for each row of weights.

    x : (n,). y : (n,) success. weight : (fits, n). The weak prior on q = ln slope (normal around ln 10, width 1: slopes of 3
    to 30 per unit of x) keeps separable samples finite. Newton steps with a damping of their own for each fit.
    """
    sign = np.where(y, 1.0, -1.0)
    order = np.argsort(x)
    half = np.cumsum(weight[:, order], axis=1) >= weight.sum(axis=1, keepdims=True) / 2
    at = np.stack([x[order][np.argmax(half, axis=1)], np.full(len(weight), np.log(10.0))], axis=1)
    damping = np.ones(len(weight))
    value, gradient, curvature = _logistic_loss(at, x, sign, weight)
    for _ in range(NEWTON_STEPS):
        damped = curvature + damping[:, None, None] * np.eye(2) * np.abs(curvature).max(axis=(1, 2))[:, None, None]
        step = np.linalg.solve(damped, gradient[:, :, None])[:, :, 0]
        trial = at - step
        new = _logistic_loss(trial, x, sign, weight)
        better = new[0] <= value
        at[better], value[better] = trial[better], new[0][better]
        gradient[better], curvature[better] = new[1][better], new[2][better]
        damping = np.where(better, damping * 0.2, damping * 8.0)
        if np.abs(step[better]).max(initial=0.0) < 1e-7 and better.any():
            break
    return at[:, 0]


def _logistic_loss(
    at: NDArray[np.float64], x: NDArray[np.float64], sign: NDArray[np.float64], weight: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Negative log posterior, its gradient (fits, 2) and Hessian (fits, 2, 2) in (centre, ln slope)."""
    slope = np.exp(np.clip(at[:, 1:], -20.0, 20.0))
    margin = slope * (x - at[:, :1]) * sign
    miss = special.expit(-margin)
    prior = at[:, 1] - np.log(10.0)
    value = (weight * np.logaddexp(0.0, -margin)).sum(axis=1) + 0.5 * prior**2
    by_centre, spread = -slope * sign, miss * (1.0 - miss)
    gradient = np.stack([-(weight * miss * by_centre).sum(axis=1), prior - (weight * miss * margin).sum(axis=1)], axis=1)
    cc = (weight * spread * by_centre**2).sum(axis=1)
    cq = (weight * (spread * margin - miss) * by_centre).sum(axis=1)
    qq = 1.0 + (weight * (spread * margin - miss) * margin).sum(axis=1)
    return value, gradient, np.stack([np.stack([cc, cq], axis=1), np.stack([cq, qq], axis=1)], axis=1)
