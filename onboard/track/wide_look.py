"""The best starts of the first look, judged in the frames two away as well, still at half resolution and without a climb.

Noise whose seed and neighbours agree by chance shows nothing there, so that few seeds are left to be climbed with.
"""

import math
from typing import Final

import numba as nb
import numpy as np
from numpy.typing import NDArray

from onboard.track.corridor import LANES, MOST_PIECES, PARTS, brightest, gather
from onboard.track.first_look import STEPS
from onboard.track.frames import Span
from onboard.track.trail_sums import Corridors, Look

AWAY: Final = 2  # frames before and after the seed's that are looked at
KEPT: Final = 0.8
"""Starts are looked at whose S/N in the first look is no farther below the best one's. Chosen, not measured."""

FINER: Final = 0.5
"""A start's length is tried this many steps of the first look shorter and longer, and its tilt half of this many lanes less and
more: two frames away an error is twice as large."""

LEAST_FRAMES: Final = 3  # pairs are the first look's
SPARE: Final = 2.0  # steps of the first look that are gathered beyond the starts' trails


@nb.njit(cache=True)
def gather_starts(
    image: NDArray[np.uint64],
    frame: int,
    place: NDArray[np.float64],
    look: Look,
    starts: NDArray[np.float64],
    corridors: Corridors,
) -> int:
    """Gather what the trails of some starts cover in a frame; returns the pixels read.

    image : rows are the major axis. place : see `gather`, of the seed in this frame. starts : as `first_look` fills them, one or
    more, all of the look's sense.
    """
    step = look.seed_px / STEPS
    first_px, last_px = 1e9, -1e9
    for k in range(len(starts)):
        begin = starts[k, 0] + look.sense * look.taus[frame] * starts[k, 1]
        first_px, last_px = min(first_px, begin), max(last_px, begin + starts[k, 1])
    begin, piece = first_px - SPARE * step, max(1.0, step)
    n = min(MOST_PIECES, math.ceil((last_px - first_px + 2.0 * SPARE * step) / piece))
    corridors.grid[frame, 0], corridors.grid[frame, 1], corridors.pieces[frame] = begin, piece, n
    return gather(image, True, place, begin, piece, n, corridors.sums[frame], corridors.counts[frame])


@nb.njit(cache=True)
def wide_look(
    corridors: Corridors,
    look: Look,
    span: Span,
    margin: NDArray[np.float64],
    least: float,
    starts: NDArray[np.float64],
    lane: int,
    best: NDArray[np.float64],
    room: NDArray[np.float64],
) -> float:
    """Best of some starts and their neighbours on a finer lattice in the frames of a span; fills best (a, length, tilt, sense).

    By how much the S/N of three or more frames in a row with the centre exceeds margin[number of frames]; `least` where none has
    more. starts : all of the look's sense. lane : of the seed. room (2, frames) : work space.
    """
    sums, counts, grid, pieces = corridors
    centre, low, high = span
    scale, step, score = math.sqrt(look.variance * PARTS), look.seed_px / STEPS, least
    total, weight = room[0], room[1]
    for e in range(len(starts)):
        for longer in range(-1, 2):
            length = starts[e, 1] + FINER * longer * step
            start = starts[e, 0] - 0.5 * FINER * longer * step
            for turn in range(-1, 2):
                tilt = starts[e, 2] + 0.5 * FINER * turn
                for frame in range(low, high + 1):
                    begin = start + look.sense * look.taus[frame] * length
                    at = lane + round(tilt * ((begin + 0.5 * length) / look.seed_px - 0.5))
                    total[frame] = weight[frame] = 0.0
                    if 0 <= at < LANES:
                        first = (begin - grid[frame, 0]) / grid[frame, 1]
                        last = first + length / grid[frame, 1]
                        total[frame] = brightest(sums, frame, pieces[frame], first, last, at, at)
                        weight[frame] = brightest(counts, frame, pieces[frame], first, last, at, at)
                for first_frame in range(low, centre + 1):
                    s = w = 0.0
                    for frame in range(first_frame, high + 1):
                        s += total[frame]
                        w += weight[frame]
                        n = frame - first_frame + 1
                        if frame >= centre and n >= LEAST_FRAMES and s > 0.0 and w > 0.0:
                            value = s / (scale * math.sqrt(w)) - margin[n]
                            if value > score:
                                score = value
                                best[0], best[1], best[2], best[3] = start, length, tilt, look.sense
    return score
