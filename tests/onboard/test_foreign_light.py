"""Light that a frame's own trails explain is no evidence for a track of another motion; trails may cross."""

import numpy as np
import pytest
from numpy.typing import NDArray

from onboard.track.foreign_light import LitMember, own_light
from onboard.track.packed import packed
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.signals import Detection

PSF_SIGMA_PX = 0.85
LIT_CODE = 40  # 2.5 sigma of a smoothed pixel: too faint to be blanked as a hit
FAINT_CODE = 16  # on 80 px S/N 5
DARK: NDArray[np.float64] = np.zeros((0, 4))
NO_STARS: NDArray[np.float64] = np.zeros((0, 2))
TRAIL = np.array([[100.0, 20.0, 100.0, 230.0]])


def image(*, lit: bool) -> NDArray[np.uint64]:
    """A frame without noise, with a bright trail along row 100 and a faint one across or with nothing."""
    smooth = np.zeros((256, 256), np.int8)
    if lit:
        smooth[60:141, 127:130] = FAINT_CODE
        smooth[99:102, 20:231] = LIT_CODE
    return packed(smooth)


def member(
    row0: float,
    col0: float,
    row1: float,
    col1: float,
    snr: float,
    trails: NDArray[np.float64],
    stars: NDArray[np.float64] = NO_STARS,
) -> LitMember:
    detection = Detection(row0=row0, col0=col0, row1=row1, col1=col1, snr=snr, flags=StreakFlag(0))
    return LitMember(detection, snr, image(lit=len(trails) > 0), trails, stars)


def test_a_member_along_a_brighter_trail_of_another_object_leaves_its_track_the_other_frames() -> None:
    """Both senses of either; what is left rests on one frame."""
    alone = member(60.0, 100.0, 60.0, 160.0, 5.0, DARK)
    for ends in ((100.0, 100.0, 100.0, 160.0), (101.0, 160.0, 100.0, 100.0)):
        for trail in (TRAIL, TRAIL[:, [2, 3, 0, 1]]):
            own = own_light([alone, member(*ends, 11.0, trail)], np.zeros(0), PSF_SIGMA_PX)
            assert own is not None
            assert own.snr == pytest.approx(5.0, abs=0.1)
            assert own.least < 0.5


def test_a_member_that_crosses_a_bright_trail_keeps_what_lies_beside_it() -> None:
    """8 px of 80 are not counted, nor their light."""
    own = own_light(
        [member(60.0, 40.0, 60.0, 120.0, 5.0, DARK), member(60.0, 128.0, 140.0, 128.0, 5.0, TRAIL)], np.zeros(0), PSF_SIGMA_PX
    )
    assert own is not None
    assert 7.1 < own.snr < 7.6  # the codes round 1 sigma to 1.1
    assert own.least > 4.0


def test_a_frame_that_shows_the_object_itself_takes_nothing() -> None:
    """Its whole trail or a part of it; and a trail that lies elsewhere."""
    first = member(60.0, 20.0, 60.0, 230.0, 5.0, DARK)
    for trail in (TRAIL, np.array([[100.0, 60.0, 101.0, 190.0]]), np.array([[120.0, 20.0, 120.0, 230.0]])):
        assert own_light([first, member(100.0, 22.0, 100.5, 228.0, 9.0, trail)], np.zeros(0), PSF_SIGMA_PX) is None


def test_frames_whose_pixels_are_gone_count_as_much_as_a_member() -> None:
    """Three of S/N 5 and one that another trail explains."""
    own = own_light(
        [member(60.0, 100.0, 60.0, 160.0, 5.0, DARK), member(100.0, 100.0, 100.0, 160.0, 11.0, TRAIL)],
        np.array([5.0, 5.0]),
        PSF_SIGMA_PX,
    )
    assert own is not None
    assert own.snr == pytest.approx(5.0 * np.sqrt(3.0), abs=0.1)


def test_the_light_of_a_star_that_was_left_in_is_not_the_tracks() -> None:
    """A trail of 60 px along nothing but a star of 4 sigma: what is left of it is dark, and the star's 5 px do not count."""
    smooth = np.zeros((256, 256), np.int8)
    smooth[99:102, 148:153] = 64
    detection = Detection(row0=100.0, col0=120.0, row1=100.0, col1=180.0, snr=4.0, flags=StreakFlag(0))
    first = member(60.0, 40.0, 60.0, 120.0, 5.0, DARK)
    own = own_light(
        [first, LitMember(detection, 4.0, packed(smooth), DARK, np.array([[100.2, 150.0]]))], np.zeros(0), PSF_SIGMA_PX
    )
    assert own is not None
    # without light the second frame adds its 55 of 80 + 55 px to the noise alone
    assert own.snr == pytest.approx(5.0 * np.sqrt(80.0 / 135.0), abs=0.15)
