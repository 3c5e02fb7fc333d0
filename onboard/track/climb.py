"""A track is raised to its highest joint S/N, and to the run of frames that shows it best."""

import math
from typing import Final

import numba as nb
import numpy as np
from numpy.typing import NDArray

from onboard.track.frames import Span
from onboard.track.trail_sums import Corridors, Look, evaluate, trail_sums, trail_variance

LEAST_SEEN: Final = 0.4
"""A frame counts where so much of the trail in it falls on known pixels."""


@nb.njit(cache=True, error_model="numpy")
def climb(
    corridors: Corridors,
    look: Look,
    low: int,
    high: int,
    track: NDArray[np.float64],
    steps: NDArray[np.float64],
    halvings: int,
    trial: NDArray[np.float64],
) -> float:
    """Raise a track's joint S/N by steps in its four parameters, alone and with its length about its middle; in place."""
    snr = evaluate(corridors, look, low, high, track)
    scale = 1.0
    for _ in range(halvings):
        failed = 0
        for _ in range(8):
            for parameter in range(5):
                for sign in (-1.0, 1.0):
                    if failed == 10:  # all ten steps from where the track is
                        break
                    failed += 1
                    trial[:] = track
                    if parameter < 4:
                        trial[parameter] += sign * scale * steps[parameter]
                    else:
                        # longer about its middle: alone, length and start would wait for each other
                        trial[1] += sign * scale * steps[1]
                        trial[0] -= 0.5 * sign * scale * steps[1]
                    if trial[1] < 0.4 * look.seed_px or trial[1] > 1.8 * look.seed_px:
                        continue
                    value = evaluate(corridors, look, low, high, trial)
                    if value > snr + 1e-4:
                        snr, failed = value, 0
                        track[:] = trial
        scale *= 0.5
    return snr


@nb.njit(cache=True)
def best_range(
    corridors: Corridors,
    look: Look,
    span: Span,
    track: NDArray[np.float64],
    threshold: NDArray[np.float64],
    sums: NDArray[np.float64],
    weights: NDArray[np.float64],
) -> tuple[float, int, int]:
    """The run of frames with the centre whose joint S/N exceeds its threshold most: this margin, first and last frame."""
    centre, low, high = span
    full = track[1] * look.per_lane
    unit = math.sqrt(trail_variance(look.variance, look.ends, full))
    for frame in range(low, high + 1):
        sums[frame], weights[frame] = trail_sums(corridors, look, frame, track)
    score, first, last = -1e9, centre, centre
    for i in range(low, centre + 1):
        for j in range(centre, high + 1):
            total = weight = 0.0
            seen = 0
            for k in range(i, j + 1):
                if weights[k] > LEAST_SEEN * full:
                    seen += 1
                total += sums[k]
                weight += weights[k]
            if seen == j - i + 1 and seen >= 2:
                value = total / (unit * math.sqrt(weight)) - threshold[seen]
                if value > score:
                    score, first, last = value, i, j
    return score, first, last
