"""From a seed in one frame to the straight track through its neighbours with the highest joint S/N."""

import math
from typing import Final

import numba as nb
import numpy as np
from numpy.typing import NDArray

from onboard.track.climb import best_range, climb
from onboard.track.corridor import LANES, MIDDLE, MOST_PIECES, gather, path_sum
from onboard.track.first_look import END_STEPS, ENDS, LONGEST, STEPS, Span, first_look, own_ends
from onboard.track.packed import HALF_ROUNDING
from onboard.track.trail_sums import (
    Corridors,
    Look,
    collect,
    collect_half,
    evaluate,
    line_variance,
    look_of,
    placed,
    trail_sums,
    trail_variance,
)
from onboard.track.wide_look import AWAY, KEPT, gather_starts, wide_look

STATIC_SIGMAS: Final = 3.0  # noise makes one in 740 so bright; lower refuses more tracks. Chosen, not measured
LEAST_STATIC: Final = 1.2
"""A seed is refused where the other frames show at its own place an S/N of `LEAST_STATIC` for one frame that is also
`STATIC_SIGMAS` errors of their mean: faint stars, in a row or left over, stand still."""

STATIC_ERRORS: Final = 1.0
"""Light at a track's places in the other frames counts above this many errors of its mean. Without this, noise alone takes 0.16
of the joint S/N from every track."""

WAITING: Final = 1.6
"""A track that falls short by less, with light in later frames, is followed again when more of them have come."""

CLIMBED: Final = 2.0
"""S/N by which a track may fall short in the seed's frame and those beside it, once it was climbed there, to be looked for in
more frames. With `LONGER` there it costs 4 of 253 seeds that become tracks, and three quarters of the climbs in more than three
frames (30 cubes of eight frames, seed 101)."""
LONGER: Final = 1.7  # the same in more frames

NARROW: Final = 1.8  # the same of the first look
WIDE: Final = 2.0
"""S/N by which the look in the frames two away may fall short for a seed to be climbed with; where the first look falls short by
less than `NARROW` it may be more. Of noise's seeds that come so far these leave one in twelve."""

DEARER: Final = 0.15  # chosen, not measured
DEARER_PX: Final = 256.0
"""A seed needs so much more S/N for each doubling of its length beyond this: the work grows as its length, and fewer of its
object's trails lie in the image."""

FINE: Final = 24
"""Pieces of a seed in the second look."""


@nb.vectorize(cache=True)
def dearer(seed_px: float) -> float:
    """S/N that a seed of such a length needs beyond what short ones do."""
    return DEARER * max(0.0, math.log2(seed_px / DEARER_PX))


@nb.njit(cache=True)
def static_snr(
    images: tuple[NDArray[np.uint64], ...],
    transforms: NDArray[np.float64],
    n_old: int,
    n_frames: int,
    own: int,
    line: NDArray[np.float64],
    unit: float,
    place: NDArray[np.float64],
) -> float:
    """S/N that what stands still gives to a segment of frame `own`: the mean of the other frames at its place among the stars.

    The frames before n_old are not looked at.
    line (4,) : row0, col0, row1, col1 in the frame that the transforms start from. place (4,) : work space. 0 where nothing is
    known.
    """
    length = math.hypot(line[2] - line[0], line[3] - line[1])
    total = known = others = 0
    weight = -1.0
    for frame in range(n_old, n_frames):
        steep = placed(line, transforms[frame], place)
        s, w = path_sum(images[frame], steep, place, 0.0, length)
        if frame == own:
            weight = float(w)
        else:
            total += s
            known += w
            others += 1
    if weight < 0.0:  # of an older frame
        weight = known / max(others, 1)
    return total / known * math.sqrt(weight) / unit if known > 0 else 0.0


@nb.njit(cache=True)
def _segment(
    seed: NDArray[np.float64], track: NDArray[np.float64], shift: float, seed_px: float, line: NDArray[np.float64]
) -> None:
    """Ends (row0, col0, row1, col1) of a track's trail, by growing place on the seed's line, in the seed's frame; into line.

    shift : of the trail from where it is in the seed's frame, in lengths.
    """
    u_row, u_col = (seed[2] - seed[0]) / seed_px, (seed[3] - seed[1]) / seed_px
    steep = abs(u_row) >= abs(u_col)
    scale = max(abs(u_row), abs(u_col))
    for end in range(2):
        along = track[0] + (shift + end) * track[1]
        away = (track[2] + track[3] * (along / seed_px - 0.5)) / scale
        line[2 * end] = seed[0] + along * u_row + (0.0 if steep else away)
        line[2 * end + 1] = seed[1] + along * u_col + (away if steep else 0.0)


@nb.njit(cache=True)
def follow(
    images: tuple[NDArray[np.uint64], ...],
    halves: tuple[NDArray[np.uint64], ...],
    flat_halves: tuple[NDArray[np.uint64], ...],
    transforms: NDArray[np.float64],
    taus: NDArray[np.float64],
    n_old: int,
    n_frames: int,
    centre: int,
    seeds: NDArray[np.float64],
    senses: NDArray[np.float64],
    psf_sigma_px: float,
    threshold: NDArray[np.float64],
    first_margin: float,
    least_own: float,
    most_work: int,
    corridors: Corridors,
) -> tuple[NDArray[np.float64], NDArray[np.float64], int, int]:
    """Tracks through seeds, in their order.

    images : of frames in their order, as `packed.packed`, the first n_old at half resolution: they are looked at where a track
    reaches the oldest of the others. halves, flat_halves : the same as `packed.halved` makes them, and
    transposed; those from n_frames on are not looked at. transforms (n, 2, 3) : of (row, col) of the centre frame into each;
    taus (n,) : start of each exposure after that of the centre frame, in exposures, on the rows where the object is. seeds
    (m, 5) : row0, col0, row1, col1, S/N in the centre frame. senses (m,) : of the motion where it is known, so that there is no
    first look, or 0. threshold : joint S/N asked of n frames, at index n. first_margin : how far the first look, on a lattice,
    may fall short. least_own : S/N that the seed's own frame must show it at half resolution. most_work : pixels read after which
    no further seed is taken up.

    Returns (k, 12 + images): number of the seed, sense, a, length, offset, tilt (px), first and last frame, joint S/N, least
    joint S/N that is left without one of the frames, chi-square of the frames against even brightness, its degrees of freedom,
    S/N in each frame; seeds that may yet become a track when later frames have come, as climbed to, and
    their senses, (j, 6); the pixels read; the seeds taken up.
    """
    found = np.zeros((len(seeds), 12 + len(images)))
    waiting = np.zeros((len(seeds), 6))
    n_found = n_waiting = read = taken = 0
    place, trial, best, line = np.empty(4), np.empty(4), np.empty(4), np.empty(4)
    half_seed, parameters, wide_best = np.empty(4), np.empty(4), np.empty(4)
    starts, chosen, room = np.empty((2 * ENDS**2 + 1, 5)), np.empty((2 * ENDS**2, 5)), np.empty((2, len(images)))
    ends, before = np.empty((ENDS**2, 4)), np.empty((2, ENDS, 2, LANES), np.int64)
    # pixel centres of the halved image lie at 2 k + 0.5
    half_transforms = transforms.copy()
    for frame in range(n_frames):
        for k in range(2):
            half_transforms[frame, k, 2] = 0.5 * (
                transforms[frame, k, 2] + 0.5 * (transforms[frame, k, 0] + transforms[frame, k, 1]) - 0.5
            )
    wider = math.hypot(psf_sigma_px, 0.5)
    half_variance = 0.5 * psf_sigma_px / wider
    static_limit = max(LEAST_STATIC, STATIC_SIGMAS / math.sqrt(max(n_frames - n_old - 1.0, 1.0)))
    static_error = STATIC_ERRORS / math.sqrt(max(n_frames - n_old - 1.0, 1.0))
    # a line's brightest pixels are lower at half resolution
    fainter = math.sqrt(2.0 * psf_sigma_px**2 / (2.0 * psf_sigma_px**2 + 0.25))
    steps, sums, weights = np.empty(4), np.empty(len(images)), np.empty(len(images))
    for m in range(len(seeds)):
        if read > most_work:
            break
        taken += 1
        seed = seeds[m]
        d_row, d_col = abs(seed[2] - seed[0]), abs(seed[3] - seed[1])
        seed_px = math.hypot(d_row, d_col)
        # px across the line for a step of one pixel along the minor axis
        per_lane = max(d_row, d_col) / seed_px
        lane, nearest = MIDDLE, 1
        best[0], best[1], best[2], best[3] = 0.0, 0.5 * seed_px, 0.0, senses[m]
        half_seed[:] = 0.5 * (seed[:4] - 0.5)
        half_noise = half_variance * line_variance(psf_sigma_px, per_lane) + HALF_ROUNDING
        if senses[m] == 0.0:
            # the first look is at half resolution: a quarter of the pixels, which the cache holds better
            half_px = 0.5 * seed_px
            steep = abs(seed[2] - seed[0]) >= abs(seed[3] - seed[1])
            reach = END_STEPS / STEPS * half_px
            low, high = max(n_old, centre - 1), min(n_frames - 1, centre + 1)
            half_look = Look(taus, 1.0, half_px, per_lane, 1.0, half_noise, 0.0, 0)
            n_ends = 0
            for turn in range(3):
                # the seed's own frame first: those beside it cost six times as much
                frame = centre if turn == 0 else centre - 3 + 2 * turn
                if frame < low or frame > high:
                    continue
                away = abs(taus[frame]) * LONGEST * half_px
                begin, piece = -away - reach, max(1.0, half_px / STEPS)
                n = min(MOST_PIECES, math.ceil((half_px + 2.0 * (away + reach)) / piece))
                corridors.grid[frame, 0], corridors.grid[frame, 1], corridors.pieces[frame] = begin, piece, n
                placed(half_seed, half_transforms[frame], place)
                image = halves[frame] if steep else flat_halves[frame]
                read += gather(image, True, place, begin, piece, n, corridors.sums[frame], corridors.counts[frame])
                if turn == 0:
                    n_ends, lane, own = own_ends(corridors, half_look, centre, ends, before)
                    if own < least_own + dearer(seed_px):
                        n_ends = 0
                        break
            if n_ends == 0:
                continue
            found_at, n_starts = first_look(
                corridors, half_look, Span(centre, low, high), threshold, -first_margin, best, ends, n_ends, lane, starts, KEPT
            )
            if found_at <= -first_margin:
                continue
            low, high = max(n_old, centre - AWAY), min(n_frames - 1, centre + AWAY)
            wide, span = -1e9, Span(centre, low, high)
            for side in (-1.0, 1.0):
                n = 0
                for k in range(n_starts):
                    if starts[k, 3] == side and starts[k, 4] >= found_at - KEPT:
                        chosen[n] = starts[k]
                        n += 1
                if n == 0:
                    continue
                half_look = Look(taus, side, half_px, per_lane, 1.0, half_noise, 0.0, 0)
                for frame in (centre - AWAY, centre + AWAY):
                    if low <= frame <= high:
                        placed(half_seed, half_transforms[frame], place)
                        image = halves[frame] if steep else flat_halves[frame]
                        read += gather_starts(image, frame, place, half_look, chosen[:n], corridors)
                wide = wide_look(corridors, half_look, span, threshold, wide, chosen[:n], lane, wide_best, room)
            if found_at < -NARROW and wide < -WIDE:
                continue
            if wide > found_at:
                best[:] = wide_best
                nearest = AWAY
        read += (n_frames - n_old) * round(seed_px)
        track, sense = parameters, best[3]
        look = look_of(taus, sense, seed_px, per_lane, psf_sigma_px, n_old)
        unit = math.sqrt(trail_variance(look.variance, look.ends, per_lane * seed_px))
        if static_snr(images, transforms, n_old, n_frames, centre, seed[:4], unit, place) > static_limit:
            continue
        track[0], track[1] = 2.0 * best[0], 2.0 * best[1]
        track[2], track[3] = 2.0 * (lane - MIDDLE) * per_lane, 2.0 * best[2] * per_lane
        score, first, last = -1e9, centre, centre
        for reach_frames in range(nearest, len(images)):
            low, high = max(n_old, centre - reach_frames), min(n_frames - 1, centre + reach_frames)
            for frame in range(low, high + 1):
                # what was gathered for nearer frames is gathered again, finer, about the place as it is known now
                middle = track[0] + (0.5 + sense * taus[frame]) * track[1]
                half = (0.9 + 0.12 * abs(taus[frame])) * seed_px
                piece = max(1.0, seed_px / FINE)
                read += collect(images, frame, seed, transforms, middle - half, middle + half, piece, corridors, place)
            span = max(1.0, abs(taus[low]), abs(taus[high]))
            steps[0], steps[1] = seed_px / STEPS, seed_px / STEPS / span
            steps[2], steps[3] = 0.6, 1.2 / span
            climb(corridors, look, low, high, track, steps, 4, trial)
            score, first, last = best_range(corridors, look, centre, low, high, track, threshold, sums, weights)
            # noise may end a faint track's best run early; its frames together tell whether there is light in more of them
            ended = last < high and first > low
            together = evaluate(corridors, look, low, high, track) - threshold[high - low + 1] if ended else score
            if together < -(CLIMBED if reach_frames == 1 else LONGER):
                break
            if low == n_old and high == n_frames - 1:
                break
        while score > -WAITING and 0 < low <= n_old and first == low:
            # a track that reaches the oldest frame is followed into those before it
            low -= 1
            middle = track[0] + (0.5 + sense * taus[low]) * track[1]
            half = (0.9 + 0.12 * abs(taus[low])) * seed_px
            ratio = look.variance / half_noise
            scale = (fainter * ratio, fainter**2 * ratio)
            piece = max(2.0, seed_px / FINE)
            read += collect_half(
                images, low, half_seed, half_transforms, middle - half, middle + half, piece, scale, corridors, place
            )
            span = max(1.0, abs(taus[low]), abs(taus[high]))
            steps[0], steps[1] = seed_px / STEPS, seed_px / STEPS / span
            steps[2], steps[3] = 0.6, 1.2 / span
            climb(corridors, look, low, high, track, steps, 4, trial)
            score, first, last = best_range(corridors, look, centre, low, high, track, threshold, sums, weights)
        if score > -WAITING and last > centre:
            # kept until it is found
            _segment(seed, track, 0.0, seed_px, waiting[n_waiting])
            waiting[n_waiting, 5] = sense
            n_waiting += 1
        if score < -0.5:
            continue
        # the last word on the frames that count alone
        span = max(1.0, abs(taus[first]), abs(taus[last]))
        steps[0], steps[1] = seed_px / FINE, seed_px / FINE / span
        steps[2], steps[3] = 0.3, 0.6 / span
        snr = climb(corridors, look, first, last, track, steps, 3, trial)
        if snr < threshold[last - first + 1]:
            continue
        total = weight = 0.0
        unit = math.sqrt(trail_variance(look.variance, look.ends, per_lane * track[1]))
        for frame in range(first, last + 1):
            sums[frame], weights[frame] = trail_sums(corridors, look, frame, track)
            total += sums[frame]
            weight += weights[frame]
        chi2, least, static = 0.0, 1e9, 0.0
        for frame in range(first, last + 1):
            _segment(seed, track, sense * taus[frame], seed_px, line)
            share = static_snr(images, transforms, n_old, n_frames, frame, line, unit, place)
            static += share * math.sqrt(weights[frame] / max(weight, 1.0))
        if snr - max(static - static_error, 0.0) < threshold[last - first + 1]:
            continue
        for frame in range(first, last + 1):
            expected = total * weights[frame] / weight
            chi2 += (sums[frame] - expected) ** 2 / (unit * unit * max(weights[frame], 1.0))
            rest_w = weight - weights[frame]
            least = min(least, (total - sums[frame]) / (unit * math.sqrt(max(rest_w, 1.0))))
            found[n_found, 12 + frame] = sums[frame] / (unit * math.sqrt(max(weights[frame], 1.0)))
        found[n_found, 0], found[n_found, 1] = m, sense
        found[n_found, 2:6] = track
        found[n_found, 6], found[n_found, 7], found[n_found, 8] = first, last, snr
        found[n_found, 9], found[n_found, 10], found[n_found, 11] = least, chi2, last - first
        n_found += 1
        if score > -WAITING and last > centre:
            n_waiting -= 1
    return found[:n_found], waiting[:n_waiting], read, taken
