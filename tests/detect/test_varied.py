"""Facts about trails whose light varies, drawn by `tests.benchmarks.tumblers`, not by the simulator."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from onboard.detect.line_integral import varied
from onboard.detect.line_integral.varied import trail_followed
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.signals import Detection
from tests.benchmarks.tumblers import measure, whole

SIDE = 512
TRAIL = Detection(row0=256.0, col0=200.0, row1=256.0, col1=300.0, snr=200.0)


def images(light: NDArray[np.float64], seed: int) -> Any:
    """Working images of light (rows, cols) in sigmas, over white noise, clipped as the detector's are."""
    sigmas = light + np.random.default_rng(seed).normal(size=light.shape)
    image = np.clip(np.rint(16.0 * sigmas), -127, 127).astype(np.int8)
    return SimpleNamespace(image=image, blocked=np.zeros(light.shape, np.uint8), level=np.zeros((SIDE, SIDE), np.float32))


def trail(first: float, last: float, height: float) -> NDArray[np.float64]:
    """Light on row 256 from one column to another."""
    row, col = np.mgrid[:SIDE, :SIDE]
    return np.asarray(height * np.exp(-0.5 * ((row - 256.0) / 1.2) ** 2) * ((col >= first) & (col <= last)))


def test_stars_beyond_an_end_do_not_lengthen_a_trail_where_lines_beside_it_meet_as_many() -> None:
    """1,500 stars that are on no list, six skies. Without a look beside it the trail of 100 px takes in others' light."""
    longer: dict[bool, int] = {True: 0, False: 0}
    row, col = np.mgrid[-4:5, -4:5]
    star = 8.0 * np.exp(-0.5 * (row**2 + col**2) / 1.2**2)
    for seed in range(6):
        light = trail(200, 300, 8.0)
        for r, c in np.random.default_rng(100 + seed).integers(4, SIDE - 5, (1500, 2)):
            light[r - 4 : r + 5, c - 4 : c + 5] += star
        sky = images(light, seed)
        for held in longer:
            longer[held] += trail_followed(TRAIL, sky, 1.2, held).length_px > 110.0
    assert longer[False] >= 5
    assert longer[True] <= 2


def test_where_lines_beside_a_trail_show_light_only_bright_light_lengthens_it() -> None:
    """Of 137 lines on trails of pictures 40 were followed to where other stars, clouds or trails had a tenth of their light.

    Bands of cloud lie across the trail; a twentieth or a half of its light goes on along it for 60 px.
    """
    row, col = np.mgrid[:SIDE, :SIDE]
    bands = 0.4 * ((col > 305) & (col < 355) & (np.abs(row - 256.0) > 3.0))
    for share, length_px in ((0.05, 100.0), (0.5, 160.0)):
        sky = images(trail(200, 300, 16.0) + trail(301, 360, share * 16.0) + bands, 4)
        assert abs(trail_followed(TRAIL, sky, 1.2, True).length_px - length_px) < 15.0
    # without bands as with them, if the sky is not looked at
    dim = images(trail(200, 300, 16.0) + trail(301, 360, 0.8), 4)
    assert trail_followed(TRAIL, dim, 1.2, False).length_px > 140.0


def test_a_dim_part_of_a_trail_is_followed_where_lines_beside_it_show_nothing() -> None:
    """A tenth of its light on 60 px: S/N 8."""
    for seed in range(3):
        sky = images(trail(200, 300, 8.0) + trail(301, 360, 0.8), seed)
        assert abs(trail_followed(TRAIL, sky, 1.2, True).length_px - 160.0) < 15.0


def test_a_trail_that_is_followed_to_the_border_ends_on_it() -> None:
    """Its end had no flag of the border, since the flags were those of the detection before it was followed."""
    found = trail_followed(TRAIL, images(trail(200, SIDE, 16.0), 2), 1.2, False)
    assert found.col1 > SIDE - 4.0
    assert found.flags & StreakFlag.EDGE1
    assert not found.flags & StreakFlag.EDGE0


def test_tumblers_come_out_as_one_trail_and_whole() -> None:
    """Cosines and flashes that fall to a few per cent, S/N 20 to 90. Before, 73 of 108 came out in pieces or in part."""
    measured = measure(2, 2)
    lit = [found for trail, found in measured if trail.attainable() >= 0.9]
    assert sum(len(found) == 1 for _, found in measured) >= 17
    assert len(lit) >= 8
    assert sum(whole(found) for found in lit) >= len(lit) - 1


def test_trails_of_even_light_are_followed_no_farther_than_they_go() -> None:
    measured = measure(2, 4, depth=0.0)
    assert len(measured) >= 4
    for trail, found in measured:
        assert whole(found), (trail, found)


@given(length=st.floats(8.0, 500.0), sigma=st.floats(0.5, 20.0))
def test_light_beyond_the_ends_is_a_view_of_the_bins_that_lie_there(length: float, sigma: float) -> None:
    """Sixteen lines beside a trail are looked at in each step; their sums are not copied bin by bin."""
    reach = math.ceil(varied.REACH_LENGTHS * length + varied.REACH_PX)
    along = np.arange(2 * reach + math.ceil(length) + 1, dtype=np.float64) - reach
    after, before = varied._beyond(along.size, reach, length, sigma)
    np.testing.assert_array_equal(along[after], along[along > length + varied.BEYOND_SIGMAS * sigma])
    np.testing.assert_array_equal(along[before], along[along < -varied.BEYOND_SIGMAS * sigma])
    assert along[after].base is along
