"""What a detection lies on: saturated pixels, listed stars under the trail, a bright star it points at."""

import math
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd.flags import MaskBit, StarFlag, StreakFlag
from sboc_e2e.icd.signals import Detection, DetectorView

UNDER_SIGMAS: Final = 3.0
"""A star whose centre lies closer to a trail, in PSF widths, shines into its cross-section."""

SPIKE_REACH_PX: Final = 40.0
"""A spike or a bleeding column begins no farther from the centre of its saturated star ..."""

SPIKE_ACROSS_PX: Final = 2.0
"""... and its line passes the centre as close as this."""


def with_context(detection: Detection, view: DetectorView, static: NDArray[np.bool_]) -> Detection:
    """The detection with SATURATED, CROSSES_STAR and SPIKE_LIKE where they are known to be true.

    static : (n,) entries of the view's star list that the frame before shows too; only they count as stars, for a bright trail
    is in the list itself.
    """
    flags = detection.flags | (StreakFlag.SATURATED if _saturated(detection, view.mask) else StreakFlag(0))
    length = detection.length_px
    u_row, u_col = (
        ((detection.row1 - detection.row0) / length, (detection.col1 - detection.col0) / length) if length else (0.0, 0.0)
    )
    reach, stars = SPIKE_REACH_PX, view.stars
    near = (
        static
        & (stars.row > min(detection.row0, detection.row1) - reach)
        & (stars.row < max(detection.row0, detection.row1) + reach)
    )
    near &= (stars.col > min(detection.col0, detection.col1) - reach) & (stars.col < max(detection.col0, detection.col1) + reach)
    d_row, d_col = stars.row[near] - detection.row0, stars.col[near] - detection.col0
    along = d_row * u_row + d_col * u_col
    distance = np.hypot(d_row - np.clip(along, 0.0, length) * u_row, d_col - np.clip(along, 0.0, length) * u_col)
    if (distance < UNDER_SIGMAS * view.psf_sigma_px).any():
        flags |= StreakFlag.CROSSES_STAR
    beyond = np.maximum(-along, along - length)
    across = np.abs(d_row * u_col - d_col * u_row)
    bright = (stars.flags[near] & StarFlag.SATURATED) != 0
    if length > 0.0 and (bright & (beyond > 0.0) & (beyond < SPIKE_REACH_PX) & (across < SPIKE_ACROSS_PX)).any():
        flags |= StreakFlag.SPIKE_LIKE
    return replace(detection, flags=flags)


def _saturated(detection: Detection, mask: NDArray[np.uint8]) -> bool:
    """Whether a pixel on the path is saturated."""
    n = 2 * math.ceil(detection.length_px) + 1
    row = np.rint(np.linspace(detection.row0, detection.row1, n)).astype(np.int64)
    col = np.rint(np.linspace(detection.col0, detection.col1, n)).astype(np.int64)
    return bool((mask[np.clip(row, 0, mask.shape[0] - 1), np.clip(col, 0, mask.shape[1] - 1)] & MaskBit.SATURATED).any())
