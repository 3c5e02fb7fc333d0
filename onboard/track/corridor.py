"""Sums along a line and its neighbours, frame by frame: what all tracks near one seed are evaluated from.

A straight track has four parameters. `a` and `length` (px) are where its trail in the seed's frame begins on the seed's line,
from the seed's first end, and how long it is; `offset` and `tilt` (px) are how far off that line it lies in the middle of the
seed, and by how much more one seed length farther on. With epoch `tau`, the time of a frame from the seed's in exposures, its
trail covers ``a + sense tau length ... + length``, sense = 1 where the seed's first end came first in time, -1 where the last
one did. A rolling shutter stretches the trail and the way between two frames alike, so that it needs no term here.
"""

import math
from typing import Final

import numba as nb
import numpy as np
from numpy.typing import NDArray

from onboard.track.packed import PIXELS, ZERO, add_lanes, add_rows, code_at

LANES: Final = PIXELS  # a word holds as many
MIDDLE: Final = 8
"""Lines of a corridor, one pixel apart along the minor axis; the middle one runs along the seed."""

PARTS: Final = 16
"""Parts of a piece that the first look tells apart."""

MOST_PIECES: Final = 512
"""Pieces of a corridor."""


@nb.njit(cache=True)
def gather(
    image: NDArray[np.uint64],
    steep: bool,
    place: NDArray[np.float64],
    first_px: float,
    piece_px: float,
    n_pieces: int,
    sums: NDArray[np.int32],
    counts: NDArray[np.int32],
) -> int:
    """Running sums over a frame's corridor; returns the pixels read.

    image : as `packed.packed`. steep : the major axis is row. place (4,) : major and minor coordinate in this frame of the
    seed's first end, and of the seed's direction (change per px along it; that of major > 0). Piece p covers
    first_px + p piece_px ... on the seed's line, from its first end. sums, counts (MOST_PIECES + 1, LANES) : of the values in
    steps of a code, and of the known pixels before each piece, lane by lane; row n_pieces holds the whole.
    """
    n_major = image.shape[0] if steep else PIXELS * (image.shape[1] - 2)
    slope = place[3] / place[2]
    origin = place[1] - slope * place[0] + 0.5 - MIDDLE
    for k in range(np.uint64(LANES)):
        sums[0, k] = counts[0, k] = 0
    read, room = 0, np.empty((3, 0 if steep else PIXELS), np.uint64)
    start = math.ceil(place[0] + place[2] * first_px)
    for p in range(n_pieces):
        stop = math.ceil(place[0] + place[2] * (first_px + (p + 1) * piece_px))
        before, after = np.uint64(p), np.uint64(p + 1)
        for k in range(np.uint64(LANES)):
            sums[after, k] = sums[before, k]
            counts[after, k] = counts[before, k]
        low, high = max(0, start), min(n_major, stop)
        if steep:
            read += add_lanes(image, low, high, origin, slope, sums, counts, p + 1)
        else:
            read += add_rows(image, low, high, origin, slope, room, sums, counts, p + 1)
        start = stop
    return read


@nb.njit(cache=True, error_model="numpy", inline="always")
def between(
    sums: NDArray[np.int32],
    counts: NDArray[np.int32],
    frame: int,
    n_pieces: int,
    first: float,
    last: float,
    lane: float,
    correlation: float,
) -> tuple[float, float]:
    """Sum and weight of a trail: of a frame's pieces first ... last (fractions interpolated) on a fractional lane; 0, 0 outside.

    sums, counts : of `Corridors`. weight : sum of the variances of the interpolated values, in pixels; correlation : of
    neighbouring lanes.
    """
    lane += MIDDLE
    first, last = max(first, 0.0), min(last, float(n_pieces))
    if last <= first or lane < 0.0 or lane >= LANES - 1.0:
        return 0.0, 0.0
    k = np.uint64(lane)
    f = lane - float(k)
    g, i, j = np.uint64(frame), np.uint64(min(int(first), n_pieces - 1)), np.uint64(min(int(last), n_pieces - 1))
    u, v = first - float(i), last - float(j)
    i1, j1 = i + np.uint64(1), j + np.uint64(1)
    total = weight = 0.0
    for side in range(2):
        share = 1.0 - f if side == 0 else f
        n = k + np.uint64(side)
        low = sums[g, i, n] + u * (sums[g, i1, n] - sums[g, i, n])
        high = sums[g, j, n] + v * (sums[g, j1, n] - sums[g, j, n])
        total += share * (high - low)
        low = counts[g, i, n] + u * (counts[g, i1, n] - counts[g, i, n])
        high = counts[g, j, n] + v * (counts[g, j1, n] - counts[g, j, n])
        weight += share * (high - low)
    return total, weight * (1.0 - 2.0 * f * (1.0 - f) * (1.0 - correlation))


@nb.njit(cache=True, inline="always")
def brightest(sums: NDArray[np.int32], frame: int, n_pieces: int, first: float, last: float, low: int, high: int) -> int:
    """Largest sum over pieces first ... last of a frame, in 1 / PARTS, of the lanes low ... high; 0 outside.

    sums : of `Corridors`. first, last : in pieces, to the nearest of PARTS.
    """
    begin, end = max(round(first * PARTS), 0), min(round(last * PARTS), PARTS * n_pieces)
    if end <= begin:
        return 0
    g, i, j = np.uint64(frame), np.uint64(min(begin // PARTS, n_pieces - 1)), np.uint64(min(end // PARTS, n_pieces - 1))
    u, v = begin - PARTS * int(i), end - PARTS * int(j)
    u0, v0 = PARTS - u, PARTS - v
    i1, j1 = i + np.uint64(1), j + np.uint64(1)
    most = -(2**40)
    for k in range(np.uint64(low), np.uint64(high + 1)):
        most = max(most, v0 * sums[g, j, k] + v * sums[g, j1, k] - u0 * sums[g, i, k] - u * sums[g, i1, k])
    return most


@nb.njit(cache=True, inline="always")
def running(
    sums: NDArray[np.int32],
    counts: NDArray[np.int32],
    frame: int,
    n_pieces: int,
    at: float,
    low: int,
    high: int,
    out: NDArray[np.int64],
) -> None:
    """Sums and counts before a place of a frame, in 1 / PARTS, of the lanes low ... high; `brightest` takes their difference.

    at : in pieces, to the nearest of PARTS. out : (2, LANES).
    """
    parts = min(max(round(at * PARTS), 0), PARTS * n_pieces)
    g, i = np.uint64(frame), np.uint64(min(parts // PARTS, n_pieces - 1))
    v = parts - PARTS * int(i)
    i1 = i + np.uint64(1)
    for k in range(np.uint64(low), np.uint64(high + 1)):
        out[0, k] = (PARTS - v) * sums[g, i, k] + v * sums[g, i1, k]
        out[1, k] = (PARTS - v) * counts[g, i, k] + v * counts[g, i1, k]


@nb.njit(cache=True)
def path_sum(
    image: NDArray[np.uint64], steep: bool, place: NDArray[np.float64], first_px: float, last_px: float
) -> tuple[int, int]:
    """Sum of values, in steps of a code, and number of known pixels on the seed's line itself; see `gather`."""
    n_major, n_minor = image.shape[0], PIXELS * (image.shape[1] - 2)
    if not steep:
        n_major, n_minor = n_minor, n_major
    slope = place[3] / place[2]
    total = count = 0
    for major in range(
        max(0, math.ceil(place[0] + place[2] * first_px)), min(n_major, math.floor(place[0] + place[2] * last_px) + 1)
    ):
        minor = math.floor(place[1] + slope * (major - place[0]) + 0.5)
        if 0 <= minor < n_minor:
            code = code_at(image, major, minor) if steep else code_at(image, minor, major)
            if code > 0:
                total += code - ZERO
                count += 1
    return total, count
