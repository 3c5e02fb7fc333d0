"""Lines that point at one place: a shower of meteors, and what is none."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ground.streaks import TrailedPsfFitter
from ground.vetting.look_alikes import with_odds
from ground.vetting.radiants import Lines, for_radiant
from sboc_e2e.icd.products import StreakFit
from tests.streaks.impostors import draw
from tests.streaks.lit_lines import EVEN, judged, lit

RADIANT = (-40.0, 90.0)
FRAME = (300, 400)
MEMBERS = (35.0, 60.0, 85.0, 110.0)
"""Directions (deg) from the radiant of four meteors of a shower."""


@pytest.fixture(scope="module")
def drawn() -> StreakFit:
    """A fit of a trail of no place yet."""
    shot = draw("real", np.random.default_rng(5))
    return replace(TrailedPsfFitter().fit(shot.pixels, shot.detection), sagitta_px=0.0, chi2_nu=1.0, width_px=1.2, snr=60.0)


def way(fit: StreakFit, angle_deg: float, near_px: float, length_px: float, turn_deg: float = 0.0) -> StreakFit:
    """The fit on a line from the radiant, turned about its own first end."""
    d_row, d_col = math.sin(math.radians(angle_deg)), math.cos(math.radians(angle_deg))
    row, col = RADIANT[0] + near_px * d_row, RADIANT[1] + near_px * d_col
    turned = math.radians(angle_deg + turn_deg)
    end = row + length_px * math.sin(turned), col + length_px * math.cos(turned)
    return replace(fit, row0=row, col0=col, row1=end[0], col1=end[1])


def shower(fit: StreakFit, n: int) -> list[StreakFit]:
    """The first n of four meteors."""
    return [way(fit, angle, 90.0 + 10.0 * k, 50.0 + 20.0 * k) for k, angle in enumerate(MEMBERS[:n])]


def odds_of(others: list[StreakFit], fit: StreakFit, *, round_stars: bool = True) -> float:
    """For a fit that may be a trail beside others that are published."""
    given = np.array([*[0.8] * len(others), 0.3])
    return float(for_radiant([*others, fit], given, FRAME, round_stars=round_stars)[-1])


def test_a_line_that_points_at_the_radiant_of_published_ones_gains_and_others_do_not(drawn: StreakFit) -> None:
    """Nine meteors of two showers, three to five others published, had p of 0.15 to 0.49."""
    others, faint = shower(drawn, 4), way(drawn, 72.0, 170.0, 60.0)
    assert odds_of(others, faint) == pytest.approx(30.0, rel=0.01)
    assert odds_of(others, way(drawn, 72.0, 170.0, 60.0, turn_deg=8.0)) == 1.0
    assert odds_of(others[:2], faint) == 1.0, "two lines always cross"
    assert with_odds(np.array([0.0, 0.3, 1.0]), 30.0) == pytest.approx([0.0, 0.928, 1.0], abs=1e-3)


def test_a_radiant_that_chance_gives_as_well_says_little(drawn: StreakFit) -> None:
    """Of thirteen published lines of a picture four met in a place, and chance gives 0.8 such places."""
    stray = [way(drawn, 40.0 + 7.0 * k, 90.0 + 14.0 * k, 60.0, turn_deg=25.0 + 17.0 * k) for k in range(7)]
    faint = way(drawn, 72.0, 170.0, 60.0)
    few, among = odds_of(shower(drawn, 3), faint), odds_of(shower(drawn, 3) + stray, faint)
    assert few > 25.0
    assert among < 0.25 * few


def test_parallel_lines_and_many_lines_without_round_stars_may_be_trailed_stars(drawn: StreakFit) -> None:
    """Two pictures of trailed stars: 9 of 18 and 13 of 21 published lines pointed at one place, and 14 more followed them."""
    parallel = [replace(drawn, row0=20.0 + 30.0 * k, col0=40.0 * k, row1=70.0 + 30.0 * k, col1=40.0 * k + 60.0) for k in range(6)]
    assert odds_of(parallel[:-1], parallel[-1]) == 1.0
    faint = way(drawn, 72.0, 170.0, 60.0)
    many = [way(drawn, 20.0 + 12.0 * k, 90.0 + 20.0 * (k % 3), 60.0) for k in range(8)]
    assert odds_of(many, faint) > 25.0
    assert odds_of(many, faint, round_stars=False) == 1.0
    assert odds_of(many[:7], faint, round_stars=False) > 25.0


def in_fisheye(fit: StreakFit, focal_px: float, angle_deg: float, from_deg: float) -> StreakFit:
    """The fit on 8 deg of a great circle from a radiant 40 deg off the axis of an equidistant fisheye."""
    radiant = np.array([math.sin(math.radians(40.0)), 0.0, math.cos(math.radians(40.0))])
    pole = Rotation.from_rotvec(math.radians(angle_deg) * radiant).apply([0.0, 1.0, 0.0])
    ends = [Rotation.from_rotvec(math.radians(from_deg + each) * pole).apply(radiant) for each in (0.0, 8.0)]
    theta = [math.acos(end[2]) for end in ends]
    (row0, col0), (row1, col1) = (
        (149.5 + focal_px * t * end[0] / math.sin(t), 199.5 + focal_px * t * end[1] / math.sin(t))
        for t, end in zip(theta, ends, strict=True)
    )
    return replace(fit, row0=row0, col0=col0, row1=row1, col1=col1)


def test_a_shower_of_a_fisheye_is_recognised_by_the_sky_and_not_by_the_plane(drawn: StreakFit) -> None:
    """The meteors of a photograph of 180 deg met within 3 deg in the sky, 10 of 12, and 6 of 12 in the plane."""
    lines = [in_fisheye(drawn, 120.0, angle, away) for angle, away in ((20.0, 25.0), (75.0, 70.0), (130.0, 40.0), (250.0, 80.0))]
    faint = in_fisheye(drawn, 120.0, 315.0, 60.0)
    assert odds_of(lines, faint) > 20.0
    assert odds_of(lines, replace(faint, row1=faint.row1 + 6.0)) == 1.0
    ends = np.array([(line.row0, line.col0, line.row1, line.col1) for line in lines])
    way = (ends[:, 2:] - ends[:, :2]) / np.hypot(*(ends[:, 2:] - ends[:, :2]).T)[:, None]
    assert (Lines.in_plane(0.5 * (ends[:, :2] + ends[:, 2:]), way).agree <= 3.0).sum(axis=1).max() < 4


def test_unlikely_lines_that_look_like_published_ones_tell_a_radiant_with_them(drawn: StreakFit) -> None:
    """Twelve short meteors of one photograph: three were published and seven had p of 0.03 to 0.19."""
    lines = [way(drawn, angle, 90.0 + 9.0 * k, 40.0) for k, angle in enumerate((35.0, 60.0, 85.0, 110.0, 47.0, 72.0, 97.0))]

    def odds(published: int, *, round_stars: bool = True, lines: list[StreakFit] = lines) -> float:
        given = np.array([*[0.8] * published, *[0.1] * (len(lines) - published)])
        return float(for_radiant(lines, given, FRAME, round_stars=round_stars)[-1])

    assert odds(2) > 25.0
    assert odds(1) == 1.0, "roofs and clouds are unlikely lines as well"
    assert odds(2, round_stars=False) == 1.0, "trailed stars of a wide lens"
    wide = replace(lines[-1], width_px=4.0 * drawn.width_px)
    assert odds(2, lines=[*lines[:-1], wide]) == 1.0, "the edge of a cloud"
    others = [way(line, 40.0, 90.0, 40.0, turn_deg=40.0 + 13.0 * k) for k, line in enumerate(lines[2:-1])]
    assert odds(2, lines=[*lines[:2], *others, lines[-1]]) == 1.0


def test_no_line_speaks_for_itself_nor_for_a_second_fit_on_its_trail(drawn: StreakFit) -> None:
    others = shower(drawn, 3)
    again = replace(others[2], row1=others[2].row1 - 5.0)
    assert odds_of(others, again) == 1.0, "the two others always cross"
    assert for_radiant(others, np.full(3, 0.8), FRAME, round_stars=True) == pytest.approx(1.0)
    none = replace(drawn, row1=drawn.row0, col1=drawn.col0)
    assert odds_of(others, none) == 1.0, "no length"


def test_a_faint_meteor_of_a_shower_is_published(drawn: StreakFit) -> None:
    lines = [*shower(drawn, 4), way(drawn, 72.0, 170.0, 60.0), way(drawn, 48.0, 190.0, 60.0, turn_deg=60.0)]
    pixels = sum((lit(line, EVEN, 9.0) for line in lines[1:]), lit(lines[0], EVEN, 9.0)) - 100.0 * (len(lines) - 1)
    p = judged((0.9, 0.9, 0.9, 0.9, 0.05, 0.05), lines, pixels)
    assert p[:4].min() > 0.5
    assert p[4] > 0.8
    assert p[5] < 0.5, "as bright, but it points elsewhere"


def test_a_large_shower_counts_where_the_stars_are_no_lines_whether_or_not_they_tell_a_width(drawn: StreakFit) -> None:
    """A photograph of 38 meteors: its stars, drawn out by 3 px, told no width, and its faint meteors had p of 0.07 to 0.37."""
    lines = [*(way(drawn, 30.0 + 9.0 * k, 90.0 + 85.0 * (k % 3), 60.0) for k in range(9)), way(drawn, 71.0, 95.0, 60.0)]
    pixels = sum((lit(line, EVEN, 9.0) for line in lines[1:]), lit(lines[0], EVEN, 9.0)) - 100.0 * (len(lines) - 1)
    told = (*[0.9] * 9, 0.05)
    as_lines, as_points = judged(told, lines, pixels), judged(told, lines, pixels, points=True)
    assert np.count_nonzero(as_lines[:9] > 0.5) >= 8
    odds = [p[9] / (1.0 - p[9]) for p in (as_lines, as_points)]
    assert odds[1] > 20.0 * odds[0]
