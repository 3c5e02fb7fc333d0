"""Isotonic regression: the values nearest to given ones that never fall, or never rise.

Pools of adjacent violators, Algorithm 1 of Busing (2022, doi:10.18637/jss.v102.c01). `scipy.optimize.isotonic_regression` gives
the same numbers, and its package takes a quarter of a second to load.
"""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray


def never_falling(values: NDArray[np.float64], weights: NDArray[np.float64]) -> NDArray[np.float64]:
    """The values (n,) of least weighted square distance from given ones that never fall. weights : (n,), positive."""
    return _pooled(np.array(values, dtype=np.float64), np.array(weights, dtype=np.float64))


def never_rising(values: NDArray[np.float64], weights: NDArray[np.float64]) -> NDArray[np.float64]:
    """The same that never rise."""
    return never_falling(values[::-1], weights[::-1])[::-1]


@njit(cache=True)
def _pooled(x: Any, w: Any) -> Any:
    """`x` and `w` are overwritten by mean and weight of each pool, and `x` then by the mean of its pool."""
    n = x.size
    first = np.zeros(n + 1, np.int64)  # of the values of each pool
    if n == 0:
        return x
    first[1] = 1
    pool, before, i = 0, x[0], 1
    while i < n:
        pool += 1
        mean, weight = x[i], w[i]
        if before >= mean:
            pool -= 1
            total = w[pool] * before + weight * mean
            weight += w[pool]
            mean = total / weight
            while i < n - 1 and mean >= x[i + 1]:
                i += 1
                total += w[i] * x[i]
                weight += w[i]
                mean = total / weight
            while pool > 0 and x[pool - 1] >= mean:
                pool -= 1
                total += w[pool] * x[pool]
                weight += w[pool]
                mean = total / weight
        x[pool], w[pool] = mean, weight
        before = mean
        i += 1
        first[pool + 1] = i
    last = n
    for k in range(pool, -1, -1):
        x[first[k] : last] = x[k]
        last = first[k]
    return x
