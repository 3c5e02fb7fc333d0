"""What a straight track shows in corridors gathered about a seed's line: sums, weights and joint S/N over frames."""

import math
from typing import Final, NamedTuple

import numba as nb
import numpy as np
from numpy.typing import NDArray

from onboard.track.corridor import LANES, MOST_PIECES, between, gather
from onboard.track.packed import HALF_ROUNDING, ROUNDING, STEP

REACH_SIGMAS: Final = 6.0  # of the PSF, where the correlation is 1e-4
LEAST_PATH: Final = 4.0  # pixels: shorter paths are hardly longer than the correlation reaches


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
    correlation : of neighbouring lanes. variance, ends : of a path's sum, see `path_variance`. n_old : frames, the first ones,
    that are kept at half resolution.
    """

    taus: NDArray[np.float64]
    sense: float
    seed_px: float
    per_lane: float
    correlation: float
    variance: float
    ends: float
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
    variance, ends = path_variance(psf_sigma_px, per_lane)
    return Look(taus, sense, seed_px, per_lane, math.exp(-0.25 * (per_lane / psf_sigma_px) ** 2), variance, ends, n_old)


@nb.njit(cache=True)
def path_variance(psf_sigma_px: float, per_lane: float) -> tuple[float, float]:
    """Variance of the sum of smoothed pixels along a path for each of them, and what is less of it in a whole path, for its ends.

    In steps of a code squared. A path takes the nearest pixel of the minor axis. So pixels k steps apart lie floor(k slope) apart
    along it, or one more in a share of the places. Noise that is smoothed by the PSF has the correlation exp(-(r / 2 sigma)^2) at
    a distance r. A path of n pixels has n - k pairs at k steps.
    """
    slope = math.sqrt(max(1.0 / (per_lane * per_lane) - 1.0, 0.0))
    variance, ends = 1.0, 0.0
    for k in range(1, math.ceil(REACH_SIGMAS * psf_sigma_px) + 1):
        across = math.floor(k * slope)
        share = k * slope - across
        near = math.exp(-0.25 * (k * k + across**2) / psf_sigma_px**2)
        far = math.exp(-0.25 * (k * k + (across + 1) ** 2) / psf_sigma_px**2)
        pair = 2.0 * ((1.0 - share) * near + share * far)
        variance += pair
        ends += k * pair
    return (16.0 / STEP) ** 2 * variance + ROUNDING, (16.0 / STEP) ** 2 * ends


@nb.njit(cache=True)
def trail_variance(variance: float, ends: float, path_px: float) -> float:
    """Variance of the sum over a whole path of so many pixels, over its weight; variance, ends : see `path_variance`."""
    return variance - ends / max(path_px, LEAST_PATH)


@nb.njit(cache=True)
def line_variance(psf_sigma_px: float, per_lane: float) -> float:
    """Variance of the sum of smoothed pixels along an endless line, for each of them, steps of a code squared."""
    return (16.0 / STEP) ** 2 * 2.0 * math.sqrt(math.pi) * psf_sigma_px * per_lane


@nb.njit(cache=True)
def half_line_variance(psf_sigma_px: float, per_lane: float) -> float:
    """The same of halved images, whose rounding is theirs."""
    return 0.5 * psf_sigma_px / math.hypot(psf_sigma_px, 0.5) * line_variance(psf_sigma_px, per_lane) + HALF_ROUNDING


@nb.njit(cache=True)
def placed(seed: NDArray[np.float64], transform: NDArray[np.float64], place: NDArray[np.float64]) -> bool:
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
    steep = placed(seed, transforms[frame], place)
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
    steep = placed(half_seed, half_transforms[frame], place)
    sums, counts = corridors.sums[frame], corridors.counts[frame]
    read = gather(images[frame], steep, place, 0.5 * first_px, 0.5 * piece_px, n, sums, counts)
    for p in range(n + 1):
        for k in range(LANES):
            sums[p, k] = round(scale[0] * sums[p, k])
            counts[p, k] = round(scale[1] * counts[p, k])
    return read


@nb.njit(cache=True, error_model="numpy", inline="always")
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


@nb.njit(cache=True, error_model="numpy")
def evaluate(corridors: Corridors, look: Look, low: int, high: int, track: NDArray[np.float64]) -> float:
    """Joint S/N of a track in frames low ... high."""
    total = weight = 0.0
    for frame in range(low, high + 1):
        s, w = trail_sums(corridors, look, frame, track)
        total += s
        weight += w
    return total / math.sqrt(weight * trail_variance(look.variance, look.ends, look.per_lane * track[1])) if weight > 0.0 else 0.0
