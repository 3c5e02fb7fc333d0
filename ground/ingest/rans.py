"""Decoder of `rans` blocks (ICD.md, section 4): four interleaved coders, classes of values by their neighbours.

For any bytes, the work is bounded by the number of values. A block is valid only if every coder ends in the state where
encoders begin and no word remains.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.special import erf

from sboc_e2e.icd import ans
from sboc_e2e.icd.errors import ContractError
from sboc_e2e.icd.layout import MAX_STRIP_PIXELS, CodecNumber

HEAD_BYTES = ans.HEAD.size + ans.STATES * ans.STATE_BYTES


def differences_of_tokens() -> NDArray[np.int64]:
    """(80, 2) lowest and highest difference from the level of each token, the escape left out."""
    spans = [(code // 2, code // 2) if code % 2 == 0 else (-(code // 2) - 1, -(code // 2) - 1) for code in range(ans.PLAIN)]
    for top in range(5, 17):
        for half in (0, 1):
            first = (1 << (top - 1)) + half * (1 << (top - 2))
            last = first + (1 << (top - 2)) - 1
            spans += [(first, last), (-last - 1, -first - 1)]
    return np.array(spans)


SPANS = differences_of_tokens()


@lru_cache(maxsize=64)
def sky_model(noise_code: int, centre_code: int) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.uint8]]:
    """Limits (10,); first slot of each token and the end (classes, 82); token of every 256th slot (classes, 256)."""
    sigma = 2.0 ** (noise_code / ans.CODES_PER_OCTAVE + math.log2(ans.LEAST_SIGMA))
    centre = sigma * centre_code / ans.CENTRE_CODES_PER_SIGMA
    limits = np.array([max(-32768, min(32767, math.ceil(5 * (limit * sigma + centre)))) for limit in ans.LIMITS_SIGMA])
    edges = (SPANS + np.array([-0.5, 0.5]) - centre) / sigma
    slots = np.zeros((len(ans.CLASSES), ans.TOKENS + 1), dtype=np.int64)
    for k, (mean, width, share, scale, anything) in enumerate(ans.CLASSES):
        gauss = 0.5 * np.diff(erf((edges - mean) / (math.sqrt(2.0) * width)), axis=1)[:, 0]
        light = -np.diff(np.exp(-np.maximum(edges, 0.0) / scale), axis=1)[:, 0]
        chance = (1 - anything) * ((1 - share) * gauss + share * light)
        chance = np.concatenate((chance, [0.0])) + anything / ans.TOKENS
        frequency = 1 + np.floor((ans.SCALE - ans.TOKENS) * chance).astype(np.int64)
        frequency[np.argmax(frequency)] += ans.SCALE - frequency.sum()
        slots[k, 1:] = np.cumsum(frequency)
    coarse = np.stack([np.searchsorted(row, np.arange(0, ans.SCALE, 256), side="right") - 1 for row in slots])
    return limits, slots, coarse.astype(np.uint8)


@njit(cache=True)
def _class_of(light: int, rises: bool, limits: NDArray[np.int64]) -> int:
    """Class of a value from its neighbours."""
    number = 0
    for k in range(limits.size):
        if light < limits[k]:
            break
        number += 1 if k < 3 else 2
    return number + 1 if rises and light >= limits[2] else number


@njit(cache=True)
def _refilled(state: np.int64, words: NDArray[np.uint16], taken: int) -> tuple[np.int64, int]:
    """A state that fell below the least one takes a word; beyond the last word it takes zeros, which are counted."""
    if state >= ans.LOWEST:
        return state, taken
    word = np.int64(words[taken]) if taken < words.size else np.int64(0)
    return (state << 16) | word, taken + 1


@njit(cache=True)
def decode_values(
    words: NDArray[np.uint16],
    states: NDArray[np.int64],
    limits: NDArray[np.int64],
    slots: NDArray[np.int64],
    coarse: NDArray[np.uint8],
    out: NDArray[np.int32],
) -> int:
    """Differences from the level into out, (n, width); returns how many words were taken."""
    rows, cols = out.shape
    near = np.zeros((rows + 2, cols + 3), dtype=np.int64)  # clipped; around the block lies sky
    taken = 0
    for row in range(rows):
        for col in range(cols):
            beside = near[row + 1, col + 2] + near[row + 2, col + 1]
            beyond = near[row, col + 2] + near[row + 2, col]
            kind = _class_of(2 * beside + near[row + 1, col + 3], beside > beyond, limits)
            coder = col % ans.STATES
            state = states[coder]
            slot = state & 0xFFFF
            token = np.int64(coarse[kind, slot >> 8])
            while slots[kind, token + 1] <= slot:
                token += 1
            frequency = slots[kind, token + 1] - slots[kind, token]
            state, taken = _refilled(frequency * (state >> 16) + slot - slots[kind, token], words, taken)
            code = np.int64(token)
            if token == ans.ESCAPE:
                high = state & 0xFFFF
                state, taken = _refilled(state >> 16, words, taken)
                code = (high << 16) | (state & 0xFFFF)
                state, taken = _refilled(state >> 16, words, taken)
            elif token >= ans.PLAIN:
                top = 5 + (token - ans.PLAIN) // 4
                n_bits = top - 2
                rest = state & ((1 << n_bits) - 1)
                state, taken = _refilled(state >> n_bits, words, taken)
                code = ((2 + (((token - ans.PLAIN) >> 1) & 1)) << (top - 1)) | (rest << 1) | (token & 1)
            states[coder] = state
            difference = (code >> 1) ^ -(code & 1)
            out[row, col] = np.int32(difference)
            near[row + 2, col + 2] = min(max(difference, -ans.NEIGHBOUR_LIMIT), ans.NEIGHBOUR_LIMIT)
    return taken


@dataclass(frozen=True, kw_only=True)
class RansDecoder:
    """`rans`: tokens by their probabilities among stars and sky."""

    @property
    def number(self) -> int:
        """Codec number."""
        return int(CodecNumber.RANS)

    def decode(self, block: bytes, shape: tuple[int, int], *, level_adu: int, sigma_adu: float) -> NDArray[np.int32]:
        """The integers that were encoded."""
        if not 0 < shape[0] * shape[1] <= MAX_STRIP_PIXELS:
            raise ContractError(f"block shape: expected 1 to {MAX_STRIP_PIXELS} pixels, got {shape[0]} x {shape[1]}")
        if len(block) < HEAD_BYTES or (len(block) - HEAD_BYTES) % 2:
            raise ContractError(f"rans block: expected {HEAD_BYTES} bytes and whole words, got {len(block)}")
        places = range(ans.HEAD.size, HEAD_BYTES, ans.STATE_BYTES)
        states = np.array([int.from_bytes(block[k : k + ans.STATE_BYTES], "big") for k in places])
        if states.min() < ans.LOWEST:
            raise ContractError(f"rans block: expected states of at least {ans.LOWEST}, got {states.min()}")
        words = np.frombuffer(block, dtype=">u2", offset=HEAD_BYTES).astype(np.uint16)
        differences = np.empty(shape, dtype=np.int32)
        taken = decode_values(words, states, *sky_model(*ans.HEAD.unpack_from(block)), differences)
        if taken != len(words):
            raise ContractError(f"rans block: expected {taken} words, got {len(words)}")
        if (states != ans.LOWEST).any():
            raise ContractError("rans block: the coders do not end where they began")
        return (differences.view(np.uint32) + np.uint32(level_adu & 0xFFFFFFFF)).view(np.int32)
