"""Where the climb from a seed starts: what its frame and those around show at half resolution.

A halved image has a quarter of the pixels, and the cache holds it better. Most seeds are noise and end here.
"""

import math
from typing import Final, NamedTuple

import numba as nb
import numpy as np
from numpy.typing import NDArray

from onboard.track.corridor import LANES, MOST_PIECES, gather
from onboard.track.first_look import END_STEPS, ENDS, LONGEST, STEPS, first_look, own_ends
from onboard.track.frames import Frames, span_of
from onboard.track.trail_sums import Corridors, Look, placed
from onboard.track.wide_look import AWAY, KEPT, gather_starts, wide_look

NARROW: Final = 1.9  # S/N by which the first look may fall short for a seed to be climbed with
WIDE: Final = 2.1
"""The same of the look in the frames two away; where the first look falls short by less than `NARROW` it may be more. Of noise's
seeds that come so far these leave one in twelve."""

DEARER: Final = 0.15  # chosen, not measured
DEARER_PX: Final = 256.0
"""A seed needs so much more S/N for each doubling of its length beyond this: the work grows as its length, and fewer of its
object's trails lie in the image."""


class Start(NamedTuple):
    """What the looks found of a seed.

    away : frames on either side that showed it; 0 where it is not worth a climb. lane : of halved images, on which its trail
    lies. read : pixels read.
    """

    away: int
    lane: int
    read: int


class Room(NamedTuple):
    """Work space of the looks.

    place (4,); ends (n, 4); before (2, ENDS, 2, LANES); starts and chosen (m, 5); wide_best (4,); lit (2, frames).
    """

    place: NDArray[np.float64]
    ends: NDArray[np.float64]
    before: NDArray[np.int64]
    starts: NDArray[np.float64]
    chosen: NDArray[np.float64]
    wide_best: NDArray[np.float64]
    lit: NDArray[np.float64]


@nb.njit(cache=True)
def room_for(n_frames: int) -> Room:
    """Work space for the looks of a window."""
    return Room(
        np.empty(4),
        np.empty((ENDS**2, 4)),
        np.empty((2, ENDS, 2, LANES), np.int64),
        np.empty((2 * ENDS**2 + 1, 5)),
        np.empty((2 * ENDS**2, 5)),
        np.empty(4),
        np.empty((2, n_frames)),
    )


@nb.vectorize(cache=True)
def dearer(seed_px: float) -> float:
    """S/N that a seed of such a length needs beyond what short ones do."""
    return DEARER * max(0.0, math.log2(seed_px / DEARER_PX))


@nb.njit(cache=True)
def own_look(
    frames: Frames,
    image: NDArray[np.uint64],
    half_seed: NDArray[np.float64],
    look: Look,
    least: float,
    corridors: Corridors,
    room: Room,
) -> tuple[int, int, int]:
    """Ends that a seed's own frame likes: how many, 0 where it shows less than an S/N of `least`, and on which lane; pixels read.

    image : the frame halved, its rows the seed's major axis. half_seed (4,) : the seed's ends in it. look : at half resolution.
    """
    begin, piece, n = _beside(look, 0.0)
    corridors.grid[frames.centre, 0], corridors.grid[frames.centre, 1], corridors.pieces[frames.centre] = begin, piece, n
    placed(half_seed, frames.half_transforms[frames.centre], room.place)
    sums, counts = corridors.sums[frames.centre], corridors.counts[frames.centre]
    read = gather(image, True, room.place, begin, piece, n, sums, counts)
    n_ends, lane, own = own_ends(corridors, look, frames.centre, room.ends, room.before)
    return n_ends if own >= least else 0, lane, read


@nb.njit(cache=True)
def _beside(look: Look, tau: float) -> tuple[float, float, int]:
    """What the first look gathers of a frame: from where on the seed's line, px per piece, how many pieces."""
    reach, away = END_STEPS / STEPS * look.seed_px, abs(tau) * LONGEST * look.seed_px
    piece = max(1.0, look.seed_px / STEPS)
    return -away - reach, piece, min(MOST_PIECES, math.ceil((look.seed_px + 2.0 * (away + reach)) / piece))


@nb.njit(cache=True)
def start_of(
    frames: Frames,
    halves: tuple[NDArray[np.uint64], ...],
    half_seed: NDArray[np.float64],
    look: Look,
    n_ends: int,
    lane: int,
    first_margin: float,
    corridors: Corridors,
    room: Room,
    best: NDArray[np.float64],
) -> Start:
    """Where to start from a seed; fills best (a, length, tilt, sense), px of halved images.

    halves : as `packed.halved` makes them, of the frames up to AWAY from the centre, their rows the seed's major axis. half_seed,
    look : see `own_look`. n_ends, lane : as it returns them. first_margin : how far the first look may fall short.
    """
    beside, oldest, place, read = span_of(frames, 1), frames.centre - AWAY, room.place, 0
    for frame in (frames.centre - 1, frames.centre + 1):
        if beside.low <= frame <= beside.high:
            begin, piece, n = _beside(look, frames.taus[frame])
            corridors.grid[frame, 0], corridors.grid[frame, 1], corridors.pieces[frame] = begin, piece, n
            placed(half_seed, frames.half_transforms[frame], place)
            sums, counts = corridors.sums[frame], corridors.counts[frame]
            read += gather(halves[frame - oldest], True, place, begin, piece, n, sums, counts)
    found, n_starts = first_look(
        corridors, look, beside, frames.threshold, -first_margin, best, room.ends, n_ends, lane, room.starts, KEPT
    )
    if found <= -first_margin:
        return Start(0, lane, read)
    span, wide, chosen = span_of(frames, AWAY), -1e9, room.chosen
    for side in (-1.0, 1.0):
        n = 0
        for k in range(n_starts):
            if room.starts[k, 3] == side and room.starts[k, 4] >= found - KEPT:
                chosen[n] = room.starts[k]
                n += 1
        if n == 0:
            continue
        towards = Look(look.taus, side, look.seed_px, look.per_lane, look.correlation, look.variance, look.ends, 0)
        for frame in (frames.centre - AWAY, frames.centre + AWAY):
            if span.low <= frame <= span.high:
                placed(half_seed, frames.half_transforms[frame], place)
                read += gather_starts(halves[frame - oldest], frame, place, towards, chosen[:n], corridors)
        wide = wide_look(corridors, towards, span, frames.threshold, wide, chosen[:n], lane, room.wide_best, room.lit)
    if found < -NARROW and wide < -WIDE:
        return Start(0, lane, read)
    if wide > found:
        best[:] = room.wide_best
        return Start(AWAY, lane, read)
    return Start(1, lane, read)
