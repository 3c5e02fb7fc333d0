"""What a detection lies on: saturated pixels, listed stars under the trail, a bright star it points at."""

import math
from dataclasses import replace
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from onboard.image.nearest import inside
from sboc_e2e.icd.flags import MaskBit, StarFlag, StreakFlag
from sboc_e2e.icd.signals import Detection, DetectorView

SATURATED: Final = np.uint8(MaskBit.SATURATED)

UNDER_SIGMAS: Final = 3.0
"""A star whose centre lies closer to a trail, in PSF widths, shines into its cross-section."""

SPIKE_SNR: Final = 5000.0
"""Least S/N of a star with visible spikes: 2 % of its light in four arms make a line of S/N 4 to 7 just outside its mask."""

SPIKE_REACH_PX: Final = 60.0
"""A spike or a bleeding column begins no farther outside the mask of its star ..."""

ARM_PX: Final = 200.0  # half a pair of arms of a star of S/N `ARM_SNR`; no measurement of it is on record
ARM_SNR: Final = 50_000.0  # light that falls as r^-2 stays above a limit to a distance that grows as the root of S/N
MOST_ARM_PX: Final = 300.0
"""... opposite arms, joined across the star, reach no farther, growing as the root of S/N / ARM_SNR up to the most, to which
saturated stars are held at once ..."""

ARM_SHARE: Final = 0.09
"""... and the shorter one has so much of the length ..."""

SPIKE_ACROSS_PX: Final = 2.0
"""... and its line passes the centre as close as this, its own uncertainty added ..."""

COLUMN_ACROSS_PX: Final = 6.0  # six columns to either side. Chosen, not measured
COLUMN_SLOPE: Final = 0.1
"""... or as this along the columns of a saturated star: several bleed side by side, and which ones do hangs on its place."""


def with_context(detection: Detection, view: DetectorView, is_star: NDArray[np.bool_], radii: NDArray[np.float64]) -> Detection:
    """The detection with SATURATED, CROSSES_STAR and SPIKE_LIKE where they are known to be true.

    is_star : (n,) entries of the view's star list that are stars, for a bright trail is in the list itself. radii : (n,) of
    their masks, px. A trail that happens to aim at a bright star is SPIKE_LIKE too: about one in 200.
    """
    length, stars = detection.length_px, view.stars
    ends = (detection.row0, detection.col0, detection.row1, detection.col1)
    flags = detection.flags | (StreakFlag.SATURATED if _saturated(ends, length, view.mask) else StreakFlag(0))
    u_row, u_col = (
        ((detection.row1 - detection.row0) / length, (detection.col1 - detection.col0) / length) if length else (0.0, 0.0)
    )
    reach = SPIKE_REACH_PX + radii
    near = inside(stars.row, stars.col, ends, float(reach.max(initial=0.0)))
    near = near[is_star[near]]
    row, col, reach = stars.row[near], stars.col[near], reach[near]
    close = (row > min(ends[0], ends[2]) - reach) & (row < max(ends[0], ends[2]) + reach)
    close &= (col > min(ends[1], ends[3]) - reach) & (col < max(ends[1], ends[3]) + reach)
    near, reach = near[close], reach[close]
    d_row, d_col = stars.row[near] - detection.row0, stars.col[near] - detection.col0
    along = d_row * u_row + d_col * u_col
    distance = np.hypot(d_row - np.clip(along, 0.0, length) * u_row, d_col - np.clip(along, 0.0, length) * u_col)
    if (distance < UNDER_SIGMAS * view.psf_sigma_px).any():
        flags |= StreakFlag.CROSSES_STAR
    full = (stars.flags[near] & StarFlag.SATURATED) != 0
    bright = full | (stars.snr[near] > SPIKE_SNR)
    if length > 0.0 and bright.any():
        beyond = np.maximum(-along, along - length)
        across = np.abs(d_row * u_col - d_col * u_row)
        # three sigma of a fitted line at a distance: its angle is known to sqrt(24) s / (S L)
        turn = 3.0 * math.sqrt(24.0) * view.psf_sigma_px / (detection.snr * length)
        least = np.where(full & (abs(u_col) < COLUMN_SLOPE), COLUMN_ACROSS_PX, SPIKE_ACROSS_PX)
        # a bent line runs between its chord and its parabola, wherever it goes beyond its ends
        ahead = np.maximum(0.0, beyond) / length
        bow = abs(detection.sagitta_px) * np.maximum(1.0, 4.0 * ahead * (1.0 + ahead))
        aims = across < least + bow + turn * np.maximum(0.0, beyond + 0.5 * length)
        begins = (beyond > 0.0) & (beyond < reach)
        arm = radii[near] + np.where(full, MOST_ARM_PX, np.minimum(MOST_ARM_PX, ARM_PX * np.sqrt(stars.snr[near] / ARM_SNR)))
        both_arms = (beyond <= -ARM_SHARE * length) & (np.maximum(along, length - along) < arm)
        if (bright & aims & (begins | both_arms)).any():
            flags |= StreakFlag.SPIKE_LIKE
    return detection if flags == detection.flags else replace(detection, flags=flags)


@njit(cache=True)
def _saturated(ends: tuple[float, float, float, float], length_px: float, mask: NDArray[np.uint8]) -> bool:
    """Whether a pixel on the path is saturated."""
    steps = 2 * math.ceil(length_px)
    for k in range(steps + 1):
        u = k / max(steps, 1)
        row, col = np.rint(ends[0] + u * (ends[2] - ends[0])), np.rint(ends[1] + u * (ends[3] - ends[1]))
        if mask[min(max(int(row), 0), mask.shape[0] - 1), min(max(int(col), 0), mask.shape[1] - 1)] & SATURATED:
            return True
    return False
