"""From seeds in one frame to the straight tracks through its neighbours with the highest joint S/N."""

import math
from typing import Final

import numba as nb
import numpy as np
from numpy.typing import NDArray

from onboard.track.climb import climb
from onboard.track.corridor import MIDDLE
from onboard.track.frames import Frames
from onboard.track.growth import FINE, WAITING, Grown, gathered, grown, half_scale, set_steps
from onboard.track.standing_light import STATIC_ERRORS, others, standing
from onboard.track.start import Start, dearer, own_look, room_for, start_of
from onboard.track.trail_sums import Corridors, Look, half_line_variance, look_of, trail_sums, trail_variance
from onboard.track.wide_look import AWAY

STATIC_SIGMAS: Final = 3.0  # noise makes one in 740 so bright; lower refuses more tracks. Chosen, not measured
LEAST_STATIC: Final = 1.2
"""A seed is refused where the other frames show at its own place an S/N of `LEAST_STATIC` for one frame that is also
`STATIC_SIGMAS` errors of their mean: faint stars, in a row or left over, stand still."""

SHORT_PX: Final = 16.0  # below the 20 px from which trails are asked for, as an end errs by a tenth. Chosen, not measured
SHORTER: Final = 0.4
"""More joint S/N is asked of trails shorter than `SHORT_PX`, for each halving: stars make most of what is false there, and one
pixel more or less decides. Chosen on seeds 55000 and 55100, where 8 of 22 false tracks that came near were so short."""

LONG_PX: Final = (32.0, 512.0)  # lengths between which ever less is asked
LESS: Final = 0.07
"""Less joint S/N is asked of longer trails, for each doubling from the first to the second of `LONG_PX`. Noise has twice as many
tracks in each octave of length. But seeds of long trails must be brighter, and hide each other, so that the search comes upon
fewer. Of 40 false tracks of two frames in 272 whole frames with thresholds 0.45 and 0.6 lower, 7 were of 10 to 20 px, and 15,
10, 5, 1, 2 and 0 of each octave from there (seeds 57200 to 57202, before tracks were measured on their own lines)."""

NEARLY: Final = 0.5
"""A track that falls short by more is not climbed once more in the frames that show it best."""


@nb.njit(cache=True)
def more_asked(length_px: float) -> float:
    """Joint S/N asked of a track beyond what its number of frames asks, by the length of its trail in an exposure."""
    short, long = SHORT_PX / max(length_px, 1.0), min(length_px, LONG_PX[1]) / LONG_PX[0]
    return SHORTER * math.log2(max(1.0, short)) - LESS * math.log2(max(1.0, long))


@nb.njit(cache=True)
def follow(
    frames: Frames,
    images: tuple[NDArray[np.uint64], ...],
    halves: tuple[NDArray[np.uint64], ...],
    flat_halves: tuple[NDArray[np.uint64], ...],
    seeds: NDArray[np.float64],
    senses: NDArray[np.float64],
    first_margin: float,
    least_own: float,
    most_work: int,
    corridors: Corridors,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], int, int]:
    """Tracks through seeds, in their order.

    images : see `grown`. halves, flat_halves : see `start_of`; the second ones transposed. seeds (m, 5) : row0, col0, row1, col1,
    S/N in the centre frame. senses (m,) : of the motion where it is known, so that there is no first look, or 0. first_margin :
    see `start_of`. least_own : S/N that short seeds must show at half resolution in their own frame. most_work : pixels read
    after which no further seed is taken up.

    Returns (k, 11 + frames): sense, a, length, offset, tilt (px), first and last frame, joint S/N, least joint S/N that is left
    without one of the frames, chi-square of the frames against even brightness, its degrees of freedom, S/N in each frame; the
    lines that these are measured on in the centre frame, (k, 4) as seeds; seeds that may yet become a track when later frames
    have come, as climbed to, and their senses, (j, 6); the pixels read; the seeds taken up.
    """
    n_images = len(images)
    # room for every seed, of which hardly any is touched
    found, waiting = np.empty((len(seeds), 11 + n_images)), np.empty((len(seeds), 6))
    lines, half_line = np.empty((len(seeds), 4)), np.empty(4)
    n_found = n_waiting = read = taken = 0
    room, best, half_seed, track = room_for(n_images), np.empty(4), np.empty(4), np.empty(4)
    place, sums, weights = np.empty(4), np.empty(n_images), np.empty(n_images)
    own_half, own_flat = halves[AWAY], flat_halves[AWAY]
    static_limit = max(LEAST_STATIC, STATIC_SIGMAS / math.sqrt(others(frames)))
    for m in range(len(seeds)):
        if read > most_work:
            break
        taken += 1
        seed, start = seeds[m], Start(1, MIDDLE, 0)
        d_row, d_col = abs(seed[2] - seed[0]), abs(seed[3] - seed[1])
        seed_px = math.hypot(d_row, d_col)
        per_lane = max(d_row, d_col) / seed_px
        best[0], best[1], best[2], best[3] = 0.0, 0.5 * seed_px, 0.0, senses[m]
        half_seed[:] = 0.5 * (seed[:4] - 0.5)
        if senses[m] == 0.0:
            noise = half_line_variance(frames.psf_sigma_px, per_lane)
            half_look = Look(frames.taus, 1.0, 0.5 * seed_px, per_lane, 1.0, noise, 0.0, 0)
            image = own_half if d_row >= d_col else own_flat
            n_ends, lane, px = own_look(frames, image, half_seed, half_look, least_own + dearer(seed_px), corridors, room)
            read += px
            if n_ends == 0:
                continue
            near = halves if d_row >= d_col else flat_halves
            start = start_of(frames, near, half_seed, half_look, n_ends, lane, first_margin, corridors, room, best)
            read += start.read
            if start.away == 0:
                continue
        read += (frames.n_frames - frames.n_old) * round(seed_px)
        look = line_look(frames, seed, best[3])
        unit = math.sqrt(trail_variance(look.variance, look.ends, per_lane * seed_px))
        if standing(frames, images, frames.centre, seed[:4], unit, place).static > static_limit:
            continue
        track[0], track[1] = 2.0 * best[0], 2.0 * best[1]
        track[2], track[3] = 2.0 * (start.lane - MIDDLE) * per_lane, 2.0 * best[2] * per_lane
        run = grown(frames, images, seed, half_seed, look, start.away, track, corridors, sums, weights)
        read += run.read
        may_grow = run.margin > -WAITING and run.last > frames.centre
        if may_grow:
            _segment(seed, track, 0.0, seed_px, waiting[n_waiting])
            waiting[n_waiting, 4], waiting[n_waiting, 5] = 0.0, look.sense  # it was judged, and needs no S/N
        if run.margin >= min(0.0, more_asked(track[1])) - NEARLY:
            own_line = lines[n_found]
            own = line_look(frames, own_line, along_own_line(seed, look, track, own_line))
            half_line[:] = 0.5 * (own_line - 0.5)
            track[0], track[1], track[2], track[3] = 0.0, own.seed_px, 0.0, 0.0
            scale = half_scale(frames, own)
            for frame in range(run.first, run.last + 1):
                read += gathered(frames, images, frame, own_line, half_line, own, track, scale, corridors, place)
            found[n_found] = 0.0
            if judged(frames, images, own_line, own, run, track, corridors, sums, weights, found[n_found]):
                n_found += 1
                continue
        if may_grow:  # it waits until it is found
            n_waiting += 1
    return found[:n_found].copy(), lines[:n_found].copy(), waiting[:n_waiting].copy(), read, taken


@nb.njit(cache=True)
def along_own_line(seed: NDArray[np.float64], look: Look, track: NDArray[np.float64], line: NDArray[np.float64]) -> float:
    """Ends of a track's trail in the seed's frame, into line, by growing place along its major axis; the sense of motion on it.

    Away from its seed's line, a tilted track's pixels are taken from lane to lane, up to a pixel beside those that its own line
    takes. Climbs make use of that: noise has S/N on such steps that it has on no straight line.
    """
    _segment(seed, track, 0.0, look.seed_px, line)
    d_row, d_col = line[2] - line[0], line[3] - line[1]
    if (d_row if abs(d_row) >= abs(d_col) else d_col) >= 0.0:
        return look.sense
    line[0], line[1], line[2], line[3] = line[2], line[3], line[0], line[1]
    return -look.sense


@nb.njit(cache=True)
def line_look(frames: Frames, line: NDArray[np.float64], sense: float) -> Look:
    """The look at a line (4,) of the centre frame at full resolution."""
    d_row, d_col = abs(line[2] - line[0]), abs(line[3] - line[1])
    length = max(math.hypot(d_row, d_col), 1.0)
    return look_of(frames.taus, sense, length, max(d_row, d_col) / length, frames.psf_sigma_px, frames.n_old)


@nb.njit(cache=True)
def judged(
    frames: Frames,
    images: tuple[NDArray[np.uint64], ...],
    seed: NDArray[np.float64],
    look: Look,
    run: Grown,
    track: NDArray[np.float64],
    corridors: Corridors,
    sums: NDArray[np.float64],
    weights: NDArray[np.float64],
    row: NDArray[np.float64],
) -> bool:
    """Whether a track passes once it was climbed in the frames of its best run alone; row : of `follow`.

    What stands still at its places in the other frames counts against it. sums, weights (frames,) : work space.
    """
    steps, trial, place, line = np.empty(4), np.empty(4), np.empty(4), np.empty(4)
    first, last = run.first, run.last
    set_steps(steps, look, first, last, FINE, 0.3)
    snr = climb(corridors, look, first, last, track, steps, 3, trial)
    asked = frames.threshold[last - first + 1] + more_asked(track[1])
    if snr < asked:
        return False
    total = weight = 0.0
    unit = math.sqrt(trail_variance(look.variance, look.ends, look.per_lane * track[1]))
    for frame in range(first, last + 1):
        sums[frame], weights[frame] = trail_sums(corridors, look, frame, track)
        total += sums[frame]
        weight += weights[frame]
    chi2, least, static, lit, pixels = 0.0, 1e9, 0.0, 0.0, 0
    for frame in range(first, last + 1):
        _segment(seed, track, look.sense * look.taus[frame], look.seed_px, line)
        still = standing(frames, images, frame, line, unit, place)
        static += still.rest * math.sqrt(weights[frame] / max(weight, 1.0))
        lit += still.lit
        pixels += still.pixels
    own = min(snr, (total - lit) / (unit * math.sqrt(max(weight - pixels, 1.0))))
    if own - max(static - STATIC_ERRORS / math.sqrt(others(frames)), 0.0) < asked:
        return False
    for frame in range(first, last + 1):
        expected = total * weights[frame] / weight
        chi2 += (sums[frame] - expected) ** 2 / (unit * unit * max(weights[frame], 1.0))
        rest_w = weight - weights[frame]
        least = min(least, (total - sums[frame]) / (unit * math.sqrt(max(rest_w, 1.0))))
        row[11 + frame] = sums[frame] / (unit * math.sqrt(max(weights[frame], 1.0)))
    row[0] = look.sense
    row[1:5] = track
    row[5], row[6], row[7] = first, last, snr
    row[8], row[9], row[10] = least, chi2, last - first
    return True


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
