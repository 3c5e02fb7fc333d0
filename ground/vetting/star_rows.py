"""Rows of stars: a short line whose light lies in lumps, in a field that has as many bright stars as that takes.

A search of a frame's negative counts no rows of stars, for stars have no negative. Two things tell them from trails. The light of
a trail lies all along it, and stars that it crosses only add to it. A row of stars, a pair of bright ones or the tail of one has
gaps. And the frame's own list of stars says how many pairs of stars of that brightness lie as near to each other by chance.
Where images of stars overlap all over a frame, rows without gaps come by chance too, and the list says how many.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
import scipy  # scipy.special is loaded where it is used: a frame's stars are listed without it
from numpy.typing import NDArray

from ground.streaks.centre_line import effective_width_px
from ground.vetting.rise_and_fall import rise_and_fall
from sboc_e2e.icd.products import StreakFit

LONGEST_PX: Final = 128.0
"""Longer lines are not judged. The longest line of stars among 51 of a field with 2,500 stars in 650 x 500 px had 71 px."""

CELL_WIDTHS: Final = 2.0
"""Length of a cell along a line in widths of its profile: below the full width of a star (2.35), so that gaps show."""
FEWEST_CELLS: Final = 5
"""Least number of cells that tell. Chosen, not measured."""

CORE_WIDTHS: Final = 2.5
"""Half the breadth of a line's light: a Gaussian has 1 % of its light beyond."""
SIDE_WIDTHS: Final = (3.0, 6.0)
"""From where to where the sky is taken beside a line."""
MARGIN_PX: Final = 24
"""What is kept around a line. A profile of 4 px has its sky in it."""

LEVEL_CELLS: Final = 8
"""The level of the sky is a median over so many cells to both sides along the line: slopes along it are no gaps."""

MOST_PIXELS: Final = 1 << 20
"""Pixels kept around the lines of a frame, 4 MB. A frame of cosmic rays has more lines; those beyond are not judged."""

CERTAIN_SIGMAS: Final = 3.0
"""Gaps count by what is certain of them: so many standard errors of the part that noise has in them are taken off."""

ROW_GAPS: Final = (0.4, 1.4)
"""Gaps of rows of stars, any in between alike. Measured: see docs/vetting.md, rows of stars."""
TRAIL_GAPS: Final = 0.1
"""Scale of the gaps of trails, whose number falls exponentially with them. Measured: see docs/vetting.md, rows of stars."""
UNEVEN_TRAILS: Final = 0.05
"""Share of trails with gaps as rows of stars have: flashes of tumbling objects, fits that run on past the trail's end. Measured
on injected trails, see docs/vetting.md, rows of stars."""

FULL_SNR: Final = 1000.0
"""S/N from which a star is full or nearly: it spills, has a tail, and its companions and wings show. Chosen, not measured."""
FULL_LONGEST_PX: Final = 256.0
"""Lines as bright as that are judged up to this length: one full star and the glow of a border were 164 px."""
FULL_PER_FRAME: Final = 0.1
"""Expected lines that are such a star, however few are listed. In 142 frames of a crowded field one was published (S/N 19,600, 28
px, chi square 31,000, p 0.72), and a pair in two stacks of galaxies. Chosen, not measured."""

SHORT_OVER_TRAIL: Final = 2.5
"""Density of full stars over that of trails among lines of fewer than `FEWEST_CELLS`: all full stars, and of trails whose lengths
are alike in their logarithm (1.7 to 400 px) four in ten."""

PITCH_FWHM: Final = 2.0
"""Largest distance of the stars of a row without gaps, in full widths: halfway between them each has 6 % of its peak left."""
BREADTH_WIDTHS: Final = 4.0
"""Breadth of such a row in widths: two to both sides, where a Gaussian has 14 % of its peak left."""
FAINTEST_SHARE: Final = 0.5
"""Least light of its stars, as a share of the line's light in one full width."""

FEWEST_ROWS: Final = 1e-4
"""Expected rows up to which gaps are not looked at: they count twenty times at most (`row_over_trail`)."""

LIT_SHARE: Final = 0.5
"""A cell with this share of the claimed light, or more, is lit."""
CELLS_OF_STAR: Final = 3.0
"""Lit cells of one star, at most: twenty times as bright as a cell's least light, it lights 2.7 of them."""

ROUND_FILL: Final = 0.6
"""Share of a line that its light fills, (sum of cells)^2 / (n sum of squares) of its best rise and fall, from which on a fall to
both ends is no gap. A triangle has 0.75, a star with a tail 0.1 to 0.3."""
ROUND_WIDTHS: Final = 1.3
"""Largest width over that of the PSF of such a line: bulges of galaxies and full stars are wider. Chosen, not measured."""
LONG_WIDTHS: Final = 20.0
"""Length over width from which a line as bright as a full star may be wider than that: ten widths from its middle the image of a
star has a thousandth of its peak left (a Moffat profile, index 2.5), so that it does not fill such a line. Fireballs do."""
THIN_WIDTHS: Final = 32.0
"""Length over width from which any line may be wider. Two galaxies seen from their edge (S/N 225 and 301) had 20 and 24;
meteors that are wider than stars had 40 and 52."""

REAL_PER_FRAME: Final = 0.5
"""Expected real streaks per frame: the default of `ground.vetter`."""
LN_LENGTHS: Final = math.log(400.0 / 1.7)
"""Lengths of real streaks, 1.7 to 400 px, are alike in their logarithm."""
FWHM_PER_SIGMA: Final = 2.0 * math.sqrt(2.0 * math.log(2.0))
"""Full width at half maximum of a Gaussian over its sigma: 2.3548."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Crop:
    """Counts around a line, (rows, cols) float32, ADU, NaN where no pixel saw the sky; row, col : of its first pixel."""

    adu: NDArray[np.float32]
    row: int
    col: int

    def holds(self, row: NDArray[np.float64], col: NDArray[np.float64]) -> bool:
        """Whether all places lie inside or on the border, which runs half a pixel beyond the middles of its pixels."""
        r, c = row - self.row, col - self.col
        last = np.array(self.adu.shape) - 0.5
        return bool((r >= -0.5).all() and (c >= -0.5).all() and (r <= last[0]).all() and (c <= last[1]).all())


@dataclass(frozen=True, kw_only=True, eq=False)
class StarField:
    """What a frame shows of its stars.

    flux_e : (n,) of the listed ones, rising. area_px2 : in which they lie. crops : counts around its short lines.
    """

    flux_e: NDArray[np.float32]
    area_px2: float
    crops: tuple[Crop, ...]

    def brighter(self, fit: StreakFit, share: float) -> int:
        """Number of stars with this share, or more, of a line's light in one image of a star."""
        return len(self.flux_e) - int(np.searchsorted(self.flux_e, share * fit.flux_e * min(_fwhm_px(fit) / fit.length_px, 1.0)))

    def pairs(self, fit: StreakFit) -> float:
        """Expected pairs of stars as near to each other as a line is long, each as bright as its light in one image of a star."""
        n = self.brighter(fit, 1.0)
        return 0.5 * n * max(n - 1, 0) * min(math.pi * fit.length_px**2 / self.area_px2, 1.0)

    def even_rows(self, fit: StreakFit) -> float:
        """Expected rows without gaps, as long and as bright as a line: each star has the next one within a pitch on its line.

        The first two are a pair within the pitch in any direction; each further star lies in a strip as long as the pitch.
        """
        n = self.brighter(fit, FAINTEST_SHARE)
        pitch, density = PITCH_FWHM * _fwhm_px(fit), n / self.area_px2
        further = max(fit.length_px / pitch - 1.0, 0.0)
        next_one = min(density * pitch * BREADTH_WIDTHS * _fwhm_px(fit) / FWHM_PER_SIGMA, 1.0)
        return 0.5 * n * density * math.pi * pitch**2 * next_one**further

    def rows(self, fit: StreakFit, lit_cells: int) -> float:
        """Expected rows of stars of a line's length and light that have so many lit cells: a pair, and the others on its line."""
        further = lit_cells / CELLS_OF_STAR - 2.0
        if not further > 0.0:
            return self.pairs(fit)
        density = self.brighter(fit, FAINTEST_SHARE) / self.area_px2
        on_line = density * fit.length_px * BREADTH_WIDTHS * _fwhm_px(fit) / FWHM_PER_SIGMA
        return self.pairs(fit) * float(scipy.special.gammainc(further, on_line))

    def against(self, fit: StreakFit, gain_e_adu: float) -> float:
        """Odds of a row of stars against a trail, as far as gaps and the stars of the frame tell; 0 where they do not."""
        full = fit.snr > FULL_SNR
        if not 0.0 < fit.length_px <= (FULL_LONGEST_PX if full else LONGEST_PX) or not fit.flux_e > 0.0:
            return 0.0
        odds = self.even_rows(fit) / REAL_PER_FRAME
        if self.pairs(fit) > 0.0 or full:
            along = self.along(fit, gain_e_adu)
            stars = FULL_PER_FRAME if full else 0.0
            if along is not None:
                stars += self.rows(fit, along.lit_cells)
                if stars > FEWEST_ROWS:
                    odds += stars / REAL_PER_FRAME * row_over_trail(along.gaps_for(fit))
            elif fit.length_px < FEWEST_CELLS * CELL_WIDTHS * effective_width_px(fit.width_px):
                odds += stars / REAL_PER_FRAME * SHORT_OVER_TRAIL
        return odds

    def along(self, fit: StreakFit, gain_e_adu: float) -> "Along | None":
        """A line's light in the crop in whose middle it lies best; None where none tells."""
        middle = np.array([0.5 * (fit.row0 + fit.row1), 0.5 * (fit.col0 + fit.col1)])

        def apart(crop: Crop) -> float:
            centre = np.array([crop.row, crop.col]) + 0.5 * (np.array(crop.adu.shape) - 1.0)
            return float(np.hypot(*(centre - middle)))

        for crop in sorted((crop for crop in self.crops if _reaches(crop, fit)), key=apart):
            along = Along.of(fit, crop, gain_e_adu)
            if along is not None:
                return along
        return None


def _fwhm_px(fit: StreakFit) -> float:
    """Full width at half maximum of a line's profile, pixel included."""
    return FWHM_PER_SIGMA * effective_width_px(fit.width_px)


def is_long(fit: StreakFit, widths: float = LONG_WIDTHS) -> bool:
    """Whether a line has so many widths; by default more than the image of any star has."""
    return fit.length_px >= widths * effective_width_px(fit.width_px)


def row_over_trail(gaps: float) -> float:
    """Density of the gaps of rows of stars over that of trails."""
    low, high = ROW_GAPS
    row = 1.0 / (high - low) if gaps >= low else 0.0
    trail = (1.0 - UNEVEN_TRAILS) / TRAIL_GAPS * math.exp(-gaps / TRAIL_GAPS) + UNEVEN_TRAILS / (high - low)
    return row / trail


@dataclass(frozen=True, kw_only=True, eq=False)
class Along:
    """Light of the cells along a line and its error, as shares of what the fit claims, (n,) each."""

    light: NDArray[np.float64]
    error: NDArray[np.float64]

    @classmethod
    def of(cls, fit: StreakFit, crop: Crop, gain_e_adu: float) -> "Along | None":
        """Of a line in a crop; None: too little is seen."""
        width = effective_width_px(fit.width_px)
        n = round(fit.length_px / max(CELL_WIDTHS * width, 1.0))
        if n < FEWEST_CELLS:
            return None
        per_cell = max(math.ceil(fit.length_px / n), 1)
        share = (np.arange(n * per_cell) + 0.5) / (n * per_cell)
        across = np.arange(-math.ceil(SIDE_WIDTHS[1] * width), math.ceil(SIDE_WIDTHS[1] * width) + 1.0)
        value = _along(fit, crop, share, across).reshape(n, per_cell, across.size)
        core = np.where(np.abs(across) <= CORE_WIDTHS * width, np.exp(-0.5 * (across / width) ** 2), 0.0)
        side = value[:, :, np.abs(across) >= SIDE_WIDTHS[0] * width].reshape(n, -1)
        known = np.isfinite(value)
        power = (known * core**2).sum(axis=2)
        told = (power > 0.5 * float(core @ core)).any(axis=1) & np.isfinite(side).any(axis=1)
        if np.count_nonzero(told) < max(FEWEST_CELLS, n // 2):
            return None
        slope = _slope(side)
        flat = side - slope[:, None]
        level = slope + np.array([_median(flat[max(k - LEVEL_CELLS, 0) : k + LEVEL_CELLS + 1]) for k in range(n)])
        noise = 1.4826 * _median(np.abs(side - level[:, None]))
        light = (np.where(known, value - level[:, None, None], 0.0) * core).sum(axis=(1, 2))[told] / power.sum(axis=1)[told]
        claimed = fit.flux_e / gain_e_adu / fit.length_px / (math.sqrt(2.0 * math.pi) * width)
        # pixels share their cells' values where a line is sampled once a pixel and more
        error = noise / np.sqrt(power.sum(axis=1)[told] * fit.length_px / (n * per_cell))
        return cls(light=light / claimed, error=error / claimed)

    @property
    def lit_cells(self) -> int:
        """Number of cells with light."""
        return int(np.count_nonzero(self.light >= LIT_SHARE))

    @property
    def gaps(self) -> float:
        """Rms by which cells fall below what the fit claims, as a share of it.

        Only what is missing counts: stars that a trail crosses add light. The part of the noise is taken off. Trails have less
        than rows of stars: docs/vetting.md, rows of stars, has the measured ones of both.
        """
        return self._missing_from(np.ones(self.light.size))

    def gaps_for(self, fit: StreakFit) -> float:
        """The same, but of a line that rises once and falls once and fills its length: of its dips alone.

        Meteors rise and fall so, and may be wider than stars. A star with a tail fills little of its length, and the bulge of a
        galaxy is wide and short.
        """
        plain = self.gaps
        thin = is_long(fit, LONG_WIDTHS if fit.snr > FULL_SNR else THIN_WIDTHS)
        narrow = fit.width_px <= ROUND_WIDTHS * fit.psf_sigma_px or thin
        if not plain > 0.0 or not narrow:
            return plain
        best = rise_and_fall(self.light, 1.0 / np.maximum(self.error, 1e-6) ** 2)
        lit = np.maximum(best, 0.0)
        fill = float(lit.sum()) ** 2 / max(float(lit @ lit) * lit.size, 1e-300)
        return min(plain, self._missing_from(best)) if fill >= ROUND_FILL else plain

    def _missing_from(self, expected: NDArray[np.float64]) -> float:
        """Rms by which cells fall below an expectation, with the part that noise has for certain taken off."""
        missing = 2.0 * np.minimum(self.light - expected, 0.0) ** 2
        # the mean of 2 min(x, 0)^2 is that of x^2, and its variance 5 sigma^4
        of_noise = float(np.mean(self.error**2)) * (1.0 + CERTAIN_SIGMAS * math.sqrt(5.0 / self.light.size))
        return math.sqrt(max(float(missing.mean()) - of_noise, 0.0))


def _slope(side: NDArray[np.float64]) -> NDArray[np.float64]:
    """The sky's straight slope along a line, (n,), from its sides (n, k) of each cell."""
    middle = np.array([_median(each) for each in side])
    cell, known = np.arange(len(side), dtype=np.float64), np.isfinite(middle)
    return np.asarray(np.polyval(np.polyfit(cell[known], middle[known], 1), cell), dtype=np.float64)


def _median(values: NDArray[np.float64]) -> float:
    return float(np.nanmedian(values)) if np.isfinite(values).any() else math.nan


def _along(fit: StreakFit, crop: Crop, share: NDArray[np.float64], across: NDArray[np.float64]) -> NDArray[np.float64]:
    """Counts of the nearest pixels, (places along, places across), of a line; NaN outside the crop."""
    d_row, d_col = (fit.row1 - fit.row0) / fit.length_px, (fit.col1 - fit.col0) / fit.length_px
    offset = across + (4.0 * fit.sagitta_px * share * (1.0 - share))[:, None]
    row = fit.row0 - crop.row + (share * fit.length_px * d_row)[:, None] + offset * d_col
    col = fit.col0 - crop.col + (share * fit.length_px * d_col)[:, None] - offset * d_row
    r, c = np.rint(row).astype(np.int64), np.rint(col).astype(np.int64)
    inside = (r >= 0) & (c >= 0) & (r < crop.adu.shape[0]) & (c < crop.adu.shape[1])
    return np.where(inside, crop.adu[np.where(inside, r, 0), np.where(inside, c, 0)], np.nan).astype(np.float64)


def _reaches(crop: Crop, fit: StreakFit) -> bool:
    """Whether a crop holds both ends of a fit."""
    return crop.holds(np.array([fit.row0, fit.row1]), np.array([fit.col0, fit.col1]))
