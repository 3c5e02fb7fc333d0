"""Rows of equal trails one behind the other: found one by one, and no tumbler taken apart."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from onboard.detect.line_integral.trains import pieces
from sboc_e2e.icd.flags import StreakFlag
from tests.benchmarks import sky_frames
from tests.benchmarks.bench_detection import score
from tests.benchmarks.detection_frames import Streak
from tests.benchmarks.other_skies import second_of

SIDE = 1024


def train(n: int, seed: int) -> tuple[NDArray[np.uint16], NDArray[np.uint16], list[Streak]]:
    """A pair of frames, and n trails of 9.8 px and S/N 35 to 75 in a row in the later one."""
    rng = np.random.default_rng(seed)
    drawn = sky_frames.scene(sky_frames.ROWS[0], SIDE, [], seed)
    angle = rng.uniform(0.0, math.pi)
    along = np.array([math.sin(angle), math.cos(angle)])
    middle, apart = 0.5 * SIDE + rng.uniform(-60.0, 60.0, 2), min(40.0, 900.0 / n)
    light, streaks = np.zeros((SIDE, SIDE)), []
    for k in range(n):
        (r0, c0), (r1, c1) = (middle + along * (apart * (k - 0.5 * (n - 1)) + end) for end in (-4.9, 4.9))
        snr = rng.uniform(35.0, 75.0)
        streaks.append(Streak(row0=r0, col0=c0, row1=r1, col1=c1, snr=snr))
        window, shape = sky_frames.streak_light(streaks[-1], light.shape, sky_frames.width_px(sky_frames.FWHM_PX))
        light[window] += snr * sky_frames.SIGMA_E / math.sqrt(float(np.sum(shape**2))) * shape
    return drawn.earlier, sky_frames.digitised(drawn.later + rng.poisson(light)), streaks


@pytest.mark.parametrize("n", [12, 26])
def test_every_trail_of_a_row_is_found(n: int) -> None:
    """None of 8 to 26 was: together they came out as one line of 300 to 900 px."""
    earlier, later, streaks = train(n, 1)
    result, _ = second_of(earlier, later)
    paired, _, false = score(result.detections, streaks)
    assert sum(d is not None for d in paired) >= n - 1
    assert false == 0
    inner = [
        d for d in result.detections if min(d.row0, d.col0, d.row1, d.col1) > 30.0 < SIDE - max(d.row0, d.col0, d.row1, d.col1)
    ]
    assert len(inner) >= n - 4
    assert not any(d.flags & (StreakFlag.EDGE0 | StreakFlag.EDGE1) for d in inner), "each has the flags of its own ends"


def lines(light: NDArray[np.float64], seed: int) -> list[tuple[int, int]]:
    weight = np.full(len(light), 0.33)
    return pieces(weight * light + np.sqrt(weight) * np.random.default_rng(seed).standard_normal(len(light)), weight)


def test_light_that_rises_and_falls_is_one_trail() -> None:
    """A tumbler that dims to a fifth of its light, ten times along the trail; a trail with one hole; an even one."""
    k = np.arange(300.0)
    assert lines(20.0 * (0.6 + 0.4 * np.sin(2.0 * np.pi * k / 30.0)), 1) == []
    assert lines(np.where(np.abs(k - 150.0) < 20.0, 0.0, 20.0), 2) == []
    assert lines(np.full(300, 20.0), 3) == []


def test_equal_pieces_with_nothing_between_are_taken_apart() -> None:
    k = np.arange(300)
    found = lines(np.where(k % 40 < 10, 20.0, 0.0), 4)
    assert len(found) == 8
