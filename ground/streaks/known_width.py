"""Effect of the error of the PSF width on the flux of a trail.

The stars of a frame give the PSF width with an error. A template that is too wide makes a trail too bright: by half the relative
error of the width if the sky dominates the noise, by nothing if the object's own photons do. Bright trails show their width,
faint ones do not. The width is therefore a parameter with a prior, and its posterior error is included in the error of the flux.
"""

import math
from typing import Final

import numpy as np

from ground.streaks.psf_field import SCATTER as PRIOR

_V: Final = np.linspace(-4.0, 4.0, 33)
_PROFILE: Final = np.exp(-0.5 * _V**2) / math.sqrt(2.0 * math.pi)


def flux_slope(density_e_px: float, variance_e2: float, width_px: float) -> float:
    """d ln flux / d ln width of the least-squares flux of a Gaussian profile in noise ``variance + model``."""
    profile = _PROFILE / width_px
    weight = 1.0 / (variance_e2 + max(density_e_px, 0.0) * profile)
    return float(np.sum(weight * profile**2 * (1.0 - _V**2)) / np.sum(weight * profile**2))


def posterior(ln_excess: float, error: float) -> tuple[float, float]:
    """Mean and sigma of ln (width / expected width) from a measured excess and its error."""
    if not math.isfinite(error):
        return 0.0, PRIOR
    share = PRIOR**2 / (PRIOR**2 + error**2)
    return share * ln_excess, math.sqrt(share) * error
