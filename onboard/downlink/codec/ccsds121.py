"""Conformity: Rice coding by CCSDS 121.0-B-3 (adaptive entropy coder, by libaec), preprocessor bypassed.

The level is taken away and the result zigzag-mapped before the coder, because the standard's unit-delay predictor
costs half a bit per pixel on uncorrelated noise (1.04-1.08 instead of 1.12-1.22 times the entropy).
"""

from dataclasses import dataclass

import imagecodecs
import numpy as np
from numpy.typing import NDArray

from onboard.downlink.codec.planes import zigzag_codes
from sboc_e2e.icd.layout import CodecNumber

BLOCK_SIZE = 64
"""Samples per block, J (the standard allows 8, 16, 32, 64)."""

SAMPLES_PER_REFERENCE = 128
"""Blocks between reference samples; without preprocessor it only sets the length of a zero-block run."""


@dataclass(frozen=True, kw_only=True)
class Ccsds121Codec:
    """`ccsds121`: lossless, for ground segments that insist on the standard."""

    @property
    def number(self) -> int:
        """Codec number in the packet."""
        return int(CodecNumber.CCSDS121)

    @property
    def lossless(self) -> bool:
        """Decoding gives the same integers."""
        return True

    def encode(self, values_adu: NDArray[np.int32], *, level_adu: int, sigma_adu: float) -> bytes:
        """Bits per sample (1 byte: 8, 16 or 32), then the coder's output for the block row by row, big endian."""
        codes, largest = zigzag_codes(values_adu, level_adu)
        n_bits = largest.bit_length()
        bits = next(size for size in (8, 16, 32) if n_bits <= size)
        samples = codes.astype(f"<u{bits // 8}")
        coded = imagecodecs.aec_encode(
            samples.tobytes(), bitspersample=bits, flags=0, blocksize=BLOCK_SIZE, rsi=SAMPLES_PER_REFERENCE
        )
        return bytes((bits,)) + coded
