"""Spikes of bright stars: a line that passes through a star's centre, or aims at it from beside it.

Struts before a mirror and full columns draw lines through a star that hold some per cent of its light. A trail does so only by
chance, and the frame's own list of stars says how often: the more stars are as bright as that, the less it means.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ground.vetting.star_rows import FULL_LONGEST_PX, FULL_PER_FRAME, FULL_SNR, REAL_PER_FRAME, is_long
from sboc_e2e.icd.products import StreakFit

LEAST_LIGHT: Final = 20.0
"""Light of a star over that of its spike, at least. Struts take some per cent of the aperture, and a fit through the star takes
some of its core: four had a twenty-fifth."""
LEAST_OF_LINE: Final = 0.3
"""Light of a full star over that of a line which is this star, at least: what it spills is the rest. An even trail has a tenth of
its light in one image of a star. Chosen, not measured."""

SPILL_SLOPE: Final = 0.1
"""Slope to rows or columns up to which a line may be charge that a full star spilled, on several columns side by side: as on
board (`onboard.detect.line_integral.context.COLUMN_SLOPE`)."""

CENTRE_ERROR_PX: Final = 2.0
"""How near to the centre of a star its spikes run: the middle of a full star is known to a pixel or two. Chosen, not measured."""
SIGMAS: Final = 3.0
"""The line's own error is added so many times."""

SPIKE_PLACES: Final = (-1.0, 2.0)
"""Where on a line the star of a spike may lie, in lengths from end 0: between the ends, or up to a length beside them."""

SPIKE_PER_REAL: Final = 0.5
"""Expected lines that are spikes, for each real streak: one frame in four has one. Chosen, not measured."""


@dataclass(frozen=True, kw_only=True, eq=False)
class BrightStars:
    """The listed stars of a frame by rising light: row, col (px) and flux_e, (n,) each; and the area in which they lie (px2)."""

    row: NDArray[np.float64]
    col: NDArray[np.float64]
    flux_e: NDArray[np.float32]
    area_px2: float

    @classmethod
    def of(
        cls, row: NDArray[np.float64], col: NDArray[np.float64], flux_e: NDArray[np.float32], area_px2: float
    ) -> "BrightStars":
        """From a list in any order; entries without a number are left out."""
        order = np.argsort(flux_e, kind="stable")
        order = order[np.isfinite(flux_e[order])]
        return cls(row=row[order], col=col[order], flux_e=flux_e[order], area_px2=area_px2)

    def against(self, fit: StreakFit) -> float:
        """Odds of a spike or of one full star against a trail, as far as the stars tell; 0 where a line aims at none."""
        odds = self._aimed_at(fit, LEAST_LIGHT, *SPIKE_PLACES, SPIKE_PER_REAL)
        may_be_full = fit.length_px <= FULL_LONGEST_PX and fit.snr > FULL_SNR
        if may_be_full and (_may_be_spilled(fit) or not is_long(fit)):
            odds += self._aimed_at(fit, LEAST_OF_LINE, 0.0, 1.0, FULL_PER_FRAME / REAL_PER_FRAME)
        return odds

    def _aimed_at(self, fit: StreakFit, least: float, low: float, high: float, per_real: float) -> float:
        """Odds that a line belongs to a star of at least so many times its light, which lies on it.

        low, high : where, in lengths from end 0. per_real : expected lines of this kind for each real streak.
        """
        length = fit.length_px
        first = int(np.searchsorted(self.flux_e, least * fit.flux_e))
        if not length > 0.0 or not fit.flux_e > 0.0 or first == len(self.flux_e):
            return 0.0
        place, away, reach = aim_of(fit, self.row[first:], self.col[first:])
        aims = (away < reach) & (place > low) & (place < high)
        if not aims.any():
            return 0.0
        breadth = 2.0 * float(np.median(reach[aims]))
        chance = min(len(place) * breadth * (high - low) * length / self.area_px2, 1.0)
        return per_real * (1.0 / chance - 1.0)


def _may_be_spilled(fit: StreakFit) -> bool:
    """Whether a line runs about along rows or columns. In other directions a full star is no longer than its image."""
    drow, dcol = abs(fit.row1 - fit.row0), abs(fit.col1 - fit.col0)
    return min(drow, dcol) < SPILL_SLOPE * max(drow, dcol)


def aim_of(
    fit: StreakFit, row: NDArray[np.float64], col: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """How a line lies to the centres of stars, (n,) each, px: it has a length.

    Returns where on the line each lies, in lengths from end 0, how far beside it, px, and how far it may, (n,) each.
    """
    length = fit.length_px
    along_row, along_col = (fit.row1 - fit.row0) / length, (fit.col1 - fit.col0) / length
    row, col = row - fit.row0, col - fit.col0
    place = (row * along_row + col * along_col) / length
    return place, np.abs(row * along_col - col * along_row), CENTRE_ERROR_PX + SIGMAS * _across_error(fit, place)


def _across_error(fit: StreakFit, place: NDArray[np.float64]) -> NDArray[np.float64]:
    """One sigma of a line across itself, px, at places (n,) along it: 0 and 1 are its ends, others lie beyond."""
    across = np.array([fit.col1 - fit.col0, fit.row0 - fit.row1]) / fit.length_px
    ends = np.zeros((2, 4))
    ends[0, :2], ends[1, 2:] = across, across
    covariance = ends @ fit.covariance_px2 @ ends.T * max(float(np.nan_to_num(fit.chi2_nu, nan=1.0)), 1.0)
    weight = np.stack((1.0 - place, place))
    return np.asarray(np.sqrt(np.maximum(np.einsum("in,ij,jn->n", weight, covariance, weight), 0.0)), dtype=np.float64)
