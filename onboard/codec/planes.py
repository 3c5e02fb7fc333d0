"""Lossless default: level, zigzag, byte planes, zstd.

Sky is uncorrelated noise, so prediction from neighbours costs bits; the local level is the best predictor there is,
and a Huffman code of the low byte is within about one per cent of the entropy. Because the level is taken away
before the bytes are split, the cost does not depend on where the sky falls (a plain byte shuffle loses 1.5 bits per
pixel when the sky sits at a multiple of 256).
"""

from dataclasses import dataclass

import numpy as np
import zstandard
from numba import njit
from numpy.typing import NDArray

from sboc_e2e.icd.layout import CodecNumber


def _parameters() -> zstandard.ZstdCompressionParameters:
    """Huffman coding with as few matches as zstd allows: short matches in noise cost more than they save."""
    return zstandard.ZstdCompressionParameters(
        window_log=17, chain_log=6, hash_log=12, search_log=1, min_match=7, target_length=0, strategy=zstandard.STRATEGY_FAST
    )


@njit(cache=True)
def zigzag(values: NDArray[np.int32], level: int, out: NDArray[np.uint32]) -> int:
    """Map ``value - level`` to 0, 1, 2, 3, ... for 0, -1, 1, -2, ...; returns the bitwise or of all codes.

    The difference is taken modulo 2**32, so every pair of int32 values is reversible.
    """
    seen = np.uint32(0)
    for k in range(values.size):
        difference = np.int32(values[k] - level)
        code = np.uint32((difference << 1) ^ (difference >> 31))
        out[k] = code
        seen |= code
    return seen


@njit(cache=True)
def split_planes(codes: NDArray[np.uint32], out: NDArray[np.uint8]) -> None:
    """Byte planes of the codes, least significant first; out has shape (planes, n)."""
    for plane in range(out.shape[0]):
        shift = np.uint32(8 * plane)
        for k in range(codes.size):
            out[plane, k] = np.uint8((codes[k] >> shift) & np.uint32(0xFF))


def encode_planes(values: NDArray[np.int32], level: int) -> bytes:
    """Block of `CodecNumber.PLANES`: number of planes (1 byte), then one zstd frame of all planes."""
    flat = np.ascontiguousarray(values, dtype=np.int32).ravel()
    codes = np.empty(flat.size, dtype=np.uint32)
    n_planes = max(1, (int(zigzag(flat, level, codes)).bit_length() + 7) // 8)
    planes = np.empty((n_planes, flat.size), dtype=np.uint8)
    split_planes(codes, planes)
    return bytes((n_planes,)) + zstandard.ZstdCompressor(compression_params=_parameters()).compress(planes.data)


@dataclass(frozen=True, kw_only=True)
class PlanesCodec:
    """`planes`: lossless, 1.01-1.03 times the entropy of noise."""

    @property
    def number(self) -> int:
        """Codec number in the packet."""
        return int(CodecNumber.PLANES)

    @property
    def lossless(self) -> bool:
        """Decoding gives the same integers."""
        return True

    def encode(self, values_adu: NDArray[np.int32], *, level_adu: int, sigma_adu: float) -> bytes:
        """Encode a (n, width) block around a level; the noise is not needed."""
        return encode_planes(values_adu, level_adu)
