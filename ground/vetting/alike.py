"""Lines that cannot be real, as a search of a frame's negative finds them, and how many of a fit's kind they foretell."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ground.streaks.trail_model import PIXEL_VARIANCE_PX2
from ground.vetting.contrast import Contrast
from ground.vetting.distance import told_at_distance
from ground.vetting.features import LEAST_BINS
from sboc_e2e.icd.products import StreakFit

KIND: Final = (0.7, 0.7)
"""Sigma of ln S/N and ln length within which two lines are of one kind: half to twice."""

KIND_WIDTH: Final = 0.5
"""Sigma of ln width (that of a pixel included) within which two lines are of one kind. Slopes of the sky at a vignetted border
are ten times as wide as trails, and say nothing of these."""

WIDTH_ERROR: Final = 10.0
"""Error of ln width of a look-alike, times its S/N: its profile is a median along the line, and its half height is read off."""

ALL_ALONG: Final = 0.95
"""Wins from which on a line stands out all along it, as a trail does. Once dark lines counted by how they stand out, 26 lines
more were published in frames that had been seen. Ten had these wins, none of them false; of the sixteen others eight were."""
KIND_WINS: Final = 0.3
"""A dark line that wins in so much less of its pieces than a bright one is hardly of its kind (one sigma). Chosen in view of
frames that were seen, where 0.2 to 0.3, with peaks of 0.15 to 0.3, publish about as many trails."""
KIND_PEAK: Final = 0.15
"""The same of the peak."""

ALIGNED_SLOPE: Final = 0.035
"""Slope within which a line runs along rows or columns: 2 deg, as the rims of vignetted fields do. Of lines of any direction 4 %
do. What follows the readout or a border tells nothing of lines that cross it: two satellites (S/N 181 and 48) were refused for a
dark column of half the frame."""


def _no_lines() -> NDArray[np.float64]:
    return np.zeros((0, 5))


@dataclass(frozen=True, kw_only=True, eq=False)
class LookAlikes:
    """Lines that cannot be real, by falling S/N.

    table : (k, 5) S/N, length, width (sigma, px; that of a pixel included), evenness, 0 to 1, and 1 of lines that run along rows
        or columns. Such lines count for fits that do so too. The others may have any direction and count for all fits.
    weight : (k,) how many false lines each of them stands for; None: one.
    stand_out : (k, 2) how far they stand out of their neighbourhood, as wins and peak of `Contrast`, NaN where that is not known;
        None: of none. One that stands out less than a fit that does so all along counts the less against it.
    place : (k, 2) row and column of their middles; None: they count alike everywhere. shape : rows, columns of the frame.
    """

    table: NDArray[np.float64] = field(default_factory=_no_lines)
    weight: NDArray[np.float64] | None = None
    stand_out: NDArray[np.float64] | None = None
    place: NDArray[np.float64] | None = None
    shape: tuple[int, int] = (0, 0)

    def near(self, fits: Sequence[StreakFit], contrasts: Sequence[Contrast | None] | None = None) -> NDArray[np.float64]:
        """Expected look-alikes for each unit of ln S/N and ln length about each fit, shape (n,).

        contrasts : of the fits, None where nothing tells it.
        One counts in full for fits that are fainter than itself, for false lines are the more frequent the fainter they are.
        S/N is that of the median light along the line, of fits as of look-alikes: what one clump of light makes bright is like
        no trail.
        """
        if not fits or not len(self.table):
            return np.zeros(len(fits))
        place = np.log([(max(fit.snr * evenness_of(fit), 1e-3), max(fit.length_px, 0.1)) for fit in fits])
        even = self.table[:, :3] * np.column_stack((self.table[:, 3], np.ones((len(self.table), 2))))
        known = np.log(np.maximum(even, 1e-3))
        apart = (place[:, None] - known[None, :, :2]) / KIND
        width = 0.5 * np.log([fit.width_px**2 + PIXEL_VARIANCE_PX2 for fit in fits])
        aligned = np.array([follows_readout(fit.row1 - fit.row0, fit.col1 - fit.col0) for fit in fits])
        counts = aligned[:, None] | (self.table[:, 4] < 0.5)
        other = (width[:, None] - known[None, :, 2]) / np.hypot(KIND_WIDTH, WIDTH_ERROR / np.maximum(self.table[:, 0], 1.0))
        apart[..., 0] = np.maximum(apart[..., 0], 0.0)
        peak = (1.0 if self.weight is None else self.weight) / (2.0 * math.pi * math.prod(KIND))
        unlike = np.sum(apart**2, axis=-1) + other**2
        if contrasts is not None and self.stand_out is not None:
            own = np.array([(c.wins, c.peak) if c is not None and c.wins >= ALL_ALONG else (-1.0, -1.0) for c in contrasts])
            less = np.maximum(own[:, None] - np.where(np.isfinite(self.stand_out), self.stand_out, np.inf), 0.0)
            unlike += np.sum((less / (KIND_WINS, KIND_PEAK)) ** 2, axis=-1)
        each = peak * counts * np.exp(-0.5 * unlike)
        if self.place is not None:
            each = each * told_at_distance(fits, self.place, self.shape)
        return np.asarray(each.sum(axis=1), dtype=np.float64)


def follows_readout(drow: float, dcol: float) -> bool:
    """Whether a line from one end to the other (px) runs along the rows or the columns."""
    return min(abs(drow), abs(dcol)) < ALIGNED_SLOPE * max(abs(drow), abs(dcol))


def evenness_of(fit: StreakFit) -> float:
    """Median of the light along a trail over its mean, 0 to 1; 1 of fits with too few bins to tell."""
    curve = fit.light_curve_e_px
    if curve.size < LEAST_BINS or not curve.mean() > 0.0:
        return 1.0
    return min(max(float(np.median(curve) / curve.mean()), 0.0), 1.0)
