"""Searched images in half a byte a pixel: what a tracker keeps of a frame, and sums sixteen pixels of at once.

A pixel's code is its S/N in steps of `STEP` sixteenths of a sigma, from -7 to 7, plus `ZERO`; 0 says that it is unknown. Sixteen
neighbours of a row lie in one word, the first in its lowest bits. A word of unknown pixels stands before and after each row, so
that whatever begins at most a word outside can be read like everything else.
"""

import math
from typing import Final

import numba as nb
import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd.signals import UNKNOWN

PIXELS: Final = 16
"""Pixels of a word."""

STEP: Final = 9
"""Sixteenths of a sigma in one step of a code, so that the largest is 63: a pixel counts for four sigma at most.

Particles are brighter, trails that no single frame shows are not. Rounding adds 81/12 to a variance of 770 for each pixel of a
sum along a line (PSF of 0.85 px): 0.4 % of its S/N.
"""

ZERO: Final = 8
"""Code of a pixel without light."""

NINTH: Final = 57
"""2^9 / STEP, rounded up: n * NINTH >> 9 is n // STEP for n below 450."""

ROUNDING: Final = 1.0 / 12.0
"""Variance of the rounding, steps squared."""

HALF_ROUNDING: Final = (1.0 + 0.25) / 12.0
"""The same of the image at half resolution: its own, and the mean of four."""


def words_of(cols: int) -> int:
    """Words of a row, with those before and after it."""
    return -(-cols // PIXELS) + 2


def packed(smooth: NDArray[np.int8]) -> NDArray[np.uint64]:
    """An image as `Searched.smooth` (rows, cols) -> (rows, words)."""
    out = np.zeros((smooth.shape[0], words_of(smooth.shape[1])), np.uint64)
    _pack_smooth(smooth, out)
    return read_only(out)


def read_only(words: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """The same, as of a state that was read back: compiled code has one kind of image."""
    words.flags.writeable = False
    return words


@nb.njit(cache=True)
def _pack_smooth(smooth: NDArray[np.int8], out: NDArray[np.uint64]) -> None:
    cols = smooth.shape[1]
    pairs = out.view(np.uint8)  # the first pixel of two in the lower half
    for row in range(smooth.shape[0]):
        line = pairs[row, PIXELS // 2 :]
        _pack_pairs(smooth[row, : cols // 2 * 2], line[: cols // 2])
        if cols % 2:
            line[cols // 2] = _code(smooth[row, cols - 1])


@nb.njit(cache=True)
def _pack_pairs(smooth: NDArray[np.int8], out: NDArray[np.uint8]) -> None:
    for i in range(out.size):
        out[i] = np.uint8(np.int16(_code(smooth[2 * i]) | np.int16(_code(smooth[2 * i + 1]) << np.int16(4))))


@nb.njit(cache=True)
def _code(smooth: np.int8) -> np.int16:
    """Code of a value of `Searched.smooth`: rounded to whole steps, by a product and a shift for vector instructions."""
    most = np.int16(7 * STEP + STEP // 2)
    value = np.int16(smooth)
    value = np.int16(-most) if value < np.int16(-most) else value
    value = most if value > most else value
    code = np.int16(np.int16(np.int16(np.int16(value + most) * np.int16(NINTH)) >> np.int16(9)) + np.int16(1))
    return np.int16(0) if smooth == np.int8(UNKNOWN) else code


@nb.njit(cache=True)
def pack(values: NDArray[np.uint8], codes: NDArray[np.uint8], out: NDArray[np.uint64]) -> None:
    """Fill the words of an image with the codes of its values. codes : by a value's bits."""
    rows, cols = values.shape
    for row in range(rows):
        for word in range(out.shape[1] - 2):
            bits = np.uint64(0)
            for k in range(min(PIXELS, cols - PIXELS * word)):
                bits |= np.uint64(codes[values[row, PIXELS * word + k]]) << np.uint64(4 * k)
            out[row, word + 1] = bits


@nb.njit(cache=True)
def code_at(words: NDArray[np.uint64], row: int, col: int) -> int:
    """Code of a pixel."""
    return int((words[row, (col >> 4) + 1] >> np.uint64(4 * (col & 15))) & np.uint64(15))


def halved(words: NDArray[np.uint64]) -> tuple[NDArray[np.uint64], NDArray[np.uint64]]:
    """Means of 2 x 2 pixels, unknown where most are, and the same transposed. Pixel centres lie at 2 k + 0.5."""
    half = half_of(words)
    flat = np.zeros(((half.shape[1] - 2) * PIXELS, words_of(half.shape[0])), np.uint64)
    _turn(half, flat)
    return half, read_only(flat)


def half_of(words: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """The first of `halved`."""
    half = np.zeros((words.shape[0] // 2, (words.shape[1] - 1) // 2 + 2), np.uint64)
    _halve(words, half)
    return read_only(half)


@nb.njit(cache=True)
def _halve(words: NDArray[np.uint64], out: NDArray[np.uint64]) -> None:
    # a byte holds two pixels, the first in its lower half
    pairs, halves = words.view(np.uint8), out.view(np.uint8)
    begin, end = PIXELS // 2, 4 * words.shape[1]
    for row in range(out.shape[0]):
        _halve_rows(pairs[2 * row, begin:-begin], pairs[2 * row + 1, begin:-begin], halves[row, begin:end])


@nb.njit(cache=True)
def _halve_rows(upper: NDArray[np.uint8], lower: NDArray[np.uint8], out: NDArray[np.uint8]) -> None:
    for i in range(out.size):
        first = _mean_code(upper[2 * i], lower[2 * i])
        second = _mean_code(upper[2 * i + 1], lower[2 * i + 1])
        out[i] = np.uint8(np.int16(first | np.int16(second << np.int16(4))))


@nb.njit(cache=True)
def _mean_code(upper: np.uint8, lower: np.uint8) -> np.int16:
    """Code of the mean of two pairs of pixels, unknown where most are; vector instructions."""
    one, zero = np.int16(1), np.int16(0)
    a, b = np.int16(upper & np.uint8(15)), np.int16(upper >> np.uint8(4))
    d, e = np.int16(lower & np.uint8(15)), np.int16(lower >> np.uint8(4))
    known = np.int16(np.int16(np.int16(a > zero) + np.int16(b > zero)) + np.int16(np.int16(d > zero) + np.int16(e > zero)))
    total = np.int16(np.int16(np.int16(a + b) + np.int16(d + e)) - np.int16(np.int16(ZERO) * known))
    mean = np.int16(np.int16(total + np.int16(2)) >> np.int16(2))
    # halves go to the even neighbour
    odd_half = (np.int16(total & np.int16(3)) == np.int16(2)) & (np.int16(mean & one) == one)
    mean = np.int16(mean - np.int16(odd_half))
    mean = np.int16(-7) if mean < np.int16(-7) else mean
    mean = np.int16(7) if mean > np.int16(7) else mean
    return np.int16(mean + np.int16(ZERO)) if known > one else zero


@nb.njit(cache=True)
def _turn(words: NDArray[np.uint64], out: NDArray[np.uint64]) -> None:
    """Transpose, sixteen by sixteen pixels at a time; rows and cols of the result are those of whole words."""
    rows, block = words.shape[0], np.zeros(PIXELS, np.uint64)
    for word in range(words.shape[1] - 2):
        for first in range(0, rows, PIXELS):
            n = min(PIXELS, rows - first)
            for i in range(n):
                block[i] = words[first + i, word + 1]
            block[n:] = np.uint64(0)
            # squares of 8, 4, 2 and 1 pixels across the diagonal change places
            _swap(block, 8, np.uint64(0x00000000FFFFFFFF))
            _swap(block, 4, np.uint64(0x0000FFFF0000FFFF))
            _swap(block, 2, np.uint64(0x00FF00FF00FF00FF))
            _swap(block, 1, np.uint64(0x0F0F0F0F0F0F0F0F))
            for k in range(PIXELS):
                out[PIXELS * word + k, (first >> 4) + 1] = block[k]


@nb.njit(cache=True)
def _swap(block: NDArray[np.uint64], side: int, mask: np.uint64) -> None:
    """Upper right squares of `side` with the lower left ones. mask : columns of the left ones."""
    bits = np.uint64(4 * side)
    for first in range(0, PIXELS, 2 * side):
        for i in range(np.uint64(first), np.uint64(first + side)):
            j = i + np.uint64(side)
            change = ((block[i] >> bits) ^ block[j]) & mask
            block[i] ^= change << bits
            block[j] ^= change


@nb.njit(cache=True)
def add_lanes(
    words: NDArray[np.uint64],
    start: int,
    stop: int,
    first: float,
    slope: float,
    sums: NDArray[np.int32],
    counts: NDArray[np.int32],
    at_row: int,
) -> int:
    """Add sixteen neighbouring lanes along rows start ... stop - 1 to row `at_row` of sums and counts; returns the pixels read.

    first, slope : the first lane lies in column floor(first + slope row). sums : of the codes less `ZERO`, known pixels alone.
    """
    low, one, most = np.uint64(0x0F0F0F0F0F0F0F0F), np.uint64(0x0101010101010101), np.uint64(0x7F7F7F7F7F7F7F7F)
    four, seven, end = np.uint64(4), np.uint64(7), PIXELS * (words.shape[1] - 2)
    byte, line = np.uint64(255), np.uint64(at_row)
    read = 0
    while start < stop:
        # bytes of a word hold the sum of sixteen codes
        last = min(start + 16, stop)
        even = odd = even_known = odd_known = np.uint64(0)
        for row in range(start, last):
            base = math.floor(first + slope * row)
            if base >= end or base <= -PIXELS:
                continue
            read += PIXELS
            word, at = np.uint64((base >> 4) + 1), np.uint64(4 * (base & 15))
            bits = words[np.uint64(row), word] >> at
            bits |= (words[np.uint64(row), word + np.uint64(1)] << np.uint64(1)) << (np.uint64(63) - at)
            part = bits & low
            even += part
            even_known += ((part + most) >> seven) & one
            part = (bits >> four) & low
            odd += part
            odd_known += ((part + most) >> seven) & one
        for k in range(8):
            at, lane = np.uint64(8 * k), np.uint64(2 * k)
            known = np.int32((even_known >> at) & byte)
            counts[line, lane] += known
            sums[line, lane] += np.int32((even >> at) & byte) - np.int32(ZERO) * known
            lane += np.uint64(1)
            known = np.int32((odd_known >> at) & byte)
            counts[line, lane] += known
            sums[line, lane] += np.int32((odd >> at) & byte) - np.int32(ZERO) * known
        start = last
    return read


@nb.njit(cache=True)
def add_rows(
    words: NDArray[np.uint64],
    start: int,
    stop: int,
    first: float,
    slope: float,
    room: NDArray[np.uint64],
    sums: NDArray[np.int32],
    counts: NDArray[np.int32],
    at_row: int,
) -> int:
    """The same for lanes along columns start ... stop - 1, the first of them in row floor(first + slope col).

    A word holds sixteen pixels of one row. Columns whose lanes begin in the same row are cut out of it together.
    room (3, PIXELS) : work space.
    """
    low, one, most = np.uint64(0x0F0F0F0F0F0F0F0F), np.uint64(0x0101010101010101), np.uint64(0x7F7F7F7F7F7F7F7F)
    four, seven, at_line, rows = np.uint64(4), np.uint64(7), np.uint64(at_row), words.shape[0]
    cut, codes, known = room[0], room[1], room[2]
    read, col = 0, start
    base = math.floor(first + slope * col)
    while col < stop:
        codes[:] = known[:] = np.uint64(0)
        # bytes of a word hold the sums of eight words
        for word in range((col >> 4) + 1, min((col >> 4) + 8, ((stop - 1) >> 4) + 1) + 1):
            last = min(PIXELS * word, stop)
            cut[:] = np.uint64(0)
            while col < last:
                begin, row = col, base
                while col < last and base == row:
                    col += 1
                    base = math.floor(first + slope * col)
                if row >= rows or row <= -PIXELS:
                    continue
                read += PIXELS * (col - begin)
                mask = (~np.uint64(0) >> np.uint64(64 - 4 * (col - begin))) << np.uint64(4 * (begin & 15))
                for k in range(max(0, -row), min(PIXELS, rows - row)):
                    cut[np.uint64(k)] |= words[np.uint64(row + k), np.uint64(word)] & mask
            for k in range(np.uint64(PIXELS)):
                even, odd = cut[k] & low, (cut[k] >> four) & low
                codes[k] += even + odd
                known[k] += (((even + most) >> seven) & one) + (((odd + most) >> seven) & one)
        for k in range(np.uint64(PIXELS)):
            n = np.int32(_sum_of_bytes(known[k]))
            counts[at_line, k] += n
            sums[at_line, k] += np.int32(_sum_of_bytes(codes[k])) - np.int32(ZERO) * n
    return read


@nb.njit(cache=True)
def _sum_of_bytes(word: np.uint64) -> np.uint64:
    """Of the eight bytes of a word."""
    pairs = np.uint64(0x00FF00FF00FF00FF)
    word = (word & pairs) + ((word >> np.uint64(8)) & pairs)
    word += word >> np.uint64(32)
    return (word + (word >> np.uint64(16))) & np.uint64(0xFFFF)
