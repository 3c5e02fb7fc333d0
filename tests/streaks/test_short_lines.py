"""Short lines of a frame that stands alone: how they are judged, and that they speak against others of their kind."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ground.vetting.contrast import Contrast
from ground.vetting.meteors import IN_FAVOUR, for_meteor
from ground.vetting.short_lines import AGAINST, KIND, SHORT_PX, SHORTEST_PX, against_short_lines
from sboc_e2e.icd.products import StreakFit
from tests.streaks.lit_lines import EVEN, METEOR, fit_of_a_trail, judged_by, lit, placed, tiles


@pytest.fixture(scope="module")
def drawn() -> StreakFit:
    """A fit of a trail of no place yet."""
    return fit_of_a_trail()


def line(fit: StreakFit, length_px: float, *, row: float = 150.0, width_px: float = 0.8, snr: float = 80.0) -> StreakFit:
    """Along a slope of one in four, from a place at the left."""
    down, right = length_px / math.sqrt(17.0), 4.0 * length_px / math.sqrt(17.0)
    return placed(fit, (row, 100.0, row + down, 100.0 + right), width_px, snr)


def test_a_short_line_counts_as_far_as_it_is_of_a_kind(drawn: StreakFit) -> None:
    """By hand: exp(-1/2) for a sigma of each of S/N, length and width; a brighter one counts as one that is as bright."""
    fit = line(drawn, 30.0)
    at_width = math.sqrt((0.8**2 + 1.0 / 12.0) * math.exp(2.0 * KIND[2]) - 1.0 / 12.0)
    cases = (
        (line(drawn, 30.0), 1.0),
        (line(drawn, 30.0 * math.exp(-KIND[1])), math.exp(-0.5)),
        (line(drawn, 30.0, snr=80.0 * math.exp(-KIND[0])), math.exp(-0.5)),
        (line(drawn, 30.0, snr=4000.0), 1.0),
        (line(drawn, 30.0, width_px=at_width), math.exp(-0.5)),
    )
    for short, share in cases:
        told = against_short_lines([fit, short], np.array([False, True]))
        assert told[0] == pytest.approx(AGAINST * share, rel=1e-6)
        assert told[1] == 0.0, "none speaks against itself"
    lines = [fit, line(drawn, 300.0), *(short for short, _ in cases)]
    together = against_short_lines(lines, np.arange(len(lines)) >= 2)
    assert together[0] == pytest.approx(AGAINST * sum(share for _, share in cases), rel=1e-6)
    assert together[1] < 0.02 * together[0], "ten times as long"
    assert against_short_lines([fit], np.array([False])).tolist() == [0.0]
    assert against_short_lines([], np.zeros(0, dtype=bool)).shape == (0,)


class Constant:
    """A vetter that gives every line one probability and counts those it was asked about."""

    def __init__(self, probability: float) -> None:
        self.given = probability
        self.asked: list[int] = []

    def probability(self, fits: Any, _frame: Any) -> np.ndarray:
        """The same for all."""
        self.asked.append(len(fits))
        return np.full(len(fits), self.given)


def judged(fits: list[StreakFit], pixels: np.ndarray, *, alone: bool = True) -> tuple[np.ndarray, list[int]]:
    """Probabilities of the fits of a frame, and how many of them the vetter was asked about."""
    vetter = Constant(0.9)
    return judged_by(vetter, fits, pixels, 0.8, alone=alone), vetter.asked


def test_many_short_lines_veto_one_that_is_little_longer_and_no_long_one(drawn: StreakFit) -> None:
    """In a Hubble picture with 366 short lines two tracks of 58 and 71 px were published."""
    little, long = line(drawn, 28.0), line(drawn, 280.0, row=40.0)
    pixels = lit(little, EVEN, 30.0) + lit(long, EVEN, 30.0) - 100.0
    few = [line(drawn, 12.0 + k, row=200.0) for k in range(2)]
    many = [line(drawn, 12.0 + 0.25 * k, row=200.0) for k in range(48)]
    without, asked = judged([little, long], pixels)
    assert asked == [2]
    assert min(without) > 0.8
    beside, asked = judged([*few, little, long], pixels)
    assert asked == [4, 2], "short lines do not count among the classes of the others"
    assert max(beside[:2]) < 1e-3, "no light where they lie"
    assert beside[2] > 0.75
    crowd, _ = judged([*many, little, long], pixels)
    assert max(crowd[:48]) < 1e-3
    assert crowd[48] < 0.5
    assert crowd[49] == pytest.approx(without[1], abs=0.02)


def test_a_short_line_is_judged_by_how_it_stands_out(drawn: StreakFit) -> None:
    """Satellites of 17 to 25 px in a phone's picture are 0.4 to 0.5 px wide. A pair of stars is as wide as the stars."""
    narrow, wide = (line(drawn, 22.0, width_px=w) for w in (0.45, 1.4))
    assert narrow.length_px < SHORT_PX
    assert judged([narrow], lit(narrow, EVEN, 40.0))[0][0] > 0.5
    assert judged([wide], lit(wide, EVEN, 40.0))[0][0] < 0.5
    assert judged([narrow], lit(wide, EVEN, 40.0))[0][0] < 0.5, "the light beside it is as bright"
    crowd = [narrow, *(line(drawn, 15.0 + 0.2 * k, row=200.0, width_px=0.45) for k in range(48))]
    assert judged(crowd, lit(narrow, EVEN, 40.0))[0][0] < 0.3
    shortest = line(drawn, SHORTEST_PX - 1.0, width_px=0.2)
    assert judged([shortest], lit(shortest, EVEN, 40.0))[0].tolist() == [0.0]
    assert judged([shortest, line(drawn, SHORTEST_PX - 2.0)], lit(shortest, EVEN, 40.0))[0].tolist() == [0.0, 0.0]


def test_a_short_line_that_rises_and_falls_is_no_meteor_for_that(drawn: StreakFit) -> None:
    """Stars rise and fall too."""
    for length, gains in ((SHORT_PX - 1.0, False), (40.0, True)):
        fit = line(drawn, length, width_px=0.9, snr=200.0)
        pixels = {"even": lit(fit, EVEN, 60.0), "rises and falls": lit(fit, METEOR, 60.0)}
        seen = tiles(pixels["rises and falls"], fit)
        assert for_meteor(fit, seen, Contrast.of(fit, seen)) == IN_FAVOUR
        odds = {name: p / (1.0 - p) for name, p in ((name, judged([fit], light)[0][0]) for name, light in pixels.items())}
        assert (odds["rises and falls"] > 2.0 * odds["even"]) == gains


def test_where_stars_are_told_from_movers_short_lines_are_as_others(drawn: StreakFit) -> None:
    short = line(drawn, SHORT_PX - 5.0)
    pixels = lit(short, EVEN, 30.0)
    probability, asked = judged([short], pixels, alone=False)
    assert asked == [1]
    assert probability[0] > 0.3
    few, asked = judged([short, line(drawn, 60.0, row=40.0)], pixels, alone=False)
    assert asked == [2]
    assert few[0] > 0.3
    just_long = replace(short, col1=short.col1 + 6.0)
    assert judged([just_long], lit(just_long, EVEN, 30.0))[0][0] > 0.5


def test_a_line_as_faint_as_noise_is_refused_where_no_other_frame_tells(drawn: StreakFit) -> None:
    """A chain of galaxies, found by its stars' light, had S/N 6.5 in the fit and p 0.67."""
    for snr, published in ((6.5, False), (9.0, True)):
        fit = line(drawn, 120.0, width_px=0.9, snr=snr)
        assert (judged([fit], lit(fit, EVEN, 30.0))[0][0] > 0.5) == published
    faint = line(drawn, 120.0, width_px=0.9, snr=6.5)
    assert judged([faint], lit(faint, EVEN, 30.0), alone=False)[0][0] > 0.0
