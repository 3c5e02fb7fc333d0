"""Light that rises and falls along a line, and half lines of video along a border."""

from dataclasses import replace

import numpy as np
import pytest

from ground.vetting.contrast import Contrast
from ground.vetting.meteors import IN_FAVOUR, for_meteor
from ground.vetting.rise_and_fall import rise_and_fall
from sboc_e2e.icd.products import StreakFit
from tests.streaks.lit_lines import EVEN, METEOR, fit_of_a_trail, judged, lit, placed, tiles


@pytest.fixture(scope="module")
def drawn() -> StreakFit:
    """A fit of a trail of no place yet."""
    return fit_of_a_trail()


def in_favour(fit: StreakFit, pixels: np.ndarray) -> float:
    """Odds for a line in an image."""
    around = tiles(pixels, fit)
    return for_meteor(fit, around, Contrast.of(fit, around))


def test_a_fireball_rises_and_falls_and_a_roof_a_row_of_lamps_and_a_faint_line_do_not(drawn: StreakFit) -> None:
    fireball = placed(drawn, (60.0, 100.0, 200.0, 240.0), 5.0, 800.0)
    assert in_favour(fireball, lit(fireball, METEOR, 200.0)) == IN_FAVOUR
    assert in_favour(fireball, lit(fireball, EVEN, 200.0)) == 1.0
    lamps = METEOR * (1.0 + 0.6 * np.sin(np.linspace(0.0, 30.0, 400)))
    assert in_favour(fireball, lit(fireball, lamps, 200.0)) == 1.0
    faint = replace(fireball, snr=50.0)
    assert in_favour(faint, lit(fireball, METEOR, 200.0)) == 1.0
    short = placed(drawn, (60.0, 100.0, 75.0, 110.0), 5.0, 800.0)
    assert in_favour(short, lit(short, METEOR, 200.0)) == 1.0, "too few cells"


def test_a_fireball_that_flares_is_no_chance_order(drawn: StreakFit) -> None:
    """One of S/N 1,311 flares twice and leaves 5.4 % of its height: p 0.27. The same lights in another order are no meteor."""
    fireball = placed(drawn, (60.0, 100.0, 200.0, 330.0), 5.0, 1300.0)
    first, second = (0, 20, 30, 10, 20, 28, 42, 44, 36, 47, 63, 72, 69, 81, 90, 93, 93, 78), (66, 64, 72, 85, 91, 99, 100, 99, 67)
    flares = np.array([*first, *second], dtype=float)
    assert in_favour(fireball, lit(fireball, flares, 2.0)) == IN_FAVOUR
    mixed = np.concatenate([flares[:1], np.random.default_rng(3).permutation(flares[1:])])
    assert in_favour(fireball, lit(fireball, mixed, 2.0)) == 1.0


def test_the_best_rise_and_fall_leaves_nothing_of_one_and_half_of_a_dip() -> None:
    rises = np.array([1.0, 2.0, 5.0, 4.0, 0.5])
    assert np.array_equal(rise_and_fall(rises), rises)
    assert np.array_equal(rise_and_fall(np.array([4.0, 2.0, 5.0, 1.0])), [3.0, 3.0, 5.0, 1.0])


def test_a_half_line_of_video_is_none_however_well_it_stands_out(drawn: StreakFit) -> None:
    """Three of these, 640 to 700 px long, had p of 0.51 to 0.64: each piece of them wins."""
    border, inside = (placed(drawn, (4.0 + row, 12.0, row, 690.0), 1.5, 80.0) for row in (0.0, 150.0))
    assert judged((0.96,), [border], lit(border, EVEN, 10.0))[0] < 0.05
    assert judged((0.96,), [inside], lit(inside, EVEN, 10.0))[0] > 0.8


def test_a_half_line_of_video_does_not_tell_how_sharp_the_optics_are(drawn: StreakFit) -> None:
    """Three meteors of 60 to 121 px, 0.5 to 0.8 px wide, had p of 0.006 to 0.10: a half line of 1.9 to 2.6 px told the optics."""
    border = placed(drawn, (4.0, 12.0, 0.0, 690.0), 2.4, 80.0)
    meteor = placed(drawn, (100.0, 300.0, 160.0, 405.0), 0.6, 90.0)
    pixels = lit(border, EVEN, 10.0) + lit(meteor, EVEN, 25.0) - 100.0
    assert judged((0.96, 0.4), [border, meteor], pixels)[1] > 0.8


def test_a_line_that_is_hardly_one_does_not_tell_how_sharp_the_optics_are(drawn: StreakFit) -> None:
    """Nine meteors of 0.3 to 0.6 px were refused for a band along a fisheye's rim, 7 px wide, of p 0.016."""
    band = placed(drawn, (230.0, 20.0, 210.0, 640.0), 7.0, 220.0)
    meteor = placed(drawn, (50.0, 300.0, 110.0, 405.0), 0.4, 120.0)
    pixels = lit(band, EVEN, 3.0) + lit(meteor, EVEN, 25.0) - 100.0
    assert judged((0.016, 0.4), [band, meteor], pixels)[1] > 0.8
    assert judged((0.9, 0.4), [band, meteor], pixels)[1] < 0.1, "one that is probable does"
