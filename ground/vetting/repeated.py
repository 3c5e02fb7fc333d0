"""One trail, one streak: wide or ragged trails are detected more than once, along their flanks or in pieces."""

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd.products import StreakFit

SAME_TRAIL_WIDTHS: Final = 3.0
"""Distance from the line, in widths, within which a fit lies in the brighter one's light: 0.3 % of it is beyond."""
SUPPORTS_ABOVE: Final = 0.1
"""Least probability of the brighter fit for which a fit in its light counts as the same trail."""

PUBLISHED: Final = 0.5
"""Least probability of what is published without other frames: the default of `ground.veto_unlinked_below`."""
DOUBLED_SHARE: Final = 0.5
"""Share of a fit's length that a longer one covers from which on both are one trail. Chosen, not measured."""
RAN_ON_SHARE: Final = 0.25
"""Length of a fit over that of a longer one on its trail, below which the longer one may have run on. Chosen, not measured."""
RAN_ON_SNR: Final = 1.3
"""S/N of such a longer fit, over what the light of the shorter one alone gives it, up to which it has run on over nothing. A tail
twelve times as long as the shorter one, with 2.6 % of its brightness, gives that. Chosen, not measured."""


def repeated(fits: Sequence[StreakFit], probability: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(n,) which fits lie in the light of a brighter probable one: its flanks, or its whole length, found once more."""
    out = np.zeros(len(fits), dtype=np.bool_)
    order = sorted(range(len(fits)), key=lambda k: -fits[k].snr)
    for place, i in enumerate(order):
        if out[i] or probability[i] < SUPPORTS_ABOVE or not fits[i].length_px > 0.0:
            continue
        reach = SAME_TRAIL_WIDTHS * fits[i].width_px
        for j in order[place + 1 :]:
            out[j] |= _inside(fits[j], fits[i], reach)
    return out


def doubled(fits: Sequence[StreakFit], probability: NDArray[np.float64], stands_out: Sequence[float]) -> NDArray[np.bool_]:
    """(n,) which published fits share half of their length or more with a better one on the same line, or half of that one's.

    stands_out : share of each fit's length that is brighter than its neighbourhood. The better one has more of such length: a
        fit that ran away is longer, and its line leaves the trail. One that ran on has less S/N than what it ran on from.
    """
    out = np.zeros(len(fits), dtype=np.bool_)
    length = [fit.length_px * share for fit, share in zip(fits, stands_out, strict=True)]
    published = [k for k in range(len(fits)) if probability[k] >= PUBLISHED]
    for i in published:
        out[i] = any(_ran_on(fits[i], fits[j]) for j in published)
    order = sorted((k for k in published if not out[k]), key=lambda k: -length[k])
    for place, i in enumerate(order):
        if not out[i]:
            for j in order[place + 1 :]:
                out[j] |= on_one_trail(fits[i], fits[j])
    return out


def _ran_on(long: StreakFit, short: StreakFit) -> bool:
    """Whether a fit has hardly more light than a far shorter one on its line, which the noise of its length outweighs."""
    share = short.length_px / max(long.length_px, 1e-6)
    return share < RAN_ON_SHARE and long.snr < RAN_ON_SNR * short.snr * math.sqrt(share) and on_one_trail(long, short)


def on_one_trail(one: StreakFit, other: StreakFit) -> bool:
    """Whether the shorter of two fits lies on the line of the longer one and shares half its own length with it."""
    fit, trail = sorted((one, other), key=lambda each: each.length_px)
    along, across = _ends_on(trail, fit)
    reach = SAME_TRAIL_WIDTHS * max(fit.width_px, trail.width_px, 1.0) + abs(trail.sagitta_px) + abs(fit.sagitta_px)
    shared = min(along.max(), trail.length_px) - max(along.min(), 0.0)
    return bool(np.abs(across).max() <= reach and shared >= DOUBLED_SHARE * fit.length_px)


def _inside(fit: StreakFit, trail: StreakFit, reach: float) -> bool:
    """Whether both ends of a fit lie within `reach` of the chord of another, its bend allowed for."""
    along, across = _ends_on(trail, fit)
    beside = np.abs(across) > reach + abs(trail.sagitta_px)
    return bool(((along >= -reach) & (along <= trail.length_px + reach) & ~beside).all())


def _ends_on(trail: StreakFit, fit: StreakFit) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Places (2,) of a fit's ends along the chord of another, from its first end, and across it."""
    drow, dcol = (trail.row1 - trail.row0) / trail.length_px, (trail.col1 - trail.col0) / trail.length_px
    row, col = np.array([fit.row0, fit.row1]) - trail.row0, np.array([fit.col0, fit.col1]) - trail.col0
    return row * drow + col * dcol, row * dcol - col * drow
