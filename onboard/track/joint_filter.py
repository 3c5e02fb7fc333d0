"""From a seed in one frame to the straight track through its neighbours with the highest joint S/N."""

import math
from typing import Final, NamedTuple

import numba as nb
import numpy as np
from numpy.typing import NDArray

from onboard.track.corridor import LANES, MIDDLE, MOST_PIECES, PARTS, between, brightest, gather, path_sum
from onboard.track.packed import HALF_ROUNDING, ROUNDING, STEP

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

STATIC_SIGMAS: Final = 3.0  # noise makes one in 740 so bright; lower refuses more tracks. Chosen, not measured
LEAST_STATIC: Final = 1.2
"""A seed is refused where the other frames show at its own place an S/N of `LEAST_STATIC` for one frame that is also
`STATIC_SIGMAS` errors of their mean: faint stars, in a row or left over, stand still."""

STATIC_ERRORS: Final = 1.0
"""Light at a track's places in the other frames counts above this many errors of its mean. Without this, noise alone takes 0.16
of the joint S/N from every track."""

WAITING: Final = 1.6
"""A track that falls short by less, with light in later frames, is followed again when more of them have come."""

FINE: Final = 24
"""Pieces of a seed in the second look."""

SHORTEST: Final = 0.5  # more room costs time, less loses seeds that took in other light. Chosen, not measured
LONGEST: Final = 1.6
"""Trails are so much shorter or longer than their seed at most."""

LEAST_SEEN: Final = 0.4
"""A frame counts where so much of the trail in it falls on known pixels."""


class Corridors(NamedTuple):
    """Running sums about a seed's line in each frame of a window.

    sums, counts : (frames, MOST_PIECES + 1, LANES). grid : first px and px per piece, (frames, 2). pieces : how many, (frames,).
    """

    sums: NDArray[np.int32]
    counts: NDArray[np.int32]
    grid: NDArray[np.float64]
    pieces: NDArray[np.int64]


class Look(NamedTuple):
    """What turns a track (a, length, offset, tilt) about a seed into sums, and sums into S/N.

    taus : (frames,). sense : of the motion. seed_px : the seed's length. per_lane : px across the line from lane to lane.
    correlation : of neighbouring lanes. unit : standard deviation of a path's sum per root of its weight. n_old : frames, the
    first ones, that are kept at half resolution.
    """

    taus: NDArray[np.float64]
    sense: float
    seed_px: float
    per_lane: float
    correlation: float
    unit: float
    n_old: int


def work_space(n_frames: int) -> Corridors:
    """Room for the corridors of a window."""
    shape = (n_frames, MOST_PIECES + 1, LANES)
    return Corridors(np.zeros(shape, np.int32), np.zeros(shape, np.int32), np.zeros((n_frames, 2)), np.zeros(n_frames, np.int64))


@nb.njit(cache=True)
def look_of(
    taus: NDArray[np.float64], sense: float, seed_px: float, per_lane: float, psf_sigma_px: float, n_old: int = 0
) -> Look:
    """The look at a seed on packed images of pixels smoothed by the PSF; paths advance by one px of the major axis."""
    unit = math.sqrt(line_variance(psf_sigma_px, per_lane) + ROUNDING)
    return Look(taus, sense, seed_px, per_lane, math.exp(-0.25 * (per_lane / psf_sigma_px) ** 2), unit, n_old)


@nb.njit(cache=True)
def line_variance(psf_sigma_px: float, per_lane: float) -> float:
    """Variance of the sum of smoothed pixels along a line, for each of them, steps of a code squared."""
    return (16.0 / STEP) ** 2 * 2.0 * math.sqrt(math.pi) * psf_sigma_px * per_lane


@nb.njit(cache=True)
def _placed(seed: NDArray[np.float64], transform: NDArray[np.float64], place: NDArray[np.float64]) -> bool:
    """Fill place (see `corridor.gather`) with a seed (row0, col0, row1, col1) in a frame; returns whether rows are major."""
    d_row, d_col = seed[2] - seed[0], seed[3] - seed[1]
    steep = abs(d_row) >= abs(d_col)
    length = math.hypot(d_row, d_col)
    row = transform[0, 0] * seed[0] + transform[0, 1] * seed[1] + transform[0, 2]
    col = transform[1, 0] * seed[0] + transform[1, 1] * seed[1] + transform[1, 2]
    u_row = (transform[0, 0] * d_row + transform[0, 1] * d_col) / length
    u_col = (transform[1, 0] * d_row + transform[1, 1] * d_col) / length
    if steep:
        place[0], place[1], place[2], place[3] = row, col, u_row, u_col
    else:
        place[0], place[1], place[2], place[3] = col, row, u_col, u_row
    return steep


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
        steep = _placed(line, transforms[frame], place)
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
def collect(
    images: tuple[NDArray[np.uint64], ...],
    frame: int,
    seed: NDArray[np.float64],
    transforms: NDArray[np.float64],
    first_px: float,
    last_px: float,
    piece_px: float,
    corridors: Corridors,
    place: NDArray[np.float64],
) -> int:
    """Gather one frame's corridor from first_px to last_px on the seed's line; returns the pixels read."""
    n = min(MOST_PIECES, math.ceil((last_px - first_px) / piece_px))
    corridors.grid[frame, 0], corridors.grid[frame, 1], corridors.pieces[frame] = first_px, piece_px, n
    steep = _placed(seed, transforms[frame], place)
    return gather(images[frame], steep, place, first_px, piece_px, n, corridors.sums[frame], corridors.counts[frame])


@nb.njit(cache=True)
def collect_half(
    images: tuple[NDArray[np.uint64], ...],
    frame: int,
    half_seed: NDArray[np.float64],
    half_transforms: NDArray[np.float64],
    first_px: float,
    last_px: float,
    piece_px: float,
    scale: tuple[float, float],
    corridors: Corridors,
    place: NDArray[np.float64],
) -> int:
    """The same for a frame at half resolution; first_px ... piece_px of the whole one.

    scale : of its sums and of its known pixels, so that they add up with those of other frames.
    """
    n = min(MOST_PIECES, math.ceil((last_px - first_px) / piece_px))
    corridors.grid[frame, 0], corridors.grid[frame, 1], corridors.pieces[frame] = first_px, piece_px, n
    steep = _placed(half_seed, half_transforms[frame], place)
    sums, counts = corridors.sums[frame], corridors.counts[frame]
    read = gather(images[frame], steep, place, 0.5 * first_px, 0.5 * piece_px, n, sums, counts)
    for p in range(n + 1):
        for k in range(LANES):
            sums[p, k] = round(scale[0] * sums[p, k])
            counts[p, k] = round(scale[1] * counts[p, k])
    return read


@nb.njit(cache=True)
def trail_sums(corridors: Corridors, look: Look, frame: int, track: NDArray[np.float64]) -> tuple[float, float]:
    """Sum and weight of a track (a, length, offset, tilt) in one frame."""
    start = track[0] + look.sense * look.taus[frame] * track[1]
    middle = start + 0.5 * track[1]
    lane = (track[2] + track[3] * (middle / look.seed_px - 0.5)) / look.per_lane
    first = (start - corridors.grid[frame, 0]) / corridors.grid[frame, 1]
    last = (start + track[1] - corridors.grid[frame, 0]) / corridors.grid[frame, 1]
    if frame < look.n_old:  # lanes of half resolution, whose noise is hardly correlated
        return between(
            corridors.sums, corridors.counts, frame, corridors.pieces[frame], first, last, 0.5 * lane, look.correlation**4
        )
    return between(corridors.sums, corridors.counts, frame, corridors.pieces[frame], first, last, lane, look.correlation)


@nb.njit(cache=True)
def evaluate(corridors: Corridors, look: Look, low: int, high: int, track: NDArray[np.float64]) -> float:
    """Joint S/N of a track in frames low ... high."""
    total = weight = 0.0
    for frame in range(low, high + 1):
        s, w = trail_sums(corridors, look, frame, track)
        total += s
        weight += w
    return total / (look.unit * math.sqrt(weight)) if weight > 0.0 else 0.0


@nb.njit(cache=True)
def _own_ends(corridors: Corridors, look: Look, centre: int, ends: NDArray[np.float64]) -> tuple[int, int, float]:
    """Ends that the seed's own frame likes, of all on a lattice: how many, on which lane, S/N of the best.

    ends (n, 4) : where the trail begins and its length, px, sum and weight as `brightest` has them. Lanes beside the middle one
    count too: a seed lies on the lattice of the search that made it.
    """
    seed_px, step = look.seed_px, look.seed_px / STEPS
    top, lane, n = 0.0, MIDDLE, 0
    for turn in range(2):
        for i in range(-END_STEPS, END_STEPS + 1):
            for j in range(-END_STEPS, END_STEPS + 1):
                start, length = i * step, seed_px + (j - i) * step
                if length < SHORTEST * seed_px or length > LONGEST * seed_px:
                    continue
                first = (start - corridors.grid[centre, 0]) / corridors.grid[centre, 1]
                last = first + length / corridors.grid[centre, 1]
                for k in range(MIDDLE - BESIDE, MIDDLE + BESIDE + 1) if turn == 0 else range(lane, lane + 1):
                    total = brightest(corridors.sums, centre, corridors.pieces[centre], first, last, k, k)
                    weight = brightest(corridors.counts, centre, corridors.pieces[centre], first, last, k, k)
                    power = float(total) * float(total)
                    if total <= 0 or weight <= 0:
                        continue
                    if turn == 0:
                        if power > top * weight:
                            top, lane = power / weight, k
                    elif power >= LIKED * LIKED * top * weight:
                        ends[n, 0], ends[n, 1], ends[n, 2], ends[n, 3] = start, length, total, weight
                        n += 1
    return n, lane, math.sqrt(top / PARTS) / look.unit


@nb.njit(cache=True)
def _first_look(
    corridors: Corridors,
    look: Look,
    centre: int,
    low: int,
    high: int,
    margin: NDArray[np.float64],
    least: float,
    best: NDArray[np.float64],
    ends: NDArray[np.float64],
    n_ends: int,
    lane: int,
) -> float:
    """Best track on a lattice of ends and tilts in frames low ... high about `centre`; fills best (a, length, tilt, sense).

    All in pixels of the images that the corridors are of; tilts are whole lanes per length. Pairs of frames count beside all
    three: by how much the S/N exceeds margin[number of frames]. Returns `least` where none has more. ends, n_ends, lane : as
    `_own_ends` leaves them.
    """
    sums, counts, grid, pieces = corridors
    taus, seed_px = look.taus, look.seed_px
    scale = look.unit * math.sqrt(float(PARTS))  # of a sum over the root of its weight
    score = least
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
                if value > score:
                    score = value
                    two, three = max(score + margin[2], 0.0) * scale, max(score + margin[3], 0.0) * scale
                    best[0], best[1], best[2], best[3] = start, length, tilt, sense
    return score


@nb.njit(cache=True)
def _below(total: float, weight: float, least: float) -> bool:
    """Whether total / sqrt(weight) is, without a root: nearly all are."""
    return total <= 0.0 or total * total <= least * least * weight


@nb.njit(cache=True)
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
        for _ in range(8):
            improved = False
            for parameter in range(5):
                for sign in (-1.0, 1.0):
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
                        snr, improved = value, True
                        track[:] = trial
            if not improved:
                break
        scale *= 0.5
    return snr


@nb.njit(cache=True)
def best_range(
    corridors: Corridors,
    look: Look,
    centre: int,
    low: int,
    high: int,
    track: NDArray[np.float64],
    threshold: NDArray[np.float64],
    sums: NDArray[np.float64],
    weights: NDArray[np.float64],
) -> tuple[float, int, int]:
    """The run of frames with the centre whose joint S/N exceeds its threshold most: this margin, first and last frame."""
    full = track[1] * look.per_lane
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
                value = total / (look.unit * math.sqrt(weight)) - threshold[seen]
                if value > score:
                    score, first, last = value, i, j
    return score, first, last


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
    half_seed, parameters = np.empty(4), np.empty(4)
    ends = np.empty(((2 * END_STEPS + 1) ** 2, 4))
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
        # px across the line for a step of one pixel along the minor axis, and the noise of a sum over major steps
        per_lane = max(d_row, d_col) / seed_px
        forward = look_of(taus, 1.0, seed_px, per_lane, psf_sigma_px, n_old)
        unit = forward.unit
        lane = MIDDLE
        best[0], best[1], best[2], best[3] = 0.0, 0.5 * seed_px, 0.0, senses[m]
        half_seed[:] = 0.5 * (seed[:4] - 0.5)
        half_unit = math.sqrt(half_variance * line_variance(psf_sigma_px, per_lane) + HALF_ROUNDING)
        if senses[m] == 0.0:
            # the first look is at half resolution: a quarter of the pixels, which the cache holds better
            half_px = 0.5 * seed_px
            steep = abs(seed[2] - seed[0]) >= abs(seed[3] - seed[1])
            reach = END_STEPS / STEPS * half_px
            low, high = max(n_old, centre - 1), min(n_frames - 1, centre + 1)
            half_look = Look(taus, 1.0, half_px, per_lane, 1.0, half_unit, 0)
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
                _placed(half_seed, half_transforms[frame], place)
                image = halves[frame] if steep else flat_halves[frame]
                read += gather(image, True, place, begin, piece, n, corridors.sums[frame], corridors.counts[frame])
                if turn == 0:
                    n_ends, lane, own = _own_ends(corridors, half_look, centre, ends)
                    if own < least_own:
                        n_ends = 0
                        break
            if n_ends == 0:
                continue
            found_at = _first_look(corridors, half_look, centre, low, high, threshold, -first_margin, best, ends, n_ends, lane)
            if found_at <= -first_margin:
                continue
        read += (n_frames - n_old) * round(seed_px)
        if static_snr(images, transforms, n_old, n_frames, centre, seed[:4], unit, place) > static_limit:
            continue
        track, sense = parameters, best[3]
        look = look_of(taus, sense, seed_px, per_lane, psf_sigma_px, n_old)
        track[0], track[1] = 2.0 * best[0], 2.0 * best[1]
        track[2], track[3] = 2.0 * (lane - MIDDLE) * per_lane, 2.0 * best[2] * per_lane
        score, first, last = -1e9, centre, centre
        for reach_frames in range(1, len(images)):
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
            if reach_frames > 1 and together < -first_margin:
                break
            if low == n_old and high == n_frames - 1:
                break
        while score > -WAITING and 0 < low <= n_old and first == low:
            # a track that reaches the oldest frame is followed into those before it
            low -= 1
            middle = track[0] + (0.5 + sense * taus[low]) * track[1]
            half = (0.9 + 0.12 * abs(taus[low])) * seed_px
            scale = (fainter * (unit / half_unit) ** 2, (fainter * unit / half_unit) ** 2)
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
