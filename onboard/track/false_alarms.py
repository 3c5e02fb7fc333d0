"""Joint S/N that noise alone reaches: expected Euler characteristic of the S/N over all straight tracks of n frames.

A track of n frames has four free parameters, as a segment of one frame has: a place and a velocity. Frames only lengthen the
lever arm on which the velocity is known, so that the number of independent tracks grows as the variance of the epochs (leading
term of Adler & Taylor 2007 in four dimensions, metric = Fisher matrix / S^2).
"""

import math

import numpy as np
from numpy.typing import NDArray

SHORTEST_PX = 10.0
"""Of 2,000 px for the longest, it takes 0.5 % of the volume away: 0.001 sigma of the threshold."""
PARAMETERS = 4  # a place and a velocity


def independent_tracks(
    n_frames: int, *, area_px: float, longest_px: float, period_over_exposure: float, psf_sigma_px: float
) -> float:
    """Volume of the bank of tracks through n frames in units of their metric.

    Trails of one exposure are SHORTEST_PX to longest_px long, at any angle; both senses of motion count where there are two
    frames to tell them apart.
    """
    spread = period_over_exposure**2 * (n_frames**2 - 1) / 12.0
    end = 1.0 / (2.0 * math.sqrt(math.pi) * psf_sigma_px)
    root = 2.0 * end * math.sqrt(spread + 0.25) / (2.0 * psf_sigma_px**2) * math.sqrt(spread + 1.0 / 12.0)
    angles = math.pi if n_frames == 1 else 2.0 * math.pi
    return area_px * angles * max(longest_px - SHORTEST_PX, 1.0) * root


def expected_above(sigma: float, volume: float) -> float:
    """Expected number of maxima of noise above a joint S/N of `sigma` in a bank of the given volume."""
    tail = math.exp(-0.5 * sigma * sigma) * (2.0 * math.pi) ** (-0.5 * (PARAMETERS + 1))
    return volume * sigma ** (PARAMETERS - 1) * tail


def threshold_sigma(volume: float, false_alarms: float) -> float:
    """Joint S/N that noise exceeds `false_alarms` times in a bank of the given volume."""
    low, high = math.sqrt(PARAMETERS - 1), 40.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if expected_above(middle, volume) > false_alarms else (low, middle)
    return high


def half_point_sigma(threshold: float) -> float:
    """True joint S/N at which half are found: the maximum over four parameters exceeds it by 4 / (2 S) on average."""
    return 0.5 * (threshold + math.sqrt(threshold * threshold - 2.0 * PARAMETERS))


def independent_stacks(epochs_s: NDArray[np.float64], *, area_px: float, box_px2_s2: float, psf_sigma_px: float) -> float:
    """Volume of the bank of straight tracks of points through frames at `epochs_s`, in units of their metric.

    box_px2_s2 : area of the velocities searched. The metric of a point's place is 1 / (2 sigma^2) along each axis, that of its
    velocity the same times the variance of the epochs.
    """
    return area_px * box_px2_s2 * float(np.var(epochs_s)) / (4.0 * psf_sigma_px**4)
