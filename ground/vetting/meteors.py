"""Light that rises once and falls once, evenly and by a large factor: that of a meteor.

A meteor brightens from nothing, and ends. Roofs, wires and edges are as bright at one end as at the other; clouds, branches and
rows of stars are uneven. So this tells a fireball, which full pixels make several times as wide as stars, where its width speaks
against it. Of other lines, satellites among them, it says nothing.
"""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ground.streaks.centre_line import effective_width_px
from ground.vetting.contrast import SIDES, Contrast, Tiles, light_of_pieces
from ground.vetting.rise_and_fall import rise_and_fall
from sboc_e2e.icd.products import StreakFit

LEAST_SNR: Final = 100.0
"""S/N from which a line shows its rise and fall. Chosen: of fainter ones the noise is uneven."""
CELL_WIDTHS: Final = 2.0
"""Length of a cell of light along the line, in widths."""
LEAST_CELL_PX: Final = 3.0
"""Least length of a cell. Chosen, not measured."""
FEWEST_CELLS: Final = 5
"""Least number of cells that tell. Chosen, not measured."""
MOST_CELLS: Final = 64
"""Cells of a line, at most: a budget of work."""

LARGEST_REST: Final = 0.05
"""Root mean square of what is left of the cells' light beside its best rise and fall, over the brightest, at most."""
LEAST_ORDER: Final = 0.25
"""The same, over what is left when the cells stand in any order, at most: a fireball flares, and still is no chance order. Of
lines looked at that fade, with ten cells and more, 12 of 16 trails have less and four others, one of which is a meteor. These
four leave 5 % as well."""
CELLS_OF_ORDER: Final = 10
"""Cells from which on their order tells: 2^(n - 1) of n! orders rise once and fall once, which is 1 in 7,000."""
ORDERS: Final = 32
"""Chance orders that are tried, a budget of work."""
FADED: Final = 0.15
"""Light of one of its ends over the brightest, at most."""
LEAST_WINS: Final = 0.8
"""Share of its pieces in which such a line is brighter than all places beside it, at least."""
IN_FAVOUR: Final = 10.0
"""Odds of a trail for a line of this kind. On half of 62 cameras with trails two of three bright trails were of it and 1 of about
60 other lines, which is 40; less is taken, for the share of the others is known to a factor of four."""


def for_meteor(fit: StreakFit, tiles: Tiles, contrast: Contrast | None) -> float:
    """Odds of a trail that the rise and fall of a line's light adds; 1 where it says nothing.

    contrast : of the line, None where it is not known.
    """
    if fit.snr < LEAST_SNR or contrast is None or contrast.wins < LEAST_WINS:
        return 1.0
    n = int(min(fit.length_px / max(CELL_WIDTHS * effective_width_px(fit.width_px), LEAST_CELL_PX), MOST_CELLS))
    if n < FEWEST_CELLS:
        return 1.0
    light = light_of_pieces(fit, tiles, n)
    told = np.isfinite(light[SIDES]) & np.isfinite(np.delete(light, SIDES, axis=0)).any(axis=0)
    if np.count_nonzero(told) < FEWEST_CELLS:
        return 1.0
    height = light[SIDES, told] - np.nanmedian(np.delete(light[:, told], SIDES, axis=0), axis=0)
    curve = rise_and_fall(height)
    top = float(curve.max())
    rest = _rms(height - curve)
    even = rest <= LARGEST_REST * top or (height.size >= CELLS_OF_ORDER and rest <= LEAST_ORDER * _left_by_chance(height))
    return IN_FAVOUR if top > 0.0 and even and min(curve[0], curve[-1]) <= FADED * top else 1.0


def _rms(rest: NDArray[np.float64]) -> float:
    """Root mean square of what is left of cells (n,)."""
    return math.sqrt(float(np.mean(rest**2)))


def _left_by_chance(height: NDArray[np.float64]) -> float:
    """The same of these cells in chance orders beside their best rise and fall, in the mean of the orders."""
    draws = np.random.default_rng(height.size)
    orders = [draws.permutation(height) for _ in range(ORDERS)]
    return float(np.mean([_rms(order - rise_and_fall(order)) for order in orders]))
