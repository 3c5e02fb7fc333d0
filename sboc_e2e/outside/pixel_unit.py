"""The unit of a frame's pixels: its gain where the header gives none, or one that its noise denies; and units that are tiny.

Light has the photon noise that the gain tells. Too low a gain makes bright pixels count for little, and the wings of a trail and
the sky beyond its ends for much. In a stack of values below 3, with a noise of 0.05, a gain of 1 e-/ADU had both ends of a trail
of S/N 367 2.7 px off. Too high a gain forgets photon noise, and the errors of bright trails are a little too small.
"""

import math
from dataclasses import dataclass, field
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
    square root of two. It is that of rounding at least, a step over the square root of 12; 0 where all pixels are equal.

    Stars raise it, by 21 % where they cover a tenth of a frame. A narrower range would not see the noise of a picture whose sky
    is cut off at black.
    """
    rows = pixels[:: max(1, pixels.shape[0] // SAMPLED_ROWS)].astype(np.float64)
    apart = rows[:, APART_PX:] - rows[:, :-APART_PX]
    apart = apart[np.isfinite(apart)]
    steps = np.abs(apart)
    rounding = float(np.min(steps, where=steps > 0.0, initial=np.inf)) / math.sqrt(12.0)
    if math.isinf(rounding):
        return 0.0
    low, high = (_grouped_quantile(apart, share) for share in (0.1587, 0.8413))
    return max(0.5 * (high - low) / math.sqrt(2.0), rounding)


def _grouped_quantile(values: NDArray[np.float64], share: float) -> float:
    """A quantile of values of which many are alike, as those of whole numbers are: each value is spread evenly half-way to its
    neighbours. Otherwise the noise of whole numbers would come in steps of 0.71.
    """
    value = float(np.quantile(values, share, method="lower"))
    below, above = values[values < value], values[values > value]
    first = 0.5 * (value + float(below.max())) if below.size else value
    last = 0.5 * (value + float(above.min())) if above.size else value
    n_alike = values.size - below.size - above.size
    return first + (last - first) * (share * values.size - below.size) / n_alike


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


@dataclass(kw_only=True)
class CameraUnits:
    """Units of cameras, each that of the camera's first frame of real numbers: frames that share a pattern are in one unit."""

    _of: dict[str, float] = field(default_factory=dict)

    def of_next(self, camera: str, pixels: NDArray[Any]) -> float:
        """The unit of the next frame (rows, cols) of a camera, see `usable_unit`. Whole numbers set none for others."""
        unit = usable_unit(pixels, self._of.get(camera))
        if pixels.dtype.kind == "f":
            self._of.setdefault(camera, unit)
        return unit


def in_unit(pixels: NDArray[Any], unit: float) -> NDArray[np.float32]:
    """Pixels times a power of ten; NaN where that is no number."""
    with np.errstate(over="ignore"):
        out = pixels.astype(np.float32) * np.float32(unit)
    out[~np.isfinite(out)] = np.nan
    return out
