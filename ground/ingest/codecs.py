"""Decoders of ROI and frame blocks: bytes to integers. Every size is checked before anything is allocated.

The encoders live in `onboard.downlink.codec`; the block layouts are in ICD.md. Hostile bytes give a `ContractError`.
"""

import math
from dataclasses import dataclass

import imagecodecs
import numpy as np
import zstandard
from numpy.typing import NDArray

from sboc_e2e.icd.errors import ContractError
from sboc_e2e.icd.layout import (
    BYTES_ESCAPED,
    DECOMPRESSED_LIMIT_BYTES,
    MAX_STRIP_PIXELS,
    NIBBLES_ESCAPED,
    PLANES_ESCAPES,
    SQRT_PLANES,
    CodecNumber,
)

AEC_BLOCK_SIZE = 64
"""Samples per block, J (CCSDS 121.0-B-3); fixed by ICD.md for the codec `ccsds121`."""
AEC_SAMPLES_PER_REFERENCE = 128
"""Blocks per reference interval (CCSDS 121.0-B-3); fixed by ICD.md."""
SQRT_LEAST_SIGMA_ADU = 0.1
"""Noise of a frame without noise; fixed by ICD.md for `sqrt_planes`."""


def inflate(block: bytes, expected_bytes: int) -> bytes:
    """One zstd frame whose header announces exactly the expected size."""
    if expected_bytes > DECOMPRESSED_LIMIT_BYTES:
        raise ContractError(f"zstd block: expected at most {DECOMPRESSED_LIMIT_BYTES} bytes, asked for {expected_bytes}")
    try:
        announced = zstandard.get_frame_parameters(block).content_size
        if announced != expected_bytes:
            raise ContractError(f"zstd block: expected {expected_bytes} bytes, its header announces {announced}")
        plain = zstandard.ZstdDecompressor(max_window_size=2 * DECOMPRESSED_LIMIT_BYTES).decompress(block)
    except zstandard.ZstdError as error:
        raise ContractError(f"zstd block: {error}") from error
    if len(plain) != expected_bytes:
        raise ContractError(f"zstd block: expected {expected_bytes} bytes, got {len(plain)}")
    return plain


def decode_planes(block: bytes, shape: tuple[int, int], level: int) -> NDArray[np.int32]:
    """Inverse of level, zigzag and one of the three layouts of a `PLANES` block."""
    size = _checked_size(shape)
    kind, n_planes = (block[0] & 0xF0, block[0] & 0x0F) if block else (0, 0)
    if kind not in (0, BYTES_ESCAPED, NIBBLES_ESCAPED) or not 1 <= n_planes <= 4:
        raise ContractError(f"planes block: expected a known layout, got {block[:1].hex() or 'nothing'}")
    if kind == 0:
        return unzigzag(_joined(inflate(block[1:], n_planes * size), n_planes), level).reshape(shape)
    if len(block) < 1 + PLANES_ESCAPES.size:
        raise ContractError(f"planes block: expected at least {1 + PLANES_ESCAPES.size} bytes, got {len(block)}")
    (n_escapes,) = PLANES_ESCAPES.unpack_from(block, 1)
    n_body = size if kind == BYTES_ESCAPED else (size + 1) // 2
    plain = inflate(block[1 + PLANES_ESCAPES.size :], n_body + n_planes * n_escapes)
    body = np.frombuffer(plain, dtype=np.uint8, count=n_body)
    if kind == NIBBLES_ESCAPED:
        body = np.column_stack((body & 0x0F, body >> 4)).ravel()[:size]
    escape = np.uint8(255 if kind == BYTES_ESCAPED else 15)
    codes = body.astype(np.uint32)
    where = np.flatnonzero(body == escape)
    if len(where) != n_escapes:
        raise ContractError(f"planes block: expected {n_escapes} escapes, got {len(where)}")
    if n_escapes:
        codes[where] += _joined(plain[n_body:], n_planes)
    return unzigzag(codes, level).reshape(shape)


def _joined(planes: bytes, n_planes: int) -> NDArray[np.uint32]:
    """Codes of byte planes, least significant first."""
    split = np.frombuffer(planes, dtype=np.uint8).reshape(n_planes, -1)
    codes = split[0].astype(np.uint32)
    for plane in range(1, n_planes):
        codes |= split[plane].astype(np.uint32) << np.uint32(8 * plane)
    return codes


def unzigzag(codes: NDArray[np.uint32], level: int) -> NDArray[np.int32]:
    """0, 1, 2, 3, ... to level + 0, -1, 1, -2, ..., modulo 2**32."""
    difference = (codes >> np.uint32(1)) ^ (np.uint32(0) - (codes & np.uint32(1)))
    return (difference + np.uint32(level & 0xFFFFFFFF)).view(np.int32)


def dequantise(transformed: NDArray[np.float64], *, sigma_adu: float, gain_e_adu: float) -> NDArray[np.float64]:
    """ADU above the level of a transformed value: a line up to three sigma, then the inverse of the square root."""
    knee = 3.0 * sigma_adu
    scaled = np.maximum(transformed - knee, 0.0) / (2.0 * gain_e_adu * sigma_adu) + sigma_adu
    return np.minimum(transformed, knee) + gain_e_adu * (scaled * scaled - sigma_adu * sigma_adu)


def _checked_size(shape: tuple[int, int]) -> int:
    """Number of pixels of a block."""
    size = shape[0] * shape[1]
    if not 0 < size <= MAX_STRIP_PIXELS:
        raise ContractError(f"block shape: expected 1 to {MAX_STRIP_PIXELS} pixels, got {shape[0]} x {shape[1]}")
    return size


@dataclass(frozen=True, kw_only=True)
class PlanesDecoder:
    """`planes`: level, zigzag, byte planes, zstd."""

    @property
    def number(self) -> int:
        """Codec number."""
        return int(CodecNumber.PLANES)

    def decode(self, block: bytes, shape: tuple[int, int], *, level_adu: int, sigma_adu: float) -> NDArray[np.int32]:
        """The integers that were encoded."""
        return decode_planes(block, shape, level_adu)


@dataclass(frozen=True, kw_only=True)
class RawDecoder:
    """`raw`: big-endian 32-bit integers."""

    @property
    def number(self) -> int:
        """Codec number."""
        return int(CodecNumber.RAW)

    def decode(self, block: bytes, shape: tuple[int, int], *, level_adu: int, sigma_adu: float) -> NDArray[np.int32]:
        """The integers that were encoded."""
        size = _checked_size(shape)
        if len(block) != 4 * size:
            raise ContractError(f"raw block: expected {4 * size} bytes, got {len(block)}")
        return np.frombuffer(block, dtype=">i4").astype(np.int32).reshape(shape)


@dataclass(frozen=True, kw_only=True)
class Ccsds121Decoder:
    """`ccsds121`: level, zigzag, adaptive entropy coder of CCSDS 121.0-B-3 without preprocessor."""

    @property
    def number(self) -> int:
        """Codec number."""
        return int(CodecNumber.CCSDS121)

    def decode(self, block: bytes, shape: tuple[int, int], *, level_adu: int, sigma_adu: float) -> NDArray[np.int32]:
        """The integers that were encoded."""
        size = _checked_size(shape)
        if not block or block[0] not in (8, 16, 32):
            raise ContractError(f"ccsds121 block: expected 8, 16 or 32 bits per sample, got {block[0] if block else 'nothing'}")
        item_bytes = block[0] // 8
        whole_blocks = -(-size // AEC_BLOCK_SIZE) * AEC_BLOCK_SIZE * item_bytes  # the coder fills its last block
        try:
            plain = imagecodecs.aec_decode(
                block[1:],
                bitspersample=block[0],
                flags=0,
                blocksize=AEC_BLOCK_SIZE,
                rsi=AEC_SAMPLES_PER_REFERENCE,
                out=whole_blocks,
            )
        except (imagecodecs.AecError, ValueError) as error:
            raise ContractError(f"ccsds121 block: {error}") from error
        if len(plain) < size * item_bytes:
            raise ContractError(f"ccsds121 block: expected {size * item_bytes} bytes, got {len(plain)}")
        codes = np.frombuffer(plain, dtype=f"<u{item_bytes}", count=size).astype(np.uint32)
        return unzigzag(codes, level_adu).reshape(shape)


@dataclass(frozen=True, kw_only=True)
class SqrtPlanesDecoder:
    """`sqrt_planes`: each code becomes the mean of the integers that give it."""

    @property
    def number(self) -> int:
        """Codec number."""
        return int(CodecNumber.SQRT_PLANES)

    def decode(self, block: bytes, shape: tuple[int, int], *, level_adu: int, sigma_adu: float) -> NDArray[np.float32]:
        """Mean ADU of each code: integers and half-integers."""
        if len(block) < SQRT_PLANES.size:
            raise ContractError(f"sqrt_planes block: expected at least {SQRT_PLANES.size} bytes, got {len(block)}")
        step, gain = SQRT_PLANES.unpack_from(block)
        for name, value in (("step", step), ("gain", gain), ("sigma + 1", sigma_adu + 1.0)):
            if not (math.isfinite(value) and 1e-6 <= value <= 1e9):
                raise ContractError(f"sqrt_planes block: expected {name} in [1e-6, 1e9], got {value}")
        sigma = max(float(sigma_adu), SQRT_LEAST_SIGMA_ADU)
        codes = decode_planes(block[SQRT_PLANES.size :], shape, 0)
        distinct, index = np.unique(codes, return_inverse=True)
        edges = [dequantise((distinct + half) * step, sigma_adu=sigma, gain_e_adu=gain) for half in (-0.5, 0.5)]
        lowest, highest = np.ceil(edges[0]), np.ceil(edges[1]) - 1.0
        means = np.where(highest >= lowest, 0.5 * (lowest + highest), 0.5 * (edges[0] + edges[1]))
        if not np.abs(means).max() < 2.0**31:
            raise ContractError("sqrt_planes block: values beyond 32 bits")
        return (means[index].reshape(shape) + level_adu).astype(np.float32)
