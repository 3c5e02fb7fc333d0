"""Lossless default: level, zigzag, bytes or nibbles with escapes, zstd.

Sky is uncorrelated noise, so prediction from neighbours costs bits. The local level is the best predictor, and a Huffman code
of the remainder is within about one per cent of the entropy. The level is subtracted before bytes are made, so the cost does
not depend on the level of the sky (a plain byte shuffle loses 1.5 bits per pixel if the sky is at a multiple of 256).

The codes are laid out in one of three ways, whichever is shortest: byte planes (strong signal everywhere); one byte
each, with the few larger ones escaped to the end (stars); two in one byte (noise of about 2 ADU and less: a pair
has a better Huffman code than each of the two, and zstd finds no false matches in it).
"""

from dataclasses import dataclass

import numpy as np
import zstandard
from numba import njit
from numpy.typing import NDArray

from sboc_e2e.icd.layout import BYTES_ESCAPED, NIBBLES_ESCAPED, PLANES_ESCAPES, CodecNumber

NIBBLES_BELOW = 20
"""Nibbles are tried if at most one code in this many needs an escape. The shorter block is sent."""


_COMPRESSION = zstandard.ZstdCompressionParameters(
    window_log=17, chain_log=6, hash_log=6, search_log=1, min_match=7, target_length=0, strategy=zstandard.STRATEGY_FAST
)
"""Huffman coding with as few matches as zstd allows: matches found in noise cost more than they save."""


@njit(cache=True)
def zigzag(values: NDArray[np.int32], level: int, out: NDArray[np.uint32]) -> np.uint32:
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


@njit(cache=True)
def count_at_least(codes: NDArray[np.uint32]) -> tuple[np.int32, np.int32]:
    """How many codes need an escape in nibbles (>= 15) and in bytes (>= 255)."""
    nibbles, octets = np.int32(0), np.int32(0)
    for k in range(codes.size):
        nibbles += np.int32(codes[k] >= np.uint32(15))
        octets += np.int32(codes[k] >= np.uint32(255))
    return nibbles, octets


@njit(cache=True)
def pack_bytes(codes: NDArray[np.uint32], out: NDArray[np.uint8], escapes: NDArray[np.uint32]) -> None:
    """One byte per code; 255 means that ``code - 255`` is the next escape."""
    count = 0
    for k in range(codes.size):
        code = codes[k]
        if code >= 255:
            escapes[count] = code - np.uint32(255)
            count += 1
            code = np.uint32(255)
        out[k] = np.uint8(code)


@njit(cache=True)
def pack_nibbles(codes: NDArray[np.uint32], out: NDArray[np.uint8], escapes: NDArray[np.uint32]) -> None:
    """Two codes per byte, the first in the low half; 15 means that ``code - 15`` is the next escape."""
    count = 0
    for k in range(out.size):
        first = codes[2 * k]
        second = codes[2 * k + 1] if 2 * k + 1 < codes.size else np.uint32(0)
        if first >= 15:
            escapes[count] = first - np.uint32(15)
            count += 1
            first = np.uint32(15)
        if second >= 15:
            escapes[count] = second - np.uint32(15)
            count += 1
            second = np.uint32(15)
        out[k] = np.uint8(first | (second << np.uint32(4)))


def _n_planes(largest: int) -> int:
    """Bytes that a code needs, at least one."""
    return max(1, (largest.bit_length() + 7) // 8)


def _in_planes(codes: NDArray[np.uint32], largest: int) -> bytes:
    """Block of byte planes."""
    planes = np.empty((_n_planes(largest), codes.size), dtype=np.uint8)
    split_planes(codes, planes)
    return bytes((len(planes),)) + _compressed(planes)


def _escaped(codes: NDArray[np.uint32], largest: int, n_escapes: int, kind: int) -> bytes:
    """Block of bytes or nibbles with escapes."""
    n_body = codes.size if kind == BYTES_ESCAPED else (codes.size + 1) // 2
    n_planes = _n_planes(largest)
    plain = np.empty(n_body + n_planes * n_escapes, dtype=np.uint8)
    escapes = np.empty(n_escapes, dtype=np.uint32)
    (pack_bytes if kind == BYTES_ESCAPED else pack_nibbles)(codes, plain[:n_body], escapes)
    split_planes(escapes, plain[n_body:].reshape(n_planes, n_escapes))
    return bytes((kind | n_planes,)) + PLANES_ESCAPES.pack(n_escapes) + _compressed(plain)


def _compressed(plain: NDArray[np.uint8]) -> bytes:
    """One zstd frame that states its content size and carries no checksum (the packet has one)."""
    return zstandard.ZstdCompressor(compression_params=_COMPRESSION).compress(plain.data)


def zigzag_codes(values: NDArray[np.int32], level: int) -> tuple[NDArray[np.uint32], int]:
    """Codes of a block row by row, as `zigzag` makes them, and the bitwise or of all."""
    flat = np.require(values, np.int32, ("C", "W")).ravel()  # one kernel for what may be written to and what may not
    codes = np.empty(flat.size, dtype=np.uint32)
    return codes, int(zigzag(flat, level, codes))


def encode_planes(values: NDArray[np.int32], level: int) -> bytes:
    """Block of `CodecNumber.PLANES`: layout (1 byte), number of escapes where the layout has any (2), one zstd frame."""
    codes, largest = zigzag_codes(values, level)
    beyond_nibble, beyond_byte = count_at_least(codes)
    if beyond_byte * 16 > codes.size:
        return _in_planes(codes, largest)
    block = _escaped(codes, largest, int(beyond_byte), BYTES_ESCAPED)
    if beyond_nibble * NIBBLES_BELOW <= codes.size:
        block = min(block, _escaped(codes, largest, int(beyond_nibble), NIBBLES_ESCAPED), key=len)
    return block


@dataclass(frozen=True, kw_only=True)
class PlanesCodec:
    """`planes`: lossless, 1.01-1.03 times the entropy of noise in blocks of some thousand pixels."""

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
