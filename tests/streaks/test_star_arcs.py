"""Arcs of stars about the pole of the sky, and lines that run otherwise; directions turned by scipy and projected here."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ground.streaks import TrailedPsfFitter
from ground.vetting.star_arcs import of_turning_stars
from sboc_e2e.icd.products import StreakFit
from tests.streaks.impostors import draw
from tests.streaks.lit_lines import EVEN, judged, lit, placed

SHAPE = (1300, 2000)
MIDDLE = 0.5 * (np.array(SHAPE) - 1.0)


@pytest.fixture(scope="module")
def drawn() -> StreakFit:
    """A fit of a trail of no place yet."""
    shot = draw("real", np.random.default_rng(5))
    return replace(TrailedPsfFitter().fit(shot.pixels, shot.detection), sagitta_px=0.0, chi2_nu=1.0, width_px=1.2, snr=60.0)


def arc(
    fit: StreakFit, at: np.ndarray, pole: np.ndarray, turn_deg: float, focal_px: float, shape: tuple[int, int] = SHAPE
) -> StreakFit:
    """The fit on a star's arc with its middle at (row, col), about a pole (columns, rows, line of sight)."""
    middle = 0.5 * (np.array(shape) - 1.0)
    sight = np.array([*(at - middle)[::-1] / focal_px, 1.0])
    ends = []
    for half in (-0.5, 0.5):
        x, y, z = Rotation.from_rotvec(np.radians(half * turn_deg) * pole / np.linalg.norm(pole)).apply(sight)
        ends += [middle[0] + focal_px * y / z, middle[1] + focal_px * x / z]
    return replace(fit, row0=ends[0], col0=ends[1], row1=ends[2], col1=ends[3])


def arcs(fit: StreakFit, pole: tuple[float, float, float], n: int, share: float, turn_deg: float = 5.0) -> list[StreakFit]:
    """Stars anywhere in a frame of a lens with a focal length of so many sides."""
    places = np.random.default_rng(11).uniform((100.0, 100.0), np.array(SHAPE) - 100.0, (n, 2))
    return [arc(fit, at, np.array(pole), turn_deg, share * max(SHAPE)) for at in places]


def stars_among(fits: list[StreakFit], faint: int = 0, *, round_stars: bool = False) -> np.ndarray:
    """Which fits are arcs of stars, the last ones not published."""
    given = np.array([0.9] * (len(fits) - faint) + [0.2] * faint)
    return of_turning_stars(fits, given, SHAPE, round_stars=round_stars)


def test_leaves_that_pass_for_round_stars_do_not_hide_arcs_around_the_pole(drawn: StreakFit) -> None:
    """A house among bushes under 43 arcs. Geostationary objects among round stars are as many, but nearly parallel."""
    around, parallel = (arcs(drawn, pole, 20, 0.8) for pole in ((0.1, -0.3, 1.0), (0.05, 1.0, 0.02)))
    assert stars_among(around, round_stars=True).mean() >= 0.9
    assert not stars_among(around[:10], round_stars=True).any()
    assert stars_among(parallel).mean() >= 0.9
    assert not stars_among(parallel, round_stars=True).any()


@pytest.mark.parametrize("pole", [(0.1, -0.3, 1.0), (0.6, -0.9, 0.4), (0.05, 1.0, 0.02)])
@pytest.mark.parametrize("share", [0.45, 0.7, 2.0])
def test_arcs_of_stars_are_told_wherever_the_pole_is(drawn: StreakFit, pole: tuple[float, float, float], share: float) -> None:
    """In the field, beside it, far away; fields of 96 to 28 deg. Nine in ten: a lens of 0.45 is not among those tried."""
    assert stars_among(arcs(drawn, pole, 20, share)).mean() >= 0.9


def test_faint_arcs_go_with_the_published_ones_and_lines_of_objects_stay(drawn: StreakFit) -> None:
    """Across the arcs, and along them where it is three times as long as a star's."""
    pole = (0.1, -0.3, 1.0)
    stars = arcs(drawn, pole, 12, 0.8)
    at = np.array([300.0, 400.0])
    along = arc(drawn, at, np.array(pole), 5.0, 0.8 * max(SHAPE))
    d_row, d_col = along.row1 - along.row0, along.col1 - along.col0
    across = replace(along, row0=at[0], col0=at[1], row1=at[0] + d_col, col1=at[1] - d_row)
    longer = arc(drawn, at, np.array(pole), 15.0, 0.8 * max(SHAPE))
    assert stars_among([*stars, across, longer, along], faint=3).tolist() == [True] * 12 + [False, False, True]
    assert not stars_among(stars[:5]).any(), "too few"
    assert not stars_among([*stars[:6], *[across] * 4]).any(), "too small a share"


def test_a_shower_far_away_and_a_train_are_no_stars(drawn: StreakFit) -> None:
    """Nearly parallel lines fit about an axis too, but point at a place better; a train follows one circle."""
    radiant, rng = np.array([-900.0, -1500.0]), np.random.default_rng(4)
    meteors = []
    for at in rng.uniform((100.0, 100.0), np.array(SHAPE) - 100.0, (14, 2)):
        way = rng.uniform(60.0, 250.0) * (at - radiant) / np.hypot(*(at - radiant))
        meteors.append(replace(drawn, row0=at[0], col0=at[1], row1=at[0] + way[0], col1=at[1] + way[1]))
    assert not stars_among(meteors).any()
    pole, focal_px = np.array([0.1, -0.8, 0.6]), 0.8 * max(SHAPE)
    first = np.array([*(np.array([500.0, 300.0]) - MIDDLE)[::-1] / focal_px, 1.0])
    train = []
    for k in range(10):
        x, y, z = Rotation.from_rotvec(np.radians(6.0 * k) * pole).apply(first)
        train.append(arc(drawn, MIDDLE + focal_px * np.array([y, x]) / z, pole, 4.0, focal_px))
    assert not stars_among(train).any()


def test_a_frame_of_arcs_publishes_none_unless_its_stars_are_round(drawn: StreakFit) -> None:
    """Nine pictures of star trails had 12 to 120 published lines each."""
    shape = (300, 700)  # of `judged`
    places = [(60.0, 80.0), (230.0, 90.0), (90.0, 220.0), (210.0, 330.0), (70.0, 430.0), (240.0, 520.0), (120.0, 600.0)]
    pole = np.array([0.1, 0.9, 0.3])
    lines = []
    for at in places:
        fit = arc(drawn, np.array(at), pole, 8.0, 0.8 * max(shape), shape)
        lines.append(placed(fit, (fit.row0, fit.col0, fit.row1, fit.col1), 1.2, 60.0))
    pixels = sum((lit(line, EVEN, 9.0) for line in lines[1:]), lit(lines[0], EVEN, 9.0)) - 100.0 * (len(lines) - 1)
    given = (0.9,) * len(lines)
    assert judged(given, lines, pixels).max() == 0.0
    assert judged(given, lines, pixels, psf_sigma_px=1.2).min() > 0.5
