"""The picture about a line: numbers that neither exposure nor stretch changes, and that tell sky from ground."""

import numpy as np
import pytest
from numpy.typing import NDArray

from ground.vetting.surroundings import NAMES, Picture, Surroundings, numbers_of
from tests.streaks.lit_lines import fit_of_a_trail, placed

SHAPE = (400, 500)
ENDS = (150.0, 140.0, 230.0, 330.0)

Image = NDArray[np.float32]


def sky(seed: int, stars: int = 150) -> Image:
    """White noise and stars of 1.5 px."""
    rng = np.random.default_rng(seed)
    image = rng.normal(100.0, 3.0, SHAPE)
    row, col = np.indices(SHAPE)
    for _ in range(stars):
        r, c = rng.uniform(0, SHAPE[0]), rng.uniform(0, SHAPE[1])
        box = np.s_[max(int(r) - 8, 0) : int(r) + 9, max(int(c) - 8, 0) : int(c) + 9]
        image[box] += 80.0 * np.exp(-0.5 * ((row[box] - r) ** 2 + (col[box] - c) ** 2) / 1.5**2)
    return image.astype(np.float32)


def line(ends: tuple[float, float, float, float] = ENDS, height: float = 20.0) -> Image:
    """Light of a trail of 1.3 px between two points."""
    row, col = np.indices(SHAPE)
    start, stop = np.array(ends[:2]), np.array(ends[2:])
    length = float(np.linalg.norm(stop - start))
    u = ((row - start[0]) * (stop[0] - start[0]) + (col - start[1]) * (stop[1] - start[1])) / length
    v = ((row - start[0]) * (stop[1] - start[1]) - (col - start[1]) * (stop[0] - start[0])) / length
    return (height * np.exp(-0.5 * (v / 1.3) ** 2) * ((u > 0) & (u < length))).astype(np.float32)


def seen(image: Image, ends: tuple[float, ...] = ENDS) -> dict[str, float]:
    """The numbers by name."""
    return dict(zip(NAMES, numbers_of(Picture.of(image, np.zeros(SHAPE, np.uint8)), ends).tolist(), strict=True))


def test_neither_exposure_nor_level_nor_direction_changes_them() -> None:
    image = sky(1) + line()
    there = seen(image)
    assert seen(7.0 * image + 1000.0) == pytest.approx(there, abs=0.01)
    assert seen(image, ENDS[2:] + ENDS[:2]) == pytest.approx(there, abs=0.02)


def test_each_number_tells_what_it_is_for() -> None:
    """A trail among stars against: a rough neighbourhood, one that goes on, stripes, one in pieces, a hill, no star."""
    trail = seen(sky(2) + line())
    row, col = np.indices(SHAPE)
    rng = np.random.default_rng(3)
    rough = sky(2) + line() + (60.0 * (rng.random(SHAPE) < 0.04)).astype(np.float32)
    assert seen(rough)["unrest"] > trail["unrest"] + 0.2
    goes_on = tuple(np.array(ENDS) + 0.4 * np.array([ENDS[0] - ENDS[2], ENDS[1] - ENDS[3], ENDS[2] - ENDS[0], ENDS[3] - ENDS[1]]))
    assert abs(trail["beyond"]) < 0.3
    assert seen(sky(2) + line(goes_on))["beyond"] > 0.6
    across = ((row - ENDS[0]) * (ENDS[3] - ENDS[1]) - (col - ENDS[1]) * (ENDS[2] - ENDS[0])) / 206.0
    stripes = sky(2) + line() + (15.0 * np.sin(across / 3.0)).astype(np.float32)
    assert seen(stripes)["texture_ln"] < trail["texture_ln"] - 0.3
    along = ((row - ENDS[0]) * (ENDS[2] - ENDS[0]) + (col - ENDS[1]) * (ENDS[3] - ENDS[1])) / 206.0
    assert seen(sky(2) + line() * (np.sin(along / 6.0) > 0.0))["unevenness"] > trail["unevenness"] + 0.3
    hill = np.where(row > 260 + 30 * np.sin(col / 25.0), 0.0, sky(2) + line()).astype(np.float32)
    assert seen(hill)["structure_ln"] > trail["structure_ln"] + 0.3
    assert seen(sky(2, stars=0) + line())["peaks_ln"] < trail["peaks_ln"] - 0.5
    assert trail["border_share"] == pytest.approx((235.0 + 0.5) / 500.0, abs=1e-6)


def test_a_fit_has_the_numbers_of_the_nearest_line_whichever_way_it_runs() -> None:
    picture = Picture.of(sky(4) + line(), np.zeros(SHAPE, np.uint8))
    other = (20.0, 20.0, 60.0, 90.0)
    told = Surroundings.of(picture, [other, ENDS])
    reversed_fit = placed(fit_of_a_trail(), (231.0, 329.0, 151.0, 138.0), 1.3, 50.0)
    assert told.about([reversed_fit])[0] == pytest.approx(told.numbers[1])
    assert np.isnan(Surroundings().about([reversed_fit])).all()


def test_what_no_pixel_saw_is_as_dark_as_the_sky_and_frames_of_nothing_do_no_harm() -> None:
    """A masked half, a line that reaches out of the frame, a line of no length, a frame without any pixel, one of two rows."""
    image = sky(5) + line()
    mask = np.zeros(SHAPE, np.uint8)
    mask[:, 400:] = 1
    image[:, 400:] = 1e9
    assert np.isfinite(numbers_of(Picture.of(image, mask), ENDS)).all()
    for ends in ((-50.0, -80.0, 30.0, 40.0), (10.0, 10.0, 10.0, 10.0), (-900.0, -900.0, -950.0, -990.0)):
        assert np.isfinite(numbers_of(Picture.of(sky(5), np.zeros(SHAPE, np.uint8)), ends)).all()
    assert np.isfinite(numbers_of(Picture.of(image, np.ones(SHAPE, np.uint8)), ENDS)).all()
    assert np.isfinite(numbers_of(Picture.of(image[:2], mask[:2]), (0.0, 10.0, 1.0, 60.0))).all()
