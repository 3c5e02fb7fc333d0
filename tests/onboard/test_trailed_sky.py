"""Frames whose stars are the trails: drawn by `sky_frames`, with a camera that shifts and turns during the exposure."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from onboard.stars.star_motion import common_motion, refined_motion
from onboard.stars.trail_peaks import path_of
from sboc_e2e.icd.flags import StarFlag, StreakFlag
from sboc_e2e.icd.signals import StarMotion
from tests.benchmarks import sky_frames
from tests.benchmarks.detection_frames import Streak
from tests.benchmarks.other_skies import second_of

SIDE = 768


def turning_frame(motion: StarMotion, rng: np.random.Generator) -> tuple[NDArray[np.uint16], NDArray[np.float64]]:
    """Stars of S/N 10 to 1,000 that move, a point of S/N 60 at (300, 410) and a trail of S/N 25 beside them; places of stars."""
    light = np.full((SIDE, SIDE), sky_frames.SKY_E)
    width = sky_frames.width_px(sky_frames.FWHM_PX)
    places = rng.uniform(5.0, SIDE - 5.0, (200, 2))
    places = places[np.hypot(*(places - (300.0, 410.0)).T) > 25.0]
    places = places[np.abs((places[:, 0] - 480.0) * 50.0 - (places[:, 1] - 140.0) * 160.0) / 167.6 > 25.0]
    for row, col in places:
        d_row, d_col = (float(part) for part in motion.at(np.float64(row), np.float64(col)))
        snr = 10.0 ** rng.uniform(1.0, 3.0)
        ends = (row - 0.5 * d_row, col - 0.5 * d_col, row + 0.5 * d_row, col + 0.5 * d_col)
        add_streak(light, ends, snr, width)
    snr = 60.0
    flux = snr * sky_frames.SIGMA_E * 2.0 * math.sqrt(math.pi) * width
    sky_frames.add_points(light, np.array([300.0]), np.array([410.0]), np.array([flux]), sky_frames.FWHM_PX)
    add_streak(light, (480.0, 140.0, 640.0, 190.0), 25.0, width)
    return sky_frames.digitised(sky_frames.exposed(light, rng)), places


def add_streak(light: NDArray[np.float64], ends: tuple[float, float, float, float], snr: float, width_px: float) -> None:
    streak = Streak(row0=ends[0], col0=ends[1], row1=ends[2], col1=ends[3], snr=snr)
    window, shape = sky_frames.streak_light(streak, light.shape, width_px)
    light[window] += snr * sky_frames.SIGMA_E / math.sqrt(float(np.sum(shape**2))) * shape


@pytest.mark.parametrize(("drow", "dcol", "turn_rad"), [(9.0, 24.0, 0.0), (-14.0, 20.0, 0.012)])
def test_when_stars_trail_what_stands_still_is_the_object(drow: float, dcol: float, turn_rad: float) -> None:
    """Stars as trails came out as up to fifty detections in a frame, and the point among them as none."""
    middle = 0.5 * (SIDE - 1)
    motion = StarMotion(drow=drow, dcol=dcol, turn_rad=turn_rad, middle_row=middle, middle_col=middle)
    rng = np.random.default_rng(5)
    frames = [turning_frame(motion, rng) for _ in range(2)]
    result, _ = second_of(frames[0][0], frames[1][0])
    found = [d for d in result.detections if not d.flags & StreakFlag.COSMIC_LIKE]
    points = [d for d in found if d.flags & StreakFlag.POINT_LIKE]
    assert [(round(d.row0), round(d.col0)) for d in points] == [(300, 410)]
    assert not points[0].flags & StreakFlag.STATIC
    lines = [d for d in found if not d.flags & StreakFlag.POINT_LIKE]
    assert len(lines) == 1
    assert math.hypot(lines[0].row0 - 480.0, lines[0].col0 - 140.0) < 4.0
    measured = result.stars.motion
    assert measured is not None
    sign = math.copysign(1.0, measured.drow * drow)
    assert sign * measured.drow == pytest.approx(drow, abs=0.5)
    assert sign * measured.dcol == pytest.approx(dcol, abs=0.5)
    assert sign * measured.turn_rad == pytest.approx(turn_rad, abs=1e-3)


def test_all_but_overlapping_stars_are_listed_at_their_middle() -> None:
    middle = 0.5 * (SIDE - 1)
    motion = StarMotion(drow=-14.0, dcol=20.0, turn_rad=0.012, middle_row=middle, middle_col=middle)
    pixels, places = turning_frame(motion, np.random.default_rng(6))
    result, _ = second_of(pixels[::-1].copy(), pixels)
    trailed = (result.stars.flags & int(StarFlag.TRAILED)) != 0
    listed = np.column_stack((result.stars.row, result.stars.col))[trailed]
    apart = np.array([np.hypot(*(listed - place).T).min() for place in places])
    inside = (np.abs(places - middle) < middle - 25.0).all(axis=1)
    assert np.mean(apart[inside] < 1.5) > 0.8
    assert np.median(apart[inside]) < 0.3


def test_a_few_objects_side_by_side_do_not_pass_for_trailing_stars() -> None:
    """Six bright trails with one motion in a poor field: they were taken for the stars, and forty faint stars for objects."""
    rng = np.random.default_rng(9)
    places, snr = rng.uniform(8.0, SIDE - 8.0, (40, 2)), rng.uniform(8.0, 30.0, 40)
    frames = []
    for number in range(2):
        light = np.full((SIDE, SIDE), sky_frames.SKY_E)
        width = sky_frames.width_px(sky_frames.FWHM_PX)
        flux = snr * sky_frames.SIGMA_E * 2.0 * math.sqrt(math.pi) * width
        sky_frames.add_points(light, *places.T, flux, sky_frames.FWHM_PX)
        for k in range(6):
            row, col = 80.0 + 110.0 * k, 100.0 + 20.0 * k + 36.0 * number
            add_streak(light, (row, col, row + 2.0, col + 28.0), 300.0, width)
        frames.append(sky_frames.digitised(sky_frames.exposed(light, rng)))
    result, _ = second_of(*frames)
    assert result.stars.motion is None
    found = sorted(d.row0 for d in result.detections if not d.flags & StreakFlag.COSMIC_LIKE and d.length_px > 20.0)
    assert found == pytest.approx([80.0 + 110.0 * k for k in range(6)], abs=3.0)
    assert len(result.detections) == 6


def test_a_motion_is_found_among_trails_that_go_all_ways() -> None:
    """Sixty trails of a turn about a point in the frame, signs at random, and thirty of anything."""
    rng = np.random.default_rng(7)
    middle = (500.0, 500.0)
    true = StarMotion(drow=3.0, dcol=-5.0, turn_rad=0.03, middle_row=500.0, middle_col=500.0)
    places = rng.uniform(0.0, 1000.0, (90, 2))
    vectors = np.column_stack(true.at(places[:, 0], places[:, 1])) + rng.normal(0.0, 0.3, (90, 2))
    vectors[60:] = rng.uniform(-20.0, 20.0, (30, 2))
    vectors *= rng.choice((-1.0, 1.0), (90, 1))
    order = rng.permutation(90)
    found = common_motion(places[order], vectors[order], middle)
    assert found is not None
    better = refined_motion(places[:60], vectors[:60], found)
    assert better is not None
    sign = math.copysign(1.0, better.turn_rad)
    assert (sign * better.drow, sign * better.dcol) == pytest.approx((3.0, -5.0), abs=0.2)
    assert sign * better.turn_rad == pytest.approx(0.03, abs=5e-4)


def test_trails_that_go_all_ways_have_no_motion() -> None:
    rng = np.random.default_rng(8)
    places, vectors = rng.uniform(0.0, 1000.0, (90, 2)), rng.uniform(-20.0, 20.0, (90, 2))
    assert common_motion(places, vectors, (500.0, 500.0)) is None


def test_a_path_has_one_pixel_for_each_step_of_its_longer_axis() -> None:
    path = path_of(3.0, -10.0)
    assert len(path) == 11
    assert (np.diff(path[:, 1]) == -1).all()
    assert tuple(path[5]) == (0, 0)
