"""What noise does to a pixel: its variance, and the exact entropy of its ADU given the mean."""

import math
from functools import cache
from typing import Final

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln, ndtr

_GAUSSIAN_ABOVE_E: Final = 400.0
"""Mean electrons above which the entropy of a rounded Gaussian is used (error below 1e-3 bit there)."""

_TAIL: Final = 6.5
"""Standard deviations of either noise that are kept; what lies beyond adds less than 1e-8 bit."""


def pixel_probabilities(mean_e: float, read_noise_e: float, gain_e_adu: float) -> NDArray[np.float64]:
    """Distribution of a pixel's ADU (up to an offset): Poisson electrons plus Gaussian read noise, rounded.

    The pedestal is an integer, so that code k holds signals of [k - 1/2, k + 1/2) units.
    """
    reach = _TAIL * math.sqrt(mean_e) + 10.0
    counts = np.arange(max(0, int(mean_e - reach)), int(mean_e + reach) + 2)
    log_p = counts * math.log(mean_e) - mean_e - gammaln(counts + 1.0) if mean_e > 0.0 else np.where(counts == 0, 0.0, -np.inf)
    low = math.floor((counts[0] - _TAIL * read_noise_e) / gain_e_adu) - 1
    high = math.ceil((counts[-1] + _TAIL * read_noise_e) / gain_e_adu) + 1
    borders = (np.arange(low, high + 1) - 0.5) * gain_e_adu
    if read_noise_e > 0.0:
        below = ndtr((borders[None, :] - counts[:, None]) / read_noise_e)
    else:
        below = (counts[:, None] < borders[None, :]).astype(np.float64)
    return np.asarray(np.exp(log_p) @ np.diff(below, axis=1))


def entropy_bits(probabilities: NDArray[np.float64]) -> float:
    """Shannon entropy of a distribution."""
    p = probabilities[probabilities > 0.0]
    return float(-(p * np.log2(p)).sum())


@cache
def entropy_table(
    read_noise_e: tuple[float, ...], gain_e_adu: float, nodes: int = 97
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Entropy, averaged over the given read noises, at means ``m`` spaced evenly in sqrt(m).

    Returns sqrt(m) nodes and bits; linear interpolation errs by less than 2e-3 bit for read noises above 0.5 e-.
    """
    roots = np.linspace(0.0, math.sqrt(_GAUSSIAN_ABOVE_E), nodes)
    bits = [np.mean([entropy_bits(pixel_probabilities(r * r, s, gain_e_adu)) for s in read_noise_e]) for r in roots]
    return roots, np.asarray(bits)


@numba.njit(cache=True)
def pixel_variance(
    mean_e: NDArray[np.float32],
    response: NDArray[np.uint8],
    dark: NDArray[np.uint8],
    noise: NDArray[np.uint8],
    variance_per_e: NDArray[np.float64],
    dark_variance_e2: NDArray[np.float64],
    read_variance_e2: NDArray[np.float64],
    out: NDArray[np.float32],
) -> None:
    """Noise variance of each pixel from its mean and its classes (`simulator.sensor.maps`); all images of one shape."""
    for r in range(mean_e.shape[0]):
        for c in range(mean_e.shape[1]):
            out[r, c] = (
                mean_e[r, c] * variance_per_e[response[r, c]] + dark_variance_e2[dark[r, c]] + read_variance_e2[noise[r, c]]
            )


@numba.njit(cache=True)
def mean_entropy_bits(
    mean_e: NDArray[np.float32],
    dark_e: float,
    roots: NDArray[np.float64],
    bits: NDArray[np.float64],
    high: tuple[float, float, float],
    low: tuple[float, float, float],
) -> float:
    """Mean over an image of the entropy of each pixel's ADU.

    roots, bits : `entropy_table`. high : gain, read noise and end (electrons) of the high-gain channel. low : gain and read
    noise of the low-gain one, and the charge from which a pixel is saturated and says nothing. Beyond the table a code is a
    rounded Gaussian much wider than one unit, of entropy ``log2(sigma sqrt(2 pi e) / gain)``.
    """
    high_gain, high_noise, handover_e = high
    low_gain, low_noise, saturated_e = low
    scale = (roots.size - 1) / roots[-1]
    faint_end = roots[-1] ** 2
    total = 0.0
    for r in range(mean_e.shape[0]):
        line = 0.0
        for c in range(mean_e.shape[1]):
            mean = max(mean_e[r, c] + dark_e, 0.0)
            if mean < faint_end:
                position = math.sqrt(mean) * scale
                node = min(int(position), roots.size - 2)
                line += bits[node] + (bits[node + 1] - bits[node]) * (position - node)
            elif mean < saturated_e:
                gain, noise = (high_gain, high_noise) if mean < handover_e else (low_gain, low_noise)
                line += 0.5 * math.log2(2.0 * math.pi * math.e * (mean + noise**2) / gain**2)
        total += line
    return total / mean_e.size
