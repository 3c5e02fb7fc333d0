"""Tracks of one object and tracks of two objects that cross: told apart by the light that is not shared."""

import math

import numpy as np
import pytest

from onboard.track.joint import JointTracker
from onboard.track.same import light_of, same_object, tells_nothing_new
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.signals import Detection, Track, TrackMember
from tests.benchmarks.bench_tracks import WHOLE_PX

ASKED = JointTracker().thresholds((WHOLE_PX, WHOLE_PX), 1.25, 0.85)


def segment(row0: float, col0: float, row1: float, col1: float, snr: float = 4.0) -> Detection:
    return Detection(row0=row0, col0=col0, row1=row1, col1=col1, snr=snr, flags=StreakFlag(0))


def straight(
    row: float, col: float, angle_deg: float, length: float, *, frames: range, snr: float = 4.0, number: int = 0, middle: int = 3
) -> Track:
    """A track whose trail in frame `middle` has its middle at (row, col)."""
    way = np.array([math.sin(math.radians(angle_deg)), math.cos(math.radians(angle_deg))])
    members = []
    for k in frames:
        at = np.array([row, col]) + 1.25 * length * (k - middle) * way
        low, high = at - 0.5 * length * way, at + 0.5 * length * way
        members.append(TrackMember(frame=k, detection=segment(*low, *high, snr=snr)))
    return Track(number=number, snr=snr * math.sqrt(len(members)), members=tuple(members))


@pytest.mark.parametrize("angle_deg", [10.0, 40.0, 90.0, 200.0])
def test_two_objects_whose_trails_cross_in_one_frame_are_two(angle_deg: float) -> None:
    """Each has light of its own; the same tracks where they are too faint without the common light are taken for one."""
    known = straight(1000.0, 1000.0, 0.0, 200.0, frames=range(7), snr=9.0)
    other = straight(1001.0, 1003.0, angle_deg, 150.0, frames=range(7))
    assert not same_object(known, other, ASKED)
    assert same_object(known, other)
    faint = straight(1001.0, 1003.0, angle_deg, 150.0, frames=range(7), snr=2.8)
    assert same_object(known, faint, ASKED)


def test_a_find_with_a_wrong_motion_is_the_same_object() -> None:
    """Wrong sense, wrong speed, wrong direction: outside of the object's light there is noise, or its light a second time."""
    known = straight(1000.0, 1000.0, 20.0, 150.0, frames=range(7), snr=15.0)
    in_noise = {200.0: 1.5, 26.0: 2.5}
    for angle_deg, noise in in_noise.items():
        wrong = straight(1000.0, 1000.0, angle_deg, 150.0, frames=range(7), snr=noise)
        assert same_object(known, wrong, ASKED)
    along = straight(1000.0, 1000.0, 20.0, 185.0, frames=range(7), snr=12.0)
    assert same_object(known, along, ASKED)


def test_an_object_goes_on_under_its_number_and_others_are_others() -> None:
    """Later frames of one motion; a track of other frames; a parallel neighbour 30 px aside."""
    known = straight(1000.0, 1000.0, 20.0, 60.0, frames=range(5))
    assert same_object(known, straight(1001.0, 1002.0, 20.5, 61.0, frames=range(3, 10)), ASKED)
    assert same_object(known, straight(1001.0, 1002.0, 20.5, 61.0, frames=range(4, 11), snr=9.0), ASKED)
    assert not same_object(known, straight(1000.0, 1000.0, 20.0, 60.0, frames=range(5, 9)), ASKED)
    assert not same_object(known, straight(1030.0, 1000.0, 20.0, 60.0, frames=range(5)), ASKED)


def test_crossing_tracks_of_two_frames_are_two_where_they_share_little() -> None:
    """At right angles 8 of 400 px are shared; at 1 degree nearly all of one frame is, and what is left is no track."""
    known = straight(1000.0, 1000.0, 0.0, 300.0, frames=range(3, 5), snr=6.0)
    assert not same_object(known, straight(1001.0, 1003.0, 90.0, 400.0, frames=range(3, 5), snr=6.5), ASKED)
    assert same_object(known, straight(1001.0, 1003.0, 181.0, 400.0, frames=range(3, 5), snr=6.5), ASKED)


def test_tracks_with_one_common_frame_where_their_trails_cross_are_two() -> None:
    """The first has gone when the other comes. One that goes on in the same trail is the same object."""
    known = straight(1000.0, 1000.0, 0.0, 200.0, frames=range(4), snr=9.0)
    assert not same_object(known, straight(1001.0, 1003.0, 60.0, 150.0, frames=range(3, 7), snr=5.0), ASKED)
    assert same_object(known, straight(1001.0, 1003.0, 0.3, 190.0, frames=range(3, 7), snr=5.0), ASKED)
    assert same_object(known, straight(1001.0, 1003.0, 60.0, 150.0, frames=range(3, 7), snr=3.0), ASKED)


def test_the_light_of_a_trail_in_another_is_that_of_their_common_part() -> None:
    """On itself all of it; on one of twice the length the root of a half; across at right angles 8 px."""
    trail = segment(100.0, 100.0, 100.0, 200.0, snr=6.0)
    assert light_of(trail, trail) == pytest.approx(6.0)
    assert light_of(trail, segment(100.0, 50.0, 100.0, 250.0)) == pytest.approx(6.0 * math.sqrt(0.5), rel=0.1)
    assert light_of(trail, segment(50.0, 150.0, 150.0, 150.0)) == pytest.approx(6.0 * 8.0 / 100.0, rel=0.15)
    assert light_of(trail, segment(105.0, 100.0, 105.0, 200.0)) == 0.0


def test_a_fainter_find_in_frames_that_are_known_tells_nothing_new() -> None:
    """A brighter one may have the better motion, and one with a later frame follows the object on."""
    known = straight(1000.0, 1000.0, 20.0, 150.0, frames=range(1, 5), snr=5.0)
    assert tells_nothing_new(known, straight(1000.0, 1000.0, 25.0, 170.0, frames=range(2, 4), snr=4.9))
    assert not tells_nothing_new(known, straight(1000.0, 1000.0, 20.0, 150.0, frames=range(1, 5), snr=5.1))
    assert not tells_nothing_new(known, straight(1000.0, 1000.0, 20.0, 150.0, frames=range(3, 6), snr=4.9))
