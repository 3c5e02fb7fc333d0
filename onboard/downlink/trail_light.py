"""Light across a trail and beyond its ends: how wide and how long a region must be to hold it."""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from onboard.downlink.roi import arc_points
from sboc_e2e.icd.signals import Detection, DetectorView

MOST_SAMPLES: Final = 2000
"""Places along a trail at which its light is looked at; a limit of time."""

BLOCK_WIDTHS: Final = 4.0
"""Length of a block of light beyond an end, in widths of the trail (one sigma)."""
LIT_WIDTHS: Final = 2.5
"""Pixels within this many widths of the line hold its light, those beyond twice as many the sky beside it."""
LIT_SIGMAS: Final = 3.0
"""Light of a block, above the sky beside it, from which the trail may go on there."""
DARK_BLOCKS: Final = 4
"""Blocks without light after which none is expected; they also tell the ground that the light is gone."""
LONGEST_GAP_PX: Final = 48.0
"""Dark blocks hold so many pixels at most."""


def trail_half_width_px(view: DetectorView, detection: Detection, *, least_px: float, largest_px: float) -> float:
    """Half width across that holds the trail's light, measured on the image: near objects are out of focus.

    The profile across the trail, above what lies at the largest distance, is followed outwards from `least_px` as long as
    the next 2 px on either side hold a significant part of the light (4 sigma, and 1 % of what lies within).
    """
    reach = math.ceil(largest_px)
    if reach < least_px + 4.0:
        return least_px
    profile, number = cross_profile(view, detection, reach)
    profile = profile - 0.5 * (np.median(profile[:4]) + np.median(profile[-4:]))
    noise = float(np.median(view.background.sigma_adu)) * math.sqrt(number)
    half = least_px
    while half + 2.0 <= largest_px:
        inner = round(half)
        inside = profile[reach - inner : reach + inner + 1].sum()
        ring = profile[reach - inner - 2 : reach - inner].sum() + profile[reach + inner + 1 : reach + inner + 3].sum()
        if ring < 4.0 * noise * 2.0 or ring < 0.01 * inside:
            break
        half += 2.0
    return half


def cross_profile(view: DetectorView, detection: Detection, reach: int) -> tuple[NDArray[np.float64], int]:
    """Sum along the trail of the image at offsets -reach ... reach px across it (nearest pixels), and how many each adds."""
    samples = max(1, min(int(detection.length_px), MOST_SAMPLES))
    values, _ = light_about(view, detection, (np.arange(samples) + 0.5) / samples, np.arange(-reach, reach + 1.0))
    # stars under the trail must not widen it: each offset's brightest and faintest tenths are left out
    values = np.sort(values, axis=0)
    cut = samples // 10
    return values[cut : samples - cut].sum(axis=0).astype(np.float64), samples - 2 * cut


def light_about(
    view: DetectorView, detection: Detection, fractions: NDArray[np.float64], offsets: NDArray[np.float64]
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """The image, ADU above the sky, at fractions (n,) of a trail's chord and offsets (m,) px across it, and whether it is known.

    Both are (n, m), of nearest pixels. Fractions below 0 and above 1 lie on the tangents at the ends.
    """
    length = detection.length_px
    drow, dcol = detection.row1 - detection.row0, detection.col1 - detection.col0
    points = arc_points(detection, fractions)
    normal = (dcol / length, -drow / length) if length > 0.0 else (0.0, 1.0)
    row = np.rint(points[:, :1] + offsets * normal[0]).astype(np.intp)
    col = np.rint(points[:, 1:] + offsets * normal[1]).astype(np.intp)
    rows, cols = view.residual_adu.shape
    inside = (row >= 0) & (row < rows) & (col >= 0) & (col < cols)
    row, col = np.clip(row, 0, rows - 1), np.clip(col, 0, cols - 1)
    return np.where(inside, view.residual_adu[row, col], np.float32(0.0)), inside & (view.mask[row, col] == 0)


def room_beyond_px(view: DetectorView, detection: Detection, end: int, width_px: float) -> float:
    """How far a region reaches beyond an end: as far as light goes on there, at most by the trail's own length, and some sky.

    Light is followed in blocks along the tangent. Blocks of which too little is known, as below a saturated star, neither hold
    light nor end it. end : 0 or 1. width_px : the trail's profile, one sigma.
    """
    block_px = math.ceil(max(BLOCK_WIDTHS * width_px, 2.0))
    dark_blocks = min(DARK_BLOCKS, math.ceil(LONGEST_GAP_PX / block_px))
    number = max(math.ceil(min(detection.length_px, MOST_SAMPLES) / block_px), dark_blocks)
    beyond = (np.arange(number * block_px, dtype=np.float64) + 0.5) / max(detection.length_px, 1.0)
    lit_px = math.ceil(LIT_WIDTHS * width_px)
    offsets = np.arange(-4 * lit_px, 4 * lit_px + 1, dtype=np.float64)
    values, known = light_about(view, detection, 1.0 + beyond if end else -beyond, offsets)
    on_line = np.abs(offsets) <= lit_px
    light, light_number = _block_means(values[:, on_line], known[:, on_line], number)
    apart = np.abs(offsets) > 2 * lit_px
    sky, sky_number = _block_means(values[:, apart], known[:, apart], number)
    enough = (light_number > 0.5 * block_px * on_line.sum()) & (sky_number > 0.25 * block_px * apart.sum())
    noise_adu = float(np.median(view.background.sigma_adu))
    error = noise_adu * np.sqrt(1.0 / np.maximum(light_number, 1.0) + 1.0 / np.maximum(sky_number, 1.0))
    lit = enough & (light - sky > LIT_SIGMAS * error)
    reached = 0
    dark = 0
    for k in range(number):
        reached, dark = (k + 1, 0) if lit[k] else (reached, dark + int(enough[k]))
        if dark >= dark_blocks:
            break
    return float((reached + dark_blocks) * block_px)


def _block_means(
    values: NDArray[np.float32], known: NDArray[np.bool_], number: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean of what is known in each of `number` equal parts of the rows of values, and its number of pixels; (number,) both."""
    count = known.reshape(number, -1).sum(axis=1, dtype=np.float64)
    total = np.where(known, values, np.float32(0.0)).reshape(number, -1).sum(axis=1, dtype=np.float64)
    return total / np.maximum(count, 1.0), count
