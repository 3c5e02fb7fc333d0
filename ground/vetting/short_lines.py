"""Lines of a frame that are too short to be judged, and what they say of longer ones: tracks of particles and blends of stars.

A frame that stands alone does not tell stars from trails below some length, so shorter lines are refused. Where many of them are
as bright and as wide as a longer line, it is likely to be one of theirs: their lengths do not end at that limit. Short meteors of
a shower count in this way too, but they are few.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ground.streaks.trail_model import PIXEL_VARIANCE_PX2
from ground.vetting import alike
from sboc_e2e.icd.products import StreakFit

KIND: Final = (*alike.KIND, 0.3)
"""Sigma of ln S/N, ln length and ln width (that of a pixel included) within which two lines are of one kind. Both widths are
fitted here, and told better than that of a look-alike."""

AGAINST: Final = 0.1
"""Odds against a line for each short one of its kind. Of 800 lines with a probability of 0.03 and more in 331 frames of exams
that had been seen 326 lie on trails. Without this term 308 of these and 62 others are published, with it 306 and 48. The
likelihood is largest at 0.5, where 295 and 43 are."""


def against_short_lines(fits: Sequence[StreakFit], short: Sequence[StreakFit]) -> NDArray[np.float64]:
    """Odds (n,) that short lines of a frame add against its fits. A brighter one counts as if it were as bright as the fit."""
    if not fits or not short:
        return np.zeros(len(fits))
    apart = (_place(fits)[:, None] - _place(short)) / KIND
    apart[..., 0] = np.maximum(apart[..., 0], 0.0)
    return np.asarray(AGAINST * np.exp(-0.5 * (apart**2).sum(axis=-1)).sum(axis=1), dtype=np.float64)


def _place(fits: Sequence[StreakFit]) -> NDArray[np.float64]:
    """Ln of S/N, length and width (n, 3)."""
    told = [(max(fit.snr, 1e-3), max(fit.length_px, 0.1), np.sqrt(fit.width_px**2 + PIXEL_VARIANCE_PX2)) for fit in fits]
    return np.asarray(np.log(told), dtype=np.float64)
