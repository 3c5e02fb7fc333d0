"""A line against lines beside it: the same length, direction and bend, a little to both sides, and how much these scatter.

The S/N of a fit is that of white noise. Compressed pictures, clouds, branches and crowded fields scatter more. What parallel
lines show is the scatter of lines of this kind at this place. With n of them a line by chance exceeds them as Student's t does
with n - 2 degrees of freedom, and a frame has as many places and directions for lines as its area holds points, for each length.
"""

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
import scipy  # scipy.special is loaded where it is used
from numpy.typing import NDArray

from ground.streaks.centre_line import effective_width_px
from ground.vetting.contrast import REACH_PX, Tiles
from ground.vetting.star_rows import REAL_PER_FRAME
from sboc_e2e.icd.products import StreakFit

FIRST_WIDTHS: Final = 3.0
"""Distance of the first line beside a line in widths: a Gaussian has 0.3 % of its light beyond. A pixel is added."""
STEP_WIDTHS: Final = 2.0
"""From one to the next."""
LEAST_STEP_PX: Final = 1.5
"""Least distance from one to the next: nearer lines share their pixels."""
FEWEST: Final = 8
"""Least number of lines that tell how they scatter. Chosen, not measured."""
SEEN_SHARE: Final = 0.5
"""Least share of a line's length that is seen."""
LIGHT_WIDTHS: Final = 2.0
"""Half the breadth over which a line's light is summed, in widths."""
CLIP: Final = 4.0
"""Sigmas of a pixel's place along the lines beside at which its light is cut: stars on them are no scatter of the sky."""
OUTLIERS: Final = 3.0
"""Sigmas from which on a line beside shows something else: another trail."""
PARALLEL_DEG: Final = 3.0
"""Angle between two trails of a train, at most. Chosen, not measured."""
WIDER: Final = 2.0
"""Width of the other one over that of a line, at most. Chosen, not measured."""
LEAST_TRAIL_SNR: Final = 20.0
"""S/N from which another line is one without doubt. Chosen, not measured."""
OVERLAP_SHARE: Final = 0.2
"""Share of a line from which on another trail that runs beside it is left out. Chosen, not measured."""
LEAST_EXCESS: Final = 2.0
"""Scatter of the lines beside, over that of white noise, from which on they count: what little more says is the vetter's. Without
it eight of 250 satellites of S/N 8 to 12 in simulated skies were lost."""
BRIGHTEST: Final = 100.0
"""S/N from which lines are not judged by this. What is as bright beside them is seldom scatter: trains, pairs, wires."""
LENGTHS: Final = 6.0
"""Lengths that a line may have at each place: octaves from 25 to 1,600 px."""
MOST_ALONG: Final = 512
"""Samples along a line, at most: a budget of work."""


def surpassed_by_chance(fit: StreakFit, tiles: Tiles, trails: Sequence[StreakFit] = ()) -> float:
    """Probability that a line exceeds those beside it by as much as this one does, if it is one of them; 0 where they do not
    tell.

    trails : other lines that may be trails. Where those parallel to it run, as in a train, the sky does not show its scatter.
    """
    length, width = fit.length_px, effective_width_px(fit.width_px)
    if not length > 0.0 or not math.isfinite(length + width + fit.sagitta_px) or fit.snr > BRIGHTEST:
        return 0.0
    step, first = max(STEP_WIDTHS * width, LEAST_STEP_PX), FIRST_WIDTHS * width + 1.0
    each = int((REACH_PX - first) // step) + 1
    if 2 * each < FEWEST:
        return 0.0
    away = first + step * np.arange(each)
    place = np.concatenate((-away[::-1], [0.0], away))
    light = _light(fit, tiles, place, width)
    seen = np.isfinite(light).mean(axis=1) >= SEEN_SHARE
    beside = (np.arange(place.size) != each) & ~_on_trails(fit, trails, place)
    if not seen[each] or np.count_nonzero(seen & beside) < FEWEST:
        return 0.0
    others = light[seen & beside]
    level = float(np.nanmedian(others))
    spread = CLIP * 1.4826 * float(np.nanmedian(np.abs(others - level)))
    mean = np.nanmean(np.clip(others, level - spread, level + spread), axis=1)
    return _tail(place[seen & beside], mean, float(np.nanmean(light[each])), fit.snr)


def _on_trails(fit: StreakFit, trails: Sequence[StreakFit], place: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which lines beside a line (n,), by their distances from it, lie on trails parallel to it for a part of it."""
    d_row, d_col = (fit.row1 - fit.row0) / fit.length_px, (fit.col1 - fit.col0) / fit.length_px
    out = np.zeros(place.size, dtype=np.bool_)
    for other in trails:
        turn = abs((other.angle_deg - fit.angle_deg + 90.0) % 180.0 - 90.0)
        alike = other.snr >= LEAST_TRAIL_SNR and other.width_px < WIDER * fit.width_px
        if other is fit or turn > PARALLEL_DEG or not alike:
            continue
        row, col = np.array([other.row0, other.row1]) - fit.row0, np.array([other.col0, other.col1]) - fit.col0
        along, across = row * d_row + col * d_col, row * d_col - col * d_row
        order = np.argsort(along)
        inside = np.clip(along[order], 0.0, fit.length_px)
        if not inside[1] - inside[0] > OVERLAP_SHARE * fit.length_px:
            continue
        low, high = np.sort(np.interp(inside, along[order], across[order]))
        reach = FIRST_WIDTHS * effective_width_px(other.width_px) + 1.0
        out |= (place > low - reach) & (place < high + reach)
    return out


def _light(fit: StreakFit, tiles: Tiles, place: NDArray[np.float64], width: float) -> NDArray[np.float64]:
    """Light across a line and those beside it, at places along them, (lines, n); NaN where half of it is not seen."""
    n = min(max(int(fit.length_px), 4), MOST_ALONG)
    share = (np.arange(n) + 0.5) / n
    half = math.ceil(LIGHT_WIDTHS * width)
    fine = np.arange(-half, half + 1.0)
    core = np.exp(-0.5 * (fine / width) ** 2)
    across = (place[:, None] + fine)[:, :, None] + 4.0 * fit.sagitta_px * share * (1.0 - share)
    d_row, d_col = (fit.row1 - fit.row0) / fit.length_px, (fit.col1 - fit.col0) / fit.length_px
    along = share * fit.length_px
    value = tiles.at(fit.row0 + along * d_row + across * d_col, fit.col0 + along * d_col - across * d_row)
    known = np.isfinite(value)
    weight = np.einsum("pfn,f->pn", known, core)
    light = np.einsum("pfn,f->pn", np.where(known, value, 0.0), core) / np.maximum(weight, 1e-9)
    return np.where(weight < 0.5 * core.sum(), np.nan, light)


def _tail(place: NDArray[np.float64], mean: NDArray[np.float64], own: float, snr: float) -> float:
    """Probability that a line of the same kind is as bright as one in the middle of others (n,), which may lie on a slope.

    snr : that the line has in white noise. 0 where the others scatter little more than this noise.
    """
    keep = np.ones(mean.size, dtype=np.bool_)
    for _ in range(3):
        line = np.polyfit(place[keep], mean[keep], 1)
        rest = mean - np.polyval(line, place)
        new = np.abs(rest) < OUTLIERS * 1.4826 * float(np.median(np.abs(rest)))
        if np.count_nonzero(new) < FEWEST or bool((new == keep).all()):
            break
        keep = new
    free = int(np.count_nonzero(keep)) - 2
    scatter = math.sqrt(float(rest[keep] @ rest[keep]) / free)
    above = (own - float(line[1])) / max(scatter, 1e-9)
    return float(scipy.special.stdtr(free, -above)) if above * LEAST_EXCESS < snr else 0.0


def against_beside(fit: StreakFit, tiles: Tiles, area_px2: float, trails: Sequence[StreakFit] = ()) -> float:
    """Odds that a line of the frame's own scatter is as bright, against a trail.

    area_px2 : of the frame. trails : see `surpassed_by_chance`.
    """
    places = LENGTHS * math.pi * area_px2 / effective_width_px(fit.width_px) ** 2
    return places * surpassed_by_chance(fit, tiles, trails) / REAL_PER_FRAME
