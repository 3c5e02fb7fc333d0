"""Searched images in half a byte a pixel: what a code says, halves, sums along lines, against sums of single pixels."""

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from onboard.downlink import roi
from onboard.downlink.kept_counts import kept_counts
from onboard.image.calibrate import Counts
from onboard.image.dark_map import DarkMap
from onboard.track import corridor
from onboard.track.packed import PIXELS, STEP, ZERO, halved, packed
from sboc_e2e.icd.signals import UNKNOWN, BackgroundModel
from tests.onboard.small_run import header

SHAPE = (70, 91)


def image(seed: int) -> NDArray[np.int8]:
    """Noise of 16 with unknown pixels and some far beyond the clip."""
    rng = np.random.default_rng(seed)
    values = np.clip(np.rint(rng.normal(0.0, 16.0, SHAPE)), -127, 127)
    values[rng.random(SHAPE) < 0.02] = 120
    values[rng.random(SHAPE) < 0.1] = UNKNOWN
    return values.astype(np.int8)


def codes(words: NDArray[np.uint64], cols: int) -> NDArray[np.int64]:
    """Pixels of a packed image; the words before and after its rows must be empty."""
    assert not words[:, [0, -1]].any()
    every = (words[:, 1:-1, None] >> (4 * np.arange(PIXELS, dtype=np.uint64))) & np.uint64(15)
    whole = every.reshape(len(words), -1).astype(np.int64)
    assert not whole[:, cols:].any()
    return whole[:, :cols]


def test_codes_are_steps_of_nine_sixteenths_of_a_sigma_up_to_four_sigma() -> None:
    values = image(1)
    expected = np.clip(np.rint(values / STEP), -7, 7) + ZERO
    expected[values == UNKNOWN] = 0
    assert (codes(packed(values), SHAPE[1]) == expected).all()


def test_halves_are_means_of_four_and_unknown_where_most_are() -> None:
    values = image(2)
    half, flat = halved(packed(values))
    four = codes(packed(values), SHAPE[1])[:, :90].reshape(35, 2, 45, 2)
    known = (four > 0).sum(axis=(1, 3))
    mean = np.clip(np.rint((four.sum(axis=(1, 3)) - ZERO * known) / 4), -7, 7) + ZERO
    mean[known < 2] = 0
    found = codes(half, half.shape[1] * PIXELS - 2 * PIXELS)
    assert (found[:, :45] == mean).all()
    assert (codes(flat, 35)[:45] == mean.T).all()


@pytest.mark.parametrize("steep", [False, True])
@pytest.mark.parametrize("slope", [-0.9, 0.03, 0.6])
def test_corridors_are_sums_of_the_pixels_within_and_outside_the_frame(steep: bool, slope: float) -> None:
    """Sixteen lanes along a line that enters and leaves through the sides."""
    words = packed(image(3))
    plane = codes(words, SHAPE[1])
    plane = plane if steep else plane.T
    direction = 1.0 / math.hypot(1.0, slope)
    place = np.array([3.2, 40.6, direction, slope * direction])
    sums, counts = (np.zeros((corridor.MOST_PIECES + 1, corridor.LANES), np.int32) for _ in range(2))
    corridor.gather(words, steep, place, -20.0, 7.0, 16, sums, counts)
    expected, known = np.zeros((17, corridor.LANES), int), np.zeros((17, corridor.LANES), int)
    for p in range(16):
        first, last = (math.ceil(3.2 + direction * (-20.0 + 7.0 * (p + k))) for k in (0, 1))
        for major in range(max(first, 0), min(last, plane.shape[0])):
            for k in range(corridor.LANES):
                minor = math.floor(40.6 + slope * (major - 3.2) + 0.5) - corridor.MIDDLE + k
                if 0 <= minor < plane.shape[1] and plane[major, minor] > 0:
                    expected[p + 1 :, k] += plane[major, minor] - ZERO
                    known[p + 1 :, k] += 1
    assert known[16].max() > 30
    assert (sums[:17] == expected).all()
    assert (counts[:17] == known).all()


@pytest.mark.parametrize("sigma_adu", [0.5, 2.6, 20.0, 300.0])
def test_kept_counts_hold_any_noise_without_loss(sigma_adu: float) -> None:
    """Few, some and nearly all pixels beyond four bits and beyond a byte."""
    rng = np.random.default_rng(4)
    shape = (66, 83)
    pixels = np.clip(np.rint(rng.normal(1000.0, sigma_adu, shape)), 0, 65535).astype(np.uint16)
    counts = Counts(
        pixels=pixels, dark=DarkMap.of(np.full(shape, 100.0, np.float32)), defects=np.zeros(shape, np.uint8), adu_scale=1.0,
        adu_offset=0.0, saturation=65535,
    )  # fmt: skip
    sky = BackgroundModel(
        tile_px=64, level_adu=np.full((2, 2), 900.0, np.float32), sigma_adu=np.full((2, 2), sigma_adu, np.float32)
    )
    kept = kept_counts(replace(header(0), rows=shape[0], cols=shape[1]), sky, counts, ())
    strip = roi.StripGeometry(axis=0, major0=-2, n=70, width=83, minor0_fp=0, slope_fp=6553)
    expected = roi.cut_strip(strip, counts.pixels, counts.dark, 7)
    assert (kept.cut(strip, 7).values_adu == expected.values_adu).all()
