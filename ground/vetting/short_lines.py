"""Short lines of a frame that stands alone: blends of stars and tracks of particles look like them, and short meteors are some.

Where many of them are as bright and as wide as another line, this is likely to be one of theirs, short or long. They say nothing
of the rates of longer lines: a frame has them by the hundred.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ground.streaks.trail_model import PIXEL_VARIANCE_PX2
from ground.vetting import alike
from sboc_e2e.icd.products import StreakFit

SHORT_PX: Final = 25.0
"""Blends of stars look like trails up to this length in a frame that was held against no other frame of the same sky."""

SHORTEST_PX: Final = 12.0
"""Shorter ones are neither reported on board nor judged there; fits of longer ones become as short. What is found first of a
short meteor is its bright part: 16 to 25 px in eight trails of 16 to 43 px, S/N 30 to 54."""

KIND: Final = (*alike.KIND, 0.3)
"""Sigma of ln S/N, ln length and ln width (that of a pixel included) within which two lines are of one kind. Both widths are
fitted here, and told better than that of a look-alike."""

AGAINST: Final = 0.1
"""Odds against a line for each short one of its kind. Of 800 lines with a probability of 0.03 and more in 331 frames of exams
that had been seen 326 lie on trails. Without this term 308 of these and 62 others are published, with it 306 and 48. The
likelihood is largest at 0.5, where 295 and 43 are."""


def against_short_lines(fits: Sequence[StreakFit], short: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Odds (n,) that the short lines among the fits of a frame add against each of the others.

    short : (n,) which of them are. A brighter one counts as if it were as bright as the fit.
    """
    which = np.flatnonzero(short)
    if not which.size:
        return np.zeros(len(fits))
    place = _place(fits)
    apart = (place[:, None] - place[which]) / KIND
    apart[..., 0] = np.maximum(apart[..., 0], 0.0)
    each = AGAINST * np.exp(-0.5 * (apart**2).sum(axis=-1))
    each[which, np.arange(which.size)] = 0.0
    return np.asarray(each.sum(axis=1), dtype=np.float64)


def _place(fits: Sequence[StreakFit]) -> NDArray[np.float64]:
    """Ln of S/N, length and width (n, 3)."""
    told = [(max(fit.snr, 1e-3), max(fit.length_px, 0.1), np.sqrt(fit.width_px**2 + PIXEL_VARIANCE_PX2)) for fit in fits]
    return np.asarray(np.log(told), dtype=np.float64)
