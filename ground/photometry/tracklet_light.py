"""Mean light of a tracklet whose object may tumble. Its error includes the unobserved part of the light curve.

The result is V of the object's mean light over its light curve, at the mean epoch of the exposures. Relative fluxes are

    f_i = F [1 + g (t_i - t_mean) + a cos(2 pi t_i / P) + b sin(2 pi t_i / P) + second harmonic] + w_i + noise_i

with a slow trend g (the range changes), a curve of unknown period P with two harmonics, and scatter w without memory for
everything that is faster or of another shape. Given P and the scales of a, b and w, F is the mean of a normal distribution in
closed form. The posterior is the mixture over a grid of periods and scales. With one exposure it is the prior of unobserved
variation, with a whole turn the fitted mean of the curve. A period that is too long for the arc stays in the error. Flashes that
were recognised on trails are not in these fluxes; their mean light is added.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr, ndtr

from ground.photometry.zero_point import POGSON
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.products import StreakMeasurement, Tracklet

Array = NDArray[np.float64]

VARIABLE_SHARE: Final = 1.0 / 3.0
"""Objects whose light varies, before the data: fragments of break-ups mostly tumble, others have come to rest. ASSUMED; the
posterior of a tracklet of a turn or more hardly depends on it."""

PERIODS_S: Final = (0.05, 30.0)
"""Periods are log-uniform between these: tumbling debris turns in a fraction of a second to minutes (Silha et al. 2018, ASR 61,
844), and slower rotation is practically steady during a passage of seconds."""

SCALES: Final = (0.07, 0.2, 0.45)
"""Standard deviations of a and b, relative to the mean light, each as probable as the others."""

WHITE: Final = ((0.0, 0.94), (0.05, 0.04), (0.25, 0.02))
"""Relative scatter without memory, and its prior probability."""

MOST_PERIODS: Final = 500
"""A budget of work and memory; longer arcs are searched with wider steps. Chosen, not measured."""
STEPS_PER_CYCLE: Final = 4.0
"""Frequencies are 1 / (this x span) apart, finer than a peak of the periodogram."""

SLOW_PERIODS: Final = 12
"""Even in the logarithm, for less than one turn in the arc: neighbours hardly differ there. Chosen, not measured."""
SECOND_HARMONIC: Final = 1.0 / 3.0
"""Scale of the second harmonic over that of the first."""

TREND_PER_RADIAN: Final = 2.0
"""Standard deviation of the change of ln(light) with the angle moved through: d(ln f)/dt = -2 (range rate / range), and the range
rate is of the order of the transverse velocity."""

SHARED_ERROR_MAG: Final = 0.007
"""Common error of the members of a tracklet, which their scatter does not show: the flat's slope along the path, the PSF width,
the catalogue's colours. By maximum likelihood, of bright steady objects, 0.0035 [0.003, 0.004] mag in `nadir_rotation` (77
tracklets), in `sso_antisun` 0.007 [0.005, 0.009] with the ideal camera (28) and 0.008 [0.006, 0.011] with the real one (24)."""

FEWEST_BINS: Final = 4
"""Fewer bins cannot show a change beside the trend; chosen, not measured."""
MOST_BINS: Final = 12
"""Bins of one trail, a budget of work. Chosen, not measured."""
BIN_SNR: Final = 4.0
"""Bins are joined to this S/N: relative errors of a quarter, still near to normal. Chosen, not measured."""
SIGMAS_90: Final = 1.645
"""Half width of a 90 % interval: the 95 % point of the normal distribution."""
HALF_POINT_SNR: Final = 7.2
"""S/N at which the default chain finds half of the trails (docs/survey.md: 7.26 [7.10, 7.38])."""

THRESHOLD_WIDTH: Final = 0.6
"""Sigma, in S/N, by which the threshold differs from one trail to the next. Of trails of S/N 6.0 on board finds 0.2, of 7.2 0.57,
of 8.6 0.92, of 10 all, which is a threshold of this width under noise of one. With a sharp threshold, exposures below it would
speak for an object without any light."""

SURELY_FOUND: Final = 3.0
"""Exposures this many sigma above the half point were not chosen by their noise."""

LEAST_WEIGHT: Final = 1e-6
"""Periods and scatters whose weight is below this share of the best are left out: a budget of work."""
NEWTON_STEPS: Final = 20
"""A budget: the loop ends at a step of 1e-6 of the half point."""
_FLOOR: Final = 0.02
"""Least mean light, relative to the brightness seen, that a posterior may reach: magnitudes need a positive one."""


@dataclass(frozen=True, kw_only=True)
class TrackletLight:
    """Light of a tracklet. mag : V of the mean light, posterior median; mag_err : half of its 68.3 % interval.

    mag_low, mag_high : 5 % and 95 % points (the bright one first). scatter_mag : rms of the object's light about its mean, as
    1.0857 x relative light, and scatter_err_mag, one sigma. chi2_nu : of constant light, NaN with one sample.
    """

    mag: float
    mag_err: float
    mag_low: float
    mag_high: float
    scatter_mag: float
    scatter_err_mag: float
    chi2_nu: float


UNKNOWN: Final = TrackletLight(
    mag=np.nan, mag_err=np.nan, mag_low=np.nan, mag_high=np.nan, scatter_mag=np.nan, scatter_err_mag=np.nan, chi2_nu=np.nan
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Samples:
    """Light of exposures, or of parts of them: mid-epoch t_s (n,), duration_s (n,), light and light_err (n,).

    light : in units of that of the magnitude reference_mag; noise makes some of it negative where exposures were not chosen by
    their own light. snr : (n,) of exposures that were; NaN for others, and for parts.
    """

    t_s: Array
    duration_s: Array
    light: Array
    light_err: Array
    snr: Array
    reference_mag: float

    @classmethod
    def of_magnitudes(cls, *, t_s: Array, duration_s: Array, mag: Array, mag_err: Array, snr: Array) -> "Samples":
        """Samples whose light has a magnitude, in units of their median."""
        reference = float(np.median(mag))
        light = 10.0 ** (-0.4 * (mag - reference))
        return cls(
            t_s=t_s, duration_s=duration_s, light=light, light_err=light * mag_err / POGSON, snr=snr, reference_mag=reference
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Cells:
    """Likely cells of the mixture: log_weight (c,), mean (c, 6) and covariance (c, 6, 6) of the linear parameters."""

    log_weight: Array
    mean: Array
    covariance: Array


def with_mean_light(tracklet: Tracklet, members: Sequence[StreakMeasurement], half_point_snr: float = HALF_POINT_SNR) -> Tracklet:
    """The tracklet with the mean light of the object that its members show, as they were measured last.

    half_point_snr : S/N at which half of the trails are found.
    """
    # a star under a point adds its light to it
    own = [m for m in members if not (m.fit.is_foretold and m.flags & StreakFlag.CROSSES_STAR)]
    known = [m for m in own if np.isfinite(m.mag) and m.mag_err > 0.0]
    dark = [m for m in own if m.fit.is_foretold and not m.fit.flux_e > 0.0 and m.fit.flux_err_e > 0.0]
    samples = with_dark(samples_of(known), known, dark) if known else None
    light = UNKNOWN if samples is None else _with_flashes(mean_light(samples, tracklet.rate_deg_s, half_point_snr), known)
    return replace(
        tracklet,
        mag=light.mag,
        mag_err=light.mag_err,
        mag_low=light.mag_low,
        mag_high=light.mag_high,
        mag_scatter=light.scatter_mag,
        mag_scatter_err=light.scatter_err_mag,
        mag_chi2_nu=light.chi2_nu,
    )


def _with_flashes(steady: TrackletLight, members: Sequence[StreakMeasurement]) -> TrackletLight:
    """The mean light with that of the flashes that were seen.

    n flashes of the energies E in the exposures of the length T add sum(E) / T on average, and an error of sqrt(sum(E^2)) / T,
    because they come by chance in exposures or between them.
    """
    if not any(m.fit.flash_e > 0.0 for m in members):
        return steady
    light = 10.0 ** (-0.4 * (np.array([m.mag for m in members]) - steady.mag))
    share = np.array([m.fit.flash_e / m.fit.flux_e for m in members])
    exposed_s = np.array([max(float(m.t_tai_ns[2] - m.t_tai_ns[0]) * 1e-9, 1e-9) for m in members])
    energy, total_s = light * share * exposed_s, float(exposed_s.sum())
    added, error = float(energy.sum()) / total_s, POGSON * float(np.sqrt(np.sum(energy**2))) / total_s
    mag = steady.mag - 2.5 * float(np.log10(1.0 + added))

    def widened(steady_mag: float, sigmas: float) -> float:
        return float(np.hypot(steady_mag, sigmas * error)) / (1.0 + added)

    return replace(
        steady,
        mag=mag,
        mag_err=widened(steady.mag_err, 1.0),
        mag_low=mag - widened(steady.mag - steady.mag_low, SIGMAS_90),
        mag_high=mag + widened(steady.mag_high - steady.mag, SIGMAS_90),
    )


def samples_of(members: Sequence[StreakMeasurement]) -> Samples:
    """Samples of the steady light of members that have a magnitude: one each, or the bins of a trail along which it varies."""
    origin = min(int(m.t_tai_ns[1]) for m in members)
    rows: list[tuple[float, float, float, float, float]] = []
    for member in members:
        start, middle, stop = ((int(t) - origin) * 1e-9 for t in member.t_tai_ns)
        bins = _bins(member) if stop > start else None
        mag = member.mag - 2.5 * float(np.log10(1.0 - member.fit.flash_e / member.fit.flux_e))
        if bins is None:
            snr = np.nan if member.fit.is_foretold else member.fit.snr
            rows.append((middle, max(stop - start, 0.0), mag, member.mag_err, snr))
            continue
        relative, error = bins
        step = (stop - start) / len(relative)
        # the streak's error is that of all bins together; what a bin adds is that of its share of the light
        own = np.maximum(POGSON * error / relative, member.mag_err * np.sqrt(len(relative)))
        rows += [
            (start + (k + 0.5) * step, step, mag - 2.5 * float(np.log10(relative[k])), float(own[k]), np.nan)
            for k in range(len(relative))
        ]
    t_s, duration_s, mag, mag_err, snr = np.array(rows).T
    return Samples.of_magnitudes(t_s=t_s, duration_s=duration_s, mag=mag, mag_err=mag_err, snr=snr)


def with_dark(samples: Samples, known: Sequence[StreakMeasurement], dark: Sequence[StreakMeasurement]) -> Samples:
    """The samples and those of members in which noise took more than the object gave: they have a flux but no magnitude.

    Members of one tracklet are exposed alike, so that the others tell what light an electron stands for. known : the members
    behind the samples.
    """
    if not dark:
        return samples
    per_electron = float(np.median([10.0 ** (-0.4 * (m.mag - samples.reference_mag)) / m.fit.flux_e for m in known]))
    # samples count from the first known member
    origin = min(int(m.t_tai_ns[1]) for m in known)
    start, middle, stop = ((np.array([int(m.t_tai_ns[k]) for m in dark]) - origin) * 1e-9 for k in range(3))
    return Samples(
        t_s=np.append(samples.t_s, middle),
        duration_s=np.append(samples.duration_s, np.maximum(stop - start, 0.0)),
        light=np.append(samples.light, [per_electron * m.fit.flux_e for m in dark]),
        light_err=np.append(samples.light_err, [per_electron * m.fit.flux_err_e for m in dark]),
        snr=np.append(samples.snr, np.full(len(dark), np.nan)),
        reference_mag=samples.reference_mag,
    )


def _bins(member: StreakMeasurement) -> tuple[Array, Array] | None:
    """Relative light (k,) of equal parts of a trail from end 0 to end 1 and its errors; None for constant or faint ones."""
    density, error = (np.asarray(a, float) for a in (member.fit.light_curve_e_px, member.fit.light_curve_err_e_px))
    needed = StreakFlag.VARIABLE | StreakFlag.DIRECTION_RESOLVED
    if (member.flags & needed) != needed or len(density) < FEWEST_BINS or not (np.isfinite(error) & (error > 0.0)).all():
        return None
    snr = float(density.mean() / np.median(error))
    n_bins = min(int(len(density) * min(1.0, (max(snr, 0.0) / BIN_SNR) ** 2)), MOST_BINS)
    if n_bins < FEWEST_BINS:
        return None
    edge = np.linspace(0, len(density), n_bins + 1).astype(int)
    light = np.array([density[i:j].mean() for i, j in pairwise(edge)])
    sigma = np.array([np.sqrt(np.sum(error[i:j] ** 2)) / (j - i) for i, j in pairwise(edge)])
    light, sigma = light / density.mean(), sigma / density.mean()
    return None if (light < 2.0 * sigma).any() else (light, sigma)


def mean_light(samples: Samples, rate_deg_s: float, half_point_snr: float = HALF_POINT_SNR) -> TrackletLight:
    """The posterior of the mean light of one or more samples, which were found at half_point_snr and above."""
    reference, y, e = samples.reference_mag, samples.light, samples.light_err
    t = samples.t_s - samples.t_s.mean()
    n = len(y)
    weight = e**-2
    # scales are relative to the light; where noise hides it, to one sigma
    flat = max(float(weight @ y / weight.sum()), float(weight.sum() ** -0.5))
    chi2_nu = float(weight @ (y - flat) ** 2) / (n - 1) if n > 1 else np.nan
    frequency, share = _frequencies(t)
    trend = TREND_PER_RADIAN * np.radians(rate_deg_s) if np.isfinite(rate_deg_s) else 0.0
    design = _design(t, samples.duration_s, frequency)

    # cells: steady or a scale for each frequency, times the white scatter
    scales = np.array([0.0, *SCALES])
    prior_scale = np.array([1.0 - VARIABLE_SHARE, *([VARIABLE_SHARE / len(SCALES)] * len(SCALES))])
    variance = np.empty((len(frequency), len(scales), 6))
    variance[..., 0] = 100.0
    variance[..., 1] = max(trend, 1e-6) ** 2
    variance[..., 2:4] = np.maximum(scales, 1e-6)[None, :, None] ** 2
    variance[..., 4:] = SECOND_HARMONIC**2 * variance[..., 2:4]
    variance[..., 1:] *= flat**2
    parts = [_posterior(design, y, np.hypot(e, white * flat), variance) for white, _ in WHITE]
    prior = np.log(share)[:, None] + np.log(prior_scale)[None, :]
    log_weight = np.stack([part[0] + prior + np.log(p) for part, (_, p) in zip(parts, WHITE, strict=True)])
    likely = np.nonzero(log_weight > log_weight.max() + np.log(LEAST_WEIGHT))
    white = np.array([w for w, _ in WHITE])[likely[0]]
    cells = Cells(
        log_weight=log_weight[likely],
        mean=np.stack([part[1] for part in parts])[likely],
        covariance=np.stack([part[2] for part in parts])[likely],
    )
    if (samples.snr < half_point_snr + SURELY_FOUND).any():
        cells = given_detection(cells, design[likely[1]], np.hypot(e, white[:, None] * flat), y * half_point_snr / samples.snr)
    cell = np.exp(cells.log_weight - cells.log_weight.max())
    cell /= cell.sum()
    mean, covariance = cells.mean, cells.covariance
    sigma = np.sqrt(covariance[:, 0, 0] + (SHARED_ERROR_MAG / POGSON * mean[:, 0]) ** 2)
    light = np.maximum(_quantiles(mean[:, 0], sigma, cell), _FLOOR * flat)
    low, lower, middle, upper, high = reference - 2.5 * np.log10(light[::-1])
    spread = np.trace(covariance[:, 2:, 2:], axis1=-2, axis2=-1)
    power = 0.5 * (np.sum(mean[:, 2:] ** 2, axis=-1) + spread) / flat**2 + white**2
    rms = float(cell @ np.sqrt(power))
    rms_err = float(np.sqrt(max(float(cell @ power) - rms**2, 0.0)))
    return TrackletLight(
        mag=float(middle),
        mag_err=max(float(0.5 * (upper - lower)), SHARED_ERROR_MAG),
        mag_low=float(low),
        mag_high=float(high),
        scatter_mag=float(POGSON * rms),
        scatter_err_mag=float(POGSON * rms_err),
        chi2_nu=float(chi2_nu),
    )


def _frequencies(t_s: Array) -> tuple[Array, Array]:
    """Frequencies (k,) in Hz and their prior shares: log-spaced where the arc is less than a turn, evenly above.

    Those above the Nyquist frequency of the samples are aliases of lower ones and are left to the scatter without memory.
    """
    slowest, fastest = 1.0 / PERIODS_S[1], 1.0 / PERIODS_S[0]
    span = float(np.ptp(t_s))
    if span <= 0.0:
        return np.array([np.sqrt(slowest * fastest)]), np.ones(1)
    gap = float(np.median(np.diff(np.unique(t_s))))
    highest = min(max(0.5 / gap, 1.0 / span), fastest)
    turn = min(max(1.0 / span, slowest * 1.01), highest)
    slow = np.geomspace(slowest, turn, SLOW_PERIODS)
    n_fast = min(int((highest - turn) * STEPS_PER_CYCLE * span) + 1, MOST_PERIODS)
    # three times give half a turn per gap and one per arc: the same frequency, but for the last bit
    fast = np.linspace(turn, highest, n_fast + 1)[1:] if highest > 1.001 * turn else np.zeros(0)
    frequency = np.concatenate([slow, fast])
    edges = np.concatenate([[slow[0]], np.sqrt(frequency[1:] * frequency[:-1]), [frequency[-1]]])
    share = np.log(edges[1:] / edges[:-1])
    return frequency, share / share.sum()


def _design(t_s: Array, duration_s: Array, frequency: Array) -> Array:
    """(k, n, 6) mean, trend, cosine and sine at each frequency and at twice that, averaged over the exposures."""
    ones = np.ones((len(frequency), len(t_s)))
    columns = [ones, ones * t_s]
    for order in (1.0, 2.0):
        angle = 2.0 * np.pi * order * frequency[:, None] * t_s
        damped = np.sinc(order * frequency[:, None] * duration_s)
        columns += [damped * np.cos(angle), damped * np.sin(angle)]
    return np.stack(columns, axis=-1)


def _posterior(design: Array, y: Array, sigma: Array, variance: Array) -> tuple[Array, Array, Array]:
    """ln evidence (k, s), mean (k, s, 6) and covariance (k, s, 6, 6) of the linear parameters with prior variances (k, s, 6)."""
    weighted = design / sigma[:, None] ** 2
    information = np.einsum("kni,knj->kij", weighted, design)[:, None] + np.eye(variance.shape[-1]) / variance[..., None]
    projected = np.einsum("kni,n->ki", weighted, y)[:, None, :]
    covariance = np.linalg.inv(information)
    mean = np.einsum("ksij,ksj->ksi", covariance, np.broadcast_to(projected, variance.shape))
    explained = np.einsum("ksi,ksi->ks", mean, np.broadcast_to(projected, variance.shape))
    determinant = np.linalg.slogdet(information)[1] + np.log(variance).sum(axis=-1) + 2.0 * np.log(sigma).sum()
    return 0.5 * (explained - float(np.sum((y / sigma) ** 2)) - determinant), mean, covariance


def given_detection(cells: Cells, design: Array, sigma: Array, half_point: Array) -> Cells:
    """The cells given that each exposure was found: of faint ones those are found that noise and light curve make brighter.

    An exposure of the expected light m is found with probability Phi((m - half_point) / s), by which its likelihood is divided
    (a truncated normal distribution; Eddington 1913, MNRAS 73, 359, has the bias without it). s^2 is the sum of the variances
    of the noise, sigma^2, and of the threshold. Each cell becomes the normal distribution of the same mode and curvature,
    and keeps its weight: exposures that were found do not tell how many were not, and weights by their chance favoured objects
    four magnitudes fainter that would have been found at their brightest alone.
    design : (c, n, 6), sigma (c, n), half_point (n,), NaN where no selection took place, all in units of the light.
    """
    chosen = np.isfinite(half_point)
    design, half_point = design[:, chosen], half_point[chosen]
    sigma = sigma[:, chosen] * np.hypot(1.0, THRESHOLD_WIDTH)
    precision = np.linalg.inv(cells.covariance)
    x = cells.mean
    for _ in range(NEWTON_STEPS):
        u = (np.einsum("cni,ci->cn", design, x) - half_point) / sigma
        hazard = _hazard(u)
        gradient = np.einsum("cij,cj->ci", precision, x - cells.mean) + np.einsum("cni,cn->ci", design, hazard / sigma)
        lost = hazard * (u + hazard) / sigma**2
        hessian = precision - np.einsum("cni,cn,cnj->cij", design, lost, design)
        step = np.linalg.solve(hessian, gradient[..., None])[..., 0]
        x = x - step
        if np.max(np.abs(step[:, 0])) < 1e-6 * float(np.max(half_point)):
            break
    return Cells(log_weight=cells.log_weight, mean=x, covariance=np.linalg.inv(hessian))


def _hazard(u: Array) -> Array:
    """phi(u) / Phi(u), which goes to -u far below 0."""
    return np.asarray(np.exp(-0.5 * u * u - 0.5 * np.log(2.0 * np.pi) - log_ndtr(u)))


def _quantiles(mean: Array, sigma: Array, weight: Array) -> Array:
    """5, 15.87, 50, 84.13 and 95 % points (5,) of a mixture of normal distributions."""
    points = np.array([0.05, 0.158655, 0.5, 0.841345, 0.95])
    low = np.full(5, float((mean - 6.0 * sigma).min()))
    high = np.full(5, float((mean + 6.0 * sigma).max()))
    for _ in range(40):
        middle = 0.5 * (low + high)
        below = (ndtr((middle[:, None] - mean) / sigma) @ weight) < points
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return 0.5 * (low + high)
