"""A trail has its light all along it; a pair of stars, a row of them and the tail of one have gaps."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from ground.vetting.star_rows import FULL_SNR, LONGEST_PX, ROW_GAPS, Along, Crop, StarField, row_over_trail

SIDE, NOISE, SIGMA, PIXEL = 128, 10.0, 1.2, 12.0**-0.5
ENDS = (40.0, 44.0, 70.0, 84.0)
"""Row and column of both ends: 50 px."""
LENGTH = 50.0


def fit(snr_per_px: float, length_px: float = LENGTH) -> Any:
    """A fit of the line, or of a longer one, with so much light in each pixel of its length."""
    ends = dict(zip(("row0", "col0", "row1", "col1"), ENDS, strict=True))
    flux = snr_per_px * NOISE * (2.0 * np.sqrt(np.pi) * SIGMA) ** 0.5 * length_px
    more = {"length_px": length_px, "width_px": SIGMA, "flux_e": flux, "sagitta_px": 0.0, "snr": snr_per_px * length_px**0.5}
    return type("Fit", (), ends | more | {"psf_sigma_px": SIGMA})()


def gaps_of(line: Any, crop: Crop, gain_e_adu: float) -> float:
    """Gaps of a line that a crop shows."""
    seen = Along.of(line, crop, gain_e_adu)
    assert seen is not None
    return seen.gaps


def image_of(light: NDArray[np.float64], seed: int) -> Crop:
    """Light in each pixel of the line's length (n,), with the same line in noise."""
    row, col = np.mgrid[:SIDE, :SIDE].astype(float)
    image = 1_000.0 + np.random.default_rng(seed).normal(0.0, NOISE, row.shape)
    width2 = SIGMA**2 + PIXEL**2
    for share, flux in zip((np.arange(light.size) + 0.5) / light.size, light, strict=True):
        r, c = ENDS[0] + share * (ENDS[2] - ENDS[0]), ENDS[1] + share * (ENDS[3] - ENDS[1])
        image += flux / (2.0 * np.pi * width2) * np.exp(-0.5 * ((row - r) ** 2 + (col - c) ** 2) / width2)
    return Crop(adu=image.astype(np.float32), row=0, col=0)


def along(snr_per_px: float) -> NDArray[np.float64]:
    """The light of an even line, as `fit` claims it."""
    return np.full(int(LENGTH), fit(snr_per_px).flux_e / LENGTH)


@pytest.mark.parametrize("snr_per_px", [1.5, 5.0, 50.0])
def test_a_trail_has_no_gaps(snr_per_px: float) -> None:
    """S/N of 10 to 350, and a star of three times its light upon it."""
    light = along(snr_per_px)
    assert max(gaps_of(fit(snr_per_px), image_of(light, seed), 1.0) for seed in range(3)) < ROW_GAPS[0]
    light[20] += 3.0 * light.sum()
    assert max(gaps_of(fit(snr_per_px), image_of(light, seed), 1.0) for seed in range(3)) < ROW_GAPS[0]


@pytest.mark.parametrize("places", [(0, 49), (0, 24, 49), (0, 12, 25, 37, 49)])
def test_a_row_of_stars_has_gaps(places: tuple[int, ...]) -> None:
    """Two to five stars with the light of a line of S/N 35."""
    light = np.zeros(int(LENGTH))
    light[list(places)] = fit(5.0).flux_e / len(places)
    assert min(gaps_of(fit(5.0), image_of(light, seed), 1.0) for seed in range(3)) > 0.4


def test_a_slope_of_the_sky_along_a_line_is_no_gap() -> None:
    """Vignetting takes half of the sky from one end of a trail to the other."""
    crop = image_of(along(5.0), 1)
    sloped = Crop(adu=(crop.adu - 10.0 * np.mgrid[:SIDE, :SIDE][1]).astype(np.float32), row=0, col=0)
    assert gaps_of(fit(5.0), sloped, 1.0) < 0.25


def test_gaps_count_by_the_stars_that_the_frame_has() -> None:
    """A tumbling object flashes too: with few stars its gaps say little, in a crowded field they say what it is."""
    light = np.zeros(int(LENGTH))
    light[[0, 49]] = 0.5 * fit(5.0).flux_e
    crop = image_of(light, 1)

    def odds(stars: int) -> float:
        flux = np.full(stars, 0.5 * fit(5.0).flux_e, dtype=np.float32)
        return StarField(flux_e=flux, area_px2=1e6, crops=(crop,)).against(fit(5.0), 1.0)

    assert max(odds(0), odds(1)) < 1e-3
    assert odds(2) < 1.0 < 100.0 < odds(200)
    faint = StarField(flux_e=np.full(5_000, 1.0, dtype=np.float32), area_px2=1e6, crops=(crop,))
    assert faint.against(fit(5.0), 1.0) == 0.0


def odds_of(light: NDArray[np.float64], line: Any, stars: int) -> float:
    """Odds of a row of stars against a trail, with so many stars in a megapixel that are as bright as the whole line."""
    flux = np.full(stars, line.flux_e, dtype=np.float32)
    return StarField(flux_e=flux, area_px2=1e6, crops=(image_of(light, 1),)).against(line, 1.0)


def test_a_meteor_rises_and_falls_and_has_no_dips() -> None:
    """A triangle with its top at 0.3 of the line: rms of what is missing 3^-0.5 of the mean, dips none."""
    share = (np.arange(int(LENGTH)) + 0.5) / LENGTH
    triangle = 2.0 * np.where(share < 0.3, share / 0.3, (1.0 - share) / 0.7)
    light = triangle * fit(20.0).flux_e / LENGTH
    seen = Along.of(fit(20.0), image_of(light, 1), 1.0)
    assert seen is not None
    assert seen.gaps == pytest.approx(3.0**-0.5, abs=0.08)
    assert seen.gaps_for(fit(20.0)) < 0.1
    assert odds_of(light, fit(20.0), 500) < 0.1
    wide = fit(20.0)
    wide.psf_sigma_px = 0.5 * SIGMA
    assert seen.gaps_for(wide) < 0.1, "a meteor, wider than stars: nothing else of forty widths rises and falls so"
    wide.width_px = LENGTH / 24.0
    assert seen.gaps_for(wide) == seen.gaps, "a galaxy from its edge, or a full star"
    wide.snr = 1.1 * FULL_SNR
    assert seen.gaps_for(wide) < 0.1, "a fireball: no full star is 24 widths long"
    wide.width_px = LENGTH / 15.0
    assert seen.gaps_for(wide) == seen.gaps, "as short as the image of a star"


def test_a_star_with_a_tail_keeps_its_gaps() -> None:
    """It rises at one end and falls, and fills little of its length."""
    light = np.exp(-np.arange(int(LENGTH)) / 4.0)
    light *= fit(20.0).flux_e / light.sum()
    seen = Along.of(fit(20.0), image_of(light, 1), 1.0)
    assert seen is not None
    assert seen.gaps_for(fit(20.0)) == seen.gaps > 0.6
    assert odds_of(light, fit(20.0), 500) > 5.0


def test_a_long_lit_line_with_dips_is_no_row_of_stars_where_that_takes_many() -> None:
    """A shutter's dips: twelve of fifty px dark. Stars for all the rest do not lie in a row by chance; two stars do."""
    light = np.full(int(LENGTH), fit(20.0).flux_e / LENGTH)
    for start in (8, 20, 32):
        light[start : start + 6] = 0.0
    assert odds_of(light, fit(20.0), 100) < 0.1
    pair = np.zeros(int(LENGTH))
    pair[[0, -1]] = 0.5 * fit(20.0).flux_e
    assert odds_of(pair, fit(20.0), 100) > 10.0


def test_the_stars_on_a_line_follow_poissons_law() -> None:
    """Twelve lit cells are four stars: a pair, and two or more of the mu others on a strip of four widths."""
    field = StarField(flux_e=np.full(3_000, fit(5.0).flux_e, dtype=np.float32), area_px2=1e6, crops=())
    width = (SIGMA**2 + PIXEL**2) ** 0.5
    mu = 3_000 / 1e6 * LENGTH * 4.0 * width
    assert field.rows(fit(5.0), 12) / field.pairs(fit(5.0)) == pytest.approx(1.0 - np.exp(-mu) * (1.0 + mu), rel=1e-6)
    assert field.rows(fit(5.0), 6) == field.pairs(fit(5.0))


def test_a_full_star_is_no_trail_where_it_is_the_only_one() -> None:
    """A line of S/N 19,600 and 28 px that held one clump of light was published with p 0.72: no star was listed as bright."""
    bright = fit(1000.0)
    clump = np.zeros(int(LENGTH))
    clump[[24, 25]] = 0.5 * bright.flux_e
    none = np.zeros(0, dtype=np.float32)
    assert StarField(flux_e=none, area_px2=1e6, crops=(image_of(clump, 1),)).against(bright, 1.0) > 2.0
    assert StarField(flux_e=none, area_px2=1e6, crops=(image_of(along(1000.0), 1),)).against(bright, 1.0) < 1e-3


def test_a_line_that_ends_on_the_border_is_judged() -> None:
    """Its end lies half a pixel beyond the middle of the last one. None of them was held by a crop."""
    crop = Crop(adu=np.zeros((20, 30), np.float32), row=0, col=0)
    for row, held in ((-0.5, True), (19.5, True), (-0.6, False), (19.6, False)):
        assert crop.holds(np.array([row, 5.0]), np.array([3.0, 29.5])) == held


def test_long_lines_and_lines_that_no_crop_holds_are_not_judged() -> None:
    """Chance makes no long rows, and what was not kept cannot be looked at."""
    flux = np.full(5_000, 1e5, dtype=np.float32)
    crop = image_of(np.zeros(int(LENGTH)), 1)
    assert StarField(flux_e=flux, area_px2=1e6, crops=(crop,)).against(fit(5.0, LONGEST_PX + 1.0), 1.0) == 0.0
    aside = Crop(adu=crop.adu[:60], row=0, col=0)
    assert StarField(flux_e=flux, area_px2=1e6, crops=(aside,)).against(fit(5.0), 1.0) < 0.01


def test_the_odds_turn_where_trails_have_no_such_gaps() -> None:
    """Both densities hold all of their own cases."""
    gaps = np.linspace(0.0, 3.0, 30_001)
    ratio = np.array([row_over_trail(float(each)) for each in gaps])
    assert ratio[gaps < 0.3].max() == 0.0
    assert ratio[gaps > 0.6].min() > 10.0


def test_stars_that_overlap_all_over_a_frame_make_rows_without_gaps() -> None:
    """With 2.9 px of full width: a star in each 8 by 8 px, and one in each 16 by 16 px. Longer and brighter rows are rarer."""

    def rows(pitch_px: float, line: Any) -> float:
        flux = np.full(round(1e6 / pitch_px**2), 0.1 * fit(5.0).flux_e, dtype=np.float32)
        return StarField(flux_e=flux, area_px2=1e6, crops=()).even_rows(line)

    assert rows(8.0, fit(5.0)) > 10.0 > 0.001 > rows(16.0, fit(5.0))
    assert rows(8.0, fit(5.0, 100.0)) < 0.01 * rows(8.0, fit(5.0))
    assert rows(8.0, fit(50.0)) == 0.0


def test_the_crop_around_a_line_is_taken_before_one_that_it_borders() -> None:
    """A brighter line's crop may end at this line's side, and does not tell."""
    light = np.zeros(int(LENGTH))
    light[[0, 49]] = 0.5 * fit(5.0).flux_e
    whole = image_of(light, 1)
    border = Crop(adu=whole.adu[:71], row=0, col=0)
    flux = np.full(200, fit(5.0).flux_e, dtype=np.float32)
    field = StarField(flux_e=flux, area_px2=1e6, crops=(border, whole))
    along = field.along(fit(5.0), 1.0)
    assert along is not None
    assert along.gaps == gaps_of(fit(5.0), whole, 1.0)
