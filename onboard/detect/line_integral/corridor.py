"""First refinement of a coarse candidate: sums along parallel paths of a corridor around it, on the smoothed image.

Coordinates here and in `refine` are (major, minor): major is the axis along which a line advances by one pixel per step (row
for steep lines, col for flat ones, with the images handed in transposed), minor the other one.
"""

import math
from typing import Final, NamedTuple

import numba as nb
import numpy as np
from numpy.typing import NDArray

from onboard.detect.cross_profile import bend
from onboard.prefetch import ask_for

OFFSETS: Final = 13
"""Parallel paths of a corridor, one pixel apart; odd."""

BOW_GAIN: Final = 0.6
"""What half-pixel steps and a bent path can add to the S/N of a path on whole pixels."""

BENT_PX: Final = 40.0
"""Shorter segments are straight: their curvature cannot be measured."""

PIECES: Final = 48
"""Most pieces that a corridor is cut into along its length."""

LANES: Final = 16
"""Pixels of a row that are read at once: the paths of a corridor, filled up to two words of eight bytes."""

CACHE_LINE: Final = 64
"""Pixels of a row that come into the cache together."""

ROWS_AHEAD: Final = 16  # that memory is asked for. Chosen, not measured

FLUSH: Final = 256
"""Rows whose bytes are summed in 16 bits."""

BIAS: Final = 128
"""What makes a signed byte unsigned: its highest bit flipped."""


class Lines(NamedTuple):
    """An image as corridors read it. flat : its pixels, row by row; words : the same, eight in each, without those left over.

    rows, cols : its shape. steep : rows are the major axis.
    """

    flat: NDArray[np.int8]
    words: NDArray[np.uint64]
    rows: int
    cols: int
    steep: bool


@nb.njit(cache=True)
def lines_of(image: NDArray[np.int8], steep: bool) -> Lines:
    """The rows of an image (rows, cols), or its columns, as major axis."""
    flat = image.reshape(-1)
    return Lines(flat, flat[: flat.size // 8 * 8].view(np.uint64), image.shape[0], image.shape[1], steep)


@nb.njit(cache=True)
def corridor_sums(
    lines: Lines,
    major0: int,
    major1: int,
    minor0: float,
    slope: float,
    piece: int,
    sums: NDArray[np.int32],
    counts: NDArray[np.int32],
) -> int:
    """Sums of the smoothed image along OFFSETS parallel paths, in pieces of `piece` px; returns the number of pieces.

    The middle path starts at (major0, minor0) and climbs by `slope` per px; sums, counts: (PIECES, OFFSETS).
    """
    flat, words, _, cols, steep = lines
    # pixels across that are read at once
    across, n_minor = (LANES, cols) if steep else (OFFSETS, lines.rows)
    n_piece = min(PIECES, (major1 - major0 + piece) // piece)
    counts[:n_piece] = 0
    sums[:n_piece] = 0
    for p in range(n_piece):
        start, stop = major0 + p * piece, min(major0 + (p + 1) * piece, major1 + 1)
        while start < stop:
            last = min(start + FLUSH, stop)
            base0 = _base(minor0, slope, start - major0)
            base1 = _base(minor0, slope, last - 1 - major0)
            inside = min(base0, base1) >= 0 and max(base0, base1) + across <= n_minor
            if inside and not steep:
                _add_columns(sums, p, flat, cols, major0, minor0, slope, start, last)
            elif inside and ((last - 1) * cols + base1 >> 3) + 2 < words.size:
                _add_rows(words, cols, start, last, major0, minor0, slope, sums, p)
            else:
                inside = False
                for major in range(start, last):
                    _add_some(lines, major, _base(minor0, slope, major - major0), sums, counts, p)
            if inside:
                for k in range(OFFSETS):
                    counts[p, k] += last - start
            start = last
    return n_piece


@nb.njit(cache=True)
def _base(minor0: float, slope: float, step: int) -> int:
    """Pixel of the first path."""
    return math.floor(minor0 + slope * step + 0.5) - OFFSETS // 2


@nb.njit(cache=True)
def _add_rows(
    words: NDArray[np.uint64],
    cols: int,
    start: int,
    stop: int,
    major0: int,
    minor0: float,
    slope: float,
    sums: NDArray[np.int32],
    p: int,
) -> None:
    """Add rows start ... stop - 1, all of whose paths lie in the image, to row p of sums: sixteen bytes of each at once."""
    even, signs = np.uint64(0x00FF00FF00FF00FF), np.uint64(0x8080808080808080)
    one, two, eight, rest = np.uint64(1), np.uint64(2), np.uint64(8), np.uint64(63)
    first = second = third = fourth = np.uint64(0)
    ahead = ROWS_AHEAD * cols + int(ROWS_AHEAD * slope)
    for row in range(start, stop):
        place = row * cols + _base(minor0, slope, row - major0)
        ask_for(words, ((place + ahead) >> 3,))
        at = np.uint64(place)
        word, bits = at >> np.uint64(3), eight * (at & np.uint64(7))
        low, middle, high = words[word], words[word + one], words[word + two]
        # unsigned bytes: a flipped sign adds BIAS
        low = ((low >> bits) | ((middle << one) << (rest - bits))) ^ signs
        high = ((middle >> bits) | ((high << one) << (rest - bits))) ^ signs
        first += low & even
        second += (low >> eight) & even
        third += high & even
        fourth += (high >> eight) & even
    for k in range(OFFSETS):
        four = (second if k % 2 else first) if k < 8 else (fourth if k % 2 else third)
        sums[p, k] += np.int32((four >> np.uint64(8 * (k % 8 - k % 2))) & np.uint64(0xFFFF)) - BIAS * (stop - start)


@nb.njit(cache=True)
def _add_columns(
    sums: NDArray[np.int32],
    p: int,
    flat: NDArray[np.int8],
    cols: int,
    major0: int,
    minor0: float,
    slope: float,
    start: int,
    stop: int,
) -> None:
    """The same for columns, pixel by pixel."""
    line, stride = np.uint64(p), np.uint64(cols)
    for col in range(start, stop):
        base = _base(minor0, slope, col - major0)
        if (col - start) % CACHE_LINE == 0:
            for row in range(OFFSETS):
                ask_for(flat, ((base + int(CACHE_LINE * slope) + row) * cols + col + CACHE_LINE,))
        at = np.uint64(base * cols + col)
        for k in range(np.uint64(OFFSETS)):
            sums[line, k] += flat[at]
            at += stride


@nb.njit(cache=True)
def _add_some(lines: Lines, major: int, base: int, sums: NDArray[np.int32], counts: NDArray[np.int32], p: int) -> None:
    """Add those pixels of a line of the major axis that lie in the image."""
    n_minor = lines.cols if lines.steep else lines.rows
    for k in range(OFFSETS):
        minor = base + k
        if 0 <= minor < n_minor:
            sums[p, k] += lines.flat[major * lines.cols + minor if lines.steep else minor * lines.cols + major]
            counts[p, k] += 1


@nb.njit(cache=True, error_model="numpy")
def _of_piece(values: NDArray[np.int32], p: int, position: float) -> float:
    """Sum, or count, of a piece at a fractional path number, linear between paths."""
    position = min(max(position, 0.0), OFFSETS - 1.001)
    line, k = np.uint64(p), np.uint64(position)
    f, beside = position - float(k), k + np.uint64(1)
    return values[line, k] * (1.0 - f) + values[line, beside] * f


@nb.njit(cache=True, error_model="numpy")
def _of_path(
    values: NDArray[np.int32],
    first: int,
    last: int,
    start: float,
    climb: float,
    bow: float,
    along: NDArray[np.float64],
    bent: NDArray[np.float64],
) -> float:
    """Sum, or count, of the pieces first..last on a path that begins at the path number `start`, climbs and bends."""
    total = 0.0
    for p in range(first, last + 1):
        total += _of_piece(values, p, start + climb * along[p] + bow * bent[p])
    return total


@nb.njit(cache=True)
def _same_counts(counts: NDArray[np.int32], n_piece: int) -> bool:
    """Whether all paths have the same pixels in each piece, as those that stay in the image have."""
    same = True
    for p in range(n_piece):
        for k in range(OFFSETS):
            same &= counts[p, k] == counts[p, 0]
    return same


@nb.njit(cache=True, error_model="numpy")
def best_pieces(
    sums: NDArray[np.int32],
    counts: NDArray[np.int32],
    n_piece: int,
    o0: float,
    o1: float,
    sag: float,
    first: int,
    last: int,
    variance: float,
) -> tuple[float, int, int]:
    """The run of pieces with the highest S/N on a fixed path (offsets o0, o1 at the corridor's ends, bent in first..last)."""
    half, span = OFFSETS // 2, max(1, n_piece - 1)
    cumulative_s, cumulative_c = np.zeros(n_piece + 1), np.zeros(n_piece + 1)
    for p in range(n_piece):
        at = half + o0 + (o1 - o0) * p / span + sag * bend((p - first + 0.5) / (last - first + 1))
        cumulative_s[p + 1] = cumulative_s[p] + _of_piece(sums, p, at)
        cumulative_c[p + 1] = cumulative_c[p] + _of_piece(counts, p, at)
    # runs are compared by the square of their S/N without division: a / b > c / d for b, d > 0 is a d > c b
    power, pixels, best_first, best_last = -1e18, 1.0, first, last
    for i in range(n_piece):
        for j in range(i, n_piece):
            s, c = cumulative_s[j + 1] - cumulative_s[i], cumulative_c[j + 1] - cumulative_c[i]
            if c > 0.0 and s * abs(s) * pixels > power * c:
                power, pixels, best_first, best_last = s * abs(s), c, i, j
    return math.copysign(math.sqrt(abs(power) / (pixels * variance)), power), best_first, best_last


@nb.njit(cache=True, error_model="numpy")
def search_corridor(
    sums: NDArray[np.int32],
    counts: NDArray[np.int32],
    n_piece: int,
    first: int,
    last: int,
    reach: float,
    variance: float,
    least: float,
) -> tuple[float, float, float, float, int, int]:
    """Best (S/N, start offset, end offset, sagitta, first piece, last piece) of one corridor.

    Starts from the pieces first..last; `variance` is that of a path sum per px. Offsets in px at the corridor's ends (piece 0
    and n_piece - 1), relative to the middle path. Straight paths on whole pixels come first; only when they reach `least` less
    BOW_GAIN are bent ones tried, at half-pixel steps.
    """
    half, span = OFFSETS // 2, max(1, n_piece - 1)
    o0 = o1 = sag = 0.0
    snr = -1e9
    along, bent = np.empty(n_piece), np.empty(n_piece)
    # hardly ever do paths have to be counted one by one
    same = _same_counts(counts, n_piece)
    for turn in range(2):
        step, width = (1.0, reach) if turn == 0 else (0.5, 1.0)
        n_step = round(width / step)
        bows = 0 if turn == 0 or last - first < 3 else 2
        u_first, u_last = (first - 0.5) / span, (last + 0.5) / span
        centre0, centre1 = o0 + (o1 - o0) * u_first, o0 + (o1 - o0) * u_last
        for p in range(first, last + 1):
            along[p] = (p - first + 0.5) / (last - first + 1)
            bent[p] = bend(along[p])
        snr, count = -1e9, float(counts[first : last + 1, 0].sum())
        for bow in range(-bows, bows + 1):
            for i in range(-n_step, n_step + 1):
                for j in range(-n_step, n_step + 1):
                    p0, p1 = centre0 + i * step, centre1 + j * step
                    total = _of_path(sums, first, last, half + p0, p1 - p0, float(bow), along, bent)
                    if not same:
                        count = _of_path(counts, first, last, half + p0, p1 - p0, float(bow), along, bent)
                    if count > 0.0 and total > snr * math.sqrt(count * variance):
                        snr = total / math.sqrt(count * variance)
                        gradient = (p1 - p0) / (u_last - u_first)
                        o0 = p0 - gradient * u_first
                        o1 = o0 + gradient
                        sag = float(bow)
        longest, i, j = best_pieces(sums, counts, n_piece, o0, o1, sag, first, last, variance)
        if longest > snr:
            # the same parabola by its new chord
            pieces = last - first + 1.0
            u_first, u_last = (i - 0.5) / span, (j + 0.5) / span
            p0 = o0 + (o1 - o0) * u_first + sag * bend((i - first) / pieces)
            p1 = o0 + (o1 - o0) * u_last + sag * bend((j + 1 - first) / pieces)
            gradient = (p1 - p0) / (u_last - u_first)
            o0 = p0 - gradient * u_first
            o1 = o0 + gradient
            sag *= ((j - i + 1.0) / pieces) ** 2
            snr, first, last = longest, i, j
        if turn == 0 and snr < least - BOW_GAIN:
            break
    return snr, o0, o1, sag, first, last


@nb.njit(cache=True, error_model="numpy")
def locate(
    lines: Lines,
    candidate: NDArray[np.float64],
    psf_sigma_px: float,
    usable: float,
    least: float,
    segment: NDArray[np.float64],
    sums: NDArray[np.int32],
    counts: NDArray[np.int32],
) -> float:
    """First refinement of a candidate (major0, minor0, major1, minor1) on the smoothed image; fills segment, returns its S/N.

    usable : share of pixels that are not masked, by which the variance of sums is smaller. least : S/N below which the caller
    drops the candidate.
    """
    length = candidate[2] - candidate[0]
    slope = (candidate[3] - candidate[1]) / length
    extend = max(8.0, 0.3 * length)
    low = int(max(0.0, math.floor(candidate[0] - extend)))
    high = int(min((lines.rows if lines.steep else lines.cols) - 1.0, math.ceil(candidate[2] + extend)))
    piece = max(2, (high - low + PIECES) // PIECES)
    n_piece = corridor_sums(lines, low, high, candidate[1] + slope * (low - candidate[0]), slope, piece, sums, counts)
    first = min(n_piece - 1, max(0, int((candidate[0] - low) / piece)))
    last = min(n_piece - 1, max(first, int((candidate[2] - low) / piece)))
    cosine = 1.0 / math.sqrt(1.0 + slope * slope)
    variance = 2.0 * math.sqrt(math.pi) * psf_sigma_px * cosine * 256.0 * usable
    snr, o0, o1, sag, i, j = search_corridor(sums, counts, n_piece, first, last, 3.0, variance, least)
    start, stop = low + i * piece - 0.5, min(float(high), low + (j + 1) * piece - 0.5)
    span = max(1, n_piece - 1) * float(piece)
    middle = low + 0.5 * (piece - 1)
    for side in range(2):
        major = start if side == 0 else stop
        offset = o0 + (o1 - o0) * (major - middle) / span
        segment[2 * side] = major
        segment[2 * side + 1] = candidate[1] + slope * (major - candidate[0]) + offset
    segment[4] = sag if segment[2] - segment[0] >= BENT_PX else 0.0
    return snr
