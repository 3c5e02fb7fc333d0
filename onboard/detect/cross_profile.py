"""Matched sums across a segment, line by line. Detectors use them to judge a trail.

Segments are (major, minor): major is the axis along which a line advances by one pixel per step.
"""

import math

import numba as nb
import numpy as np
from numpy.typing import NDArray


@nb.njit(cache=True)
def bend(u: float) -> float:
    """Parabola of height 1 over the unit interval."""
    return 4.0 * u * (1.0 - u)


@nb.njit(cache=True)
def cross_profile(
    image: NDArray[np.int8],
    blocked: NDArray[np.uint8],
    level: NDArray[np.float32],
    tile_px: int,
    major0: float,
    minor0: float,
    major1: float,
    minor1: float,
    sagitta: float,
    extend_px: int,
    psf_sigma_px: float,
    signal: NDArray[np.float64],
    weight: NDArray[np.float64],
) -> tuple[int, int]:
    """Matched cross-track sums on each major line of a bent segment and its extension: ``sum(g x)`` and ``sum(g^2)``.

    g is the unit-density trail across the line; masked pixels count in neither. image and level (mesh of tiles) in units of
    sigma/16. Returns the
    first major line and the number of lines; signal (sigma) and weight hold them. Sagitta is measured along minor.
    """
    n_major, n_minor = image.shape
    length = max(major1 - major0, 1e-6)
    slope = (minor1 - minor0) / length
    cosine = 1.0 / math.sqrt(1.0 + slope * slope)
    radius = math.ceil(3.0 * psf_sigma_px / cosine)
    low = max(0, math.ceil(major0) - extend_px)
    high = min(n_major - 1, math.floor(major1) + extend_px)
    n = min(high - low + 1, signal.shape[0])
    factor = -0.5 * (cosine / psf_sigma_px) ** 2
    norm = 1.0 / (math.sqrt(2.0 * math.pi) * psf_sigma_px)
    for k in range(n):
        major = low + k
        u = (major - major0) / length
        minor = minor0 + slope * (major - major0) + (sagitta * bend(u) if 0.0 < u < 1.0 else 0.0)
        centre = math.floor(minor + 0.5)
        s = w = total = 0.0
        # g at equal steps by two multiplications per step: exp(a (d+1)^2) = exp(a d^2) exp(a (2 d + 1))
        first = max(0, centre - radius)
        d = first - minor
        g = norm * math.exp(factor * d * d)
        ratio = math.exp(factor * (2.0 * d + 1.0))
        growth = math.exp(2.0 * factor)
        for j in range(first, min(n_minor, centre + radius + 1)):
            if blocked[major, j] == 0:
                s += g * image[major, j]
                w += g * g
                total += g
            g *= ratio
            ratio *= growth
        tile = min(max(centre // tile_px, 0), level.shape[1] - 1)
        signal[k] = (s - total * level[major // tile_px, tile]) / 16.0
        weight[k] = w
    return low, n
