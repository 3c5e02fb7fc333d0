"""Borders of two areas: horizons, roofs, walls, slopes. The sky is as bright on one side of a trail as on the other.

The levels on both sides of a line are carried on to it, each along its own slope, so that twilight and vignetting make no step.
"""

import math
from typing import Final

import numpy as np

from ground.streaks.centre_line import effective_width_px
from ground.vetting.contrast import LEAST_PIECE_PX, MOST_PIECES, PIECE_WIDTHS, SIDES, Tiles, light_of_pieces, places_beside
from sboc_e2e.icd.products import StreakFit

PLACES: Final = 4
"""Places on each side, the nearest ones, whose straight line is carried on. Chosen: three or six tell the same borders."""
LARGEST_STEP: Final = 0.5
"""Step of the level at the line, over the line's height, from which on it is a border of two areas. Of 204 lines on trails and
doubtful ones none has 0.3, of 18 false ones three have 2.0 to 2.5."""
SIGMAS: Final = 2.5
"""The step must exceed that by so many of its errors."""
FEWEST_PIECES: Final = 3
"""Pieces of the line that must tell, for a scatter. Chosen, not measured."""


def is_border(fit: StreakFit, tiles: Tiles) -> bool:
    """Whether the level of the sky steps at a line by a large share of its height. False where the tiles do not tell."""
    length, width = fit.length_px, effective_width_px(fit.width_px)
    if not length > 0.0 or not math.isfinite(length + width + fit.sagitta_px):
        return False
    light = light_of_pieces(fit, tiles, max(int(min(length / max(PIECE_WIDTHS * width, LEAST_PIECE_PX), MOST_PIECES)), 1))
    # of a straight line through the places, its value at the fit
    carried_on = np.linalg.pinv(np.vander(places_beside(width)[:PLACES], 2))[1]
    before, behind = carried_on @ light[SIDES - PLACES : SIDES][::-1], carried_on @ light[SIDES + 1 : SIDES + 1 + PLACES]
    step, height = before - behind, light[SIDES] - 0.5 * (before + behind)
    told = np.isfinite(step) & np.isfinite(height)
    if np.count_nonzero(told) < FEWEST_PIECES:
        return False
    middle = float(np.median(step[told]))
    error = 1.25 * 1.4826 * float(np.median(np.abs(step[told] - middle))) / math.sqrt(np.count_nonzero(told))
    return abs(middle) - SIGMAS * error > LARGEST_STEP * abs(float(np.median(height[told])))
