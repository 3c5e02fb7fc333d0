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

from sboc_e2e.icd.signals import UNKNOWN

LANES: Final = 16  # pixels of a byte that a register of 128 bits holds
MIDDLE: Final = 8
"""Lines of a corridor, one pixel apart along the minor axis; the middle one runs along the seed."""

MOST_PIECES: Final = 512
"""Pieces of a corridor."""

CLIP: Final = 64
"""A pixel counts for four sigma at most: particles are brighter, trails that no single frame shows are not."""


@nb.njit(cache=True)
def _halve_row(a: NDArray[np.int8], b: NDArray[np.int8], out: NDArray[np.int8]) -> None:
    unknown, clip = np.int16(UNKNOWN), np.int16(CLIP)
    for i in range(out.size):
        total, seen = np.int16(0), np.int16(0)
        for value in (np.int16(a[2 * i]), np.int16(a[2 * i + 1]), np.int16(b[2 * i]), np.int16(b[2 * i + 1])):
            known = value != unknown
            seen += np.int16(known)
            total += min(max(value, -clip), clip) if known else np.int16(0)
        out[i] = np.int8((total + np.int16(2)) >> 2) if seen > np.int16(1) else np.int8(UNKNOWN)


@nb.njit(cache=True)
def _halve_rows(image: NDArray[np.int8], out: NDArray[np.int8]) -> None:
    for row in range(out.shape[0]):
        _halve_row(image[2 * row], image[2 * row + 1], out[row])


def halved(image: NDArray[np.int8]) -> NDArray[np.int8]:
    """Means of 2 x 2 pixels of an image as `Searched.smooth`, clipped; `UNKNOWN` where most are."""
    out = np.empty((image.shape[0] // 2, image.shape[1] // 2), np.int8)
    _halve_rows(image, out)
    return out


@nb.njit(cache=True)
def _add_lanes(values: NDArray[np.int8], sums: NDArray[np.int32], counts: NDArray[np.int32]) -> None:
    for k in range(LANES):
        value = np.int32(values[k])
        seen = value != np.int32(UNKNOWN)
        value = np.int32(CLIP) if value > np.int32(CLIP) else value
        value = np.int32(-CLIP) if value < np.int32(-CLIP) else value
        sums[k] += value if seen else np.int32(0)
        counts[k] += np.int32(seen)


@nb.njit(cache=True)
def gather(
    image: NDArray[np.int8],
    steep: bool,
    place: NDArray[np.float64],
    first_px: float,
    piece_px: float,
    n_pieces: int,
    sums: NDArray[np.int32],
    counts: NDArray[np.int32],
) -> int:
    """Running sums over a frame's corridor; returns the pixels read.

    image : as `Searched.smooth`. steep : the major axis is row. place (4,) : major and minor coordinate in this frame of the
    seed's first end, and of the seed's direction (change per px along it; that of major > 0). Piece p covers
    first_px + p piece_px ... on the seed's line, from its first end. sums, counts (MOST_PIECES + 1, LANES) : of the clipped
    values and of the known pixels before each piece, lane by lane; row n_pieces holds the whole.
    """
    n_major, n_minor = (image.shape[0], image.shape[1]) if steep else (image.shape[1], image.shape[0])
    slope = place[3] / place[2]
    sums[0], counts[0] = 0, 0
    read = 0
    start = math.ceil(place[0] + place[2] * first_px)
    for p in range(n_pieces):
        stop = math.ceil(place[0] + place[2] * (first_px + (p + 1) * piece_px))
        sums[p + 1], counts[p + 1] = sums[p], counts[p]
        for major in range(max(0, start), min(n_major, stop)):
            base = math.floor(place[1] + slope * (major - place[0]) + 0.5) - MIDDLE
            if base >= n_minor or base + LANES <= 0:
                continue
            read += LANES
            if base >= 0 and base + LANES <= n_minor and steep:
                _add_lanes(image[major, base : base + LANES], sums[p + 1], counts[p + 1])
                continue
            for k in range(max(0, -base), min(LANES, n_minor - base)):
                value = int(image[major, base + k]) if steep else int(image[base + k, major])
                if value != UNKNOWN:
                    sums[p + 1, k] += min(max(value, -CLIP), CLIP)
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
    image: NDArray[np.int8], steep: bool, place: NDArray[np.float64], first_px: float, last_px: float
) -> tuple[int, int]:
    """Sum of clipped values and number of known pixels on the seed's line itself; see `gather`."""
    n_major, n_minor = (image.shape[0], image.shape[1]) if steep else (image.shape[1], image.shape[0])
    slope = place[3] / place[2]
    total = count = 0
    for major in range(
        max(0, math.ceil(place[0] + place[2] * first_px)), min(n_major, math.floor(place[0] + place[2] * last_px) + 1)
    ):
        minor = math.floor(place[1] + slope * (major - place[0]) + 0.5)
        if 0 <= minor < n_minor:
            value = int(image[major, minor]) if steep else int(image[minor, major])
            if value != UNKNOWN:
                total += min(max(value, -CLIP), CLIP)
                count += 1
    return total, count
