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

from onboard.track.packed import PIXELS, ZERO, add_lanes, code_at

LANES: Final = PIXELS  # a word holds as many
MIDDLE: Final = 8
"""Lines of a corridor, one pixel apart along the minor axis; the middle one runs along the seed."""

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
    n_major, n_minor = image.shape[0], PIXELS * (image.shape[1] - 2)
    if not steep:
        n_major, n_minor = n_minor, n_major
    slope = place[3] / place[2]
    origin = place[1] - slope * place[0] + 0.5 - MIDDLE
    sums[0], counts[0] = 0, 0
    read = 0
    start = math.ceil(place[0] + place[2] * first_px)
    for p in range(n_pieces):
        stop = math.ceil(place[0] + place[2] * (first_px + (p + 1) * piece_px))
        sums[p + 1], counts[p + 1] = sums[p], counts[p]
        low, high = max(0, start), min(n_major, stop)
        if steep:
            read += add_lanes(image, low, high, origin, slope, sums[p + 1], counts[p + 1])
        else:
            for major in range(low, high):
                base = math.floor(origin + slope * major)
                if base >= n_minor or base + LANES <= 0:
                    continue
                read += LANES
                for k in range(max(0, -base), min(LANES, n_minor - base)):
                    code = code_at(image, base + k, major)
                    if code > 0:
                        sums[p + 1, k] += code - ZERO
                        counts[p + 1, k] += 1
        start = stop
    return read


@nb.njit(cache=True)
def between(
    sums: NDArray[np.int32],
    counts: NDArray[np.int32],
    n_pieces: int,
    first: float,
    last: float,
    lane: float,
    correlation: float,
) -> tuple[float, float]:
    """Sum and weight of a trail: of pieces first ... last (fractions interpolated) on a fractional lane; 0, 0 outside.

    weight : sum of the variances of the interpolated values, in pixels; correlation : of neighbouring lanes.
    """
    lane += MIDDLE
    first, last = max(first, 0.0), min(last, float(n_pieces))
    if last <= first or lane < 0.0 or lane >= LANES - 1.0:
        return 0.0, 0.0
    k = int(lane)
    f = lane - k
    i, j = min(int(first), n_pieces - 1), min(int(last), n_pieces - 1)
    u, v = first - i, last - j
    total = weight = 0.0
    for side in range(2):
        share = 1.0 - f if side == 0 else f
        n = k + side
        low = sums[i, n] + u * (sums[i + 1, n] - sums[i, n])
        high = sums[j, n] + v * (sums[j + 1, n] - sums[j, n])
        total += share * (high - low)
        low = counts[i, n] + u * (counts[i + 1, n] - counts[i, n])
        high = counts[j, n] + v * (counts[j + 1, n] - counts[j, n])
        weight += share * (high - low)
    return total, weight * (1.0 - 2.0 * f * (1.0 - f) * (1.0 - correlation))


@nb.njit(cache=True)
def lanes_between(
    sums: NDArray[np.int32],
    counts: NDArray[np.int32],
    n_pieces: int,
    first: float,
    last: float,
    total: NDArray[np.float32],
    weight: NDArray[np.float32],
) -> None:
    """Sum and known pixels of pieces first ... last (fractions interpolated) on each lane, into total and weight (LANES,)."""
    first, last = max(first, 0.0), min(last, float(n_pieces))
    if last <= first:
        total[:], weight[:] = 0.0, 0.0
        return
    i, j = min(int(first), n_pieces - 1), min(int(last), n_pieces - 1)
    u, v = np.float32(first - i), np.float32(last - j)
    _interpolated(sums[i], sums[i + 1], u, sums[j], sums[j + 1], v, total)
    _interpolated(counts[i], counts[i + 1], u, counts[j], counts[j + 1], v, weight)


@nb.njit(cache=True)
def _interpolated(
    a: NDArray[np.int32],
    b: NDArray[np.int32],
    u: np.float32,
    c: NDArray[np.int32],
    d: NDArray[np.int32],
    v: np.float32,
    out: NDArray[np.float32],
) -> None:
    for k in range(LANES):
        out[k] = np.float32(c[k] - a[k]) + v * np.float32(d[k] - c[k]) - u * np.float32(b[k] - a[k])


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
