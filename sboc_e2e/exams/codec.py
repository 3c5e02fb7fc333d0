"""What an encoder writes is read again by its decoder: what comes back, in how many bits, how fast."""

import time
from collections.abc import Iterator
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.exams.verdict import Verdict, asked, expect
from sboc_e2e.icd.steps import Decoder, Encoder

LEVEL_ADU: Final = 100  # Sky level of the blocks: any positive number; codecs subtract it. That of the exam's pedestal.
NOISE_ADU: Final = 2.4
"""Noise of a sky pixel: 2.9 e- at 1.2 e-/ADU, the root of the squares of 2.3 e- read noise and 1.7 e- of sky. Chosen; a codec
sees only integers."""
MOST_LOST: Final = 1.0
"""Largest rms error of a lossy codec on noise, in sigmas of the noise. A larger error would cost more S/N than the noise."""
SPEED_SHAPE: Final = (256, 256)  # A block of 65,536 pixels, the most that a packet's block may hold (`MAX_STRIP_PIXELS`).
SPEED_BLOCKS: Final = 16
"""Together a million pixels."""
SLOW_S_PER_MPX: Final = 10.0
"""CPU seconds beyond which a step is too slow for any use. Chosen: the default chain on board takes 0.015 (0.25 for 4096 x 4096
px, docs/limits.md)."""


def round_trip(encoder: Encoder, decoder: Decoder) -> Iterator[Verdict]:
    """Blocks through both."""
    rng = np.random.default_rng(3)
    streak = rng.normal(LEVEL_ADU, NOISE_ADU, (60, 17))
    streak[:, 8] += 400.0
    noise = rng.normal(LEVEL_ADU, NOISE_ADU, (40, 13)).astype(np.int32)
    kind = "the same integers" if encoder.lossless else f"noise within {MOST_LOST:g} sigma"
    for name, values in (
        ("noise", noise),
        ("a streak", streak.astype(np.int32)),
        ("one pixel", np.array([[LEVEL_ADU]], np.int32)),
    ):
        yield asked(f"{name} comes back as {kind}", partial(_comes_back, encoder, decoder, values, name))
    extremes = np.array([[-65535, 65535], [0, 65535]], np.int32)
    yield asked("extremes come back", lambda: _shape_comes_back(encoder, decoder, extremes))
    yield asked(f"takes less than {SLOW_S_PER_MPX:g} s each way for a million pixels", lambda: _fast(encoder, decoder))


def _through(encoder: Encoder, decoder: Decoder, values: NDArray[np.int32]) -> tuple[NDArray[np.float64], int]:
    """What comes back, and the bytes in between."""
    rows, cols = values.shape
    block = encoder.encode(values, level_adu=LEVEL_ADU, sigma_adu=NOISE_ADU)
    back = decoder.decode(block, (rows, cols), level_adu=LEVEL_ADU, sigma_adu=NOISE_ADU)
    expect(np.shape(back) == values.shape, f"shape {np.shape(back)}, expected {values.shape}")
    return np.asarray(back, dtype=np.float64), len(block)


def _shape_comes_back(encoder: Encoder, decoder: Decoder, values: NDArray[np.int32]) -> None:
    back, _ = _through(encoder, decoder, values)
    if encoder.lossless:
        expect(bool((back == values).all()), "other values came back, and the codec says that it is lossless")


def _comes_back(encoder: Encoder, decoder: Decoder, values: NDArray[np.int32], name: str) -> str:
    back, n_bytes = _through(encoder, decoder, values)
    lost = back - values
    if encoder.lossless:
        expect(not lost.any(), f"{int((lost != 0).sum())} of {lost.size} values changed, and the codec says that it is lossless")
    sky = values < LEVEL_ADU + 5 * NOISE_ADU
    rms = float(np.sqrt(np.mean(lost[sky] ** 2))) / NOISE_ADU
    expect(rms <= MOST_LOST, f"lost {rms:.2f} sigma rms of {name}")
    return f"{8 * n_bytes / values.size:.2f} bits per pixel" + ("" if encoder.lossless else f", lost {rms:.2f} sigma rms")


def _fast(encoder: Encoder, decoder: Decoder) -> str:
    values = np.random.default_rng(5).normal(LEVEL_ADU, NOISE_ADU, SPEED_SHAPE).astype(np.int32)
    _through(encoder, decoder, values)
    start = time.process_time()
    blocks = [encoder.encode(values, level_adu=LEVEL_ADU, sigma_adu=NOISE_ADU) for _ in range(SPEED_BLOCKS)]
    middle = time.process_time()
    for block in blocks:
        decoder.decode(block, SPEED_SHAPE, level_adu=LEVEL_ADU, sigma_adu=NOISE_ADU)
    there_s, back_s = middle - start, time.process_time() - middle
    expect(max(there_s, back_s) < SLOW_S_PER_MPX, f"took {there_s:.1f} s to encode and {back_s:.1f} s to decode")
    return f"{there_s:.2f} s to encode, {back_s:.2f} s to decode"
