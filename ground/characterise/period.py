"""Period of an object's light over several passes.

Each pass has an amplitude and phase of its own, because the geometry changes between passes; only the period is common. No cycle
has to be counted from one pass to the next, so that gaps make no aliases. Peaks come from Lomb-Scargle periodograms of one and
of three harmonics (astropy; VanderPlas 2018, ApJS 236, 16). Multiples of the best ones are compared with as many harmonics as
the data ask for, because two like faces make half of the turn stand out.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from astropy.timeseries import LombScargle
from numpy.typing import NDArray
from scipy.stats import beta

Array = NDArray[np.float64]

FALSE_ALARM: Final = 0.01
"""Probability below which a period is given: one noise curve in a hundred (0 of 60 stable ones, docs/objects.md)."""
FEWEST_SAMPLES: Final = 12
"""Drift (3), amplitude, phase, frequency take six; as many again show whether the model repeats. Chosen."""
_CYCLES: Final = 2.5
"""Turns in the longest pass that a period needs: fewer cannot be told from a slow change."""
_DRIFT: Final = 2
"""Degree of the polynomial in time that stands for the slow change of a pass."""
_OVERSAMPLING: Final = 6.0
"""Frequencies per 1/span: a peak between two loses at most 2.3 %. Also trials per independent frequency."""
_TERMS: Final = (1, 3)  # harmonics searched for: a sine, and the sharper light of boxes and panels
_PEAKS: Final = 4  # peaks of each search that are tried: aliases may be higher than the truth. A budget of work
_ORDERS: Final = (1, 2, 3, 4, 6, 8, 12, 16, 24)
"""Numbers of harmonics compared by Bayesian information, in steps by about half: 24 follow glints of panels."""
_RIDGE: Final = 1e-9  # of the mean diagonal: keeps the normal matrix invertible where samples do not fix all harmonics
_MOST_MULTIPLE: Final = 8  # a body with eight like faces shows an eighth of its period; boxes show a half or a quarter
_SCREEN_ORDERS: Final = (4, 8)  # orders of the first comparison: two instead of nine, a budget of work
_LIKE: Final = 0.2
"""Of chi2: two periods that fit alike."""
_KEPT: Final = 5
"""Multiples that are compared with all orders, out of all that a few orders have tried."""
_MOST_FREQUENCIES: Final = 60_000  # a budget of work and memory. Longer series are searched with fewer points to a peak
_BLOCKS: Final = 5  # of a pass: each fifth is foretold from the other four
_REPEATS: Final = 0.8
"""A model that repeats leaves no more than this of the scatter in parts of a pass that it was not fitted to."""
_REPEAT_TERMS: Final = 3
"""More harmonics than that would swing in the block that is left out."""
_SHUFFLES: Final = 100  # the share is then known to 0.01; it is reported and decides nothing


@dataclass(frozen=True, kw_only=True)
class Period:
    """period_s, period_err_s : NaN without a period that is significant and repeats. best_s : of the highest peak in any case.

    false_alarm : probability that noise alone has as high a peak, all trials counted. string_alarm : share of shuffled curves
    whose string (Dworetsky 1983, MNRAS 203, 917) is as short. left : share of the scatter that the periodic model leaves in
    parts of the passes that it was not fitted to. amplitude_mag : peak to peak of the model. terms : harmonics.
    """

    period_s: float
    period_err_s: float
    best_s: float
    false_alarm: float
    string_alarm: float
    left: float
    amplitude_mag: float
    terms: int


@dataclass(frozen=True, eq=False)
class _Curve:
    """One pass: times from its middle (n,) s, magnitudes (n,) without their slow change, weights (n,)."""

    t: Array
    y: Array
    w: Array

    @property
    def span(self) -> float:
        return float(np.ptp(self.t))


def find_period(times: Sequence[Array], mags: Sequence[Array], errors: Sequence[Array], *, seed: int = 0) -> Period:
    """The period common to passes: times (n,) s, magnitudes and one sigma (n,) of each.

    Tried are periods from two samples to 1/2.5 of the longest pass. seed : of the shuffled curves.
    """
    every = zip(times, mags, errors, strict=True)
    curves = [_without_drift(t, y, e) for t, y, e in every if len(t) >= FEWEST_SAMPLES and np.ptp(t) > 0.0]
    nan = float("nan")
    none = Period(
        period_s=nan, period_err_s=nan, best_s=nan, false_alarm=nan, string_alarm=nan, left=nan, amplitude_mag=nan, terms=0
    )
    if not curves:
        return none
    longest = max(c.span for c in curves)
    every_s = float(np.median(np.concatenate([np.diff(c.t) for c in curves])).clip(1e-6))
    lowest = _CYCLES / longest
    highest = 0.5 / every_s - lowest
    n = int(min(_OVERSAMPLING * longest * (highest - lowest), _MOST_FREQUENCIES))
    if n < 10:
        return none
    frequency = np.linspace(lowest, highest, n)
    candidates: list[float] = []
    alarm = 1.0
    for terms in _TERMS:
        power = _joint_power(curves, frequency, terms)
        alarm = min(alarm, len(_TERMS) * _alarm(curves, float(power.max()), terms, longest * (highest - lowest)))
        candidates += [_sharpened(curves, float(frequency[k]), longest, terms) for k in _peaks(power)]
    if not alarm < FALSE_ALARM:
        string = _string_alarm(curves, candidates[0], np.random.default_rng(seed))
        amplitude, _ = _amplitude_and_error(curves, candidates[0], 1)
        return replace(
            none, best_s=1.0 / candidates[0], false_alarm=min(alarm, 1.0), string_alarm=string, amplitude_mag=amplitude
        )
    tried: list[float] = []
    for start in candidates:
        for first in start / np.arange(1, _MOST_MULTIPLE + 1):
            if first >= lowest and not _is_slow(first, every_s, lowest) and all(abs(first - f) > 0.2 / longest for f in tried):
                tried.append(float(first))
    if not tried:
        return replace(none, best_s=1.0 / candidates[0], false_alarm=min(alarm, 1.0))
    screened = sorted((_refined(curves, f, longest, _SCREEN_ORDERS) for f in tried), key=lambda found: found[1])
    refined = [_refined(curves, f, longest, _ORDERS) for f, _, _ in screened[:_KEPT]]
    best, terms = _shortest(curves, min(refined, key=lambda found: found[1]), longest, highest)
    left = _left_elsewhere(curves, best, min(terms, _REPEAT_TERMS))
    string = _string_alarm(curves, best, np.random.default_rng(seed))
    amplitude, error = _amplitude_and_error(curves, best, terms)
    # a drift of one pass is no period: half of the passes show it
    shown = sum(_left_elsewhere([c], best, min(terms, _REPEAT_TERMS)) < _REPEATS for c in curves)
    real = alarm < FALSE_ALARM and left < _REPEATS and 2 * shown >= len(curves)
    return Period(
        period_s=1.0 / best if real else nan,
        period_err_s=error / best**2 if real else nan,
        best_s=1.0 / best,
        false_alarm=min(alarm, 1.0),
        string_alarm=string,
        left=left,
        amplitude_mag=amplitude,
        terms=terms,
    )


def _is_slow(frequency: float, every_s: float, lowest: float) -> bool:
    """Whether one of the first harmonics, sampled regularly, is a slow change: such a period would explain any drift."""
    turns = np.arange(1, 5) * frequency * every_s
    return bool((np.abs(turns - np.rint(turns)) < 0.6 * lowest * every_s).any())


def _without_drift(t: Array, y: Array, error: Array) -> _Curve:
    """A pass less its slow change, robustly: what is far off (a flash) does not bend the polynomial."""
    at = t - 0.5 * (t[0] + t[-1])
    scaled, w = at / max(float(np.ptp(at)), 1e-9), error**-2
    columns = np.vander(scaled, _DRIFT + 1)
    weight = w.copy()
    for _ in range(3):
        root = np.sqrt(weight)
        coefficients, *_ = np.linalg.lstsq(columns * root[:, None], y * root, rcond=None)
        left = y - columns @ coefficients
        size = 2.0 * 1.4826 * float(np.median(np.abs(left))) + 1e-9
        weight = w * np.minimum(1.0, size / np.maximum(np.abs(left), 1e-12))
    return _Curve(at, np.asarray(left - np.average(left, weights=w)), w)


def _joint_power(curves: Sequence[_Curve], frequency: Array, terms: int) -> Array:
    """Share (m,) of the weighted scatter of all passes that a period removes."""
    total, removed = 0.0, np.zeros(len(frequency))
    for c in curves:
        chi2 = float(c.w @ c.y**2)
        method = "fast" if terms == 1 else "fastchi2"
        model = LombScargle(c.t, c.y, c.w**-0.5, nterms=terms)
        power = model.power(frequency, method=method, assume_regular_frequency=True, normalization="standard")
        # a pass shorter than two turns says nothing of a period: polynomial and harmonics are alike
        removed += chi2 * np.where(frequency * c.span > 2.0, np.clip(power, 0.0, 1.0), 0.0)
        total += chi2
    return np.asarray(removed / max(total, 1e-300))


def _alarm(curves: Sequence[_Curve], power: float, terms: int, independent: float) -> float:
    """Probability that white noise of unknown size has so high a joint power at any of the frequencies."""
    free = sum(len(c.t) for c in curves) - (_DRIFT + 1) * len(curves)
    used = 2 * terms * len(curves)
    if free <= used + 2:
        return 1.0
    single = float(beta.sf(min(power, 1.0), 0.5 * used, 0.5 * (free - used)))
    return float(-np.expm1(_OVERSAMPLING * independent * np.log1p(-min(single, 1.0 - 1e-15))))


def _peaks(power: Array) -> list[int]:
    """Indices of the highest maxima."""
    inner = np.flatnonzero((power[1:-1] >= power[:-2]) & (power[1:-1] > power[2:])) + 1
    every = np.concatenate([inner, [int(np.argmax(power))]])
    return [int(k) for k in every[np.argsort(-power[every], kind="stable")][:_PEAKS]]


def _harmonics(t: Array, frequency: Array, terms: int) -> Array:
    """Columns (m, n, 3 + 2 terms) of the model at times (n,) for frequencies (m,): the drift, then cosines, then sines."""
    out = np.empty((len(frequency), len(t), _DRIFT + 1 + 2 * terms))
    out[:, :, : _DRIFT + 1] = np.vander(t / max(float(np.ptp(t)), 1e-9), _DRIFT + 1)
    first = np.exp(2j * np.pi * np.outer(frequency, t))
    turned = first.copy()
    for k in range(terms):
        out[:, :, _DRIFT + 1 + k], out[:, :, _DRIFT + 1 + terms + k] = turned.real, turned.imag
        turned *= first
    return out


def _solved(columns: Array, y: Array, w: Array) -> Array:
    """Coefficients (m, k) of weighted least squares for columns (m, n, k); a trace of a ridge keeps free ones finite."""
    weighted = np.swapaxes(columns * w[:, None], 1, 2)
    normal = weighted @ columns
    diagonal = np.arange(normal.shape[1])
    normal[:, diagonal, diagonal] += _RIDGE * normal[:, diagonal, diagonal].mean(axis=1, keepdims=True)
    return np.asarray(np.linalg.solve(normal, (weighted @ y)[..., None])[..., 0])


def _fitted(c: _Curve, frequency: Array, terms: int) -> Array:
    """The models (m, n) of a pass."""
    columns = _harmonics(c.t, frequency, terms)
    return np.asarray((columns @ _solved(columns, c.y, c.w)[..., None])[..., 0])


def _chi2(curves: Sequence[_Curve], frequency: Array, terms: int) -> Array:
    """Of all passes, for each frequency (m,)."""
    return np.asarray(sum((c.y - _fitted(c, frequency, terms)) ** 2 @ c.w for c in curves))


def _sharpened(curves: Sequence[_Curve], frequency: float, longest: float, terms: int) -> float:
    """The frequency of least chi2 near one, to a hundredth of the resolution of the longest pass over the harmonics."""
    step = 0.15 / (longest * terms)
    for _ in range(4):
        tried = frequency + step * np.linspace(-1.0, 1.0, 5)
        frequency = float(tried[int(np.argmin(_chi2(curves, tried, terms)))])
        step *= 0.5
    return frequency


def _refined(curves: Sequence[_Curve], frequency: float, longest: float, orders: Sequence[int]) -> tuple[float, float, int]:
    """The nearby frequency, its Bayesian information, and how many harmonics make that least."""
    n = sum(len(c.t) for c in curves)
    # a few harmonics see where the minimum lies, more of them see it sharper
    centre = frequency
    for terms, reach, points in ((4, 0.12, 13), (8, 0.015, 7)):
        near = centre + reach / longest * np.linspace(-1.0, 1.0, points)
        if (2 * terms + _DRIFT + 1) * len(curves) <= 0.4 * n:
            centre = float(near[int(np.argmin(_chi2(curves, near, terms)))])
    best = (centre, np.inf, 1)
    for terms in orders:
        used = (2 * terms + _DRIFT + 1) * len(curves)
        if used > 0.4 * n:
            break
        near = centre + 0.06 / (longest * terms) * np.linspace(-1.0, 1.0, 5)
        every = _chi2(curves, near, terms)
        cost = n * float(np.log(max(float(every.min()), 1e-300) / n)) + used * float(np.log(n))
        if cost < best[1]:
            best = (float(near[int(np.argmin(every))]), cost, terms)
    return best


def _shortest(curves: Sequence[_Curve], found: tuple[float, float, int], longest: float, highest: float) -> tuple[float, int]:
    """A half or third of the period where that fits and predicts as well: light that changes from turn to turn asks for more.

    Both have harmonics up to the same frequency, and predict blocks that they were not fitted to.
    """
    frequency, least, terms = found
    n = sum(len(c.t) for c in curves)
    for part in (3, 2):
        at, cost, order = _refined(curves, part * frequency, longest, _ORDERS)
        if at > highest or cost > least + _LIKE * n:
            continue
        if _left_elsewhere(curves, at, _REPEAT_TERMS) < _left_elsewhere(curves, frequency, part * _REPEAT_TERMS):
            return at, order
    return frequency, terms


def _left_elsewhere(curves: Sequence[_Curve], frequency: float, terms: int) -> float:
    """Scatter about the model in blocks of time that it was not fitted to, over the scatter: below 1 where the light repeats."""
    before, after = 0.0, 0.0
    for c in curves:
        block = np.minimum((_BLOCKS * (c.t - c.t[0]) / c.span).astype(int), _BLOCKS - 1)
        columns = _harmonics(c.t, np.array([frequency]), terms)[0, :, _DRIFT:]
        for k in range(_BLOCKS):
            out = block == k
            if not out.any() or (~out).sum() <= 2 * terms + _DRIFT + 2:
                continue
            coefficients = _solved(columns[None, ~out], c.y[~out], c.w[~out])[0]
            level = float(np.average(c.y, weights=c.w * ~out))
            before += float(c.w[out] @ (c.y[out] - level) ** 2)
            after += float(c.w[out] @ (c.y[out] - columns[out] @ coefficients) ** 2)
    return after / before if before > 0.0 else 1.0


def _string_alarm(curves: Sequence[_Curve], frequency: float, rng: np.random.Generator) -> float:
    """Share of curves whose magnitudes were shuffled within their pass that have as short a string."""

    def length(values: Sequence[Array]) -> float:
        total = 0.0
        for c, y in zip(curves, values, strict=True):
            phase = np.mod(c.t * frequency, 1.0)
            order = np.argsort(phase, kind="stable")
            scaled = 0.5 * y[order] / max(float(np.ptp(y)), 1e-12)
            along = np.diff(phase[order], append=phase[order[:1]] + 1.0)
            total += float(np.hypot(np.diff(scaled, append=scaled[:1]), along).sum())
        return total

    own = length([c.y for c in curves])
    shorter = sum(length([rng.permutation(c.y) for c in curves]) <= own for _ in range(_SHUFFLES))
    return (shorter + 1) / (_SHUFFLES + 1)


def _amplitude_and_error(curves: Sequence[_Curve], frequency: float, terms: int) -> tuple[float, float]:
    """Peak to peak of the largest pass's model (mag), and one sigma of the frequency (Hz) from the curvature of chi2."""
    n = sum(len(c.t) for c in curves)
    step = 0.05 / (max(c.span for c in curves) * terms)
    below, chi2, above = (float(value) for value in _chi2(curves, frequency + step * np.array([-1.0, 0.0, 1.0]), terms))
    scale = chi2 / max(n - (2 * terms + _DRIFT + 1) * len(curves), 1)
    bend = (above + below - 2.0 * chi2) / step**2
    swing, once = 0.0, np.linspace(0.0, 1.0 / frequency, 200)
    turn = _harmonics(once, np.array([frequency]), terms)[0, :, _DRIFT + 1 :]
    for c in curves:
        coefficients = _solved(_harmonics(c.t, np.array([frequency]), terms), c.y, c.w)[0, _DRIFT + 1 :]
        swing = max(swing, float(np.ptp(turn @ coefficients)))
    return swing, float(np.sqrt(2.0 * scale / bend)) if bend > 0.0 else float("inf")
