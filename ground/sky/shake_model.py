"""What a camera's shake does to the ends of a trail, by a process that has one time of memory.

Shake is taken as a first-order Markov process: covariance exp(-|dt| / memory), a spectrum that is white below 1 / (2 pi memory)
and falls with the square of frequency above (Uhlenbeck & Ornstein 1930, Phys. Rev. 36, 823); an endless memory is a random walk.
Attitudes of whole frames give its level, by third differences. Trails give its memory: how much more the slope of the path within
an exposure scatters about the rate by neighbouring frames than a walk of this level lets expect (`ground.link.shake`). From both
follows what no line through a trail shows: the path's departure from that line where the shutter opens and closes.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

PLACES: Final = 32
"""Epochs within an exposure at which the process is looked at."""
SHARES: Final = (0.0, 0.125, 0.25, 0.375, 0.5)
"""Parts of the exposure, first and last, that an end may show."""
EDGE_WIDTHS: Final = 2.26
"""Part of a trail that its end shows, in PSF widths: twice the mean depth, 0.8 sqrt(2), from which light comes to pixels that a
shift of the end changes."""
MEMORIES: Final = 25
"""Times of memory that are tried, from a hundredth of an exposure to a hundred steps between frames."""


@dataclass(frozen=True, kw_only=True)
class EndShake:
    """One sigma of both ends along a trail, over what the error of the rate makes there.

    turn : opposite at both ends. sways : the same at both, where an end shows these `SHARES` of the exposure.
    """

    turn: float
    sways: tuple[float, ...]

    def sway(self, length_px: float, width_px: float) -> float:
        """Of a trail this long and wide: ends of a short one show more of the exposure than its first and last moment."""
        share = EDGE_WIDTHS * width_px / max(length_px, 1e-6)
        return float(np.interp(share, SHARES, self.sways))


STEADY: Final = EndShake(turn=1.0, sways=(0.0,) * len(SHARES))
"""A camera that turns evenly."""


def end_shake(factor: float, exposure_s: float, step_s: float) -> EndShake:
    """Of exposures this long and frames this far apart.

    factor : slopes within exposures over those of a random walk with the run's third differences; below 1 counts as 1.
    """
    if not 0.0 < exposure_s < step_s:
        return STEADY
    factors, turn, sways = _by_memory(float(exposure_s), float(step_s))
    at = np.log(max(factor, 1.0))
    return EndShake(turn=float(np.interp(at, factors, turn)), sways=tuple(float(np.interp(at, factors, sway)) for sway in sways))


@lru_cache(maxsize=8)
def _by_memory(exposure_s: float, step_s: float) -> tuple[Array, Array, Array]:
    """Rising logarithms of the factor (m,), and the ratios there, (m,) and (s, m), from the longest memory to the shortest."""
    within = (np.arange(PLACES) + 0.5) / PLACES - 0.5
    t_s = np.concatenate([k * step_s + exposure_s * within for k in (-1, 0, 1, 2)] + [exposure_s * np.array([-0.5, 0.5])])
    mean = np.zeros((4, len(t_s)))
    for k in range(4):
        mean[k, k * PLACES : (k + 1) * PLACES] = 1.0 / PLACES
    slope, ends = np.zeros(len(t_s)), np.eye(len(t_s))[-2:]
    slope[PLACES : 2 * PLACES] = within / (exposure_s * float(within @ within))
    rate = (mean[2] - mean[0]) / (2.0 * step_s)
    seen = [
        mean[3] - 3.0 * mean[2] + 3.0 * mean[1] - mean[0],
        0.5 * exposure_s * (slope - rate),
        0.5 * (ends[1] - ends[0]) - 0.5 * exposure_s * rate,
        0.5 * (ends[0] + ends[1]) - mean[1],
    ]
    for share in SHARES[1:]:
        shown = np.zeros(len(t_s))
        shown[PLACES : 2 * PLACES] = np.abs(within) > 0.5 - share
        seen.append(shown / shown.sum() - mean[1])
    lag_s = np.abs(t_s[:, None] - t_s)
    memory_s = np.geomspace(100.0 * step_s, 0.01 * exposure_s, MEMORIES)
    # less one, which no difference sees: what is left of a long memory is not lost to rounding
    sigma = np.sqrt([np.maximum(np.diag(np.array(seen) @ np.expm1(-lag_s / m) @ np.array(seen).T), 0.0) for m in memory_s])
    factor = np.log(sigma[:, 1] / sigma[:, 0])
    rising = np.maximum.accumulate(factor - factor[0])
    return rising, sigma[:, 2] / sigma[:, 1], (sigma[:, 3:] / sigma[:, 1:2]).T
