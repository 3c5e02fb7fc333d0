"""Counter-based random numbers for pixel kernels: any row of any frame can be drawn alone, in any order.

Number i of a stream is ``mix(key + (i + 1) gamma)``, SplitMix64 (Steele, Lea & Flood 2014, "Fast splittable pseudorandom
number generators", OOPSLA, figure 17); streams of rows start at keys that are themselves mixed from the frame's 64-bit
word, which comes from `simulator.randomness` and so from (seed, effect, frame).
"""

import math
from typing import Final

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

GAMMA: Final = np.uint64(0x9E3779B97F4A7C15)
_MIX1: Final = np.uint64(0xBF58476D1CE4E5B9)
_MIX2: Final = np.uint64(0x94D049BB133111EB)
_ROW: Final = np.uint64(0xD1342543DE82EF95)

NORMAL_BITS: Final = 12  # the table of 16 KB fits into the first cache, and errs by less than 2e-4 sigma
_CELLS: Final = 1 << NORMAL_BITS
_TAIL_CELLS: Final = 16
"""Cells at either end whose normals are computed instead of interpolated."""


def _normal_table() -> NDArray[np.float32]:
    """Quantiles of the standard normal at i / 4096; the two infinite ends are never interpolated."""
    table = ndtri(np.arange(_CELLS + 1) / _CELLS)
    table[0], table[-1] = -8.0, 8.0
    return np.asarray(table, dtype=np.float32)


NORMAL_TABLE: Final = _normal_table()
"""Quantile function of the standard normal; between nodes, outside the tail cells, linear interpolation errs by < 2e-4 sigma."""


@numba.njit(cache=True, inline="always")
def mix(z: np.uint64) -> np.uint64:
    """SplitMix64's finaliser."""
    z = (z ^ (z >> np.uint64(30))) * _MIX1
    z = (z ^ (z >> np.uint64(27))) * _MIX2
    return z ^ (z >> np.uint64(31))


@numba.njit(cache=True, inline="always")
def row_key(word: np.uint64, row: int) -> np.uint64:
    """Key of a row's stream from the word of its frame."""
    return mix(word ^ ((np.uint64(row) + np.uint64(1)) * _ROW))


@numba.njit(cache=True, inline="always")
def draw(key: np.uint64, index: int) -> np.uint64:
    """Number `index` of a stream."""
    return mix(key + (np.uint64(index) + np.uint64(1)) * GAMMA)


@numba.njit(cache=True, inline="always")
def uniform(bits: np.uint64) -> float:
    """Uniform in (0, 1), 53 bits, never 0 or 1."""
    return (float(bits >> np.uint64(11)) + 0.5) * (1.0 / 9007199254740992.0)


@numba.njit(cache=True, inline="always")
def normal(bits: np.uint64, table: NDArray[np.float32]) -> float:
    """Standard normal from 32 of the 64 bits (the upper ones), see `NORMAL_TABLE`."""
    high = np.uint32(bits >> np.uint64(32))
    cell = np.int64(high >> np.uint32(32 - NORMAL_BITS))
    fraction = float(np.int64(high & np.uint32((1 << (32 - NORMAL_BITS)) - 1))) * (1.0 / (1 << (32 - NORMAL_BITS)))
    if cell < _TAIL_CELLS or cell >= _CELLS - _TAIL_CELLS:
        return tail_normal(bits)
    low = table[cell]
    return low + (table[cell + 1] - low) * fraction


@numba.njit(cache=True)
def tail_normal(bits: np.uint64) -> float:
    """Normal quantile of a 53-bit uniform below 0.02425 or above its complement.

    Rational approximation of Acklam (2003), relative error below 1.2e-9.
    """
    p = uniform(bits)
    tail = p if p < 0.5 else 1.0 - p
    q = math.sqrt(-2.0 * math.log(tail))
    upper = ((((-7.784894002430293e-03 * q - 3.223964580411365e-01) * q - 2.400758277161838) * q - 2.549732539343734) * q
             + 4.374664141464968) * q + 2.938163982698783  # fmt: skip
    lower = (((7.784695709041462e-03 * q + 3.224671290700398e-01) * q + 2.445134137142996) * q + 3.754408661907416) * q + 1.0
    x = upper / lower
    return x if p < 0.5 else -x
