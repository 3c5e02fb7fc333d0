"""Joining pixels after conversion: mean, median, weighted mean or sum of blocks of ADU."""

import math
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from simulator.sensor.options import BinningOptions

T = TypeVar("T", bound=np.generic)


def bin_pixels(
    pixels_adu: NDArray[np.uint16], options: BinningOptions, weight: NDArray[np.float32] | None = None
) -> NDArray[np.uint16]:
    """Blocks of (rows, cols) detector pixels joined into one; rows or columns that fill no block are dropped.

    weight : (rows, cols) of each detector pixel, needed by method "weighted"; a block without weight gives its plain mean.
    """
    if options.rows == 1 and options.cols == 1:
        return pixels_adu
    blocks = _blocks(pixels_adu, options)
    match options.method:
        case "sum":
            return np.minimum(blocks.sum(axis=(1, 3), dtype=np.uint32), 65535).astype(np.uint16)
        case "median":
            flat = blocks.transpose(0, 2, 1, 3).reshape(blocks.shape[0], blocks.shape[2], -1)
            return np.floor(np.median(flat, axis=2) + 0.5).astype(np.uint16)
        case "weighted" if weight is not None:
            weights = _blocks(weight, options)
            total = weights.sum(axis=(1, 3))
            usable = total > 0.0
            mean = (weights * blocks).sum(axis=(1, 3)) / np.where(usable, total, 1.0)
            return np.floor(np.where(usable, mean, blocks.mean(axis=(1, 3))) + 0.5).astype(np.uint16)
        case _:
            return np.floor(blocks.mean(axis=(1, 3)) + 0.5).astype(np.uint16)


def bin_means(values: NDArray[np.float32], options: BinningOptions) -> NDArray[np.float32]:
    """Plain means of blocks of any map."""
    if options.rows == 1 and options.cols == 1:
        return values
    return np.asarray(_blocks(values, options).mean(axis=(1, 3)), dtype=np.float32)


def bin_flags(flags: NDArray[np.uint8], options: BinningOptions) -> NDArray[np.uint8]:
    """All flags of the pixels of each block."""
    return np.asarray(np.bitwise_or.reduce(np.bitwise_or.reduce(_blocks(flags, options), axis=3), axis=1), dtype=np.uint8)


def noise_factor(options: BinningOptions) -> float:
    """Noise of a binned pixel, in electrons of the whole block, over the noise of one detector pixel.

    sqrt(n) for sum and means; a median is noisier, by about ``sqrt(pi n / (2 n + pi - 2))`` for odd n and
    ``sqrt(pi n / (2 n + 2.4))`` for even n (fits to the variance of Gaussian medians, good to 3 %).
    """
    n = options.rows * options.cols
    factor = math.sqrt(n)
    if options.method == "median" and n > 2:
        factor *= math.sqrt(math.pi * n / (2.0 * n + (math.pi - 2.0 if n % 2 else 2.4)))
    return factor


def _blocks(values: NDArray[T], options: BinningOptions) -> NDArray[T]:
    rows, cols = values.shape[0] // options.rows, values.shape[1] // options.cols
    return values[: rows * options.rows, : cols * options.cols].reshape(rows, options.rows, cols, options.cols)
