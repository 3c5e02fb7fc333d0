"""Centroids of rendered stars against truth, for images without noise and sky."""

import numpy as np
import pytest
from numpy.typing import NDArray


def check_places(image_e: NDArray[np.float64], stars: NDArray[np.void], limit_px: float) -> int:
    """Assert places (to `limit_px`) and flux (2e-3) of the stars that stand alone; how many these are."""
    at, checked = np.arange(-9, 10), 0
    for star in stars:
        alone = np.hypot(stars["row"] - star["row"], stars["col"] - star["col"]) > 25.0
        r, c = round(float(star["row"])), round(float(star["col"]))
        if alone.sum() < len(stars) - 1 or not (12 < r < image_e.shape[0] - 12 and 12 < c < image_e.shape[1] - 12):
            continue
        box = image_e[r - 9 : r + 10, c - 9 : c + 10]
        if box.sum() > 1.002 * star["flux_e"]:  # a star too faint for the truth table lies in the box
            continue
        assert abs((box.sum(axis=1) @ at) / box.sum() + r - star["row"]) < limit_px
        assert abs((box.sum(axis=0) @ at) / box.sum() + c - star["col"]) < limit_px
        assert box.sum() == pytest.approx(star["flux_e"], rel=2e-3)
        checked += 1
    return checked
