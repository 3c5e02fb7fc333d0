"""Candidates, best first -> trails: refined, cleaned of stars on the way, tested, and taken out before the next one."""

import math
from typing import Final, NamedTuple

import numba as nb
import numpy as np
from numpy.typing import NDArray

from onboard.detect.line_integral import corridor, refine
from onboard.detect.line_integral.strip import Strip
from onboard.detect.whiten import FOUND_BIT

POLISH_GAIN: Final = 1.3
"""The search over all parameters hardly ever raises the S/N of a located segment by more than this."""


BEND_GAIN: Final = 9.0
"""A bend must raise the squared S/N by so much, and that of a bent trail must exceed n_sigma squared by as much.

Noise bends lines too: the sagitta's metric is 0.0616 S^2 per px^2 (4/45 / (2 s^2)), so that 16 px of it make
7 x 4 / sqrt(2 pi) = 11 times as many false maxima; exp(-9 / 2) leaves an eighth of one.
"""

LOCATE_WORK: Final = 20_000  # sums compared, which do not grow with the length
LOCATE_WORK_PER_PX: Final = 26.0
"""Pixels read and sums compared by the search in a corridor: 13 paths, 5 bows, and its length with the extensions."""

POLISH_WORK_PER_PX: Final = 1_600.0
"""Pixels read by the search over all parameters: about 100 paths of 16."""

TAKEN_SAMPLES: Final = 24  # places along a candidate that are looked at. Chosen, not measured
TAKEN_SHARE: Final = 0.75  # of them on found trails; a candidate that only crosses some has fewer. Chosen, not measured
TAKEN_WORK: Final = 100
"""A candidate that lies so far on found trails is one of theirs: a bright trail has thousands."""

SHARP_ENDS_PX: Final = 60.0  # sharp ends cost 0.23 s / L of the S/N (s = 0.87): of 7.2, 0.14 at 10 px and 0.02 here
SHARP_LOSS: Final = 0.15
"""What a template with sharp ends may cost a line shorter than that, which is fitted again with blurred ones."""


class Planes(NamedTuple):
    """Images with the segments' major axis along rows: image and smooth in sigma/16, blocked (bits), mesh of the level.

    lines : of smooth, in the memory's order.
    """

    image: NDArray[np.int8]
    smooth: NDArray[np.int8]
    blocked: NDArray[np.uint8]
    level: NDArray[np.float32]
    lines: corridor.Lines


class Asked(NamedTuple):
    """What is asked of a trail: its PSF, the share of pixels that are not masked, S/N at the end and at first, length."""

    psf_sigma_px: float
    usable: float
    n_sigma: float
    first_sigma: float
    min_length_px: float


class Space(NamedTuple):
    """Arrays that `accept` works in; `segment` (5,) is the trail it found."""

    segment: NDArray[np.float64]
    straight: NDArray[np.float64]
    sums: NDArray[np.int32]
    counts: NDArray[np.int32]
    signal: NDArray[np.float64]
    weight: NDArray[np.float64]
    points: NDArray[np.float64]
    strip: Strip


@nb.njit(cache=True)
def _wanted_sigma(n_sigma: float, length_px: float) -> float:
    return n_sigma - (SHARP_LOSS if length_px < SHARP_ENDS_PX else 0.0)


@nb.njit(cache=True)
def blanking_half_width(snr: float, length_px: float, psf_sigma_px: float) -> float:
    """How far across a found trail its light can still matter (px): grows with its brightness per pixel."""
    peak = (
        snr * math.sqrt(2.0 * math.sqrt(math.pi) * psf_sigma_px / max(length_px, 1.0)) / (math.sqrt(2.0 * math.pi) * psf_sigma_px)
    )
    return 3.0 * psf_sigma_px + 1.0 + 1.5 * math.log2(max(1.0, peak))


@nb.njit(cache=True)
def length_inside(segment: NDArray[np.float64], n_minor: int) -> float:
    """Length (px) of a segment within the frame: a star on the edge lights up lines that run along it outside."""
    length = math.hypot(segment[2] - segment[0], segment[3] - segment[1])
    low, high = min(segment[1], segment[3]), max(segment[1], segment[3])
    inside = min(high, n_minor - 0.5) - max(low, -0.5)
    if inside < 0.0:
        return 0.0
    return length * inside / (high - low) if high - low > inside else length


@nb.njit(cache=True)
def accept(
    planes: Planes,
    tile_px: int,
    candidate: NDArray[np.float64],
    asked: Asked,
    space: Space,
    work: NDArray[np.int64],
    located: NDArray[np.float64],
) -> float:
    """S/N of the trail at a candidate, 0 when there is none; lines under SHARP_ENDS_PX are let through SHARP_LOSS below n_sigma.

    located (5,) : becomes major0, minor0, major1, minor1 and S/N after the search in the corridor.

    The trail, and stars that were not in the star list but lie on the way, are taken out of the images. work (1,) : grows by
    what was done, in pixels read, as the length of the candidate tells.
    """
    image, smooth, blocked, level, lines = planes
    psf_sigma_px, usable, n_sigma, first_sigma, min_length_px = asked
    segment, straight, sums, counts, signal, weight, points, strip = space
    length_px = candidate[2] - candidate[0]
    work[0] += LOCATE_WORK + int(LOCATE_WORK_PER_PX * length_px)
    located[4] = corridor.locate(lines, candidate, psf_sigma_px, usable, first_sigma, segment, sums, counts)
    located[:4] = segment[:4]
    if located[4] < first_sigma:
        return 0.0
    # one exact sum before the search over all parameters, which is costly
    n = refine.profile_of(image, blocked, level, tile_px, psf_sigma_px, segment, signal, weight)
    if refine.profile_snr(signal, weight, n) < n_sigma - POLISH_GAIN:
        return 0.0
    snr, length = 0.0, 0.0
    for _ in range(4):
        work[0] += int(POLISH_WORK_PER_PX * (segment[2] - segment[0] + 24.0))
        snr = refine.polish(image, blocked, level, tile_px, segment, corridor.BENT_PX, psf_sigma_px, signal, weight, strip)
        length = length_inside(segment, image.shape[1])
        wanted = _wanted_sigma(n_sigma, length)
        if snr < wanted or length < min_length_px:
            return 0.0
        if segment[4] != 0.0:
            straight[:] = segment
            straight[1] += 2.0 / 3.0 * segment[4]
            straight[3] += 2.0 / 3.0 * segment[4]
            straight[4] = 0.0
            snr_straight = refine.polish(image, blocked, level, tile_px, straight, math.inf, psf_sigma_px, signal, weight, strip)
            if snr * snr - BEND_GAIN < max(snr_straight, wanted) ** 2:
                segment[:], snr = straight, snr_straight
                length = length_inside(segment, image.shape[1])
                if snr < _wanted_sigma(n_sigma, length) or length < min_length_px:
                    return 0.0
        expected = snr * math.sqrt(2.0 * math.sqrt(math.pi) * psf_sigma_px / length)
        # the longer the path, the higher the peaks that noise alone makes on it: one trail in a hundred has a higher one
        excess = math.sqrt(2.0 * math.log(6.0 * length))
        if refine.blank_stars_on_path(image, smooth, blocked, segment, expected + excess) == 0:
            break
    if not refine.looks_like_trail(image, smooth, blocked, level, tile_px, segment, snr, psf_sigma_px, signal, weight, points):
        return 0.0
    refine.blank_path(smooth, blocked, segment, blanking_half_width(snr, length, psf_sigma_px))
    return snr


def most_of_one(side_px: int) -> int:
    """Operations of the dearest candidate in a frame of that longer side."""
    return LOCATE_WORK + int(LOCATE_WORK_PER_PX * side_px) + 4 * int(POLISH_WORK_PER_PX * (side_px + 24.0))


@nb.njit(cache=True)
def taken(blocked: NDArray[np.uint8], candidate: NDArray[np.float32] | NDArray[np.float64]) -> bool:
    """Whether nearly all of a candidate (major0, minor0, major1, minor1) lies on trails that were found before it."""
    n_major, n_minor = blocked.shape
    off = 0
    for k in range(TAKEN_SAMPLES):
        u = (k + 0.5) / TAKEN_SAMPLES
        i = math.floor(candidate[0] + u * (candidate[2] - candidate[0]) + 0.5)
        j = math.floor(candidate[1] + u * (candidate[3] - candidate[1]) + 0.5)
        if not (0 <= i < n_major and 0 <= j < n_minor and blocked[i, j] & FOUND_BIT):
            off += 1
            if off > (1.0 - TAKEN_SHARE) * TAKEN_SAMPLES:  # as nearly all do after seven samples
                return False
    return True


@nb.njit(cache=True)
def with_free(blocked: NDArray[np.uint8], candidates: NDArray[np.float32], seeds: NDArray[np.float64], n_seeds: int) -> int:
    """Put candidates, as `resolve` takes them, that lie on no found trail after n_seeds seeds; how many seeds are there then."""
    turned = blocked.T
    for c in range(candidates.shape[0]):
        if not taken(blocked if candidates[c, 0] == 0.0 else turned, candidates[c, 1:5]):
            seeds[n_seeds] = candidates[c]
            n_seeds += 1
    return n_seeds


@nb.njit(cache=True, nogil=True)
def resolve(
    image: NDArray[np.int8],
    smooth: NDArray[np.int8],
    blocked: NDArray[np.uint8],
    level: NDArray[np.float32],
    tile_px: int,
    candidates: NDArray[np.float64],
    psf_sigma_px: float,
    usable: float,
    n_sigma: float,
    first_sigma: float,
    min_length_px: float,
    max_found: int,
    strip: Strip,
    most_work: int,
    seed_sigma: float,
    seeds: NDArray[np.float64],
) -> tuple[NDArray[np.float64], int, int, int]:
    """Trails among candidates (n, 6: axis, major0, minor0, major1, minor1, S/N; best first); the images are changed in place.

    usable : share of pixels that are not masked. strip : work space for the longer side of the frame. most_work : pixels read
    (see `accept`) after which the rest of the candidates is left. seeds (k, 6) : room for what the search in the corridor puts
    at `seed_sigma` or more, found or not: axis, major0, minor0, major1, minor1, S/N; the first k of them.

    Returns (m, 7): axis, major0, minor0, major1, minor1, sagitta along minor (px), S/N; the number of seeds; the work done; and
    how many candidates were left.
    """
    planes = Planes(image, smooth, blocked, level, corridor.lines_of(smooth, True))
    planes_t = Planes(image.T, smooth.T, blocked.T, level.T, corridor.lines_of(smooth, False))
    asked = Asked(psf_sigma_px, usable, n_sigma, first_sigma, min_length_px)
    found = np.empty((max_found, 7))
    n_found = 0
    sums = np.empty((corridor.PIECES, corridor.OFFSETS), np.int32)
    counts = np.empty((corridor.PIECES, corridor.OFFSETS), np.int32)
    signal = np.empty(max(image.shape) + 1)
    weight = np.empty(max(image.shape) + 1)
    work = np.zeros(1, np.int64)
    segment, straight, points = np.empty(5), np.empty(5), np.zeros((2, 3))
    space = Space(segment, straight, sums, counts, signal, weight, points, strip)
    located, n_seeds, n_left = np.zeros(5), 0, 0
    for c in range(candidates.shape[0]):
        if n_found == max_found or work[0] > most_work:
            n_left = candidates.shape[0] - c
            break
        work[0] += TAKEN_WORK
        located[4] = -1.0
        snr = 0.0
        if taken(blocked if candidates[c, 0] == 0.0 else planes_t.blocked, candidates[c, 1:5]):
            continue
        if candidates[c, 0] == 0.0:
            snr = accept(planes, tile_px, candidates[c, 1:5], asked, space, work, located)
        else:
            snr = accept(planes_t, tile_px, candidates[c, 1:5], asked, space, work, located)
        if n_seeds < seeds.shape[0] and located[4] >= seed_sigma:
            seeds[n_seeds, 0] = candidates[c, 0]
            seeds[n_seeds, 1:] = located
            n_seeds += 1
        if snr > 0.0:
            found[n_found, 0] = candidates[c, 0]
            found[n_found, 1:6] = segment
            found[n_found, 6] = snr
            n_found += 1
    return found[:n_found], n_seeds, work[0], n_left
