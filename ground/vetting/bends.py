"""Lines that bend more than any lens bends the path of an object: rims of nebulae, clouds, halos and reflections.

What moves through one exposure nearly follows a great circle of the sky. A lens without distortion shows it straight. A fisheye
(distance from the axis as the angle) bends it the most where it lies farthest from the axis: the horizon is a circle as large as
the image itself. No path has a smaller radius of curvature than that.
"""

import math
from typing import Final

from ground.streaks.centre_line import effective_width_px
from sboc_e2e.icd.products import StreakFit

LEAST_RADIUS: Final = 0.4
"""Least radius of curvature of a path as a share of the frame's shorter side: an image circle that fits has 0.5. Some lenses
leave a margin, and some project otherwise. Chosen, not measured."""
BEND_ERROR_WIDTHS: Final = 0.5
"""Bend that a fit may show by error, in widths of the line: flares and full pixels pull a parabola. Of 208 fits on 90 trails of
45 cameras none bends more, of 3,200 other lines 294 do, rims of the Ring Nebula with p of 0.5 to 0.9 among them."""


def bends_too_much(fit: StreakFit, shape: tuple[int, int], circle_px: float | None = None) -> bool:
    """Whether the bend of a line is more than that of any path.

    shape : rows and columns of the frame. circle_px : radius of the image circle, where the lens does not fill the frame.
    """
    radius = LEAST_RADIUS * min(shape)
    if circle_px is not None:
        radius = min(radius, circle_px)
    half = 0.5 * fit.length_px
    if half >= radius:
        return False
    path = radius - math.sqrt(radius**2 - half**2)
    return abs(fit.sagitta_px) > path + BEND_ERROR_WIDTHS * effective_width_px(fit.width_px)
