"""What an object's light says of it: stable, tumbling or glinting."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from ground.characterisation.passes import LightPass
from ground.characterisation.period import FEWEST_SAMPLES, Period, find_period
from ground.characterisation.phase_law import PhaseLaw, phase_law

FALSE_ALARM: Final = 0.01
"""A period is published when chance shows as clear a one in one object of a hundred."""

REPEATS: Final = 0.5
"""Of `Period.repeats`. Half passes of tumblers have more, transparency that drifts as a random walk seldom."""

FLASH_MAG: Final = 0.75
"""A flash doubles the light."""

FLASH_SIGMAS: Final = 6.0
FLASH_SHARE: Final = 0.1
"""Flashes fill less of a pass than this: what is bright for longer is a side of the body."""


@dataclass(frozen=True, kw_only=True)
class Character:
    """kind : "stable", "tumbling" (a period), "glinting" (flashes, with a period or without) or "unknown" (too few samples).

    variation_mag : half the range from the 5 % to the 95 % point of the samples about each pass's parabola, median over passes.
    flashes : in all passes together. period : where its false alarm is below `FALSE_ALARM` and half passes predict each other.
    """

    kind: str
    period: Period
    phase_law: PhaseLaw
    variation_mag: float
    flashes: int
    n_passes: int
    n_samples: int


def characterise(passes: Sequence[LightPass]) -> Character:
    """The character of an object from its passes."""
    period = find_period(passes)
    long = [p for p in passes if len(p.t_s) >= FEWEST_SAMPLES]
    flashes = sum(flashes_of(p) for p in long)
    periodic = bool(period.false_alarm < FALSE_ALARM and period.repeats > REPEATS)
    if not long:
        kind = "unknown"
    elif flashes:
        kind = "glinting"
    else:
        kind = "tumbling" if periodic else "stable"
    return Character(
        kind=kind,
        period=period if periodic else Period(false_alarm=period.false_alarm, repeats=period.repeats),
        phase_law=phase_law(passes),
        variation_mag=float(np.median([_variation(p) for p in long])) if long else float("nan"),
        flashes=flashes,
        n_passes=len(passes),
        n_samples=sum(len(p.t_s) for p in passes),
    )


def flashes_of(one: LightPass) -> int:
    """Runs of samples brighter than the bright quarter of the pass by `FLASH_MAG` and `FLASH_SIGMAS`; 0 where they are not brief.

    The lit side of a diffuse body that turns is bright for a good part of the time, so that its peak is near that quarter.
    """
    bright = np.percentile(one.mag, 25.0) - one.mag > np.maximum(FLASH_MAG, FLASH_SIGMAS * one.mag_err)
    if bright.mean() > FLASH_SHARE:
        return 0
    return int(np.count_nonzero(np.diff(bright.astype(np.int8), prepend=0) == 1))


def _variation(one: LightPass) -> float:
    x = np.linspace(-1.0, 1.0, len(one.t_s))
    low, high = np.percentile(one.mag - np.polyval(np.polyfit(x, one.mag, 2), x), [5.0, 95.0])
    return 0.5 * float(high - low)
