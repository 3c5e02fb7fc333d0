"""Where the light of a trail ends that may fade: as far as it is seen without a gap, and the stretch over which it is lost.

An eye follows a trail in the same way. Over the stretch the light falls from `BRIGHT_SNR` to `FAINT_SNR` in a window; where it
stops there is none. Light of unlisted stars on lines beside the trail is noise here.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from ground.streaks.light_blocks import Array, blocks_of, light_beside, sums_before, weights_of
from ground.streaks.trail_pixels import TrailPixels

BLOCK_WIDTHS: Final = 2.0
"""Length of a block in widths of the profile: half of those in which a fall is told from a step."""
WINDOW_PX: Final = 12.0
"""Length in which light must be seen. 6, 8, 12 and 20 px were tried at 140 ends of real trails, without what follows: with 8 and
12 px about 80 % of the ends lie within 6 px of the eye's, with 6 and 20 px 78 and 67 %."""
SEEN_SNR: Final = 4.0
"""S/N in a window below which the light has ended."""
BRIGHT_SNR: Final = 12.0
"""S/N in a window down to which no light is lost."""
FAINT_SNR: Final = 2.0
"""S/N in a window below which all of it is lost."""
USUAL_SNR: Final = 8.0
"""S/N that a window has in the mean of a trail: twice `SEEN_SNR`. Windows of faint trails are longer."""
BRIGHT_SHARE: Final = 0.75
"""Share of a window's usual S/N that light has where nothing of it is lost yet. Chosen, not measured."""
GAP_SNRS: Final = 2.0
"""Light from a gap on to the fit's end that is seen so many times as well as a window must be goes on after it. Chosen."""
MISSED_SHARE: Final = 0.5
"""Share of the light before a place that is left up to the fit's end, at most, where the end moves inwards to it."""
MISSED_SIGMAS: Final = 8.0
"""Significance of the light that is missing there. With 0, 3, 5 and 8 the intervals hold the eye's end, or it lies within 2 px,
at 66, 66, 67 and 69 % of 379 ends of real trails."""
CLUTTER_PERCENTILES: Final = (15.87, 84.13)
"""Half of the range of light on lines beside a trail is its scatter: one bright star is not what unlisted stars scatter by."""


@dataclass(frozen=True, kw_only=True)
class LightEnd:
    """Places from the middle of a trail, px: where light ends, and where it is lost between, for sure and for all."""

    place_px: float
    bright_px: float
    faint_px: float


def light_end(outwards: TrailPixels, end_px: float, width_px: float, border_px: float) -> LightEnd:
    """The end of the light along a half of a trail. Where light stops at the fit's end, all three places are it.

    end_px : of the fit, half of the trail's length.
    """
    blocks = blocks_of(outwards, width_px, border_px, BLOCK_WIDTHS)
    beside, variance = light_beside(outwards, end_px, width_px, border_px, BLOCK_WIDTHS)
    mean, scatter = 0.0, 0.0
    if beside.size:
        mean = max(float(np.median(beside)), 0.0)
        low, high = np.percentile(beside, CLUTTER_PERCENTILES)
        scatter = math.sqrt(max((0.5 * float(high - low)) ** 2 - float(np.median(variance)), 0.0))
    density = blocks.density - np.where(blocks.place > end_px, mean, 0.0)
    weight = weights_of(np.hypot(blocks.sigma, scatter))
    last = min(int(end_px / blocks.length_px), density.size)
    within = _snr_up_to(density, weight, last)
    window_px = max(WINDOW_PX, end_px * (USUAL_SNR / max(within[0], 1e-3)) ** 2)
    number = max(math.ceil(window_px / blocks.length_px), 1)
    if window_px > end_px or number > density.size:
        return LightEnd(place_px=end_px, bright_px=end_px, faint_px=end_px)
    before = density[max(last - number, 0) : last][weight[max(last - number, 0) : last] > 0.0]
    if before.size:  # what is brighter beyond the end than before it is the light of a star
        density = np.where(blocks.place > end_px, np.minimum(density, float(np.median(before))), density)
    usual_snr = within[0] * math.sqrt(window_px / end_px)
    first = int(0.5 * end_px / blocks.length_px)
    snr = _window_snr(density, weight, number)
    near_px = max(2.0 * blocks.length_px, 2.0)
    places = []
    for least in (SEEN_SNR, min(BRIGHT_SNR, BRIGHT_SHARE * usual_snr), FAINT_SNR):
        # what is lit again further on, before the fit's end, was a gap: a dust ring, a dark star, a glint
        lost = np.flatnonzero((snr[first:] < least) & (within[first : snr.size] < GAP_SNRS * least))
        if lost.size:
            place = _step_about(density, weight, first + int(lost[0]), number) * blocks.length_px
        else:
            place = min(density.size * blocks.length_px, border_px)
        places.append(end_px if abs(place - end_px) <= near_px else place)
    seen, bright, faint = places
    if seen < end_px and not _is_dark(density, weight, round(seen / blocks.length_px), last, number):
        seen = end_px
    return LightEnd(place_px=seen, bright_px=min(bright, seen), faint_px=max(faint, seen))


def _is_dark(density: Array, weight: Array, place: int, last: int, number: int) -> bool:
    """Whether the blocks between a place and a fit's end lack the light that those before it have."""
    before = slice(max(place - number, 0), place)
    level = float(np.average(density[before], weights=weight[before] + 1e-30))
    rest, known = density[place:last], weight[place:last]
    total = float(known.sum())
    if not total > 0.0:
        return False
    light = float(known @ rest) / total
    return light < MISSED_SHARE * level and (level - light) * math.sqrt(total) > MISSED_SIGMAS


def _window_snr(density: Array, weight: Array, number: int) -> Array:
    """S/N of the light in each window of so many blocks, infinite where none of them is known."""
    total, light = (sums_before(each) for each in (weight, weight * density))
    known = total[number:] - total[:-number]
    return np.where(known > 0.0, (light[number:] - light[:-number]) / np.sqrt(np.maximum(known, 1e-300)), math.inf)


def _snr_up_to(density: Array, weight: Array, last: int) -> Array:
    """S/N (n + 1,) of the light from each block on, up to a last one; 0 from this on."""
    total, light = (sums_before(each) for each in (weight, weight * density))
    known = np.maximum(total[last] - total, 0.0)
    return np.asarray((light[last] - light) * (known > 0.0) / np.sqrt(np.maximum(known, 1e-300)))


def _step_about(density: Array, weight: Array, block: int, number: int) -> int:
    """The block before which light stops, in the window before and the one from this block on: the best step to nothing."""
    low, high = max(block - number, 0), min(block + number, density.size)
    light, known = density[low:high], weight[low:high]
    before = light[: block + 1 - low], known[: block + 1 - low] + 1e-30
    level = float(np.average(before[0], weights=before[1]))
    off, dark = (sums_before(known * misfit**2) for misfit in (level - light, light))
    return low + int(np.argmin(off + dark[-1] - dark))
