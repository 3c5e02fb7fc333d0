"""Gains of visits and what they leave to be known, for schedules that are kept side by side.

What is known of a target is a covariance in units of that at the start. A visit changes those of the few targets in its field, so
that schedules which share their past share nearly all of their covariances: a schedule holds places in one pool of them, and the
gain of a visit is computed once for schedules that know the same of a target.
"""

import math
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Places = NDArray[np.int64]

_ROOM: Final = 8  # covariances that the pool has room for, over those of all schedules, before it is packed. Chosen, not measured


@njit(cache=True)
def _seen(covariance: Array, told: Array, cross: Array) -> tuple[float, float, float]:
    """Fills cross (2, 6), ``told covariance``; the three elements of the unit matrix plus ``told covariance told'`` (2, 2)."""
    first, both, second = 1.0, 0.0, 1.0
    for k in range(6):
        along = across = 0.0
        for j in range(6):
            along += told[0, j] * covariance[j, k]
            across += told[1, j] * covariance[j, k]
        cross[0, k], cross[1, k] = along, across
        first += along * told[0, k]
        both += along * told[1, k]
        second += across * told[1, k]
    return first, both, second


@njit(cache=True)
def _update(covariance: Array, told: Array, out: Array) -> None:
    """Fills out (6, 6), the covariance after an observation; as symmetric as the one before it."""
    cross = np.empty((2, 6))
    first, both, second = _seen(covariance, told, cross)
    determinant = first * second - both * both
    for i in range(6):
        one = (second * cross[0, i] - both * cross[1, i]) / determinant
        two = (first * cross[1, i] - both * cross[0, i]) / determinant
        for j in range(i + 1):
            out[i, j] = 0.5 * (covariance[i, j] + covariance[j, i]) - one * cross[0, j] - two * cross[1, j]
            out[j, i] = out[i, j]


@njit(cache=True)
def gains(covariance: Array, told: Array) -> Array:
    """Worth (k,) in nats of observations (k, 2, 6) where the knowledge is (k, 6, 6), in units of that at the start."""
    out, cross = np.empty(len(told)), np.empty((2, 6))
    for k in range(len(told)):
        first, both, second = _seen(covariance[k], told[k], cross)
        out[k] = 0.5 * math.log(first * second - both * both)
    return out


@njit(cache=True)
def updated(covariance: Array, told: Array) -> Array:
    """Covariances (k, 6, 6) after observations (k, 2, 6)."""
    out = np.empty((len(told), 6, 6))
    for k in range(len(told)):
        _update(covariance[k], told[k], out[k])
    return out


@njit(cache=True)
def _gains_of(pool: Array, places: Places, target: Places, told: Array) -> Array:
    """Worth (b, v) of observations of targets (v,) for schedules with places (b, m)."""
    out, cross = np.empty((len(places), len(target))), np.empty((2, 6))
    for v in range(len(target)):
        for b in range(len(places)):
            place = places[b, target[v]]
            known = 0
            while places[known, target[v]] != place:
                known += 1
            if known < b:
                out[b, v] = out[known, v]
            else:
                first, both, second = _seen(pool[place], told[v], cross)
                out[b, v] = 0.5 * math.log(first * second - both * both)
    return out


@njit(cache=True)
def _grow(pool: Array, used: int, places: Places, target: Places, told: Array) -> None:
    """Fills pool from `used` on with the covariances after observations, and sets the schedule's places (m,) to them."""
    for k in range(len(target)):
        _update(pool[places[target[k]]], told[k], pool[used + k])
        places[target[k]] = used + k


class Knowledge:
    """The pool of covariances of schedules that go on from one. covariance : (m, 6, 6) of the targets at its beginning."""

    def __init__(self, covariance: Array) -> None:
        self._used = len(covariance)
        self._pool = np.empty((2 * len(covariance), 6, 6))
        self._pool[: self._used] = covariance

    def gains(self, places: Places, target: Places, told: Array) -> Array:
        """Worth (b, v) in nats of observations (v, 2, 6) of targets (v,) for schedules whose targets have places (b, m)."""
        return np.asarray(_gains_of(self._pool, places, target, told))

    def after(self, places: Places, target: Places, told: Array) -> Places:
        """Places (m,) of a schedule (m,) after observations (k, 2, 6) of different targets (k,)."""
        if self._used + len(target) > len(self._pool):
            larger = np.empty((2 * len(self._pool) + len(target), 6, 6))
            larger[: self._used] = self._pool[: self._used]
            self._pool = larger
        grown = places.copy()
        _grow(self._pool, self._used, grown, target, told)
        self._used += len(target)
        return grown

    def packed(self, places: Places) -> Places:
        """The same places (b, m), or others where the pool is full of covariances that no schedule has any more."""
        if self._used < _ROOM * places.size:
            return places
        kept, renamed = np.unique(places, return_inverse=True)
        self._pool[: len(kept)] = self._pool[kept]
        self._used = len(kept)
        return np.asarray(renamed.reshape(places.shape), dtype=np.int64)
