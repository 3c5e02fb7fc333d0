"""First refinement of a coarse candidate: sums along parallel paths of a corridor around it, on the smoothed image.

Coordinates here and in `refine` are (major, minor): major is the axis along which a line advances by one pixel per step (row
for steep lines, col for flat ones, with the images handed in transposed), minor the other one.
"""

import math
from typing import Final

import numba as nb
import numpy as np
from numpy.typing import NDArray

OFFSETS: Final = 13
"""Parallel paths of a corridor, one pixel apart; odd."""

PIECES: Final = 48
"""Most pieces that a corridor is cut into along its length."""


@nb.njit(cache=True)
def corridor_sums(
    smooth: NDArray[np.int8], major0: int, major1: int, minor0: float, slope: float, piece: int,
    sums: NDArray[np.int32], counts: NDArray[np.int32],
) -> int:
    """Sums of the smoothed image along OFFSETS parallel paths, in pieces of `piece` px; returns the number of pieces.

    The middle path starts at (major0, minor0) and climbs by `slope` per px; sums, counts: (PIECES, OFFSETS).
    """
    n_major, n_minor = smooth.shape
    half = OFFSETS // 2
    n_piece = min(PIECES, (major1 - major0 + piece) // piece)
    sums[:n_piece] = 0
    counts[:n_piece] = 0
    for p in range(n_piece):
        for major in range(major0 + p * piece, min(major0 + (p + 1) * piece, major1 + 1)):
            base = int(math.floor(minor0 + slope * (major - major0) + 0.5)) - half
            if base >= 0 and base + OFFSETS <= n_minor:
                for k in range(OFFSETS):
                    sums[p, k] += smooth[major, base + k]
                    counts[p, k] += 1
            else:
                for k in range(OFFSETS):
                    if 0 <= base + k < n_minor:
                        sums[p, k] += smooth[major, base + k]
                        counts[p, k] += 1
    return n_piece


@nb.njit(cache=True)
def _path_piece(
    sums: NDArray[np.int32], counts: NDArray[np.int32], p: int, position: float
) -> tuple[float, float]:
    """Sum and count of a piece at a fractional path number, linear between paths."""
    position = min(max(position, 0.0), OFFSETS - 1.001)
    k = int(position)
    f = position - k
    return sums[p, k] * (1.0 - f) + sums[p, k + 1] * f, counts[p, k] * (1.0 - f) + counts[p, k + 1] * f


@nb.njit(cache=True)
def bend(u: float) -> float:
    """Parabola of height 1 over the unit interval."""
    return 4.0 * u * (1.0 - u)


@nb.njit(cache=True)
def search_corridor(
    sums: NDArray[np.int32], counts: NDArray[np.int32], n_piece: int, first: int, last: int, reach: float, variance: float
) -> tuple[float, float, float, float, int, int]:
    """Best (S/N, start offset, end offset, sagitta, first piece, last piece) of one corridor.

    Starts from the pieces first..last; `variance` is that of a path sum per px. Offsets in px at the corridor's ends
    (piece 0 and n_piece - 1), relative to the middle path.
    """
    half = OFFSETS // 2
    best_o0, best_o1, best_sag, best_snr = 0.0, 0.0, 0.0, -1e9
    for turn in range(2):
        step = 1.0 if turn == 0 else 0.5
        width = reach if turn == 0 else 1.0
        span = max(1, n_piece - 1)
        n_step = int(round(width / step))
        base0, base1, base_sag = best_o0, best_o1, best_sag
        u_first, u_last = (first - 0.5) / span, (last + 0.5) / span
        centre0 = base0 + (base1 - base0) * u_first
        centre1 = base0 + (base1 - base0) * u_last
        best_snr = -1e9
        for bow in range(-2, 3):
            sag = base_sag + bow * step
            if turn == 0 and last - first < 3 and bow != 0:
                continue
            for i in range(-n_step, n_step + 1):
                for j in range(-n_step, n_step + 1):
                    p0, p1 = centre0 + i * step, centre1 + j * step
                    total, count = 0.0, 0.0
                    for p in range(first, last + 1):
                        u = (p - first + 0.5) / (last - first + 1)
                        s, c = _path_piece(sums, counts, p, half + p0 + (p1 - p0) * u + sag * bend(u))
                        total += s
                        count += c
                    if count > 0.0:
                        snr = total / math.sqrt(count * variance)
                        if snr > best_snr:
                            best_snr = snr
                            gradient = (p1 - p0) / (u_last - u_first)
                            best_o0 = p0 - gradient * u_first
                            best_o1 = best_o0 + gradient
                            best_sag = sag
        # the line is fixed: choose the run of pieces
        fixed_first, fixed_last = first, last
        cumulative_s = np.zeros(n_piece + 1)
        cumulative_c = np.zeros(n_piece + 1)
        for p in range(n_piece):
            u = p / span
            v = (p - fixed_first + 0.5) / (fixed_last - fixed_first + 1)
            s, c = _path_piece(sums, counts, p, half + best_o0 + (best_o1 - best_o0) * u + best_sag * bend(v))
            cumulative_s[p + 1] = cumulative_s[p] + s
            cumulative_c[p + 1] = cumulative_c[p] + c
        for i in range(n_piece):
            for j in range(i, n_piece):
                c = cumulative_c[j + 1] - cumulative_c[i]
                if c > 0.0:
                    snr = (cumulative_s[j + 1] - cumulative_s[i]) / math.sqrt(c * variance)
                    if snr > best_snr:
                        best_snr, first, last = snr, i, j
        if first != fixed_first or last != fixed_last:
            best_sag *= ((last - first + 1.0) / (fixed_last - fixed_first + 1.0)) ** 2
    return best_snr, best_o0, best_o1, best_sag, first, last


@nb.njit(cache=True)
def locate(
    smooth: NDArray[np.int8], candidate: NDArray[np.float64], psf_sigma_px: float, segment: NDArray[np.float64],
    sums: NDArray[np.int32], counts: NDArray[np.int32],
) -> float:
    """First refinement of a candidate (major0, minor0, major1, minor1) on the smoothed image; fills segment, returns its S/N."""
    length = candidate[2] - candidate[0]
    slope = (candidate[3] - candidate[1]) / length
    extend = max(8.0, 0.5 * length)
    low = int(max(0.0, math.floor(candidate[0] - extend)))
    high = int(min(smooth.shape[0] - 1.0, math.ceil(candidate[2] + extend)))
    piece = max(2, (high - low + PIECES) // PIECES)
    n_piece = corridor_sums(smooth, low, high, candidate[1] + slope * (low - candidate[0]), slope, piece, sums, counts)
    first = min(n_piece - 1, max(0, int((candidate[0] - low) / piece)))
    last = min(n_piece - 1, max(first, int((candidate[2] - low) / piece)))
    cosine = 1.0 / math.sqrt(1.0 + slope * slope)
    variance = 2.0 * math.sqrt(math.pi) * psf_sigma_px * cosine * 256.0
    snr, o0, o1, sag, i, j = search_corridor(sums, counts, n_piece, first, last, 3.0, variance)
    start, stop = low + i * piece - 0.5, min(float(high), low + (j + 1) * piece - 0.5)
    span = max(1, n_piece - 1) * float(piece)
    middle = low + 0.5 * (piece - 1)
    for side in range(2):
        major = start if side == 0 else stop
        offset = o0 + (o1 - o0) * (major - middle) / span
        segment[2 * side] = major
        segment[2 * side + 1] = candidate[1] + slope * (major - candidate[0]) + offset
    segment[4] = sag
    return snr
