"""Flashes of the object itself among the light that was masked as other sources'.

A glint of a facet lasts milliseconds and looks like a star on the trail, but for three things: it is drawn out along the motion,
it is as narrow as the PSF across, and it lies on the middle of the trail. Stars that are listed, remembered or in the catalogue
were subtracted before. A particle hit is narrower than the PSF. The flash of an object that hardly moves meanwhile cannot be told
from a star; it stays out.
"""

from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ground.streaks.centre_line import LineFit
from ground.streaks.trail_model import SAGITTA, mean_all
from ground.streaks.trail_pixels import TrailPixels

Array = NDArray[np.float64]

LEAST_SNR: Final = 20.0
"""Far above the limit of the star lists (8), so that no unlisted star is taken for a flash."""
MIDDLE_WIDTHS: Final = 0.25
"""Largest distance of its light from the middle of the trail, PSF widths, beyond three sigma."""
SPREAD: Final = (0.6, 1.6)
"""Variance of its light across the trail over that of the PSF; along the trail it is larger."""
ACROSS_WIDTHS: Final = 3.0
"""Pixels this far from the line are looked at: 0.3 % of a flash's light lies beyond."""
GAP_WIDTHS: Final = 1.5
"""Masked pixels this far apart along the trail belong to two sources."""
MOST_WIDTHS: Final = 16.0
"""Longest flash along the trail: what shines for longer is followed by the light curve. Its mask may be longer by some widths."""


class Flash(NamedTuple):
    """Light of a flash, e-, and its variance."""

    light_e: float
    variance_e2: float


def flashes(line: LineFit, everything: TrailPixels, ends: tuple[float, float]) -> list[Flash]:
    """Flashes among the pixels that were left out of a trail's fit. everything : all usable pixels, in the axes of the line."""
    width = line.width_px
    near = everything.near(ACROSS_WIDTHS * width + abs(float(line.parameters[SAGITTA])))
    left_out = ~np.isin(near.index, line.pixels.index) & (near.u > ends[0] - 2.0 * width) & (near.u < ends[1] + 2.0 * width)
    masked = near.take(left_out)
    if masked.u.size == 0:
        return []
    trail = mean_all(line.parameters, masked.u, masked.v, line.scale)
    rest = masked.value_e - trail
    across = replace(line, pixels=masked).across_px
    variance = masked.variance_e2 + np.maximum(trail, 0.0) + np.maximum(rest, 0.0)
    starts = np.flatnonzero(np.diff(masked.u, prepend=-np.inf) > GAP_WIDTHS * width)
    found = []
    for some in np.split(np.arange(masked.u.size), starts[1:]):
        light, noise2 = float(rest[some].sum()), float(variance[some].sum())
        if light < LEAST_SNR * np.sqrt(noise2):
            continue
        middle = float(rest[some] @ across[some]) / light
        spread = float(rest[some] @ (across[some] - middle) ** 2) / light
        place = float(rest[some] @ masked.u[some]) / light
        along = float(rest[some] @ (masked.u[some] - place) ** 2) / light
        # of light that is even over the flash, and drawn out by the PSF
        length = float(np.sqrt(12.0 * max(along - width**2, 0.0)))
        drawn_out = along > SPREAD[1] * width**2 and length < min(MOST_WIDTHS * width, 0.5 * (ends[1] - ends[0]))
        off = MIDDLE_WIDTHS * width + 3.0 * width * np.sqrt(noise2) / light
        if drawn_out and abs(middle) < off and SPREAD[0] * width**2 < spread < SPREAD[1] * width**2:
            found.append(Flash(light, noise2))
    return found
