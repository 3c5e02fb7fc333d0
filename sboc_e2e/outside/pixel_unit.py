"""The unit of a frame's pixels: its gain where the header gives none, or one that its noise denies; and units that are tiny.

Light has the photon noise that the gain tells. Too low a gain makes bright pixels count for little, and the wings of a trail and
the sky beyond its ends for much. In a stack of values below 3, with a noise of 0.05, a gain of 1 e-/ADU had both ends of a trail
of S/N 367 2.7 px off. Too high a gain forgets photon noise, and the errors of bright trails are a little too small.
"""

import math
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

ASSUMED_NOISE_E: Final = 5.0
"""Noise of a pixel of the sky where no gain is known, at least: that of a readout. Bright skies and stacks have more. Chosen."""
LEAST_NOISE_E: Final = 0.3
"""Less noise has no camera of these: the best scientific ones have 0.7 e- of readout, and stacks of several frames a half of it.
Then the pixels are not in the unit of the header's gain: divided by the exposure, or normalised. Chosen."""
APART_PX: Final = 4
"""Pixels so far apart in a row share little noise, in pictures that were smoothed too."""
SAMPLED_ROWS: Final = 256
"""Of a frame, for its noise: 65,000 pixels and more tell it to 1 %."""

LEAST_NOISE: Final = 1e-3
"""Pixels with less noise are multiplied: the chain has floors of 1e-3 e- and less. Images in erg/(s cm2 A) have 1e-20."""
UNIT_STEP: Final = 1e6
"""Multiplied by powers of this number."""
HELD: Final = 30.0
"""Frames of one camera differ less in their noise: one beyond a border of units by less than this keeps the unit of the others.
Between exposures of 1 s and 300 s photon noise grows 17-fold."""


def noise_adu(pixels: NDArray[Any]) -> float:
    """Noise of a pixel (rows, cols): half of the range of the middle 68 % of differences of pixels `APART_PX` apart, over the
    square root of two. Where most are equal it is that of rounding, a step over the square root of 12; 0 where all are.

    Of whole numbers it comes in steps of 0.71: 0.71 where 1 was drawn, and 4.24 or 4.95 where 4 were.
    """
    rows = pixels[:: max(1, pixels.shape[0] // SAMPLED_ROWS)].astype(np.float64)
    apart = rows[:, APART_PX:] - rows[:, :-APART_PX]
    apart = apart[np.isfinite(apart)]
    if not apart.size:
        return 0.0
    low, high = np.percentile(apart, [15.87, 84.13])
    if high > low:
        return 0.5 * float(high - low) / math.sqrt(2.0)
    steps = np.abs(apart[apart != 0.0])
    return float(steps.min()) / math.sqrt(12.0) if steps.size else 0.0


def assumed_gain_e_adu(pixels: NDArray[Any]) -> float:
    """The gain (e-/ADU) with which the noise of a pixel is `ASSUMED_NOISE_E`, or 1 where it has more with that."""
    noise = noise_adu(pixels)
    return max(ASSUMED_NOISE_E / noise, 1.0) if noise > 0.0 else 1.0


def is_denied(gain_e_adu: float, pixels: NDArray[Any]) -> bool:
    """Whether the noise of a pixel is too small for a gain to be that of these numbers."""
    return 0.0 < gain_e_adu * noise_adu(pixels) < LEAST_NOISE_E


def usable_unit(pixels: NDArray[Any], held: float | None = None) -> float:
    """The power of `UNIT_STEP` that brings the noise of pixels to `LEAST_NOISE` or more; 1 where it is, and for whole numbers.

    held : unit of earlier frames of the camera, which stays where it nearly does, and where all pixels are alike: what frames
    share is in one unit.
    """
    if pixels.dtype.kind != "f":
        return 1.0
    noise = noise_adu(pixels)
    if not noise > 0.0:
        return held or 1.0
    if held is not None and LEAST_NOISE / HELD <= noise * held < LEAST_NOISE * UNIT_STEP * HELD:
        return held
    return UNIT_STEP ** math.ceil(math.log(LEAST_NOISE / noise, UNIT_STEP)) if noise < LEAST_NOISE else 1.0


def in_unit(pixels: NDArray[Any], unit: float) -> NDArray[np.float32]:
    """Pixels times a power of ten; NaN where that is no number."""
    with np.errstate(over="ignore"):
        out = pixels.astype(np.float32) * np.float32(unit)
    out[~np.isfinite(out)] = np.nan
    return out
