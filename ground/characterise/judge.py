"""Class of an object by its light: stable, tumbling, glinting, or "varying" where it changes and none of them is shown."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from ground.characterise.period import Period, find_period
from ground.characterise.reduced import Pass, PhaseFunction, phase_function

Array = NDArray[np.float64]

CLASSES: Final = ("stable", "tumbling", "glinting", "varying")
_FLASH_SIGMA: Final = 6.0  # noise alone exceeds it in one of 1e9 Gaussian samples; scatter has longer tails. See docs/objects.md
_FLASH_MAG: Final = 0.5  # smallest flash: the definition of class glinting (docs/objects.md). Chosen, not measured
_CHANGES: Final = 1e-3  # false alarm of "varying" for one object


@dataclass(frozen=True, kw_only=True)
class Character:
    """What the light of an object says. flashes : brightenings in all passes; scatter_mag : rms about the slow change."""

    kind: str
    period: Period
    phase: PhaseFunction
    flashes: int
    scatter_mag: float
    passes: int
    samples: int


def characterise(passes: Sequence[Pass]) -> Character:
    """Class, period and phase function from the passes of one object."""
    function = phase_function(passes)
    reduced = [p.at_standard - function.at(p.phase_deg) for p in passes]
    period = find_period([p.t_s for p in passes], reduced, [p.mag_err for p in passes])
    flashes, outside, free, squares, n = 0, 0.0, 0, 0.0, 0
    for one, mag in zip(passes, reduced, strict=True):
        left = mag - _level(one.t_s, mag)
        bright = left < -np.maximum(_FLASH_SIGMA * _noise(left, one.mag_err), _FLASH_MAG)
        # neighbouring samples are one flash
        flashes += int(np.count_nonzero(np.diff(bright.astype(int), prepend=0) == 1))
        outside += float(((left / one.mag_err)[~bright] ** 2).sum())
        free += max(int((~bright).sum()) - 3, 0)
        squares += float((left**2).sum())
        n += len(left)
    if np.isfinite(period.period_s):
        kind = "tumbling"
    elif flashes:
        kind = "glinting"
    else:
        kind = "varying" if free > 0 and chi2.sf(outside, free) < _CHANGES else "stable"
    return Character(
        kind=kind, period=period, phase=function, flashes=flashes, scatter_mag=float(np.sqrt(squares / n)), passes=len(passes),
        samples=n,
    )  # fmt: skip


def _level(t: Array, mag: Array) -> Array:
    """The slow change (n,): a parabola in time fitted with the far-off samples weighed down."""
    if len(t) < 4:
        return np.full(len(t), float(np.median(mag)))
    columns = np.vander((t - t.mean()) / max(float(np.ptp(t)), 1e-9), 3)
    weight = np.ones(len(t))
    for _ in range(6):
        coefficients, *_ = np.linalg.lstsq(columns * weight[:, None], mag * weight, rcond=None)
        left = mag - columns @ coefficients
        size = 1.5 * 1.4826 * float(np.median(np.abs(left))) + 1e-9
        weight = np.sqrt(np.minimum(1.0, size / np.maximum(np.abs(left), 1e-12)))
    return np.asarray(columns @ coefficients)


def _noise(left: Array, error: Array) -> Array:
    """The larger of what the errors say and what the samples show (n,)."""
    return np.maximum(error, 1.4826 * float(np.median(np.abs(left))))
