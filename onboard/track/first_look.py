"""The best track through a seed on a lattice of ends and tilts, at half resolution, in its frame and those beside it."""

import math
from typing import Final

import numba as nb
import numpy as np
from numpy.typing import NDArray

from onboard.track.corridor import LANES, MIDDLE, PARTS, brightest, running
from onboard.track.frames import Span
from onboard.track.trail_sums import Corridors, Look

STEPS: Final = 6
"""Pieces of a seed in the first look: ends are tried at steps of a sixth of its length."""

END_STEPS: Final = 2
"""Largest error of an end, in steps: a seed of S/N 5 has ends good to sqrt(26) / 25 = 0.2 of its length (change-point law)."""

TILT_STEPS: Final = 2
"""In the first look, at half resolution, the seed's direction may be wrong by this many lanes (4 px) per seed length: its
error is sqrt(24) s / S = 0.8 px."""

LIKED: Final = 0.75
"""Ends whose S/N in the seed's own frame is below this share of the best ends' are not followed."""

BESIDE: Final = 1
"""A seed may lie beside its trail by so many lanes (2 px) of the first look."""

KNOWN: Final = 0.8
"""Lanes beside the middle one have so much of its known pixels, or what they hold may be missed: its own star hides no more."""

SHORTEST: Final = 0.5  # more room costs time, less loses seeds that took in other light. Chosen, not measured
LONGEST: Final = 1.6
"""Trails are so much shorter or longer than their seed at most."""


ENDS: Final = 2 * END_STEPS + 1
"""Places that are tried for each end."""


@nb.njit(cache=True)
def own_ends(
    corridors: Corridors, look: Look, centre: int, ends: NDArray[np.float64], before: NDArray[np.int64]
) -> tuple[int, int, float]:
    """Ends that the seed's own frame likes, of all on a lattice: how many, on which lane, S/N of the best.

    ends (n, 4) : where the trail begins and its length, px, sum and weight as `brightest` has them. Lanes beside the middle one
    count too: a seed lies on the lattice of the search that made it. before (2, ENDS, 2, LANES) : work space, for sums and known
    pixels before each place of either end.
    """
    seed_px, step = look.seed_px, look.seed_px / STEPS
    grid, n_pieces = corridors.grid[centre], corridors.pieces[centre]
    for k in range(ENDS):
        for end in range(2):
            at = ((k - END_STEPS) * step + end * seed_px - grid[0]) / grid[1]
            running(corridors.sums, corridors.counts, centre, n_pieces, at, MIDDLE - BESIDE, MIDDLE + BESIDE, before[end, k])
    top, lane, n = 0.0, MIDDLE, 0
    for turn in range(2):
        for i in range(ENDS):
            for j in range(ENDS):
                length = seed_px + (j - i) * step
                if length < SHORTEST * seed_px or length > LONGEST * seed_px:
                    continue
                for k in range(MIDDLE - BESIDE, MIDDLE + BESIDE + 1) if turn == 0 else range(lane, lane + 1):
                    total = before[1, j, 0, k] - before[0, i, 0, k]
                    weight = before[1, j, 1, k] - before[0, i, 1, k]
                    power = float(total) * float(total)
                    if total <= 0 or weight <= 0:
                        continue
                    if turn == 0:
                        if power > top * weight:
                            top, lane = power / weight, k
                    elif power >= LIKED * LIKED * top * weight:
                        ends[n, 0], ends[n, 1], ends[n, 2], ends[n, 3] = (i - END_STEPS) * step, length, total, weight
                        n += 1
    return n, lane, math.sqrt(top / PARTS / look.variance)


@nb.njit(cache=True)
def first_look(
    corridors: Corridors,
    look: Look,
    span: Span,
    margin: NDArray[np.float64],
    least: float,
    best: NDArray[np.float64],
    ends: NDArray[np.float64],
    n_ends: int,
    lane: int,
    starts: NDArray[np.float64],
    keep: float,
) -> tuple[float, int]:
    """Best track on a lattice of ends and tilts in the frames of a span; fills best (a, length, tilt, sense).

    All in pixels of the images that the corridors are of; tilts are whole lanes per length. Pairs of frames count beside all
    three: by how much the S/N exceeds margin[number of frames], or `least` where none does by more. Returns this and how many
    of the starts (m, 5) were filled: a, length, tilt, sense and S/N beyond the margin of the best tilt for some ends and a
    sense. All that are no more than `keep` below the best one are among them, and some that came before it. ends, n_ends,
    lane : as `own_ends` leaves them.
    """
    sums, counts, grid, pieces = corridors
    taus, seed_px = look.taus, look.seed_px
    centre, low, high = span
    scale = math.sqrt(look.variance * PARTS)  # of a sum over the root of its weight
    score, n_starts = least, 0
    two, three = max(score + margin[2], 0.0) * scale, max(score + margin[3], 0.0) * scale
    before, after = max(centre - 1, low), min(centre + 1, high)
    for e in range(n_ends):
        start, length, s1, w1 = ends[e, 0], ends[e, 1], ends[e, 2], ends[e, 3]
        for sense in (-1.0, 1.0):
            # lanes from the seed's frame to those beside it for a tilt of one
            back = (start + (sense * taus[before] + 0.5) * length) / seed_px - 0.5
            apart = (start + (sense * taus[after] + 0.5) * length) / seed_px - 0.5
            first0 = (start + sense * taus[before] * length - grid[before, 0]) / grid[before, 1]
            first2 = (start + sense * taus[after] * length - grid[after, 0]) / grid[after, 1]
            last0, last2 = first0 + length / grid[before, 1], first2 + length / grid[after, 1]
            most0 = most2 = known0 = known2 = 0
            if before < centre:
                known0 = brightest(counts, before, pieces[before], first0, last0, lane, lane)
                wide = math.ceil(TILT_STEPS * abs(back))
                most0 = brightest(sums, before, pieces[before], first0, last0, max(0, lane - wide), min(LANES - 1, lane + wide))
            if after > centre:
                known2 = brightest(counts, after, pieces[after], first2, last2, lane, lane)
                wide = math.ceil(TILT_STEPS * abs(apart))
                most2 = brightest(sums, after, pieces[after], first2, last2, max(0, lane - wide), min(LANES - 1, lane + wide))
            # the brightest lanes of both sides tell whether any tilt can reach what is asked: hardly ever
            if (
                _below(s1 + most0, w1 + KNOWN * known0, two)
                and _below(s1 + most2, w1 + KNOWN * known2, two)
                and _below(s1 + most0 + most2, w1 + KNOWN * (known0 + known2), three)
            ):
                continue
            top = least
            for half in range(-2 * TILT_STEPS, 2 * TILT_STEPS + 1):
                tilt = 0.5 * half
                m, n = lane + round(tilt * back), lane + round(tilt * apart)
                if m < 0 or n < 0 or m >= LANES or n >= LANES:
                    continue
                s0 = w0 = s2 = w2 = 0
                if before < centre:
                    s0 = brightest(sums, before, pieces[before], first0, last0, m, m)
                    w0 = brightest(counts, before, pieces[before], first0, last0, m, m)
                if after > centre:
                    s2 = brightest(sums, after, pieces[after], first2, last2, n, n)
                    w2 = brightest(counts, after, pieces[after], first2, last2, n, n)
                value = -1e9
                if w0 > 0 and not _below(s0 + s1, w0 + w1, two):
                    value = max(value, (s0 + s1) / (scale * math.sqrt(w0 + w1)) - margin[2])
                if w2 > 0 and not _below(s2 + s1, w2 + w1, two):
                    value = max(value, (s2 + s1) / (scale * math.sqrt(w2 + w1)) - margin[2])
                if w0 > 0 and w2 > 0 and not _below(s0 + s1 + s2, w0 + w1 + w2, three):
                    value = max(value, (s0 + s1 + s2) / (scale * math.sqrt(w0 + w1 + w2)) - margin[3])
                if value > top:
                    top, each = value, starts[n_starts]
                    each[0], each[1], each[2], each[3], each[4] = start, length, tilt, sense, value
                if value > score:
                    score = value
                    wanted = max(least, score - keep)
                    two, three = max(wanted + margin[2], 0.0) * scale, max(wanted + margin[3], 0.0) * scale
                    best[0], best[1], best[2], best[3] = start, length, tilt, sense
            n_starts += int(top > least)
    return score, n_starts


@nb.njit(cache=True, inline="always")
def _below(total: float, weight: float, least: float) -> bool:
    """Whether total / sqrt(weight) is, without a root: nearly all are."""
    return total <= 0.0 or total * total <= least * least * weight
