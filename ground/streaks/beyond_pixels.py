"""Light beyond the pixels that came down: how likely the on-board detector, which saw it, ended the trail within them.

Along a lit trail the log likelihood ratio of light and no light is a Brownian motion: a pixel's length of S/N s adds s^2 / 2 on
average, with the variance s^2. The detector ends the trail where that sum is largest. It stopped before the border, where the
sum had fallen by h, only if the sum did not rise by h again over the lit length D beyond. The probability that it stays below
is that of the first passage of a Brownian motion with drift (Cox & Miller 1965, The Theory of Stochastic Processes, section 5.7):

    Phi((h - a) / b) - exp(h) Phi((-h - a) / b)        a = s^2 D / 2,  b = s sqrt(D)
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr

Array = NDArray[np.float64]

LEAST_FALL: Final = 1.0
"""Of the log likelihood from the detector's end to the border. The detector's sum is not that on ground: with none, it would have
stopped nowhere. Chosen, not measured."""


def log_stopped(lit_px: Array, fall: Array, snr2_per_px: Array) -> Array:
    """Log probability that the detector stopped though the next `lit_px` > 0 are lit.

    fall : of the log likelihood from its largest value to the border. snr2_per_px : square of the S/N of a pixel's length. All
    three broadcast.
    """
    h = np.maximum(fall, LEAST_FALL)
    passed = np.maximum(snr2_per_px * lit_px, 1e-12)
    root = np.sqrt(passed)
    below, reflected = log_ndtr((h - 0.5 * passed) / root), h + log_ndtr((-h - 0.5 * passed) / root)
    return np.asarray(below + np.log(-np.expm1(np.minimum(reflected - below, -1e-12))))
