"""Peaks above a threshold that follows the noise."""

import numpy as np
import pytest

from onboard.stars.peaks import find_peaks, gaussian_kernel

TILE_PX, TILES = 64, 8


@pytest.mark.parametrize("loud", [0, 3, 7])
@pytest.mark.parametrize("axis", [0, 1])
def test_a_threshold_is_that_of_the_noise_at_a_peak(loud: int, axis: int) -> None:
    """A peak of 10 in the middle of each tile, noise 5 but for one row or column of tiles with 20, threshold 1 sigma.

    Along rows the threshold was that of the next tile, and in the last tile what the slope before it led to.
    """
    kernel = gaussian_kernel(1.0)
    residual = np.zeros((TILE_PX * TILES, TILE_PX * TILES), np.float32)
    middles = TILE_PX * np.arange(TILES) + TILE_PX // 2
    residual[np.ix_(middles, middles)] = 10.0 / kernel[0] ** 2
    sigma = np.full((TILES, TILES), 5.0, np.float32)
    np.moveaxis(sigma, axis, 0)[loud] = 20.0
    peaks = np.empty((1000, 5), np.float32)
    n = find_peaks(residual, sigma, TILE_PX, kernel, 1.0, peaks)
    found = {(int(row) // TILE_PX, int(col) // TILE_PX) for row, col in peaks[:n, :2]}
    assert found == {(i, j) for i in range(TILES) for j in range(TILES) if (i, j)[axis] != loud}
