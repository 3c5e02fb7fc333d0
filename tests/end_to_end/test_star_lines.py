"""Stars that are lines: told from trains of satellites, and found among fits where detections of a dense field run together."""

import math
from functools import partial
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ground.vetting.look_alikes import OwnEvidence
from ground.vetting.star_trails import move_as
from onboard.stars.star_motion import common_motion
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.outside.star_lines import lanes_of, stars_as_lines

SHAPE = (500, 300)
WIDE = (1280, 1920)
NONE = StreakFlag(0)


def line(row: float, col: float, vector: tuple[float, float], snr: float, flags: StreakFlag = NONE) -> Any:
    """A detection or fit about its middle."""
    half_row, half_col = 0.5 * vector[0], 0.5 * vector[1]
    ends = {"row0": row - half_row, "col0": col - half_col, "row1": row + half_row, "col1": col + half_col}
    return type("Line", (), ends | {"length_px": float(np.hypot(*vector)), "snr": snr, "flags": flags})()


def film(n: int, seed: int) -> list[Any]:
    """Trails on film: a shift of (30, 12) px and a turn of 0.02 rad, ends to 0.5 px, all flagged as sharp as particles."""
    rng = np.random.default_rng(seed)
    lines = []
    for row, col in zip(rng.uniform(30.0, 470.0, n), rng.uniform(30.0, 270.0, n), strict=True):
        d_row, d_col = rng.normal((30.0 - 0.02 * (col - 149.5), 12.0 + 0.02 * (row - 249.5)), 0.7)
        lines.append(line(row, col, (d_row, d_col), float(rng.lognormal(4.0, 0.7)), StreakFlag.COSMIC_LIKE))
    return lines


def train(n: int, row: float, col: float, seed: int) -> list[Any]:
    """Satellites of one train: equal trails that follow each other on a line, ends to 0.5 px."""
    rng = np.random.default_rng(seed)
    along = 45.0 * np.arange(n)
    return [line(row + 0.928 * a, col + 0.371 * a, tuple(rng.normal((30.0, 12.0), 0.5)), 80.0) for a in along]


def test_fits_tell_where_detections_run_together() -> None:
    """Of 60 trails 25 remain single; 30 longer lines of two or three, at odd angles, are found first."""
    rng = np.random.default_rng(3)
    singles = film(25, 1)
    together = [
        line(*rng.uniform(40.0, 260.0, 2), (float(rng.uniform(60.0, 200.0)), float(rng.uniform(10.0, 90.0))), 150.0)
        for _ in range(45)
    ]
    assert stars_as_lines([*singles, *together], shape=SHAPE) is None
    own = OwnEvidence(shared=partial(stars_as_lines, shape=SHAPE))
    assert own.stars_among([*singles, *together], round_stars=True) is None
    motion = own.stars_among([*singles, *film(30, 2), *together], round_stars=True)
    assert motion is not None
    row, col = np.array([30.0, 30.0, 470.0, 470.0]), np.array([30.0, 270.0, 30.0, 270.0])
    d_row, d_col = motion.at(row, col)
    assert d_row == pytest.approx(30.0 - 0.02 * (col - 149.5), abs=2.0)
    assert d_col == pytest.approx(12.0 + 0.02 * (row - 249.5), abs=2.0)
    assert OwnEvidence(stars=motion).stars_among([], round_stars=True) is motion
    assert OwnEvidence().stars_among(film(30, 2), round_stars=True) is None


def turning_sky(n: int, seed: int) -> list[Any]:
    """Trails of stars that turn by 9 deg about a pole 60 deg off the axis of a gnomonic lens, 71 deg along the longer side; ends
    to 0.5 px."""
    rng, focal_px = np.random.default_rng(seed), 0.7 * WIDE[1]
    pole = np.array([math.sin(math.radians(60.0)), 0.0, math.cos(math.radians(60.0))])
    middle = np.array([0.5 * (WIDE[0] - 1), 0.5 * (WIDE[1] - 1)])
    place = np.column_stack([rng.uniform(60.0, side - 60.0, n) for side in WIDE]) - middle
    ray = np.column_stack((place, np.full(n, focal_px)))
    before, after = (Rotation.from_rotvec(math.radians(sign * 4.5) * pole).apply(ray) for sign in (-1.0, 1.0))
    ends = [focal_px * each[:, :2] / each[:, 2:] + middle + rng.normal(0.0, 0.5, (n, 2)) for each in (before, after)]
    inside = [((end > 0.0) & (end < np.array(WIDE) - 1.0)).all(axis=1) for end in ends]
    return [
        line(*(0.5 * (a + b)), tuple(b - a), float(rng.lognormal(4.0, 0.7)))
        for a, b, yes in zip(*ends, inside[0] & inside[1], strict=True)
        if yes
    ]


def test_stars_of_a_wide_lens_are_stars_up_to_its_corners() -> None:
    """A rigid motion leaves a quarter of them and more. In a picture of trailed stars twelve at its corners were published."""
    for seed in range(3):
        stars = turning_sky(90, seed)
        ends = np.array([(each.row0, each.col0, each.row1, each.col1) for each in stars])
        rigid = common_motion(
            0.5 * (ends[:, :2] + ends[:, 2:]), ends[:, 2:] - ends[:, :2], (0.5 * (WIDE[0] - 1), 0.5 * (WIDE[1] - 1))
        )
        shown = stars_as_lines(stars, shape=WIDE)
        assert rigid is not None
        assert shown is not None
        assert np.mean(move_as(rigid, stars)) < 0.75
        assert np.mean(move_as(shown, stars)) > 0.97
        strays = [line(*(600.0, 900.0), vector, 50.0) for vector in ((40.0, 150.0), (190.0, 0.0), (20.0, 20.0))]
        assert not move_as(shown, [*strays[:1], *strays[2:]]).any()


def test_trains_of_satellites_are_no_stars() -> None:
    """Three trains beside each other have three lanes, however many satellites; a border cuts none of those that count."""
    trains = [*train(8, 40.0, 30.0, 1), *train(8, 30.0, 90.0, 2), *train(8, 35.0, 160.0, 3)]
    assert stars_as_lines(trains, shape=SHAPE) is None
    stars = film(24, 4)
    assert stars_as_lines(stars, shape=SHAPE) is not None
    cut = [line(250.0, 20.0 * k, (30.0, 12.0), 50.0, StreakFlag.EDGE0) for k in range(12)]
    assert stars_as_lines(cut, shape=SHAPE) is None


def test_meteors_of_one_radiant_differ_in_length() -> None:
    """Eleven parallel meteors of 20 to 120 px: fewer than eight are equal."""
    for seed in range(20):
        rng = np.random.default_rng(seed)
        length = np.exp(rng.uniform(np.log(20.0), np.log(120.0), 11))
        meteors = [line(*rng.uniform((60.0, 60.0), (440.0, 240.0)), (0.9 * d, 0.43 * d), 60.0) for d in length]
        assert stars_as_lines(meteors, shape=SHAPE) is None
        assert stars_as_lines(meteors, False, shape=SHAPE) is None


def test_a_few_equal_lines_are_stars_where_no_star_is_round() -> None:
    """Five trails of 300 px in a frame without round stars were published as five satellites. Beside round stars equal lines are
    a formation. Four whose lengths differ by a fifth share no motion."""
    rng = np.random.default_rng(6)
    stars = [line(60.0 + 75.0 * k, 60.0 + 40.0 * k, tuple(rng.normal((90.0, -30.0), 1.0)), 40.0) for k in range(5)]
    motion = stars_as_lines(stars, False, shape=SHAPE)
    assert motion is not None
    assert abs(motion.drow) == pytest.approx(90.0, abs=3.0)
    assert stars_as_lines(stars, shape=SHAPE) is None
    assert stars_as_lines(stars[:3], False, shape=SHAPE) is None
    own = OwnEvidence(shared=partial(stars_as_lines, shape=SHAPE))
    assert own.stars_among(stars, round_stars=False) is not None
    assert own.stars_among(stars, round_stars=True) is None
    uneven = [line(60.0 + 75.0 * k, 60.0, (90.0 * (1.09 if k % 2 else 0.91), -30.0), 40.0) for k in range(4)]
    assert stars_as_lines(uneven, False, shape=SHAPE) is None


def test_lanes() -> None:
    """Trails beside each other are lanes, those behind each other share one; a trail shorter than a lane is wide tells none."""
    vectors: NDArray[np.float64] = np.tile([0.0, 40.0], (4, 1))
    places = np.array([[10.0, 50.0], [11.0, 250.0], [30.0, 50.0], [50.0, 90.0]])
    assert lanes_of(places, vectors) == 3
    assert lanes_of(places, 0.05 * vectors) == 0
    assert lanes_of(places[:0], vectors[:0]) == 0
