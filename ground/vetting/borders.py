"""Lines along a border of the frame: half lines of video, rims of masks, reflections of the sensor's edge.

Such a line stays near one border from end to end, with a slope of its own, so that it is none of the readout. A trail of any
place and direction seldom does.
"""

import math
from typing import Final

from ground.vetting.star_rows import LN_LENGTHS
from sboc_e2e.icd.products import StreakFit

BORDER_PER_REAL: Final = 0.02
"""Expected lines of this kind for each real streak: in 140 frames of 60 cameras two were published, beside 110 trails."""
DEPTH_PX: Final = 4.0
"""Mean depth of the farther end of such a line: 4 and 5 px of those two. Of trails of 46 px that run 8 px from a border most were
refused where any depth was taken to be as likely (docs/vetting.md, borders of the picture, counts them)."""
LEAST_DEPTH_PX: Final = 2.0
"""A place is not known better than this relative to what a border is: half lines of video are one or two pixels high."""


def against_border(fit: StreakFit, seen: tuple[int, int, int, int]) -> float:
    """Odds of a line along a border against a trail, as far as its place and direction tell.

    seen : first and last row, first and last column in which a pixel saw the sky. The depth is that of the end that is farther
    from the border. For lines along the border its density is exponential, and their length is any share of the border. Both ends
    of a trail are as near as its middle and its direction allow, each of which is even.
    """
    if not fit.length_px > 0.0:
        return 0.0
    top, bottom, left, right = (float(place) for place in seen)
    rows, cols = max(bottom - top, 1.0), max(right - left, 1.0)
    depth_rows = min(max(fit.row0, fit.row1) - top, bottom - min(fit.row0, fit.row1))
    depth_cols = min(max(fit.col0, fit.col1) - left, right - min(fit.col0, fit.col1))
    share = min(fit.length_px / (cols if depth_rows < depth_cols else rows), 1.0)
    depth = max(min(depth_rows, depth_cols), LEAST_DEPTH_PX)
    direction = 2.0 / math.pi * math.asin(min(depth / fit.length_px, 1.0))
    turns = 2.0 / math.pi / math.sqrt(max((fit.length_px / depth) ** 2 - 1.0, 1.0))
    of_trails = 2.0 * (1.0 / rows + 1.0 / cols) * (direction + turns) / LN_LENGTHS
    of_borders = math.exp(-depth / DEPTH_PX) / DEPTH_PX * share
    return BORDER_PER_REAL * of_borders / of_trails
