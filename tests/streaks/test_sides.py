"""A trail stands above the sky on both of its sides; slopes, rims and edges of light do not."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from ground.vetting.sides import MOST_CELLS, SkyMap

SIDE, NOISE = 512, 20.0
ENDS = (60.0, 80.0, 430.0, 400.0)
"""Row and column of both ends of the line that is judged."""


def across() -> NDArray[np.float64]:
    """Distance of each pixel from the line, px."""
    row, col = np.mgrid[:SIDE, :SIDE].astype(float)
    length = np.hypot(ENDS[2] - ENDS[0], ENDS[3] - ENDS[1])
    d_row, d_col = (ENDS[2] - ENDS[0]) / length, (ENDS[3] - ENDS[1]) / length
    return np.asarray((row - ENDS[0]) * d_col - (col - ENDS[1]) * d_row)


def fit(width_px: float, height: float) -> Any:
    """A fit of the line that claims light of this height in the middle of its profile."""
    length = float(np.hypot(ENDS[2] - ENDS[0], ENDS[3] - ENDS[1]))
    flux = height * np.sqrt(2.0 * np.pi) * np.hypot(width_px, 12.0**-0.5) * length
    ends = dict(zip(("row0", "col0", "row1", "col1"), ENDS, strict=True))
    of = {"length_px": length, "width_px": width_px, "flux_e": flux, "sagitta_px": 0.0, "psf_sigma_px": 1.3}
    return type("Fit", (), ends | of | {"light_curve_e_px": np.zeros(0, np.float32)})()


def refused(light: NDArray[np.float64], width_px: float, height: float, unknown: NDArray[np.bool_] | None = None) -> list[bool]:
    """Of three draws of the noise."""
    out = []
    for seed in range(3):
        image = (1_000.0 + light + np.random.default_rng(seed).normal(0.0, NOISE, light.shape)).astype(np.float32)
        hidden = np.zeros(light.shape, dtype=np.bool_) if unknown is None else unknown
        out.append(SkyMap.of(image, hidden).refuses(fit(width_px, height), 1.0))
    return out


@pytest.mark.parametrize("width_px", [1.3, 8.0])
@pytest.mark.parametrize("slope", [0.0, 3.0])
def test_a_trail_stands_above_both_sides_whatever_the_slope_of_the_sky(width_px: float, slope: float) -> None:
    """Of 0.5 sigma a pixel: S/N 20 and more. A slope of 3 ADU a pixel is 20 times the trail from one side of the map to the
    other."""
    v = across()
    light = 0.5 * NOISE * np.exp(-0.5 * (v / width_px) ** 2)
    assert refused(light + slope * v, width_px, 0.5 * NOISE) == [False] * 3


def test_a_step_of_the_level_is_an_edge() -> None:
    """The slit of a dome: dark on one side, a soft step of 100 ADU. A fit takes the brighter half for a trail."""
    light = 100.0 / (1.0 + np.exp(across() / 6.0))
    assert refused(light, 10.0, 50.0) == [True] * 3


def test_what_is_sharper_than_the_stars_is_no_slope() -> None:
    """A satellite of S/N 508, 0.6 px wide among stars of 0.8 px, was refused: half of its length is faint."""
    light = 100.0 / (1.0 + np.exp(across() / 6.0))
    assert refused(light, 1.6, 50.0) == [True] * 3
    assert refused(light, 1.2, 50.0) == [False] * 3


def test_a_meteor_with_its_light_in_its_head_is_no_slope() -> None:
    """The last tenth is twenty times as bright as the rest, so that the mean is three times the median along the line."""
    row = np.mgrid[:SIDE, :SIDE][0].astype(float)
    share = (row - ENDS[0]) / (ENDS[2] - ENDS[0])
    image = (1_000.0 + np.where(share > 0.9, 2_000.0, 100.0) * np.exp(-0.5 * (across() / 1.3) ** 2)).astype(np.float32)
    meteor = fit(1.3, 290.0)
    sky = SkyMap.of(image + np.random.default_rng(0).normal(0.0, NOISE, image.shape).astype(np.float32), image < 0.0)
    assert sky.refuses(meteor, 1.0)
    density = np.sqrt(2.0 * np.pi) * 1.3
    meteor.light_curve_e_px = (density * np.where(np.arange(40) >= 36, 2_000.0, 100.0)).astype(np.float32)
    assert not sky.refuses(meteor, 1.0)


def test_the_rim_of_a_field_is_an_edge() -> None:
    """A level that is flat and falls off: above a mean of both sides, and not above the flat one."""
    v = across()
    light = np.where(v < 0.0, 0.0, -4.0 * v)
    assert refused(light, 12.0, 40.0) == [True] * 3


def test_a_ridge_that_is_a_slope_for_half_its_length_is_no_trail() -> None:
    """A cloud of stars: as a whole it stands above its sides. An even trail as wide does so in each quarter."""
    v = across()
    row = np.mgrid[:SIDE, :SIDE][0]
    even = 60.0 * np.exp(-0.5 * (v / 10.0) ** 2)
    slope = np.where(v > 0.0, 60.0, 60.0 * np.exp(-0.5 * (v / 10.0) ** 2))
    assert refused(even, 10.0, 60.0) == [False] * 3
    assert refused(np.where(row > 240.0, slope, 2.0 * even), 10.0, 60.0) == [True] * 3


def test_where_the_map_does_not_tell_a_line_stays() -> None:
    """A faint narrow line in noise, without light in the map; and a line one of whose sides is masked from its middle on."""
    nothing = np.zeros((SIDE, SIDE))
    assert refused(nothing, 1.3, 0.02 * NOISE) == [False] * 3
    light = 100.0 / (1.0 + np.exp(across() / 6.0))
    assert refused(light, 10.0, 50.0, across() < -4.0) == [False] * 3


@pytest.mark.parametrize(("masked_px", "width_px"), [(15.0, 6.0), (15.0, 10.0), (20.0, 10.0)])
def test_a_side_that_is_seen_for_a_little_way_tells_its_level(masked_px: float, width_px: float) -> None:
    """The rim of a window in daylight: full pixels beyond some 15 px are masked. A trail beside such an area is none."""
    v = across()
    light = 100.0 / (1.0 + np.exp(v / 4.0))
    assert refused(light, width_px, 50.0, v < -masked_px) == [True] * 3
    trail = 50.0 * np.exp(-0.5 * (v / width_px) ** 2)
    assert refused(trail, width_px, 50.0, v < -masked_px) == [False] * 3
    assert refused(trail, width_px, 50.0, v > masked_px) == [False] * 3


def test_the_map_leaves_unknown_pixels_out_and_keeps_its_size() -> None:
    image = np.full((100, 90), 7.0, np.float32)
    hidden = np.zeros(image.shape, dtype=np.bool_)
    image[3, 3], hidden[3, 3], hidden[8:12, 8:12] = 1e6, True, True
    made = SkyMap.of(image, hidden)
    assert made.adu.shape == (25, 22)
    assert made.adu[0, 0] == 7.0
    assert np.isnan(made.adu[2, 2])
    assert SkyMap.of(np.zeros((4096, 2048), np.float32), np.zeros((4096, 2048), np.bool_)).adu.size <= MOST_CELLS
