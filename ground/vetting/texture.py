"""Lines in a landscape: lit roofs, poles, trunks and their shadows stand as clear of what is beside them as trails do.

What is beside them tells. The sky has noise, and stars, which are brighter than what is around them. A landscape is full of
places that are darker and of places that are brighter.
"""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from ground.vetting.contrast import REACH_PX, Tiles
from sboc_e2e.icd.products import StreakFit

FROM_WIDTHS: Final = 4.0
"""Nearest places that are looked at, in widths: a Gaussian has 6e-5 of its light beyond, and a bright one rings."""
LEAST_FROM_PX: Final = 6.0
"""The same in px: narrow trails ring as well. Chosen, not measured."""
FEWEST_PLACES: Final = 8
"""Places on a side, at least."""
BEYOND_PX: Final = 10.0
"""How far before and after its ends they lie."""
MOST_ALONG: Final = 1500
"""Places along a line, at most: a budget of work."""
AROUND: Final = 31
"""Places along the line whose mean on the same side is what is around."""
SIGMAS: Final = 5.0
"""Of the frame's noise by which a place is darker or brighter."""
SHARE: Final = 0.08
"""Share of the places that are darker, and share that are brighter, from which on it is a landscape."""
ODDS: Final = 1.0 / 6.0
"""Of a trail there against a line of the landscape. Of the lines published in 224 real frames 11 of 178 on trails lie there, and
20 of 61 others."""


def share_of_texture(fit: StreakFit, tiles: Tiles, noise_adu: float) -> float:
    """Share of the places beside a line that are darker, or brighter, than what is around them: the less of both.

    0 where the tiles do not tell. noise_adu : of a pixel of the sky.
    """
    length = fit.length_px
    first = max(FROM_WIDTHS * fit.width_px, LEAST_FROM_PX)
    if not length > 0.0 or not noise_adu > 0.0 or not first + FEWEST_PLACES <= REACH_PX:
        return 0.0
    u_row, u_col = (fit.row1 - fit.row0) / length, (fit.col1 - fit.col0) / length
    along = np.arange(-BEYOND_PX, min(length + BEYOND_PX, MOST_ALONG))
    away = np.arange(first, REACH_PX)
    dark = bright = known = 0.0
    for side in (-1.0, 1.0):
        row = fit.row0 + along[:, None] * u_row + side * away * u_col
        col = fit.col0 + along[:, None] * u_col - side * away * u_row
        off = _off_around(np.asarray(tiles.at(row, col), dtype=np.float64)) / noise_adu
        known += float(np.isfinite(off).sum())
        dark += float((off < -SIGMAS).sum())
        bright += float((off > SIGMAS).sum())
    return min(dark, bright) / known if known > 0.0 else 0.0


def _off_around(light: NDArray[np.float64]) -> NDArray[np.float64]:
    """Light of places (n along, m across) less the mean around them, NaN where it is not known."""
    seen = np.isfinite(light)
    total = uniform_filter1d(np.where(seen, light, 0.0).sum(axis=1), AROUND, mode="nearest")
    count = uniform_filter1d(seen.sum(axis=1).astype(np.float64), AROUND, mode="nearest")
    return np.asarray(light - np.where(count > 0.0, total / np.maximum(count, 1e-9), math.nan)[:, None])


def for_texture(fit: StreakFit, tiles: Tiles, noise_adu: float) -> float:
    """Odds of a trail against a line of the landscape."""
    return ODDS if share_of_texture(fit, tiles, noise_adu) >= SHARE else 1.0
