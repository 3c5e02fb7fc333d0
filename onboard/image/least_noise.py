"""The noise of tiles that lost theirs: a compressed picture holds one value where its noise was below the codec's step.

Such tiles have a noise of 0, or of 1e-7 by rounding, so that nothing in them was found and lines had an S/N of 1e8. Whole
numbers have the noise of their rounding at least. The codec has one step for the whole picture, so that noise which survived
somewhere is a measure of what was lost elsewhere.
"""

import numpy as np
from numpy.typing import NDArray

LEAST_SIGMA = 0.29
"""Noise of an ideal quantiser, 1/sqrt(12), in units of the pixels: no frame has less."""
SURVIVED = 0.25
"""Quantile of the noise of the tiles that kept theirs, as a measure of the step: the higher ones hold structure too. Chosen."""


def with_least_noise(sigma: NDArray[np.float32], quantum: float) -> NDArray[np.float32]:
    """Noise of tiles, any shape, in which that of rounding to multiples of a quantum, or less, is what the others kept."""
    least = LEAST_SIGMA * quantum
    lost = sigma <= least
    if not lost.any():
        return sigma
    kept = sigma[~lost]
    return np.where(lost, np.float32(np.quantile(kept, SURVIVED)) if kept.size else np.float32(least), sigma).astype(np.float32)
