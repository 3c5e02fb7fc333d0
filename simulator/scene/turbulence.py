"""Turbulence during an exposure, for a moving object above a ground site: its brightness and its place at each instant.

A star's light is the mean over the exposure; along a trail the same turbulence shows as knots and wiggles. Both series are
stationary Gaussian ones (of the logarithm, for brightness) with a one-sided power spectrum each, drawn anew for each
exposure and object.

Brightness: flat at low frequencies, at the level whose mean over long exposures has Young's variance, and falling above the
inverse of the time in which the wind crosses the aperture (Dravins et al. 1997, PASP 109, 173; 1998, PASP 110, 610).
Place: a tilt of variance ``0.18 lambda^2 r0^(-5/3) D^(-1/3)`` on each axis (Sarazin & Roddier 1990, A&A 227, 294; Martin
1987, PASP 99, 1360), falling as f^(-2/3) and above 0.24 V/D as f^(-11/3) (Tyler 1994, JOSA A 11, 358).
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LARGEST_TILT_SHARE: Final = 0.9
"""Largest share of the variance of the seeing disc. Apertures near the Fried length see only tilt, and the formula would exceed
it."""
_SAMPLES_PER_CROSSING: Final = 8  # up to 13 knees of the brightness and 17 of the tilt; 2e-4 of the former's variance lies beyond
_MOST_SAMPLES: Final = 1 << 18  # bounds memory and time of the transform; longer exposures have coarser steps


@dataclass(frozen=True, kw_only=True, eq=False)
class Unsteadiness:
    """What turbulence does to one object in one exposure, at equal steps from `start_s` after the epoch of the run.

    factor : (n,) of the flux, mean 1 over many exposures. shift_rad : (n, 2) along rows and cols.
    tilt_sigma_rad : rms of each axis, which the blur of the image must not contain again.
    """

    start_s: float
    step_s: float
    factor: Array
    shift_rad: Array
    tilt_sigma_rad: float

    def at(self, time_s: Array) -> tuple[Array, Array, Array]:
        """Factor of the flux and shifts (rad) along rows and cols at times, linear between the steps."""
        steps = (np.asarray(time_s) - self.start_s) / self.step_s
        nodes = np.arange(len(self.factor))
        row, col = (np.interp(steps, nodes, self.shift_rad[:, k]) for k in range(2))
        return np.interp(steps, nodes, self.factor), row, col


def crossing_s(aperture_m: float, wind_m_s: float) -> float:
    """Time in which the wind crosses the aperture."""
    return aperture_m / wind_m_s


def brightness_spectrum(frequency_hz: Array, long_exposure_rms_1s: float, crossing: float) -> Array:
    """One-sided power (1/Hz) of the relative flux: white at low frequencies, so that a mean over T has Young's variance.

    long_exposure_rms_1s : Young's rms for an exposure of 1 s; the level is twice its square.
    """
    corner_hz = 1.0 / (np.pi * crossing)
    return np.asarray(2.0 * long_exposure_rms_1s**2 / (1.0 + (frequency_hz / corner_hz) ** 2) ** 2)


def tilt_spectrum(frequency_hz: Array, crossing: float, lowest_hz: float) -> Array:
    """Shape of the one-sided power of the tilt; `lowest_hz`, wind over outer scale, is where its rise towards zero ends."""
    knee_hz = 0.24 / crossing
    low = (frequency_hz**2 + lowest_hz**2) ** (-1.0 / 3.0)
    return np.asarray(low * (1.0 + (frequency_hz / knee_hz) ** 2) ** -1.5)


def tilt_variance_rad2(seeing_sigma_rad: float, wavelength_m: float, aperture_m: float) -> float:
    """Variance of each axis of the image motion under a seeing disc of a Gaussian sigma (FWHM = 0.98 lambda / r0)."""
    if seeing_sigma_rad == 0.0:
        return 0.0
    fried_m = 0.98 * wavelength_m / (2.354820 * seeing_sigma_rad)
    free = 0.18 * wavelength_m**2 * fried_m ** (-5.0 / 3.0) * aperture_m ** (-1.0 / 3.0)
    return float(min(free, LARGEST_TILT_SHARE * seeing_sigma_rad**2))


def draw_unsteadiness(
    rng: np.random.Generator,
    *,
    from_s: float,
    to_s: float,
    crossing: float,
    long_exposure_rms_1s: float,
    tilt_variance: float,
    lowest_hz: float,
) -> Unsteadiness:
    """Series between two times; either effect is absent where its rms is 0."""
    n = int(np.clip(np.ceil((to_s - from_s) / crossing * _SAMPLES_PER_CROSSING), 8, _MOST_SAMPLES))
    step_s = (to_s - from_s) / n
    # A series twice as long as needed: an inverse transform is periodic, and its ends must not know each other.
    frequency_hz = np.fft.rfftfreq(2 * (n + 1), step_s).astype(np.float64)
    logarithm = _series(rng, brightness_spectrum(frequency_hz, long_exposure_rms_1s, crossing), step_s)
    variance = _variance(brightness_spectrum(frequency_hz, long_exposure_rms_1s, crossing), step_s)
    shape = tilt_spectrum(frequency_hz, crossing, lowest_hz)
    shape *= tilt_variance / _variance(shape, step_s)
    tilts = [_series(rng, shape, step_s) for _ in range(2)]
    return Unsteadiness(
        start_s=from_s,
        step_s=step_s,
        factor=np.exp(logarithm[: n + 1] - 0.5 * variance),
        shift_rad=np.stack([t[: n + 1] for t in tilts], axis=1),
        tilt_sigma_rad=float(np.sqrt(tilt_variance)),
    )


def _variance(power: Array, step_s: float) -> float:
    """Variance of a series with a one-sided spectrum at the frequencies of a real transform; zero frequency counts half."""
    bins = 2 * (len(power) - 1)
    return float((power[1:-1].sum() + 0.5 * (power[0] + power[-1])) / (bins * step_s))


def _series(rng: np.random.Generator, power: Array, step_s: float) -> Array:
    """A real Gaussian series (2 (m - 1),) with a one-sided power spectrum (m,)."""
    bins = 2 * (len(power) - 1)
    real, imaginary = rng.standard_normal((2, len(power)))
    imaginary[[0, -1]] = 0.0
    real[[0, -1]] *= np.sqrt(2.0)
    return np.asarray(np.fft.irfft((real + 1j * imaginary) * np.sqrt(0.25 * power * bins / step_s), bins))
