"""Four or six equal arms on bright stars, drawn here: lines on them are spikes."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from ground.vetting.crosses import Cross, Crosses
from ground.vetting.spikes import BrightStars
from tests.streaks.lit_lines import EVEN, SHAPE, fit_of_a_trail, judged, lit, placed

SIDE, NOISE, FULL = 400, 3.0, 250.0
PLACES = np.array([[100.0, 110.0], [300.0, 120.0], [210.0, 290.0]])
"""Row and column of the stars that are drawn, px."""
ANGLE_RAD = math.radians(20.0)
"""Of the first arm, from rows towards columns."""


def sky(seed: int, *, arms: int = 0, height: float = 60.0, places: NDArray[np.float64] = PLACES) -> Crosses:
    """The crosses of a field of full stars, each with so many arms, of 70 px, `height` in their middle."""
    row, col = np.mgrid[:SIDE, :SIDE].astype(float)
    light = np.zeros((SIDE, SIDE))
    for r, c in places:
        distance = np.hypot(row - r, col - c)
        light += 900.0 * np.exp(-0.5 * (distance / 3.0) ** 2) + 20.0 * np.exp(-distance / 15.0)
        for k in range(arms):
            along_row, along_col = math.cos(ANGLE_RAD + 2.0 * math.pi * k / arms), math.sin(ANGLE_RAD + 2.0 * math.pi * k / arms)
            along, across = (row - r) * along_row + (col - c) * along_col, (row - r) * along_col - (col - c) * along_row
            light += height * np.exp(-0.5 * across**2) * (along > 0.0) * (along < 70.0)
    image = np.minimum(light + np.random.default_rng(seed).normal(20.0, NOISE, light.shape), FULL).astype(np.float32)
    flux = np.full(len(places), 1e4, np.float32)
    return Crosses.of(image, np.zeros(image.shape, np.uint8), BrightStars.of(*places.T, flux, float(image.size)))


def line(star: NDArray[np.float64], angle_rad: float, first: float, last: float, aside: float = 0.0) -> Any:
    """A fit from one distance of a star to another, `aside` px beside the way to its centre."""
    way = np.array([math.cos(angle_rad), math.sin(angle_rad)])
    start, stop = (star + d * way + aside * np.array([-way[1], way[0]]) for d in (first, last))
    ends = {"row0": start[0], "col0": start[1], "row1": stop[0], "col1": stop[1], "length_px": last - first}
    return type("Fit", (), ends | {"chi2_nu": 1.0, "covariance_px2": 0.01 * np.eye(4)})()


@pytest.mark.parametrize("arms", [4, 6])
def test_a_line_on_an_arm_is_a_spike_and_one_between_two_is_not(arms: int) -> None:
    """Through a full star or on one side of it; 8 px beside the star, or half way between two arms, it may be anything."""
    crosses = sky(1, arms=arms)
    assert {each.arms for each in crosses.stars} == {arms}
    assert len(crosses.stars) == len(PLACES)
    for star in PLACES:
        for angle in (ANGLE_RAD, ANGLE_RAD + 2.0 * math.pi / arms):
            assert crosses.against(line(star, angle, 15.0, 65.0)) > 10.0
            assert crosses.against(line(star, angle, -60.0, 65.0)) > 10.0
            assert crosses.against(line(star, angle, 15.0, 65.0, aside=8.0)) == 0.0
            assert crosses.against(line(star, angle + math.pi / arms, 15.0, 65.0)) == 0.0
    assert crosses.against(line(PLACES[0], ANGLE_RAD, 0.0, 0.0)) == 0.0


def test_a_star_that_is_listed_as_its_rim_is_found_by_its_light() -> None:
    """One of 36 px in radius had entries on its rim alone, behind a hundred others."""
    row, col = np.mgrid[:SIDE, :SIDE].astype(float)
    distance = np.hypot(row - 200.0, col - 190.0)
    along, across = row - 200.0, col - 190.0
    arms = 80.0 * (np.exp(-0.5 * (along / 3.0) ** 2) + np.exp(-0.5 * (across / 3.0) ** 2)) * (distance < 170.0)
    light = np.where(distance < 30.0, FULL, arms)
    image = np.minimum(light + np.random.default_rng(6).normal(20.0, NOISE, light.shape), FULL).astype(np.int32)
    nothing = BrightStars.of(np.zeros(0), np.zeros(0), np.zeros(0, np.float32), float(image.size))
    (cross,) = Crosses.of(image, np.zeros(image.shape, np.uint8), nothing).stars
    assert math.hypot(cross.row - 200.0, cross.col - 190.0) < 1.0
    assert cross.arms == 4
    assert math.degrees(cross.off(0.0)) < 2.0


def test_full_stars_without_arms_have_no_crosses() -> None:
    """In twenty draws of the noise, each of three stars."""
    assert [len(sky(seed).stars) for seed in range(20)] == [0] * 20


def test_a_trail_through_a_star_makes_no_cross() -> None:
    """Of its four directions two are dark."""
    assert len(sky(3, arms=2, places=PLACES[:1]).stars) == 0


def test_a_star_at_the_border_or_without_light_has_none() -> None:
    places = np.array([[0.0, 200.0], [399.0, 399.0], [-3.0, 50.0]])
    assert len(sky(4, places=places).stars) == 0
    dark, nothing = np.zeros((50, 50), np.float32), np.zeros((50, 50), np.uint8)
    bright = BrightStars.of(np.array([25.0]), np.array([25.0]), np.ones(1, np.float32), 2500.0)
    assert len(Crosses.of(dark, nothing, bright).stars) == 0
    assert len(Crosses.of(dark, np.ones((50, 50), np.uint8), bright).stars) == 0
    assert len(Crosses.of(dark[:5, :5], nothing[:5, :5], bright).stars) == 0


@pytest.mark.parametrize("apart_deg", [90.0, 60.0])
def test_lines_that_cross_at_a_star_as_spikes_do_are_spikes_and_other_pairs_are_none(apart_deg: float) -> None:
    """Two spikes of a star in a nebula, 54 px from the border, had p of 0.99 and 1.00: its arms are as clear as the nebula."""
    crosses = sky(5)
    assert not crosses.stars, "no arms are drawn"
    star, beside = PLACES[0], PLACES[0] + np.array([0.0, 30.0])
    turn = math.radians(apart_deg)
    one, other = line(star, 0.3, -40.0, 90.0), line(star, 0.3 + turn, -60.0, 50.0)
    sure = np.array([0.99, 0.9])
    assert crosses.crossed([one, other], sure).all()
    assert crosses.crossed([one, other, line(PLACES[2], 0.3, -40.0, 90.0)], np.array([0.9, 0.05, 0.9])).tolist() == [
        True,
        True,
        False,
    ]
    assert not crosses.crossed([one, other], np.array([0.99, 0.01])).any(), "nobody believes in the other"
    assert not crosses.crossed([one, line(star, 0.3 + turn + math.radians(8.0), -60.0, 50.0)], sure).any()
    assert not crosses.crossed([one, line(star, 0.3 + turn, -60.0, 50.0, aside=20.0)], sure).any()
    assert not crosses.crossed([line(beside, 0.3, -40.0, 90.0), line(beside, 0.3 + turn, -60.0, 50.0)], sure).any(), "no star"
    assert not crosses.crossed([one, line(star, 0.3 + turn, -3.0, 4.0)], sure).any(), "the core itself"
    assert not crosses.crossed([one], sure[:1]).any()


def test_a_spike_is_none_however_well_it_stands_out() -> None:
    """A spike of 574 px, S/N 295, had odds of 31 against it, and p of 0.96: it won nearly all along."""
    fit = placed(fit_of_a_trail(), (100.0, 150.0, 180.0, 470.0), 1.5, 90.0)
    bright = lit(fit, EVEN, 10.0)
    angle = math.atan2(320.0, 80.0)
    arms = Cross(row=140.0, col=310.0, angle_rad=angle, arms=4, weakest=10.0, radius_px=5.0)
    spiked, crossing = (
        Crosses(stars=[star], area_px2=SHAPE[0] * SHAPE[1]) for star in (arms, replace(arms, angle_rad=angle + 0.5))
    )
    against = spiked.against(fit)
    assert against > 10.0
    assert judged((0.99,), [fit], bright, crosses=spiked)[0] <= 1.0 / (1.0 + against)
    assert judged((0.99,), [fit], bright, crosses=crossing)[0] > 0.9
