"""The dark map: whatever its spread, each pixel comes back as it was rounded."""

import numpy as np
import pytest
from numpy.typing import NDArray

from onboard.image.dark_map import DarkMap, whole_at


def rounded(dark_adu: NDArray[np.float32]) -> tuple[NDArray[np.int16], NDArray[np.int8]]:
    """Whole ADU and the rest in 1/128 ADU by plain NumPy."""
    whole = np.clip(np.rint(dark_adu), -32768, 32767).astype(np.int16)
    return whole, np.rint(np.clip(dark_adu - whole, -0.5, 0.5) * 128.0).astype(np.int8)


def dark_of(spread_adu: float) -> NDArray[np.float32]:
    """Columns of their own, noise, hot pixels, and many exact halves, which are rounded to even."""
    rng = np.random.default_rng(int(10 * spread_adu))
    shape = (150, 201)
    dark = 100.0 + rng.normal(0.0, 10.0, shape[1]) + rng.normal(0.0, spread_adu, shape)
    dark[rng.random(shape) < 0.01] += 40000.0 * rng.random()
    return np.where(rng.random(shape) < 0.2, np.floor(dark) + 0.5, dark).astype(np.float32)


@pytest.mark.parametrize(("spread_adu", "code_bytes"), [(0.0, 1), (0.2, 1), (5.0, 2), (1000.0, 2)])
def test_every_pixel_comes_back(spread_adu: float, code_bytes: int) -> None:
    """Written out, pixel by pixel, and in a window that begins inside of a band."""
    dark_adu = dark_of(spread_adu)
    whole, fraction = rounded(dark_adu)
    dark = DarkMap.of(dark_adu)
    assert dark.codes[0].itemsize == code_bytes
    assert (dark.whole_adu() == whole).all()
    assert (dark.fractions() == fraction).all()
    part = dark.window(37, 11, (90, 150))
    assert (part.whole_adu() == whole[37:127, 11:161]).all()
    assert (part.fractions() == fraction[37:127, 11:161]).all()
    assert all(whole_at(part.codes, row, col) == whole[37 + row, 11 + col] for row in range(0, 90, 7) for col in range(150))


def test_fractions_alone() -> None:
    """The map under a float frame, whose whole ADU are already gone."""
    fraction = rounded(dark_of(0.2))[1]
    dark = DarkMap.of_fractions(fraction)
    assert (dark.fractions() == fraction).all()
    assert not dark.whole_adu().any()
