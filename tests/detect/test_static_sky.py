"""What the earlier frame shows counts once, and a pixel of it no more than the clip of the image that trails are found on."""

import math

import numpy as np
import pytest
from scipy.stats import poisson

from onboard.detect.line_integral import static_sky
from onboard.image import registration
from sboc_e2e.icd.flags import StarFlag
from sboc_e2e.icd.signals import StarList

SIZE = 64
CLIP = 120


@pytest.mark.parametrize(("level", "expected"), [(CLIP - 20, 1), (CLIP, 12)])
def test_of_equal_neighbours_one_is_a_star_unless_they_are_clipped(level: int, expected: int) -> None:
    frame = np.zeros((SIZE, SIZE), np.int8)
    frame[30:33, 20:24] = level
    places = np.empty((100, 4))
    found = static_sky.faint_static_stars(frame, frame, 0, 0, 0, SIZE, registration.IDENTITY, 32, 86, CLIP, SIZE, places, 0)
    assert found == expected
    assert (places[:found, 2:] == level / 16.0).all()


def test_one_pixel_of_the_earlier_frame_is_not_a_trail() -> None:
    """The end of a bled column differs from frame to frame: 5,000 sigma then, nothing now."""
    codes, first = np.zeros((SIZE, SIZE), np.int8), np.zeros(SIZE + 1, np.int64)
    codes[32, 32] = 127
    first[33:] = 1
    pixels = (codes, first, np.array([32], np.int32), np.array([5000.0], np.float32))
    before = static_sky.segment_snr_before(
        pixels,
        registration.IDENTITY,
        registration.IDENTITY,
        (np.zeros((SIZE, SIZE), np.uint8), 0),
        (np.zeros((1, 1), np.float32), SIZE),
        np.array([32.0, 7.0, 32.0, 57.0]),
        0.85,
    )
    assert 0.5 < before < 1.0


def test_stars_of_the_earlier_frame_where_they_stood_on_the_sensor_refuse_nothing() -> None:
    """Its pointing was 20 px away: a bright star stood on the trail's pixels then, and is masked in its place now."""
    codes = np.zeros((SIZE, SIZE), np.int8)
    codes[31:34, 31:34] = 120
    pixels = (codes, np.zeros(SIZE + 1, np.int64), np.zeros(0, np.int32), np.zeros(0, np.float32))
    blocked = np.zeros((SIZE, SIZE), np.uint8)
    blocked[10:15, 30:35] = 2
    back = registration.inverse(np.array([[1.0, 0.0, 20.0], [0.0, 1.0, 0.0]]))
    level, ends = np.zeros((1, 1), np.float32), np.array([32.0, 7.0, 32.0, 57.0])
    here = registration.IDENTITY
    for sky, low, high in ((back, -0.01, 0.01), (here, 3.0, 8.0)):
        before = static_sky.segment_snr_before(pixels, here, sky, (blocked, 0), (level, SIZE), ends, 0.85)
        assert low <= before <= high


def test_trails_of_one_motion_do_not_outvote_the_stars() -> None:
    """Twelve stars stand still; six trails, listed as rows of five blends, moved by 36 px."""
    rng = np.random.default_rng(4)
    stars = rng.uniform(10.0, 246.0, (12, 2))
    lanes = np.column_stack([np.repeat(20.0 + 40.0 * np.arange(6), 5), 30.0 + np.tile(7.0 * np.arange(5), 6)])
    lists = []
    for moved in (0.0, 36.0):
        row, col = np.concatenate([lanes + np.array((0.0, moved)), stars]).T
        blend = np.where(np.arange(len(row)) < len(lanes), int(StarFlag.BLENDED), 0).astype(np.uint8)
        light = np.linspace(100.0, 10.0, len(row), dtype=np.float32)
        lists.append(StarList(row=row, col=col, flux_e=light, snr=light, flags=blend))
    transform = registration.register(*lists, reach_px=64.0)
    assert transform is not None
    assert np.abs(transform - registration.IDENTITY).max() < 1e-6


@pytest.mark.parametrize(("n", "side"), [(30, 512.0), (600, 512.0), (3000, 4096.0)])
def test_fields_that_have_nothing_to_do_with_each_other_are_not_matched(n: int, side: float) -> None:
    """600 stars in 512 x 512 px have shifts at which 20 of them meet others within a pixel."""
    rng = np.random.default_rng(n)
    light = np.linspace(100.0, 10.0, n, dtype=np.float32)

    def field_of(places: np.ndarray) -> StarList:
        return StarList(row=places[:, 0], col=places[:, 1], flux_e=light, snr=light, flags=np.zeros(n, np.uint8))

    for _ in range(8):
        places = rng.uniform(0.0, side, (n, 2))
        assert registration.register(field_of(places), field_of(rng.uniform(0.0, side, (n, 2))), reach_px=300.0) is None
        there = registration.register(field_of(places), field_of(places + np.array((40.0, -25.0))), reach_px=300.0)
        assert there is not None
        assert np.abs(there[:, 2] - np.array((40.0, -25.0))).max() < 0.01


@pytest.mark.parametrize(("found", "expected"), [(5, 0.3), (12, 0.3), (60, 17.0)])
def test_the_chance_of_so_many_matches_is_an_upper_bound(found: int, expected: float) -> None:
    ln_tail = math.log(poisson.sf(found - 1, expected))
    assert ln_tail <= registration.ln_chance(found, expected) < ln_tail + math.log(found) + 1.0
    assert registration.ln_chance(2, 3.0) == 0.0
