"""Brightness along a trail: densities in equal bins, whether they vary, and a period where there is one."""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

BIN_WIDTHS: Final = 4.0
"""Shortest bin in PSF widths: neighbouring bins are then nearly independent."""

BIN_SNR: Final = 2.0
"""Least S/N of one bin: fewer, longer bins for fainter trails."""

MOST_BINS: Final = 200
"""A limit of the size of a record: bins become longer on longer trails. Chosen, not measured."""
SLACK: Final = 1.3
"""The power of a period may be this much higher than that of the plain spectrum."""

FALSE_ALARM: Final = 1e-3
"""False-alarm probability of the variability test and of the period."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LightCurve:
    """density_e_px, sigma_e_px : (k,) in equal bins from end 0 to end 1.

    variable : beyond chance. period_fraction : of the trail, None without a period.
    """

    density_e_px: NDArray[np.float64]
    sigma_e_px: NDArray[np.float64]
    variable: bool
    period_fraction: float | None


def light_curve(
    u: NDArray[np.float64],
    profile: NDArray[np.float64],
    value_e: NDArray[np.float64],
    variance_e2: NDArray[np.float64],
    *,
    ends: tuple[float, float],
    smooth_density_e_px: NDArray[np.float64],
    width_px: float,
    snr: float,
) -> LightCurve:
    """Least-squares density of each bin; bins that masks leave empty hold the smooth model.

    u, value_e, variance_e2 : (n,). profile : (n,) cross-trail profile per unit density. smooth_density_e_px : (n,)
    density of the fitted model, for the noise and as what "constant" means. Bins touching an end miss light of the
    PSF's edge, so the outermost width of the trail is not used.
    """
    length = ends[1] - ends[0]
    empty = LightCurve(density_e_px=np.zeros(0), sigma_e_px=np.zeros(0), variable=False, period_fraction=None)
    n_bins = int(min(length / (BIN_WIDTHS * width_px), (snr / BIN_SNR) ** 2, MOST_BINS))
    if n_bins < 4:
        return empty
    inner = (u > ends[0] + width_px) & (u < ends[1] - width_px)
    place = np.clip(((u[inner] - ends[0]) * (n_bins / length)).astype(np.int64), 0, n_bins - 1)
    weight = 1.0 / (variance_e2[inner] + np.maximum(smooth_density_e_px[inner] * profile[inner], 0.0))
    information = np.bincount(place, weight * profile[inner] ** 2, n_bins)
    seen = information > 0.2 * np.median(information)
    if np.count_nonzero(seen) < 4:
        return empty
    known = np.where(seen, information, 1.0)
    smooth = np.bincount(place, weight * profile[inner] ** 2 * smooth_density_e_px[inner], n_bins) / known
    smooth = np.interp(np.arange(n_bins), np.flatnonzero(seen), smooth[seen])
    measured = np.bincount(place, weight * profile[inner] * value_e[inner], n_bins) / known
    density = np.where(seen, measured, smooth)
    # what no pixel shows may be as far off as there is light
    sigma = np.where(seen, 1.0 / np.sqrt(known), np.maximum(np.abs(smooth), 1.0 / np.sqrt(np.median(information[seen]))))
    chi2 = float(np.sum(((density - smooth) / sigma)[seen] ** 2))
    freedom = int(np.count_nonzero(seen)) - 1
    # Wilson & Hilferty (1931): the cube root of chi2/nu is nearly Gaussian
    deviate = ((chi2 / freedom) ** (1.0 / 3.0) - (1.0 - 2.0 / (9.0 * freedom))) / math.sqrt(2.0 / (9.0 * freedom))
    variable = deviate > 3.1
    return LightCurve(
        density_e_px=density,
        sigma_e_px=sigma,
        variable=variable,
        period_fraction=_period((density - smooth)[seen], sigma[seen], (np.flatnonzero(seen) + 0.5) / n_bins),
    )


def _period(residual: NDArray[np.float64], sigma: NDArray[np.float64], position: NDArray[np.float64]) -> float | None:
    """Period in fractions of the trail by Lomb-Scargle (Zechmeister & Kurster 2009), None above the false-alarm limit."""
    n = residual.size
    if n < 8:
        return None
    # the plain spectrum, as if the bins were all there and equally good, tells at once whether a search can find anything
    weight = sigma**-2
    centred = residual - np.average(residual, weights=weight)
    spectrum = np.abs(np.fft.rfft(centred * weight, 8 * n)) ** 2
    power = SLACK * 2.0 * float(spectrum.max()) / (weight.sum() * float(weight @ centred**2))
    if n * max(1.0 - power, 0.0) ** (0.5 * (n - 3)) > FALSE_ALARM:
        return None
    from astropy.timeseries import LombScargle  # takes a tenth of a second, which trails that do not vary do not need

    # at least 1.5 cycles in the trail, at most the Nyquist rate of the bins
    frequency = np.linspace(1.5, 0.5 * n, max(8 * n, 32))
    search = LombScargle(position, residual, sigma)
    power = search.power(frequency)
    best = int(np.argmax(power))
    # a perfect sinusoid has power 1, where the formula divides by zero
    peak = min(float(power[best]), 1.0 - 1e-9)
    chance = search.false_alarm_probability(peak, maximum_frequency=0.5 * n, method="baluev")
    return float(1.0 / frequency[best]) if chance < FALSE_ALARM else None
