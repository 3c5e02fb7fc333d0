"""Galaxies seen from their edge: far wider than the stars, shorter than trails out of focus, and wholly in the frame."""

import math
from typing import Final

from ground.vetting.any_camera import GLARING_SNR
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.products import StreakFit

LN_WIDER: Final = math.log(3.0)
"""Ln of width over that of the stars from which a line may be a galaxy seen from its edge, ..."""
MOST_WIDTHS: Final = 40.0
"""... up to so many widths long: their axes are in the ratio of ten and less. Trails out of focus are near, fast, and longer. Of
8,556 lines of 368 repositories 1,174 are as wide. Of nine on trails two are as short, and the vetter refused both."""
PER_REAL: Final = 10.0
"""Odds of a galaxy against a trail for such a line. Chosen."""


def of_galaxy(fit: StreakFit, ln_sharpness: float) -> float:
    """Odds of a galaxy against a trail. ln_sharpness : ln of the width of a fit over that of the stars.

    Lines of `GLARING_SNR` are fireballs, which full pixels widen.
    """
    whole = not fit.flags & (StreakFlag.EDGE0 | StreakFlag.EDGE1)
    like = ln_sharpness > LN_WIDER and fit.length_px < MOST_WIDTHS * fit.width_px and fit.snr < GLARING_SNR
    return PER_REAL if whole and like else 0.0
