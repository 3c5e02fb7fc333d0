"""A climbed track grows: frame by frame on either side of its seed's, and into those of which half the resolution is kept."""

import math
from typing import Final, NamedTuple

import numba as nb
import numpy as np
from numpy.typing import NDArray

from onboard.track.climb import best_range, climb
from onboard.track.first_look import STEPS
from onboard.track.frames import Frames, Span, span_of
from onboard.track.trail_sums import Corridors, Look, collect, collect_half, evaluate, half_line_variance

WAITING: Final = 1.7
"""A track that falls short by less, with light in later frames, is followed again when more of them have come."""

CLIMBED: Final = 2.1
"""S/N by which a track may fall short in the seed's frame and those beside it, once it was climbed there, to be looked for in
more frames. With `LONGER` there it costs 4 of 253 seeds that become tracks, and three quarters of the climbs in more than three
frames (30 cubes of eight frames, seed 101)."""
LONGER: Final = 1.8  # the same in more frames

FINE: Final = 24
"""Pieces of a seed in the second look."""


class Grown(NamedTuple):
    """The run of frames that shows a track best: by how much its S/N exceeds the threshold, first and last frame; pixels read."""

    margin: float
    first: int
    last: int
    read: int


@nb.njit(cache=True)
def set_steps(steps: NDArray[np.float64], look: Look, first: int, last: int, pieces: int, across_px: float) -> None:
    """First steps of a climb in frames first ... last: a piece of the seed along it, so many px across, less in a rate."""
    span = max(1.0, abs(look.taus[first]), abs(look.taus[last]))
    steps[0], steps[1] = look.seed_px / pieces, look.seed_px / pieces / span
    steps[2], steps[3] = across_px, 2.0 * across_px / span


@nb.njit(cache=True)
def grown(
    frames: Frames,
    images: tuple[NDArray[np.uint64], ...],
    seed: NDArray[np.float64],
    half_seed: NDArray[np.float64],
    look: Look,
    away: int,
    track: NDArray[np.float64],
    corridors: Corridors,
    sums: NDArray[np.float64],
    weights: NDArray[np.float64],
) -> Grown:
    """Raise a track (a, length, offset, tilt; in place) in ever more frames, at first in those up to `away` from the seed's.

    images : as `packed.packed`, old ones at half resolution. half_seed : see `start.own_look`. sums, weights (frames,) : work
    space.
    """
    place, read, scale = np.empty(4), 0, half_scale(frames, look)
    low = high = first = last = frames.centre
    score = -1e9
    for reach_frames in range(away, len(images)):
        _, low, high = span_of(frames, reach_frames)
        for frame in range(low, high + 1):
            # what was gathered for nearer frames is gathered again, finer, about the place as it is known now
            read += gathered(frames, images, frame, seed, half_seed, look, track, scale, corridors, place)
        score, first, last = _raised(frames, look, low, high, track, corridors, sums, weights)
        # noise may end a faint track's best run early; its frames together tell whether there is light in more of them
        ended = last < high and first > low
        together = evaluate(corridors, look, low, high, track) - frames.threshold[high - low + 1] if ended else score
        if together < -(CLIMBED if reach_frames == 1 else LONGER):
            break
        if low == frames.n_old and high == frames.n_frames - 1:
            break
    while score > -WAITING and 0 < low <= frames.n_old and first == low:
        # a track that reaches the oldest frame is followed into those before it
        low -= 1
        read += gathered(frames, images, low, seed, half_seed, look, track, scale, corridors, place)
        score, first, last = _raised(frames, look, low, high, track, corridors, sums, weights)
    return Grown(score, first, last, read)


@nb.njit(cache=True)
def half_scale(frames: Frames, look: Look) -> tuple[float, float]:
    """`scale` of `trail_sums.collect_half`: a line's brightest pixels are lower at half resolution."""
    fainter = math.sqrt(2.0 * frames.psf_sigma_px**2 / (2.0 * frames.psf_sigma_px**2 + 0.25))
    ratio = look.variance / half_line_variance(frames.psf_sigma_px, look.per_lane)
    return fainter * ratio, fainter**2 * ratio


@nb.njit(cache=True)
def gathered(
    frames: Frames,
    images: tuple[NDArray[np.uint64], ...],
    frame: int,
    line: NDArray[np.float64],
    half_line: NDArray[np.float64],
    look: Look,
    track: NDArray[np.float64],
    scale: tuple[float, float],
    corridors: Corridors,
    place: NDArray[np.float64],
) -> int:
    """Gather a frame, old ones at half resolution, about a track's trail on a line (4,) of the centre frame; the pixels read.

    scale : see `half_scale`. place (4,) : work space.
    """
    begin, end = _corridor(look, frame, track)
    piece = look.seed_px / FINE
    if frame >= frames.n_old:
        return collect(images, frame, line, frames.transforms, begin, end, max(1.0, piece), corridors, place)
    return collect_half(images, frame, half_line, frames.half_transforms, begin, end, max(2.0, piece), scale, corridors, place)


@nb.njit(cache=True)
def _raised(
    frames: Frames,
    look: Look,
    low: int,
    high: int,
    track: NDArray[np.float64],
    corridors: Corridors,
    sums: NDArray[np.float64],
    weights: NDArray[np.float64],
) -> tuple[float, int, int]:
    """Climb with a track in frames low ... high, in place; margin, first and last frame of its best run there."""
    steps = np.empty(4)
    set_steps(steps, look, low, high, STEPS, 0.6)
    climb(corridors, look, low, high, track, steps, 4, np.empty(4))
    return best_range(corridors, look, Span(frames.centre, low, high), track, frames.threshold, sums, weights)


@nb.njit(cache=True)
def _corridor(look: Look, frame: int, track: NDArray[np.float64]) -> tuple[float, float]:
    """From where to where a frame is gathered about a track's trail in it, px on the seed's line."""
    middle = track[0] + (0.5 + look.sense * look.taus[frame]) * track[1]
    half = (0.9 + 0.12 * abs(look.taus[frame])) * look.seed_px
    return middle - half, middle + half
