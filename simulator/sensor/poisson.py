"""Exact Poisson numbers in a few nanoseconds: alias tables on a grid of means plus a small remainder.

A Poisson number of mean m is the sum of one of mean m_k <= m (m_k a grid value, drawn from its alias table: Walker 1977,
ACM TOMS 3, 253; Vose 1991, IEEE TSE 17, 972) and one of mean m - m_k (mostly zero, drawn by inversion). The sum is exactly
Poisson. Above `EXACT_BELOW` the normal approximation with its skewness and kurtosis terms (Cornish & Fisher 1938) takes
over; there its distribution function errs by less than 1e-4.
"""

import math
from typing import Final

import numba
import numpy as np
from numpy.typing import NDArray

from simulator.sensor.counter import GAMMA, mix, normal, uniform

EXACT_BELOW: Final = 128.0
"""Means from which the corrected normal approximation is used, in electrons."""

_SUPPORT: Final = 256
_FINE_END: Final = 8.0
_MIDDLE_END: Final = 32.0
_FINE: Final = 16.0
_MIDDLE: Final = 4.0
_FINE_LEVELS: Final = int(_FINE_END * _FINE)
_MIDDLE_LEVELS: Final = int((_MIDDLE_END - _FINE_END) * _MIDDLE)
_COARSE_LEVELS: Final = int(EXACT_BELOW - _MIDDLE_END)
LEVELS: Final = _FINE_LEVELS + _MIDDLE_LEVELS + _COARSE_LEVELS


def level_means() -> NDArray[np.float64]:
    """Means of the grid: steps of 1/16 below 8, 1/4 below 32, 1 below 128 electrons."""
    fine = np.arange(_FINE_LEVELS) / _FINE
    middle = _FINE_END + np.arange(_MIDDLE_LEVELS) / _MIDDLE
    coarse = _MIDDLE_END + np.arange(_COARSE_LEVELS)
    return np.concatenate([fine, middle, coarse])


@numba.njit(cache=True)
def _alias_tables(means: NDArray[np.float64]) -> tuple[NDArray[np.uint64], NDArray[np.int64]]:
    """Vose's tables: entry = threshold (32 bits) << 32 | alias; and the first count of each level's support."""
    tables = np.empty((means.size, _SUPPORT), np.uint64)
    first = np.empty(means.size, np.int64)
    p = np.empty(_SUPPORT)
    small = np.empty(_SUPPORT, np.int64)
    large = np.empty(_SUPPORT, np.int64)
    for level in range(means.size):
        mean = means[level]
        first[level] = max(0, int(mean - 9.0 * math.sqrt(mean)) - 8)
        total = 0.0
        for i in range(_SUPPORT):
            k = first[level] + i
            if mean > 0.0:
                p[i] = math.exp(k * math.log(mean) - mean - math.lgamma(k + 1.0))
            else:
                p[i] = 1.0 if k == 0 else 0.0
            total += p[i]
        n_small = 0
        n_large = 0
        for i in range(_SUPPORT):
            p[i] *= _SUPPORT / total
            if p[i] < 1.0:
                small[n_small] = i
                n_small += 1
            else:
                large[n_large] = i
                n_large += 1
        while n_small > 0 and n_large > 0:
            n_small -= 1
            s = small[n_small]
            b = large[n_large - 1]
            tables[level, s] = (np.uint64(p[s] * 4294967295.0) << np.uint64(32)) | np.uint64(b)
            p[b] -= 1.0 - p[s]
            if p[b] < 1.0:
                n_large -= 1
                small[n_small] = b
                n_small += 1
        while n_large > 0:
            n_large -= 1
            tables[level, large[n_large]] = (np.uint64(4294967295) << np.uint64(32)) | np.uint64(large[n_large])
        while n_small > 0:
            n_small -= 1
            tables[level, small[n_small]] = (np.uint64(4294967295) << np.uint64(32)) | np.uint64(small[n_small])
    return tables, first


def poisson_tables() -> tuple[NDArray[np.uint64], NDArray[np.int64], NDArray[np.float64]]:
    """Alias tables (LEVELS, 256), first counts (LEVELS,) and means (LEVELS,) for `poisson`."""
    means = level_means()
    tables, first = _alias_tables(means)
    return tables, first, means


@numba.njit(cache=True)
def _rest_given_doubt(mean: float, key: np.uint64) -> int:
    """Poisson number of mean <= 1 given an event of probability `mean` that includes all non-zero outcomes."""
    u = uniform(mix(key ^ GAMMA)) * mean
    p = math.exp(-mean)
    # In doubt means u lies in the upper `mean` of the unit interval; the zero outcome ends at exp(-mean) >= 1 - mean.
    total = p - (1.0 - mean)
    count = 0
    while u > total and count < 40:
        count += 1
        p *= mean / count
        total += p
    return count


@numba.njit(cache=True, inline="always")
def poisson(
    mean: float,
    key: np.uint64,
    tables: NDArray[np.uint64],
    first: NDArray[np.int64],
    means: NDArray[np.float64],
    normals: NDArray[np.float32],
) -> float:
    """Poisson number of any mean >= 0 from the random word at position `key` of a stream."""
    bits = mix(key)
    if mean < EXACT_BELOW:
        if mean <= 0.0:
            return 0.0
        if mean < _FINE_END:
            level = int(mean * _FINE)
        elif mean < _MIDDLE_END:
            level = _FINE_LEVELS + int((mean - _FINE_END) * _MIDDLE)
        else:
            level = _FINE_LEVELS + _MIDDLE_LEVELS + int(mean - _MIDDLE_END)
        i = np.int64(bits & np.uint64(_SUPPORT - 1))
        entry = tables[level, i]
        if (bits >> np.uint64(32)) > (entry >> np.uint64(32)):
            i = np.int64(entry & np.uint64(_SUPPORT - 1))
        count = first[level] + i
        rest = mean - means[level]
        # 24 bits that the alias step left unused decide whether the remainder is zero: 1 - m <= exp(-m).
        if float(np.int64((bits >> np.uint64(8)) & np.uint64(0xFFFFFF))) * (1.0 / 16777216.0) >= 1.0 - rest:
            count += _rest_given_doubt(rest, key)
        return float(count)
    z = normal(bits, normals)
    root = math.sqrt(mean)
    return math.floor(mean + root * z + (z * z - 1.0) / 6.0 + (z - z * z * z) / (72.0 * root) + 0.5)
