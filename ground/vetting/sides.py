"""Whether a line is higher than the sky on both of its sides: a trail is, a slope and an edge of light are not.

The rim of a vignetted field, the edge of a dome's slit and the flank of stray light are steps or bends of the sky. The mesh of
the background does not follow them, and what it leaves looks like a wide trail. In the sky itself, the level before and the level
behind them differ. So the level on each side is continued to the line along its own slope, and the line must stand above the
higher of both by a share of the height that its fit claims.
"""

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ground.streaks.centre_line import effective_width_px
from ground.vetting.features import LEAST_BINS
from sboc_e2e.icd.products import StreakFit

LEAST_CELL_PX: Final = 4
"""Side of the cells of a map of the sky. A trail of 1.5 px keeps 0.8 of its height in them."""
MOST_CELLS: Final = 512 * 512
"""Cells of a map: 1 MB a frame. Larger frames have cells of 8 px and more, in which a trail of 1.5 px keeps 0.5 of its height."""

INNER_WIDTHS: Final = 2.5
"""The sides begin so many widths from the line, where a Gaussian has 1 % of its light left."""
OUTER_WIDTHS: Final = 6.0
"""They reach as far as they lie away, and so do the straight lines through them."""
LEAST_SIDE_CELLS: Final = 5
"""Least number of cells across a side, for a level and a slope. Chosen, not measured."""
NEAREST_WIDTHS: Final = 1.0
"""Of a side that is masked, as full areas are, the last cell that is seen tells its level from so many widths on, the line's own
light in it (0.6 at this distance, by its profile) taken off."""

LEAST_SHARE: Final = 0.35
"""Least height above the higher side, as a share of the height that the fit claims. A trail has 1; the brighter half of a step
that was fitted as a trail has 0 or less. Chosen, not measured."""
SIGMAS: Final = 2.0
"""The height must be smaller than that by so many of its errors: where the map does not tell, the line stays."""

WIDE: Final = 3.0
"""Width over that of the PSF from which a line is judged in parts: defocused satellites have 2 to 8 and are even."""
PARTS: Final = 4
"""Parts of a wide line; see `LOWER_PARTS`."""
LOWER_PARTS: Final = 2
"""Parts that are slopes or edges, of `PARTS`, from which on a wide line is one. A trail that fades may lack one. Chosen: a
galaxy's ridge, 1,334 px long and 14 px wide, had two."""

FEWEST_ALONG: Final = 8
"""Least number of cells along a line. Chosen, not measured."""


@njit(cache=True)
def _means(pixels: Any, scale: Any, unknown: Any, cell_px: int, out: Any) -> None:
    """Means of the known pixels of square cells. Lines of a cell are summed in eight parts at most, in the order of numpy."""
    rows, cols = out.shape
    parts = min(cell_px, 8)
    part = np.zeros(8, np.float32)
    known = np.zeros(cols, np.int64)
    for i in range(rows):
        known[:] = 0
        for line in range(i * cell_px, (i + 1) * cell_px):
            for j in range(cols):
                part[:] = 0.0
                for first in range(j * cell_px, (j + 1) * cell_px, parts):
                    for k in range(parts):
                        if unknown[line, first + k] == 0:
                            part[k] += np.float32(pixels[line, first + k]) * scale
                            known[j] += 1
                if parts == 8:
                    total = ((part[0] + part[1]) + (part[2] + part[3])) + ((part[4] + part[5]) + (part[6] + part[7]))
                else:
                    total = ((part[0] + part[1]) + part[2]) + part[3]
                out[i, j] = total if line == i * cell_px else out[i, j] + total
        for j in range(cols):
            out[i, j] = out[i, j] / np.float32(known[j]) if known[j] else np.nan


@dataclass(frozen=True, kw_only=True, eq=False)
class SkyMap:
    """Mean counts of square cells, (rows, cols) float32, ADU, NaN where no pixel saw the sky; and the side of a cell in px."""

    adu: NDArray[np.float32]
    cell_px: int

    @classmethod
    def of(cls, pixels: NDArray[Any], unknown: NDArray[np.bool_ | np.uint8], adu_scale: float = 1.0) -> "SkyMap":
        """The map of an image (rows, cols) in units of `adu_scale` ADU; unknown pixels, True or above 0, are left out.

        Rests of cells at the far borders are left out too.
        """
        cell_px = LEAST_CELL_PX
        while pixels.size > MOST_CELLS * cell_px**2:
            cell_px *= 2
        adu = np.empty([side // cell_px for side in pixels.shape], dtype=np.float32)
        _means(pixels, np.float32(adu_scale), unknown.view(np.uint8), cell_px, adu)
        return cls(adu=adu, cell_px=cell_px)

    def height(self, fit: StreakFit, first: float = 0.0, last: float = 1.0) -> tuple[float, float]:
        """Height of a line above the higher of its sides and its error, ADU; NaN where the map does not tell.

        first, last : the part of the line that is looked at, as shares of its length.
        """
        width = math.hypot(fit.width_px, self.cell_px / math.sqrt(12.0))
        reach = math.ceil(OUTER_WIDTHS * width / self.cell_px) + LEAST_SIDE_CELLS
        profile, scatter = self._profile(fit, reach, first, last)
        offset = self.cell_px * np.arange(-reach, reach + 1.0)
        middle = profile[reach - 1 : reach + 2]
        if not np.isfinite(middle).any():
            return math.nan, math.nan
        top = float(np.nanmax(middle))
        sides = []
        for side in (-1.0, 1.0):
            chosen = (side * offset > INNER_WIDTHS * width) & np.isfinite(profile)
            if np.count_nonzero(chosen) >= LEAST_SIDE_CELLS:
                sides.append(_continued(offset[chosen], profile[chosen]))
                continue
            near = np.flatnonzero((side * offset >= NEAREST_WIDTHS * width) & np.isfinite(profile))
            if not near.size:
                return math.nan, math.nan
            edge = int(near[-1] if side > 0.0 else near[0])
            held = math.exp(-0.5 * (float(offset[edge]) / width) ** 2)
            sides.append(((float(profile[edge]) - held * top) / (1.0 - held), scatter / (1.0 - held)))
        level, error = max(sides)
        return top - level, math.hypot(error, scatter)

    def _profile(self, fit: StreakFit, reach: int, first: float, last: float) -> tuple[NDArray[np.float64], float]:
        """Medians along a line, (2 reach + 1,) by distance across it in cells, and the error of one of them."""
        n = int((last - first) * fit.length_px / self.cell_px)
        if n < FEWEST_ALONG:
            return np.full(2 * reach + 1, np.nan), math.nan
        share = first + (last - first) * (np.arange(n) + 0.5) / n
        d_row, d_col = (fit.row1 - fit.row0) / fit.length_px, (fit.col1 - fit.col0) / fit.length_px
        bend = 4.0 * fit.sagitta_px * share * (1.0 - share)
        across = self.cell_px * np.arange(-reach, reach + 1.0)[:, None] + bend
        row = fit.row0 + share * (fit.row1 - fit.row0) + across * d_col
        col = fit.col0 + share * (fit.col1 - fit.col0) - across * d_row
        r, c = (np.floor((place + 0.5) / self.cell_px).astype(np.int64) for place in (row, col))
        inside = (r >= 0) & (c >= 0) & (r < self.adu.shape[0]) & (c < self.adu.shape[1])
        value = np.where(inside, self.adu[np.where(inside, r, 0), np.where(inside, c, 0)], np.nan).astype(np.float64)
        number = np.isfinite(value).sum(axis=1)
        profile = np.full(len(value), np.nan)
        told = number >= max(FEWEST_ALONG, n // 4)
        profile[told] = np.nanmedian(value[told], axis=1)
        if not told.any():
            return profile, math.nan
        apart = np.abs(np.diff(value[told], axis=1))
        apart = apart[np.isfinite(apart)]
        noise = 1.4826 * float(np.median(apart)) / math.sqrt(2.0) if apart.size else math.nan
        return profile, 1.25 * noise / math.sqrt(float(np.median(number[told])))

    def refuses(self, fit: StreakFit, gain_e_adu: float) -> bool:
        """Whether a line is a slope or an edge: not above the higher of its sides by the share of a trail.

        One that is sharper than the stars is neither, however little the map shows of it. A line much wider than the PSF must be
        higher in its parts too: clouds of stars and of gas are ridges here and slopes there.
        """
        if fit.width_px < fit.psf_sigma_px:
            return False
        if self._is_lower(fit, gain_e_adu, 0.0, 1.0):
            return True
        if not fit.width_px > WIDE * fit.psf_sigma_px:
            return False
        parts = np.linspace(0.0, 1.0, PARTS + 1)
        lower = [self._is_lower(fit, gain_e_adu, float(a), float(b)) for a, b in pairwise(parts)]
        return sum(lower) >= LOWER_PARTS

    def _is_lower(self, fit: StreakFit, gain_e_adu: float, first: float, last: float) -> bool:
        """Whether a part of a line is lower than the share of a trail, for certain. False where the map does not tell."""
        height, error = self.height(fit, first, last)
        wide = math.hypot(effective_width_px(fit.width_px), self.cell_px / math.sqrt(12.0))
        curve = fit.light_curve_e_px[round(first * fit.light_curve_e_px.size) : round(last * fit.light_curve_e_px.size)]
        # the map has medians along the line, and a meteor has most of its light in its head
        density = float(np.median(curve)) if curve.size >= LEAST_BINS else fit.flux_e / max(fit.length_px, 1.0)
        claimed = density / gain_e_adu / (math.sqrt(2.0 * math.pi) * wide)
        return height + SIGMAS * error < LEAST_SHARE * claimed


def _continued(offset: NDArray[np.float64], profile: NDArray[np.float64]) -> tuple[float, float]:
    """A side's straight line at the trail's place, and its error from what it leaves."""
    power = np.vander(offset, 2)
    solution, *_ = np.linalg.lstsq(power, profile, rcond=None)
    rest = profile - power @ solution
    covariance = np.linalg.inv(power.T @ power)
    variance = float(rest @ rest) / max(len(offset) - 2, 1)
    return float(solution[1]), math.sqrt(variance * covariance[1, 1])
