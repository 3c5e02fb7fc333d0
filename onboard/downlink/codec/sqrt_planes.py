"""Near-lossless: a step that is a fixed fraction of the noise at every brightness, then the lossless planes.

The noise variance of a pixel x ADU above the level is ``V(x) = sigma^2 + max(x - k, 0) / g`` with g in e-/ADU and the
knee ``k = 3 sigma``, below which x is mostly sky noise. The transform ``y(x) = integral sigma dx / (s sqrt(V))`` makes a
rounding of y a quantisation by the same share of the noise everywhere (the generalised square root of Bernstein et
al. 2010, PASP 122, 336, section 2); below the knee it is linear with a step of s = ``round(step * sigma)`` ADU, whole so
that all steps hold equally many integers.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from onboard.downlink.codec.planes import encode_planes
from sboc_e2e.icd.layout import SQRT_PLANES, CodecNumber

KNEE_SIGMA = 3.0
"""Where the square root takes over from the line; fixed by ICD.md."""

LEAST_SIGMA_ADU = 0.1
"""Noise of a frame without noise; fixed by ICD.md."""


def quantise(above_level: NDArray[np.float64], *, sigma_adu: float, step_adu: float, gain_e_adu: float) -> NDArray[np.int32]:
    """Codes of ADU above the level: the transform y rounded half up."""
    knee = KNEE_SIGMA * sigma_adu
    beyond = np.maximum(above_level - knee, 0.0)
    root = (2.0 * gain_e_adu * sigma_adu) * (np.sqrt(sigma_adu * sigma_adu + beyond / gain_e_adu) - sigma_adu)
    return np.floor((np.minimum(above_level, knee) + root) / step_adu + 0.5).astype(np.int32)


@dataclass(frozen=True, kw_only=True)
class SqrtPlanesCodec:
    """`sqrt_planes`: near-lossless; the step is a fraction of the noise of each pixel."""

    step_sigma: float = field(default=0.85, metadata={"doc": "quantisation step over the noise", "min": 0.05, "max": 4.0})
    electrons_per_adu: float = field(
        default=1.2, metadata={"doc": "gain (e-/ADU) that sets the growth of photon noise", "min": 1e-3, "max": 1e4}
    )

    @property
    def number(self) -> int:
        """Codec number in the packet."""
        return int(CodecNumber.SQRT_PLANES)

    @property
    def lossless(self) -> bool:
        """Decoding differs from the input by up to half a step."""
        return False

    def for_counts(self, adu_scale: float) -> "SqrtPlanesCodec":
        """The codec with the gain of a count of `adu_scale` ADU."""
        return replace(self, electrons_per_adu=self.electrons_per_adu * adu_scale)

    def encode(self, values_adu: NDArray[np.int32], *, level_adu: int, sigma_adu: float) -> bytes:
        """Step and gain for the decoder, then the codes as a `planes` block around zero."""
        step_adu = max(1.0, round(self.step_sigma * sigma_adu))
        head = SQRT_PLANES.pack(step_adu, self.electrons_per_adu)
        step_adu, gain = SQRT_PLANES.unpack(head)
        sigma = max(float(np.float32(sigma_adu)), LEAST_SIGMA_ADU)
        codes = quantise(values_adu.astype(np.float64) - level_adu, sigma_adu=sigma, step_adu=step_adu, gain_e_adu=gain)
        return head + encode_planes(codes, 0)
