"""No compression: big-endian 32-bit integers. For comparisons and as the simplest example of a codec."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd.layout import CodecNumber


@dataclass(frozen=True, kw_only=True)
class RawCodec:
    """`raw`: 32 bits a pixel."""

    @property
    def number(self) -> int:
        """Codec number in the packet."""
        return int(CodecNumber.RAW)

    @property
    def lossless(self) -> bool:
        """Decoding gives the same integers."""
        return True

    def encode(self, values_adu: NDArray[np.int32], *, level_adu: int, sigma_adu: float) -> bytes:
        """Encode a (n, width) block row by row; level and noise are not needed."""
        return np.ascontiguousarray(values_adu, dtype=">i4").tobytes()
