"""Structure of the unresolved light: clouds of dust that starlight makes visible (cirrus) and uneven crowds of faint stars.

Maps of interstellar dust have a power spectrum of k^-2.9 from degrees to arcminutes (Gautier et al. 1992, AJ 103, 1313;
Miville-Deschenes et al. 2007, A&A 469, 595). The logarithm of the light is a sum of plane waves with that spectrum: brightness
stays above 0, any direction can be asked for alone, and the mean of the sky is kept. How deep the structure is, is ASSUMED.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from simulator.randomness import Effect, generator

Array = NDArray[np.float64]

SLOPE: Final = 2.9  # of the power spectrum (Gautier et al. 1992, Miville-Deschenes et al. 2007)
LARGEST_DEG, SMALLEST_DEG = 20.0, 0.2
"""Lengths of the longest and shortest waves; a grid of the sky over 5 deg resolves the latter."""
_WAVES: Final = 240  # 120 a decade; their sum is near to a Gaussian field. Time grows with them; chosen, not measured


@dataclass(frozen=True, kw_only=True, eq=False)
class Cirrus:
    """Waves over the sphere. wave : (m, 3) rad^-1. phase, amplitude : (m,). rms : of the logarithm of the light."""

    wave: Array
    phase: Array
    amplitude: Array
    rms: float

    def factor(self, directions: Array) -> Array:
        """Unresolved light of directions (n, 3) over its mean, (n,)."""
        waves = np.cos(directions @ self.wave.T + self.phase) @ self.amplitude
        return np.asarray(np.exp(self.rms * waves - 0.5 * self.rms**2))


def make_cirrus(rms: float, seed: int) -> Cirrus | None:
    """The structure of a seed; None where there is none.

    Wave numbers are even in their logarithm; each then has the variance k^2 times the spectrum. Waves are tangent to the sphere
    only where they stand across the line of sight, so that a part of them is longer than its wave number says.
    """
    if rms == 0.0:
        return None
    rng = generator(seed, Effect.CIRRUS)
    low, high = (2.0 * np.pi / np.radians(d) for d in (LARGEST_DEG, SMALLEST_DEG))
    number = low * (high / low) ** ((np.arange(_WAVES) + rng.random(_WAVES)) / _WAVES)
    axis = rng.standard_normal((_WAVES, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    variance = number ** (2.0 - SLOPE)
    return Cirrus(
        wave=number[:, None] * axis,
        phase=2.0 * np.pi * rng.random(_WAVES),
        amplitude=np.sqrt(2.0 * variance / variance.sum()),
        rms=rms,
    )
