"""Lines along a border of the frame: half lines of video, rims of masks, reflections of the sensor's edge.

Such a line stays near one border from end to end, with a slope of its own, so that it is none of the readout. A trail of any
place and direction seldom does.
"""

import math
from typing import Final

from sboc_e2e.icd.products import StreakFit

BORDER_PER_REAL: Final = 0.02
"""Expected lines of this kind for each real streak: in 140 frames of 60 cameras two were published, beside 110 trails."""
LEAST_DEPTH_PX: Final = 2.0
"""A place is not known better than this relative to what a border is: half lines of video are one or two pixels high."""


def against_border(fit: StreakFit, seen: tuple[int, int, int, int]) -> float:
    """Odds of a line along a border against a trail, as far as its place and direction tell.

    seen : first and last row, first and last column in which a pixel saw the sky. The chance that a trail of this length lies as
    near to a border with both of its ends is that of its middle, times that of its direction.
    """
    if not fit.length_px > 0.0:
        return 0.0
    top, bottom, left, right = (float(place) for place in seen)
    rows, cols = max(bottom - top, 1.0), max(right - left, 1.0)
    depth = min(
        max(fit.row0, fit.row1) - top, bottom - min(fit.row0, fit.row1),
        max(fit.col0, fit.col1) - left, right - min(fit.col0, fit.col1),
    )  # fmt: skip
    depth = max(depth, LEAST_DEPTH_PX)
    place = min(2.0 * depth * (1.0 / rows + 1.0 / cols), 1.0)
    direction = min(2.0 / math.pi * math.asin(min(depth / fit.length_px, 1.0)), 1.0)
    return BORDER_PER_REAL * max(1.0 / (place * direction) - 1.0, 0.0)
