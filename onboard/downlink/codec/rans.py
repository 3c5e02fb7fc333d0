"""Lossless near the entropy: asymmetric numeral systems with a fixed model of sky and stars.

Each value becomes one of 81 tokens. The probability of a token follows from two numbers of the block (level and noise of its sky)
and from the five neighbours that the decoder already has: next to a star's light, light is likely. A Huffman code spends
whole bits on each token, this one spends ``-log2 p`` (range variant, rANS: Duda 2013, arXiv 1311.2540). Four interleaved
coders keep the processor busy, and a product with the reciprocal replaces the division (Giesen 2014, arXiv 1402.3392).
Classes by neighbours as in Rissanen & Langdon 1981 (IEEE Trans. Inf. Theory 27, 12). No table is sent: a packet's block
is too short to pay for one. The coder works backwards, so that the decoder goes forwards.
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sboc_e2e.icd import ans
from sboc_e2e.icd.layout import CodecNumber

LARGE = 0x8000
"""Bit of a symbol whose token the slow path works out."""

CLIP = ans.NEIGHBOUR_LIMIT

MOST_WORDS = 3
"""16-bit words that a value takes at most."""

SAMPLES = 4096
"""Values of a block that its sky is measured on."""

CLIPPED_STD = 0.9866
"""Standard deviation of a unit Gaussian cut at +-3."""

SYMBOL = np.dtype([("reciprocal", np.float64), ("frequency", np.uint32), ("start", np.uint32)])


@njit(cache=True)
def sky_of(values: NDArray[np.int32], level: int, start_sigma: float) -> tuple[float, float]:
    """Centre above the level and noise of the block's sky: clipped moments of some of its values, iterated."""
    step = max(1, values.size // SAMPLES) | 1
    sample = np.empty((values.size + step - 1) // step, dtype=np.int32)
    bound = 1 << 24
    for k in range(sample.size):
        sample[k] = min(max(np.int32(values[k * step] - level), np.int32(-bound)), np.int32(bound))
    centre, sigma = 0.0, start_sigma
    for turn in range(5):
        reach = max(3.0 * sigma, 1.5)  # the neighbours of a nearly constant sky are part of it
        low, high = np.int32(max(centre - reach, -bound)), np.int32(min(centre + reach, bound))
        number, total, squares = np.int64(0), np.int64(0), np.int64(0)
        for k in range(sample.size):
            inside = low <= sample[k] <= high
            value = np.int64(sample[k]) if inside else np.int64(0)
            number += np.int64(inside)
            total += value
            squares += value * value
        if turn == 0 and 2 * number < sample.size:  # The given level and noise were of another sky.
            ordered = np.sort(sample)
            centre = float(ordered[sample.size // 2])
            sigma = (float(ordered[3 * sample.size // 4]) - float(ordered[sample.size // 4])) / 1.35
            continue
        if number == 0:
            break
        mean = total / number
        new_sigma = math.sqrt(max(squares / number - mean * mean, 0.0)) / CLIPPED_STD
        settled = abs(mean - centre) <= 0.01 * sigma and abs(new_sigma - sigma) <= 0.005 * sigma
        centre, sigma = mean, new_sigma
        if settled:
            break
    return centre, max(sigma, ans.LEAST_SIGMA)


@njit(cache=True)
def _clipped(values: NDArray[np.int32], level: int, out: NDArray[np.int16]) -> None:
    """Values above the level as neighbours count them."""
    for col in range(values.size):
        out[col] = np.int16(
            min(max(np.int32(values[col] - level), np.int32(-ans.NEIGHBOUR_LIMIT)), np.int32(ans.NEIGHBOUR_LIMIT))
        )


@njit(cache=True)
def _tokens(values: NDArray[np.int32], level: int, out: NDArray[np.uint16]) -> None:
    """Zigzag codes, `PLAIN` for larger ones."""
    for col in range(values.size):
        difference = np.int32(values[col] - level)
        code = np.uint32((difference << 1) ^ (difference >> 31))
        out[col] = np.uint16(min(code, np.uint32(ans.PLAIN)))


@njit(cache=True)
def _with_class(
    left: NDArray[np.int16],
    far_left: NDArray[np.int16],
    above: NDArray[np.int16],
    above_right: NDArray[np.int16],
    far_above: NDArray[np.int16],
    limits: NDArray[np.int16],
    out: NDArray[np.uint16],
) -> None:
    """Tokens of a row to symbols, ``class * TOKENS + token``; 16-bit numbers only, so that vectors hold many."""
    t0, t1, t2, t3, t4 = limits[0], limits[1], limits[2], limits[3], limits[4]
    t5, t6, t7, t8, t9 = limits[5], limits[6], limits[7], limits[8], limits[9]
    for col in range(out.size):
        near = np.int16(above[col] + left[col])
        light = np.int16(np.int16(near + near) + above_right[col])
        pairs = np.uint16(np.uint16(light >= t3) + np.uint16(light >= t4))
        pairs = np.uint16(pairs + np.uint16(np.uint16(light >= t5) + np.uint16(light >= t6)))
        pairs = np.uint16(pairs + np.uint16(np.uint16(light >= t7) + np.uint16(light >= t8)))
        pairs = np.uint16(pairs + np.uint16(light >= t9))
        beside = np.uint16(light >= t2)
        rises = np.uint16(beside * np.uint16(near > np.int16(far_above[col] + far_left[col])))
        quiet = np.uint16(np.uint16(np.uint16(light >= t0) + np.uint16(light >= t1)) + np.uint16(beside + rises))
        number = np.uint16(np.uint16(pairs + pairs) + quiet)
        token = out[col]
        large = np.uint16(np.uint16(token >> np.uint16(5)) << np.uint16(15))
        out[col] = np.uint16(np.uint16(number * np.uint16(ans.TOKENS)) + token) | large


@njit(cache=True)
def _put(state: np.int64, symbol: Any, words: NDArray[np.uint16], place: np.int64) -> tuple[np.int64, np.int64]:
    """One symbol into a coder; a word leaves the state first where it would outgrow 40 bits."""
    frequency = np.int64(symbol.frequency)
    full = np.int64(state >= (frequency << 24))
    words[place - 1] = np.uint16(state)
    place -= full
    state >>= full << 4
    # the quotient is below 2^24 and the product good to 2^-28; half a unit more keeps it 2^-17 from the next integer: exact
    quotient = np.int64((np.float64(state) + 0.5) * symbol.reciprocal)
    return state + np.int64(symbol.start) + quotient * (ans.SCALE - frequency), place


@njit(cache=True)
def _put_bits(
    state: np.int64, bits: np.int64, n_bits: np.int64, words: NDArray[np.uint16], place: np.int64
) -> tuple[np.int64, np.int64]:
    """Up to 16 bits as they are, into a coder."""
    full = np.int64(state >= (np.int64(1) << (40 - n_bits)))
    words[place - 1] = np.uint16(state)
    place -= full
    state >>= full << 4
    return (state << n_bits) | bits, place


@njit(cache=True)
def _put_any(
    state: np.int64, symbol: np.int64, difference: np.int32, table: NDArray[Any], words: NDArray[np.uint16], place: np.int64
) -> tuple[np.int64, np.int64]:
    """A symbol that may be large: the bits that its token does not hold, then the token."""
    if symbol < LARGE:
        return _put(state, table[symbol], words, place)
    code = np.int64(np.uint32((difference << 1) ^ (difference >> 31)))
    if code >> 17:
        token = np.int64(ans.ESCAPE)
        state, place = _put_bits(state, code & 0xFFFF, np.int64(16), words, place)
        state, place = _put_bits(state, code >> 16, np.int64(16), words, place)
    else:
        top = np.int64(5)  # place of the highest bit; token: that, the bit below it, and the sign
        while code >> (top + 1):
            top += 1
        token = ans.PLAIN + 4 * (top - 5) + 2 * ((code >> (top - 1)) & 1) + (code & 1)
        rest = (code >> 1) & ((np.int64(1) << (top - 2)) - 1)
        state, place = _put_bits(state, rest, top - 2, words, place)
    return _put(state, table[symbol - LARGE - ans.PLAIN + token], words, place)


@njit(cache=True)
def _put_row(
    values: NDArray[np.int32],
    level: int,
    symbols: NDArray[np.uint16],
    table: NDArray[Any],
    states: NDArray[np.int64],
    words: NDArray[np.uint16],
    place: np.int64,
) -> np.int64:
    """A row from its last value to its first; column c goes into coder c modulo 4. Returns the place of the last word."""
    whole = values.size >> 2 << 2
    for col in range(values.size - 1, whole - 1, -1):
        difference = np.int32(values[col] - level)
        states[col & 3], place = _put_any(states[col & 3], np.int64(symbols[col]), difference, table, words, place)
    a, b, c, d = states[0], states[1], states[2], states[3]
    for group in range((values.size >> 2) - 1, -1, -1):
        k = 4 * group
        sa, sb, sc, sd = np.int64(symbols[k]), np.int64(symbols[k + 1]), np.int64(symbols[k + 2]), np.int64(symbols[k + 3])
        if (sa | sb | sc | sd) < LARGE:
            d, place = _put(d, table[sd], words, place)
            c, place = _put(c, table[sc], words, place)
            b, place = _put(b, table[sb], words, place)
            a, place = _put(a, table[sa], words, place)
        else:
            d, place = _put_any(d, sd, np.int32(values[k + 3] - level), table, words, place)
            c, place = _put_any(c, sc, np.int32(values[k + 2] - level), table, words, place)
            b, place = _put_any(b, sb, np.int32(values[k + 1] - level), table, words, place)
            a, place = _put_any(a, sa, np.int32(values[k] - level), table, words, place)
    states[0], states[1], states[2], states[3] = a, b, c, d
    return place


@njit(cache=True)
def put_block(
    values: NDArray[np.int32],
    level: int,
    limits: NDArray[np.int16],
    table: NDArray[Any],
    states: NDArray[np.int64],
    words: NDArray[np.uint16],
) -> np.int64:
    """A (n, width) block from its last row to its first into words, from their end; returns the place of the first word."""
    rows, cols = values.shape
    ring = np.zeros((3, cols + 3), dtype=np.int16)  # two columns before the row and one after it are sky
    symbols = np.empty(cols, dtype=np.uint16)
    for row in range(max(rows - 3, 0), rows):
        _clipped(values[row], level, ring[row % 3, 2 : 2 + cols])
    place = np.int64(words.size)
    for row in range(rows - 1, -1, -1):
        here, above, far = ring[row % 3], ring[(row + 2) % 3], ring[(row + 1) % 3]
        if row < 2:
            far[:] = np.int16(0)
        if row < 1:
            above[:] = np.int16(0)
        _tokens(values[row], level, symbols)
        _with_class(here[1:], here, above[2:], above[3:], far[2:], limits, symbols)
        place = _put_row(values[row], level, symbols, table, states, words, place)
        if row >= 3:
            _clipped(values[row - 3], level, here[2 : 2 + cols])
    return place


def _first_and_last() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Lowest and highest difference from the level of each token except `ESCAPE`."""
    codes = np.arange(ans.PLAIN)
    plain = (codes >> 1) ^ -(codes & 1)
    large = np.arange(ans.ESCAPE - ans.PLAIN)
    first = ((2 + ((large >> 1) & 1)) << (large // 4 + 4)) >> 1
    last = first + (1 << (large // 4 + 3)) - 1
    negative = (large & 1) == 1
    low, high = np.where(negative, -last - 1, first), np.where(negative, -first - 1, last)
    return np.append(plain, low).astype(np.float64), np.append(plain, high).astype(np.float64)


FIRST, LAST = _first_and_last()


@lru_cache(maxsize=128)
def model(noise_code: int, centre_code: int) -> tuple[NDArray[np.int16], NDArray[Any]]:
    """Limits of the classes and table of symbols for a sky; ICD.md, section 4, says how they follow."""
    from scipy.special import ndtr  # takes 20 MB of memory that other codecs do not need

    sigma = 2.0 ** (noise_code / ans.CODES_PER_OCTAVE + math.log2(ans.LEAST_SIGMA))
    centre = centre_code * sigma / ans.CENTRE_CODES_PER_SIGMA
    limits = np.ceil(5.0 * (np.array(ans.LIMITS_SIGMA) * sigma + centre))
    low, high = (FIRST - 0.5 - centre) / sigma, (LAST + 0.5 - centre) / sigma
    mean, width, share, scale, anything = np.array(ans.CLASSES).T[:, :, None]
    noise = ndtr((high - mean) / width) - ndtr((low - mean) / width)
    light = np.exp(np.minimum(-low, 0.0) / scale) - np.exp(np.minimum(-high, 0.0) / scale)
    chance = np.pad((1.0 - anything) * ((1.0 - share) * noise + share * light), ((0, 0), (0, 1))) + anything / ans.TOKENS
    frequency = 1 + np.floor((ans.SCALE - ans.TOKENS) * chance).astype(np.int64)
    frequency[np.arange(len(frequency)), frequency.argmax(axis=1)] += ans.SCALE - frequency.sum(axis=1)
    table = np.empty(frequency.shape, dtype=SYMBOL)
    table["frequency"], table["start"], table["reciprocal"] = frequency, frequency.cumsum(axis=1) - frequency, 1.0 / frequency
    return np.clip(limits, -32768, 32767).astype(np.int16), table.ravel()


@dataclass(frozen=True, kw_only=True)
class RansCodec:
    """`rans`: lossless, within 3 % of the entropy of noise and stars; a few per cent shorter than `planes`."""

    @property
    def number(self) -> int:
        """Codec number in the packet."""
        return int(CodecNumber.RANS)

    @property
    def lossless(self) -> bool:
        """Decoding gives the same integers."""
        return True

    def encode(self, values_adu: NDArray[np.int32], *, level_adu: int, sigma_adu: float) -> bytes:
        """Noise and centre of the sky as codes, the states of four coders, then their words."""
        values = np.ascontiguousarray(values_adu, dtype=np.int32)
        level = int(level_adu)
        centre, sigma = sky_of(values.ravel(), level, sigma_adu if math.isfinite(sigma_adu) else 1.0)
        noise_code = min(max(round(ans.CODES_PER_OCTAVE * (math.log2(sigma) - math.log2(ans.LEAST_SIGMA))), 0), 255)
        noise = 2.0 ** (noise_code / ans.CODES_PER_OCTAVE + math.log2(ans.LEAST_SIGMA))
        centre_code = min(max(round(ans.CENTRE_CODES_PER_SIGMA * centre / noise), -32768), 32767)
        limits, table = model(noise_code, centre_code)
        states = np.full(ans.STATES, ans.LOWEST, dtype=np.int64)
        words = np.empty(MOST_WORDS * values.size + 1, dtype=np.uint16)
        place = put_block(values, level, limits, table, states, words)
        head = ans.HEAD.pack(noise_code, centre_code)
        return head + b"".join(int(x).to_bytes(ans.STATE_BYTES) for x in states) + words[place:].astype(">u2").tobytes()
