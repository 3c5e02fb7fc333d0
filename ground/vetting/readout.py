"""Lines of the readout: columns, charge that a full pixel spills, borders of amplifiers. They follow one row or column exactly.

A trail has any direction. Its drift across the rows (or columns) from end to end is as likely to be one number of pixels as
another, and the fit knows this drift to a small part of the trail's width. So a drift of zero speaks for the readout, the more
the longer the line is; a drift that differs from zero by several of its errors speaks against it, however wide the line is.
"""

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd.products import StreakFit

READOUT_WIDTHS: Final = 2.5
"""Largest extent across, in widths (or px), of a detection on one row or column, whose drift has no error: a Gaussian has 1 % of
its light farther out. Chosen, not measured."""

READOUT_SPAN: Final = 0.7
"""Least share of the frame along it. Of lines from border to border in any direction both together take in 10 / pi widths over
the side of the frame: for a width of 2 px one of 640 in frames of 4,096 px, and one of 16 in cut-outs of 100 px. Chosen, not
measured."""

READOUT_SHARE: Final = 0.015
"""Share of lines that are the readout's in a frame that shows no others of them. Chosen, so that a trail of 25 px along a row,
one in twenty of its length, is still published, and a lone column of 60 px is not."""
READOUT_LINES: Final = 20.0
"""Lines that this expectation is worth: the frame's own lines correct it."""
LEAST_LINE_PX: Final = 15.0
"""Shorter fits say nothing of the readout. Chosen, not measured."""
ITERATIONS: Final = 20
"""The share and the lines in turn: a budget of work. Chosen, not measured."""

DRIFT_ERROR_PX: Final = 0.5
"""One sigma of a drift beside what the fit quotes: stars beside a line, pixels that it covers in part. Chosen, not measured."""
DRIFT_ERROR_WIDTHS: Final = 0.3
"""The same in widths of the line, for what is wide is seldom even across itself. Chosen, not measured."""


def is_of_readout(drow: float, dcol: float, width_px: float, shape: tuple[int, int]) -> bool:
    """Whether a line from one end to the other (px) stays on one row or column over most of a frame.

    width_px : sigma of the line's profile, that of the PSF where it was not measured. shape : rows and columns of the frame.
    """
    along, side = max((abs(drow), shape[0]), (abs(dcol), shape[1]), key=lambda pair: pair[0])
    return min(abs(drow), abs(dcol)) < READOUT_WIDTHS * max(width_px, 1.0) and along > READOUT_SPAN * side


def drift_of(fit: StreakFit) -> tuple[float, float]:
    """How far a line drifts from its row or column from end to end, and one sigma of it, px. Its length is not 0.

    The quoted covariance is of the noise alone; the scatter that the fit leaves widens it.
    """
    vector = np.array([fit.row1 - fit.row0, fit.col1 - fit.col0])
    drift = float(vector[np.argmin(np.abs(vector))])
    # across the line: an error along it moves an end by next to nothing across rows
    across = np.array([-vector[1], vector[0]]) / fit.length_px
    ends = np.concatenate((across, -across))
    variance = max(float(ends @ fit.covariance_px2 @ ends), 0.0) * max(np.nan_to_num(fit.chi2_nu, nan=1.0), 1.0)
    return drift, math.hypot(math.sqrt(variance), DRIFT_ERROR_PX, DRIFT_ERROR_WIDTHS * fit.width_px)


def exactness(fit: StreakFit) -> float:
    """Likelihood of a line's drift if it is one of the readout, over that of a trail of any direction.

    Its mean over trails of all directions is 1.
    """
    if not fit.length_px > 0.0:
        return 1.0
    drift, sigma = drift_of(fit)
    of_readout = math.exp(-0.5 * (drift / sigma) ** 2) / (math.sqrt(2.0 * math.pi) * sigma)
    # directions within 45 deg of a row or column are alike: drifts of a small angle have 2 / (pi length) for each px
    return of_readout * 0.5 * math.pi * fit.length_px


def odds_of_readout(fits: Sequence[StreakFit]) -> NDArray[np.float64]:
    """Odds (n,) of a line of the readout against a trail, as far as drifts tell; the other lines of a frame give the share."""
    exact = np.array([exactness(fit) for fit in fits])
    tells = np.array([fit.length_px > LEAST_LINE_PX for fit in fits], dtype=np.bool_)
    of_readout, share = np.zeros(len(exact)), np.full(len(exact), READOUT_SHARE)
    for _ in range(ITERATIONS):
        of_readout = np.where(tells, share * exact / (share * exact + 1.0 - share), 0.0)
        known = READOUT_SHARE * READOUT_LINES + of_readout.sum() - of_readout
        share = known / (READOUT_LINES + tells.sum() - tells)
    return np.asarray(share / (1.0 - share) * exact, dtype=np.float64)
