"""A trail stands out of the lines beside it; branches, clouds and compressed noise are among many like them."""

import math
from typing import Any

import numpy as np
import pytest
import scipy.ndimage
from numpy.typing import NDArray

from ground.vetting.beside import against_beside, surpassed_by_chance
from ground.vetting.contrast import Tiles

SIDE, NOISE, WIDTH = 256, 10.0, 0.9
ENDS = (60.0, 50.0, 170.0, 200.0)
LENGTH = math.hypot(110.0, 150.0)


def fit(snr: float, aside: float = 0.0) -> Any:
    """A fit of the line, or of one beside it."""
    d_row, d_col = 110.0 / LENGTH, 150.0 / LENGTH
    ends = {"row0": ENDS[0] + aside * d_col, "col0": ENDS[1] - aside * d_row}
    ends |= {"row1": ENDS[2] + aside * d_col, "col1": ENDS[3] - aside * d_row}
    shape = {"length_px": LENGTH, "width_px": WIDTH, "sagitta_px": 0.0, "angle_deg": math.degrees(math.atan2(110.0, 150.0))}
    return type("Fit", (), ends | shape | {"snr": snr})()


def across(aside: float = 0.0) -> NDArray[np.float64]:
    """Distance of each pixel from the line."""
    row, col = np.mgrid[:SIDE, :SIDE].astype(float)
    return np.asarray((row - ENDS[0]) * 150.0 / LENGTH - (col - ENDS[1]) * 110.0 / LENGTH - aside)


def light(snr: float, aside: float = 0.0) -> NDArray[np.float64]:
    """Of a line with this S/N in white noise."""
    width = math.hypot(WIDTH, 12.0**-0.5)
    height = snr * NOISE / math.sqrt(LENGTH * math.sqrt(math.pi) * width)
    return np.asarray(height * np.exp(-0.5 * (across(aside) / width) ** 2))


def tiles(image: NDArray[np.float64], seed: int) -> Tiles:
    """Counts about the line in white noise."""
    noisy = 1_000.0 + image + np.random.default_rng(seed).normal(0.0, NOISE, image.shape)
    return Tiles.of(noisy, np.zeros(image.shape, np.bool_), [ENDS])


def branches(seed: int) -> NDArray[np.float64]:
    """Structure as bright as a line of S/N 40, along the line and to both its sides."""
    rng = np.random.default_rng(seed)
    at = np.interp(across(), np.arange(-200.0, 200.0), scipy.ndimage.gaussian_filter1d(rng.normal(0.0, 1.0, 400), 1.0))
    return np.asarray(light(40.0).max() * at / at.std())


@pytest.mark.parametrize("snr", [8.0, 20.0, 90.0])
def test_a_trail_in_white_noise_stays(snr: float) -> None:
    """Of S/N 8 too, whatever the draw of the noise and of the lines beside it says: these scatter as white noise does."""
    odds = [against_beside(fit(snr), tiles(light(snr), seed), SIDE**2) for seed in range(30)]
    assert max(odds) < 0.1


def test_a_line_among_lines_is_none_and_a_bright_one_among_them_is() -> None:
    found = [against_beside(fit(60.0), tiles(branches(seed) + light(20.0), seed), SIDE**2) for seed in range(20)]
    assert np.median(found) > 100.0
    bright = [against_beside(fit(95.0), tiles(0.15 * branches(seed) + light(95.0), seed), SIDE**2) for seed in range(20)]
    assert np.median(bright) < 0.1
    assert against_beside(fit(600.0), tiles(branches(1) + light(20.0), 1), SIDE**2) == 0.0


def test_the_other_trails_of_a_train_are_no_scatter() -> None:
    """Five satellites side by side, 6 px apart."""
    places = (-12.0, -6.0, 6.0, 12.0, 18.0)
    image = light(90.0) + np.sum([light(90.0, aside) for aside in places], axis=0)
    train = [fit(90.0, aside) for aside in places]
    assert against_beside(fit(90.0), tiles(image, 3), SIDE**2) > 100.0
    assert against_beside(fit(90.0), tiles(image, 3), SIDE**2, train) < 1.0


def test_what_is_not_seen_says_nothing() -> None:
    """Wide lines, for which the tiles hold too few others, and places outside of all tiles."""
    wide, elsewhere = fit(90.0), fit(90.0, 300.0)
    wide.width_px = 9.0
    for line in (wide, elsewhere):
        assert surpassed_by_chance(line, tiles(light(10.0), 1)) == 0.0
