"""Lines in a landscape and in the sky, drawn here: what is beside them tells."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from ground.vetting.contrast import Tiles
from ground.vetting.texture import ODDS, for_texture, share_of_texture

SIDE, NOISE = 256, 3.0


def line(row0: float, col0: float, row1: float, col1: float, width_px: float = 1.0) -> Any:
    """A fit from end to end."""
    ends = {"row0": row0, "col0": col0, "row1": row1, "col1": col1, "length_px": float(np.hypot(row1 - row0, col1 - col0))}
    return type("Fit", (), ends | {"width_px": width_px})()


def tiles(light: NDArray[np.float64], *lines: Any) -> Tiles:
    """Counts around lines of a picture with noise."""
    image = (light + np.random.default_rng(3).normal(100.0, NOISE, light.shape)).astype(np.float32)
    return Tiles.of(image, np.zeros(image.shape, np.uint8), [(each.row0, each.col0, each.row1, each.col1) for each in lines])


def stars(n: int, height: float) -> NDArray[np.float64]:
    """Light of stars at random places."""
    row, col = np.mgrid[:SIDE, :SIDE].astype(float)
    light = np.zeros((SIDE, SIDE))
    for r, c in np.random.default_rng(8).uniform(0.0, SIDE, (n, 2)):
        light += height * np.exp(-0.5 * ((row - r) ** 2 + (col - c) ** 2) / 1.2**2)
    return light


def test_a_line_among_ribs_and_bushes_is_one_of_the_landscape() -> None:
    """Ribs of a dome, and patches of light and shadow."""
    row, col = np.mgrid[:SIDE, :SIDE].astype(float)
    pole = line(60.0, 100.0, 130.0, 110.0)
    for light in (60.0 * np.sin(2.0 * np.pi * col / 9.0), 60.0 * np.sign(np.sin(row / 3.0) * np.sin(col / 2.0 + row / 9.0))):
        assert share_of_texture(pole, tiles(light, pole), NOISE) > 0.1
        assert for_texture(pole, tiles(light, pole), NOISE) == ODDS


@pytest.mark.parametrize("light", [stars(0, 0.0), stars(250, 100.0), 0.5 * np.mgrid[:SIDE, :SIDE][0].astype(float)])
def test_noise_stars_and_slopes_are_none(light: NDArray[np.float64]) -> None:
    trail = line(40.0, 60.0, 210.0, 200.0)
    assert share_of_texture(trail, tiles(light, trail), NOISE) < 0.02
    assert for_texture(trail, tiles(light, trail), NOISE) == 1.0


def test_where_nothing_is_known_nothing_is_said() -> None:
    row = np.mgrid[:SIDE, :SIDE][0].astype(float)
    light, here, far = 60.0 * np.sin(row), line(40.0, 60.0, 100.0, 60.0), line(200.0, 200.0, 250.0, 250.0)
    assert share_of_texture(here, tiles(light, here), 0.0) == 0.0
    assert share_of_texture(far, tiles(light, here), NOISE) == 0.0
    assert share_of_texture(line(40.0, 60.0, 40.0, 60.0), tiles(light, here), NOISE) == 0.0
    assert share_of_texture(line(40.0, 60.0, 100.0, 60.0, width_px=8.0), tiles(light, here), NOISE) == 0.0
