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

_SUPPORT: Final = 256  # counts of a level, a byte: from 9 sigma below the mean to at least 12 sigma above it
_FINE_END: Final = 8.0  # electrons to which levels are 1 / _FINE apart ...
_MIDDLE_END: Final = 32.0  # ... and to which they are 1 / _MIDDLE apart, then 1 / _COARSE
_FINE: Final = 16.0  # levels for each electron: the remainder to the one below takes a second draw for 3 % of pixels
_MIDDLE: Final = 8.0  # the same between `_FINE_END` and `_MIDDLE_END`: a second draw for 6 % ...
_COARSE: Final = 4.0  # ... and 12 %. The numbers are exact with any levels: 704 of them take 1.4 MB, more would save draws
_FINE_LEVELS: Final = int(_FINE_END * _FINE)
_MIDDLE_LEVELS: Final = int((_MIDDLE_END - _FINE_END) * _MIDDLE)
_COARSE_LEVELS: Final = int((EXACT_BELOW - _MIDDLE_END) * _COARSE)
LEVELS: Final = _FINE_LEVELS + _MIDDLE_LEVELS + _COARSE_LEVELS


def level_means() -> NDArray[np.float64]:
    """Means of the grid: steps of 1/16 below 8, 1/8 below 32, 1/4 below 128 electrons."""
    fine = np.arange(_FINE_LEVELS) / _FINE
    middle = _FINE_END + np.arange(_MIDDLE_LEVELS) / _MIDDLE
    coarse = _MIDDLE_END + np.arange(_COARSE_LEVELS) / _COARSE
    return np.concatenate([fine, middle, coarse])


@numba.njit(cache=True)
def _alias_tables(means: NDArray[np.float64]) -> tuple[NDArray[np.uint64], NDArray[np.int64]]:
    """Vose's tables: entry = threshold (32 bits) << 32 | alias; and the first count of each level's support."""
    tables = np.empty((means.size, _SUPPORT), np.uint64)
    first = np.empty(means.size, np.int64)
    p = np.empty(_SUPPORT)
    small = np.empty(_SUPPORT, np.int64)
    large = np.empty(_SUPPORT, np.int64)
    for node in range(means.size):
        mean = means[node]
        first[node] = max(0, int(mean - 9.0 * math.sqrt(mean)) - 8)
        total = 0.0
        for i in range(_SUPPORT):
            k = first[node] + i
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
            tables[node, s] = (np.uint64(p[s] * 4294967295.0) << np.uint64(32)) | np.uint64(b)
            p[b] -= 1.0 - p[s]
            if p[b] < 1.0:
                n_large -= 1
                small[n_small] = b
                n_small += 1
        while n_large > 0:
            n_large -= 1
            tables[node, large[n_large]] = (np.uint64(4294967295) << np.uint64(32)) | np.uint64(large[n_large])
        while n_small > 0:
            n_small -= 1
            tables[node, small[n_small]] = (np.uint64(4294967295) << np.uint64(32)) | np.uint64(small[n_small])
    return tables, first


def poisson_tables() -> tuple[NDArray[np.uint64], NDArray[np.float64]]:
    """Alias tables (LEVELS, 256) and the first count of each level's support (LEVELS,), for `draw_poisson`."""
    tables, first = _alias_tables(level_means())
    return tables, first.astype(np.float64)


@numba.njit(cache=True)
def draw_poisson(
    mean: NDArray[np.float64],
    key: np.uint64,
    tables: NDArray[np.uint64],
    first: NDArray[np.float64],
    normals: NDArray[np.float32],
    doubt: NDArray[np.uint8],
    count: NDArray[np.float64],
) -> None:
    """Poisson numbers of means >= 0 (below 1e9), number c from word c of the stream `key`.

    The first loop does for all pixels what nearly all of them need and has no branches, so that it runs on vectors; the
    second mends the few whose remainder may not be zero and the bright ones. `doubt` (n,) is work space.
    """
    position = key
    for c in range(mean.size):
        position += GAMMA
        bits = mix(position)
        m = mean[c]
        # Position on the grid of `level_means`; its fraction is the remainder in units of the grid step.
        fine = m * _FINE
        middle = _FINE_LEVELS + (m - _FINE_END) * _MIDDLE
        coarse = (_FINE_LEVELS + _MIDDLE_LEVELS) + (m - _MIDDLE_END) * _COARSE
        grid = fine if m < _FINE_END else (middle if m < _MIDDLE_END else coarse)
        step = 1.0 / _FINE if m < _FINE_END else (1.0 / _MIDDLE if m < _MIDDLE_END else 1.0 / _COARSE)
        node = int(min(int(grid), LEVELS - 1))
        rest = (grid - float(node)) * step
        own = bits & np.uint64(_SUPPORT - 1)
        entry = tables[node, np.int64(own)]
        chosen = own if (bits >> np.uint64(32)) <= (entry >> np.uint64(32)) else entry & np.uint64(_SUPPORT - 1)
        count[c] = first[node] + float(np.int64(chosen))
        # 24 bits that the alias step left unused: zero is certain below 1 - rest, for 1 - rest <= exp(-rest).
        spare = float(np.int64((bits >> np.uint64(8)) & np.uint64(0xFFFFFF))) * (1.0 / 16777216.0)
        doubt[c] = (spare >= 1.0 - rest) | (m >= EXACT_BELOW)
    position = key
    for c in range(mean.size):
        position += GAMMA
        if doubt[c] == 0:
            continue
        m = mean[c]
        if m >= EXACT_BELOW:
            count[c] = _corrected_normal(m, normal(mix(position), normals))
            continue
        if m < _FINE_END:
            rest = m - math.floor(m * _FINE) / _FINE
        elif m < _MIDDLE_END:
            rest = m - math.floor(m * _MIDDLE) / _MIDDLE
        else:
            rest = m - math.floor(m * _COARSE) / _COARSE
        count[c] += _rest_given_doubt(rest, uniform(mix(position ^ key)))


@numba.njit(cache=True)
def _corrected_normal(mean: float, z: float) -> float:
    """Poisson number of a large mean from a normal deviate (Cornish & Fisher's expansion to order 1/mean), rounded."""
    root = math.sqrt(mean)
    return max(math.floor(mean + root * z + (z * z - 1.0) / 6.0 + (z - z * z * z) / (72.0 * root) + 0.5), 0.0)


@numba.njit(cache=True)
def _rest_given_doubt(mean: float, u: float) -> float:
    """Poisson number of mean <= 1 given an event of probability `mean` that holds all non-zero outcomes."""
    p = math.exp(-mean)
    # The event is the upper `mean` of the unit interval; the zero outcome reaches into it up to exp(-mean).
    total = p - (1.0 - mean)
    count = 0.0
    while u * mean > total and count < 40.0:
        count += 1.0
        p *= mean / count
        total += p
    return count
