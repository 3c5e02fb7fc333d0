"""Dead parts of the detector: found where there is noise around them, and nowhere else."""

import numpy as np
import pytest

from onboard.image.dead_area import TILE_PX, dead_tiles, mark_dead_area
from sboc_e2e.icd.flags import MaskBit

SHAPE = (200, 333)


def sky(sigma_adu: float) -> np.ndarray:
    return np.rint(np.random.default_rng(5).normal(100.0, sigma_adu, SHAPE)).astype(np.uint16)


def marked_in(pixels: np.ndarray) -> np.ndarray:
    defects = np.zeros(SHAPE, dtype=np.uint8)
    mark_dead_area(defects, pixels, 60000)
    return defects


@pytest.mark.parametrize("sigma_adu", [0.5, 2.4, 50.0])
def test_a_dead_corner_is_masked_and_nothing_else(sigma_adu: float) -> None:
    pixels = sky(sigma_adu)
    pixels[96:, 160:] = 100
    marked = marked_in(pixels)
    assert np.all(marked[96:, 160:] == MaskBit.DEAD)
    assert not marked[:96].any()
    assert not marked[:, :160].any()


@pytest.mark.parametrize("pixels", [sky(2.4), np.full(SHAPE, 100, np.uint16), sky(0.1)], ids=["healthy", "constant", "no noise"])
def test_a_frame_without_dead_parts_keeps_its_map(pixels: np.ndarray) -> None:
    assert not marked_in(pixels).any()


def test_saturated_parts_are_not_dead() -> None:
    pixels = sky(2.4)
    pixels[64:128, 64:128] = 65535
    assert not marked_in(pixels).any()


@pytest.mark.parametrize("shape", [(1, 1), (3, 70), (64, 5), (33, 33)])
def test_odd_shapes(shape: tuple[int, int]) -> None:
    pixels = np.random.default_rng(2).poisson(50, shape).astype(np.uint16)
    assert dead_tiles(pixels).shape == (-(-shape[0] // TILE_PX), -(-shape[1] // TILE_PX))
