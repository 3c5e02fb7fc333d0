"""The image circle of a lens that does not fill its frame, and lines that run along its rim.

An all-sky lens shows the sky in a circle. Roofs, hills and the glow above them lie along its rim, and lines among them run along
it too. A trail has any direction.
"""

import math
from dataclasses import dataclass
from typing import Final

from sboc_e2e.icd.products import StreakFit

RIM: Final = 0.80
"""Share of the circle's radius from which on lines that run along the rim are its structure: 18 deg above the horizon where
the distance from the middle is as the angle. The false lines of 20 pictures of one camera lie at 0.88 to 1.0. Chosen in view of
them."""
ALONG_RIM_DEG: Final = 15.0
"""Angle to the rim within which a line runs along it: a sixth of all directions. Chosen, not measured."""


@dataclass(frozen=True, kw_only=True)
class ImageCircle:
    """A circle in pixels of the frame (centre of pixel (0, 0) is 0.0): where the light of the lens ends."""

    row: float
    col: float
    radius_px: float

    def refuses(self, fit: StreakFit) -> bool:
        """Whether a line lies near the rim and runs along it."""
        row, col = 0.5 * (fit.row0 + fit.row1) - self.row, 0.5 * (fit.col0 + fit.col1) - self.col
        away = math.hypot(row, col)
        if away < RIM * self.radius_px or not fit.length_px > 0.0:
            return False
        outwards = abs((fit.row1 - fit.row0) * row + (fit.col1 - fit.col0) * col) / (fit.length_px * away)
        return outwards < math.sin(math.radians(ALONG_RIM_DEG))
