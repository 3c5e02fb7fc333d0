"""The period that the passes of an object share, and how likely chance shows as clear a one.

Each pass has a light curve of its own: the aspect changes from pass to pass, and over days an error of 1e-4 in the period turns
the phase by more than a revolution. Passes therefore share the frequency alone. A curve is a sum of harmonics and a parabola
(range, phase and aspect change slowly). Its chi-square is the generalised Lomb-Scargle power with several terms (VanderPlas &
Ivezic 2015, ApJ 812, 18).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from astropy.timeseries import LombScargle
from numpy.typing import NDArray
from scipy import stats

from ground.characterisation.passes import LightPass

Array = NDArray[np.float64]

FEWEST_SAMPLES: Final = 24
"""Of a pass: twice the numbers that the richest curve and the parabola have."""

LEAST_CYCLES: Final = 2.0
"""A longer period is not told from a trend."""

HARMONICS: Final = (1, 2, 4)
MULTIPLES: Final = (1.0, 2.0, 3.0, 4.0, 0.5, 1.0 / 3.0)
"""Of the period with the highest power: a body with two like sides shows half its period, a flash many harmonics."""

_OVERSAMPLED: Final = 10.0


@dataclass(frozen=True, kw_only=True)
class Period:
    """period_s and its one-sigma error; false_alarm : probability of as clear a period without any; string_length : of the folded
    curve, as a share of that in random order (Lafler & Kinman 1965, ApJS 11, 216): near 1 without a period, small with one.
    repeats : what the curve of one half of a pass predicts of the other half's variance, over what one of both halves explains.
    Slow changes that do not repeat, which a few sines may follow closely, have little of it; a period has nearly 1.

    NaN where the passes are too short to tell. harmonics : of the curve; amplitude_mag : from the brightest to the faintest point
    of the fitted curve, median over the passes.
    """

    period_s: float = float("nan")
    period_err_s: float = float("nan")
    false_alarm: float = float("nan")
    string_length: float = float("nan")
    repeats: float = float("nan")
    harmonics: int = 0
    amplitude_mag: float = float("nan")


@dataclass(frozen=True, kw_only=True, eq=False)
class _Steady:
    """A pass without its parabola; chi2 : of what is left."""

    t_s: Array
    mag: Array
    mag_err: Array
    chi2: float


def find_period(passes: Sequence[LightPass]) -> Period:
    """The most probable common period of passes; all numbers NaN where no pass has samples enough."""
    steady = [_without_parabola(p) for p in passes if len(p.t_s) >= FEWEST_SAMPLES]
    if not steady:
        return Period()
    span_s = max(float(p.t_s[-1]) for p in steady)
    step_s = float(np.median(np.concatenate([np.diff(p.t_s) for p in steady])))
    lowest, highest = LEAST_CYCLES / span_s, 0.5 / step_s
    if not highest > lowest:
        return Period()
    grid = np.arange(lowest, highest, 1.0 / (_OVERSAMPLED * span_s))
    highest_power = {int(np.argmax(_gain(steady, grid, harmonics))) for harmonics in HARMONICS}
    candidates = {round(grid[k] / multiple * _OVERSAMPLED * span_s) for k in highest_power for multiple in MULTIPLES}
    tried = [
        (*_refined(steady, number / (_OVERSAMPLED * span_s), terms, span_s), terms)
        for number in sorted(candidates)
        if lowest <= number / (_OVERSAMPLED * span_s) <= highest
        for terms in HARMONICS
    ]
    n = sum(len(p.t_s) for p in steady)
    frequency, gain_best, terms = max(
        tried, key=lambda one: one[1] / _scatter(steady, one[1], one[2]) - _numbers(steady, one[2]) * np.log(n)
    )
    left = _scatter(steady, gain_best, terms) / _worth(steady, frequency, terms)
    return Period(
        period_s=1.0 / frequency,
        period_err_s=max(
            _frequency_error(steady, frequency, terms, left, span_s), _scatter_of_passes(steady, frequency, terms, span_s)
        )
        / frequency**2,
        false_alarm=_false_alarm(steady, frequency, gain_best, terms, (highest - lowest) * span_s),
        string_length=float(np.median([_string_length(p, frequency) for p in steady])),
        repeats=_predicted(steady, frequency, terms) / max(gain_best / sum(p.chi2 for p in steady), 1e-6),
        harmonics=terms,
        amplitude_mag=float(np.median([float(np.ptp(_curve(p, frequency, terms))) for p in steady])),
    )


def _without_parabola(one: LightPass) -> _Steady:
    """Weighted least squares of a parabola taken out."""
    x = 2.0 * (one.t_s - one.t_s[0]) / max(one.t_s[-1] - one.t_s[0], 1e-9) - 1.0
    mag = one.mag - np.polyval(np.polyfit(x, one.mag, 2, w=1.0 / one.mag_err), x)
    return _Steady(t_s=one.t_s - one.t_s[0], mag=mag, mag_err=one.mag_err, chi2=float(np.sum((mag / one.mag_err) ** 2)))


def _search(one: _Steady, harmonics: int) -> LombScargle:
    return LombScargle(one.t_s, one.mag, one.mag_err, nterms=harmonics, fit_mean=True, center_data=True)


def _gain(passes: Sequence[_Steady], frequency: Array, harmonics: int) -> Array:
    """How much harmonics of these frequencies (m,) lower the chi-square, summed over the passes."""
    method = "slow" if harmonics == 1 else "fastchi2"
    out = np.zeros(len(frequency))
    for one in passes:
        power = _search(one, harmonics).power(frequency, method=method, assume_regular_frequency=True)
        out += one.chi2 * np.clip(np.nan_to_num(power), 0.0, 1.0)
    return out


def _refined(passes: Sequence[_Steady], frequency: float, harmonics: int, span_s: float) -> tuple[float, float]:
    """The highest gain within a resolution of the grid, on one ten times finer; its frequency and value."""
    step = 1.0 / (_OVERSAMPLED * span_s * harmonics)
    near = frequency + step * np.linspace(-1.5, 1.5, 31)
    near = near[near > 0.0]
    gain = _exact(passes, near, harmonics)
    best = int(np.argmax(gain))
    return float(near[best]), float(gain[best])


def _exact(passes: Sequence[_Steady], frequency: Array, harmonics: int) -> Array:
    """`_gain` by least squares at each frequency, without the grid's interpolation."""
    out = np.zeros(len(frequency))
    for one in passes:
        weighted = one.mag / one.mag_err
        for k, f in enumerate(frequency):
            design = _design(one.t_s, float(f), harmonics) / one.mag_err[:, None]
            solution = np.linalg.lstsq(design, weighted, rcond=None)[0]
            out[k] += one.chi2 - float(np.sum((weighted - design @ solution) ** 2))
    return out


def _design(t_s: Array, frequency: float, harmonics: int) -> Array:
    """A constant and the sines and cosines of the harmonics, (n, 1 + 2 harmonics)."""
    angle = 2.0 * np.pi * frequency * t_s[:, None] * np.arange(1, harmonics + 1)
    return np.hstack([np.ones((len(t_s), 1)), np.sin(angle), np.cos(angle)])


def _curve(one: _Steady, frequency: float, harmonics: int) -> Array:
    """The fitted curve over one period, 200 points; no farther than the samples reach, so that it is no extrapolation."""
    design = _design(one.t_s, frequency, harmonics) / one.mag_err[:, None]
    solution = np.linalg.lstsq(design, one.mag / one.mag_err, rcond=None)[0]
    return np.asarray(_design(np.linspace(0.0, 1.0 / frequency, 200), frequency, harmonics) @ solution)


def _numbers(passes: Sequence[_Steady], harmonics: int) -> int:
    """Numbers that the curves of all passes have."""
    return 2 * harmonics * len(passes)


def _free(passes: Sequence[_Steady], harmonics: int) -> int:
    """Degrees of freedom that samples leave; three are the parabola's."""
    return max(sum(len(p.t_s) - 3 for p in passes) - _numbers(passes, harmonics), 1)


def _scatter(passes: Sequence[_Steady], gain: float, harmonics: int) -> float:
    """Chi-square that is left, for each degree of freedom: stated errors need not be right; at least 1e-6."""
    return max((sum(p.chi2 for p in passes) - gain) / _free(passes, harmonics), 1e-6)


def _false_alarm(passes: Sequence[_Steady], frequency: float, gain: float, harmonics: int, resolutions: float) -> float:
    """Probability of as large a gain at any frequency and number of harmonics without a period.

    The gain over the scatter follows an F distribution at each frequency (Zechmeister & Kuerster 2009 for one pass and harmonic).
    """
    worth = _worth(passes, frequency, harmonics)
    numbers, free = _numbers(passes, harmonics), worth * _free(passes, harmonics)
    ratio = worth * gain / numbers / _scatter(passes, gain, harmonics)
    single = float(stats.f.logsf(ratio, numbers, max(free, 1.0)))
    trials = 2.0 * len(HARMONICS) * max(resolutions, 1.0)
    return float(-np.expm1(trials * np.log1p(-np.exp(single)))) if single < -1e-12 else 1.0


def _worth(passes: Sequence[_Steady], frequency: float, harmonics: int) -> float:
    """Independent samples in one sample, (1 - r) / (1 + r) for the correlation r >= 0 of what the curve leaves in neighbours."""
    above = below = 0.0
    for one in passes:
        design = _design(one.t_s, frequency, harmonics) / one.mag_err[:, None]
        left = one.mag / one.mag_err - design @ np.linalg.lstsq(design, one.mag / one.mag_err, rcond=None)[0]
        above += float(left[1:] @ left[:-1])
        below += float(left @ left)
    r = min(max(above / below, 0.0), 0.95) if below > 0.0 else 0.0
    return (1.0 - r) / (1.0 + r)


def _frequency_error(passes: Sequence[_Steady], frequency: float, harmonics: int, scatter: float, span_s: float) -> float:
    """One sigma from the curvature of the chi-square at its lowest point."""
    step = 0.05 / (span_s * harmonics)
    low, middle, high = _exact(passes, np.array([frequency - step, frequency, frequency + step]), harmonics)
    curvature = (2.0 * middle - low - high) / step**2
    return float(np.sqrt(2.0 * scatter / curvature)) if curvature > 0.0 else float("inf")


def _scatter_of_passes(passes: Sequence[_Steady], frequency: float, harmonics: int, span_s: float) -> float:
    """Jackknife error of the frequency, leaving out each pass in turn; 0 with one pass."""
    if len(passes) < 2:
        return 0.0
    without = [_refined([p for m, p in enumerate(passes) if m != k], frequency, harmonics, span_s)[0] for k in range(len(passes))]
    return float(np.sqrt((len(passes) - 1.0) * np.var(without)))


def _predicted(passes: Sequence[_Steady], frequency: float, harmonics: int) -> float:
    """One minus the chi-square of halves about the curve of the other half, over that about their own mean."""
    missed = alone = 0.0
    for one in passes:
        first = one.t_s < 0.5 * one.t_s[-1]
        design = _design(one.t_s, frequency, harmonics) / one.mag_err[:, None]
        weighted, unit = one.mag / one.mag_err, 1.0 / one.mag_err
        for told, asked in ((first, ~first), (~first, first)):
            left = weighted[asked] - design[asked] @ np.linalg.lstsq(design[told], weighted[told], rcond=1e-3)[0]
            for chi, values in ((0, left), (1, weighted[asked])):
                values = values - unit[asked] * float(values @ unit[asked]) / float(unit[asked] @ unit[asked])
                missed, alone = (missed + float(values @ values), alone) if chi == 0 else (missed, alone + float(values @ values))
    return 1.0 - missed / alone if alone > 0.0 else float("nan")


def _string_length(one: _Steady, frequency: float) -> float:
    """Mean square step between neighbours in phase, over that of a random order (twice the variance)."""
    folded = one.mag[np.argsort(np.mod(one.t_s * frequency, 1.0), kind="stable")]
    variance = float(np.var(folded))
    return float(np.mean(np.diff(np.append(folded, folded[0])) ** 2)) / (2.0 * variance) if variance > 0.0 else float("nan")
