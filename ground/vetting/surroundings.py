"""The picture about a line: numbers by which an eye tells the sky from ground, clouds, galaxies and compressed video.

Three cut-outs are sampled along the line: a strip of its own pixels, a strip as wide as half of its length, and a square of 2.5
lengths, each scaled by its median and its robust scatter. So neither exposure nor stretch matter, and no camera is described.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from sboc_e2e.icd.products import StreakFit

Array = NDArray[np.float32]

SMALLEST_PX: Final = 32
"""The picture is halved until its shorter side is no longer than this."""
LEAST_PX: Final = 10.0
"""Shorter lines are looked at as if they were this long."""
STRIP: Final = (32, 96)
"""Samples across and along a strip, which is two lengths long: the line takes the middle half."""
SQUARE: Final = 64
"""Samples of each side of the square."""
SQUARE_PX: Final = 160.0
"""Least side of the square."""
WIDE: Final = 0.5
"""Width of the wide strip over the line's length; at least `STRIP` pixels."""
SEEN: Final = 0.5
"""Share of a sample's pixels that lie in the frame, at least."""
LIMITS: Final = (-6.0, 8.0)
"""Samples, as the inverse hyperbolic sine of sigmas, count between these."""
ROBUST_SIGMA: Final = 1.4826
"""Standard deviation over the median absolute deviation, of a Gaussian."""

BESIDE: Final = np.r_[0:10, 22:32]
"""Rows of a strip beside its line; `ON_LINE` are those on it."""
ON_LINE: Final = slice(14, 18)
OF_LINE: Final = slice(24, 72)
"""Columns of a strip along the line; `WITHIN` are those well within, `BEFORE` and `BEHIND` those beyond its ends."""
WITHIN: Final = slice(28, 68)
BEFORE: Final = slice(4, 20)
BEHIND: Final = slice(76, 92)
SIDES: Final = (slice(0, 11), slice(21, 32))
"""Rows of the wide strip on both sides of its line."""
OFF_LINE: Final = np.r_[0:28, 36:64]
"""Rows of the square off its line, which runs along the middle: peaks within four samples of it may be the line's own."""
LEAST_LIGHT: Final = 0.2
"""Light of a line counts as this much at least where it is divided by; in the units of samples."""
SMALL: Final = 0.02
"""Keeps ratios of gradients finite; in the units of samples."""
LARGE_SAMPLES: Final = 2.0
"""Sigma of the structure at large, in samples of the square."""
PEAK_SIGMAS: Final = 2.0
"""Height of a star-like peak above the median about it."""

NAMES: Final = ("unrest", "beyond", "texture_ln", "unevenness", "structure_ln", "peaks_ln", "border_share")
"""The numbers, in their order:

unrest : scatter of the pixels beside the line over their robust scatter, stretched. Trees and compressed video have much.
beyond : light beyond the darker end over the line's own. A horizon or a spike goes on.
texture_ln : ln of the gradients along the line over those across it, beside it. Paving and clouds run along with it.
unevenness : scatter of the light along the line over its mean.
structure_ln : ln of the gradients at large in the square. Landscapes and galaxies have structure there.
peaks_ln : ln of one more than the number of star-like peaks in the square.
border_share : distance of the middle from the nearest border over that side of the frame.
"""


@dataclass(frozen=True, kw_only=True, eq=False)
class Picture:
    """A frame at full size and halved again and again, float32; what no pixel saw is as bright as the median."""

    levels: tuple[Array, ...]

    @classmethod
    def of(cls, pixels: NDArray[Any], unknown: NDArray[np.bool_ | np.uint8]) -> "Picture":
        """Of an image (rows, cols) in any units."""
        whole = pixels.astype(np.float32)
        hidden = unknown != 0
        if hidden.any():
            whole[hidden] = np.median(whole[~hidden][::7]) if not hidden.all() else 0.0
        levels = [whole]
        while min(levels[-1].shape) > SMALLEST_PX:
            rows, cols = levels[-1].shape
            half = cv2.resize(levels[-1], ((cols + 1) // 2, (rows + 1) // 2), interpolation=cv2.INTER_AREA)
            levels.append(np.asarray(half, dtype=np.float32))
        return cls(levels=tuple(levels))

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns at full size."""
        rows, cols = self.levels[0].shape
        return rows, cols

    def level_of(self, step_px: float) -> int:
        """The level whose pixels are at most half of a step."""
        return min(int(math.log2(max(0.5 * step_px, 1.0))), len(self.levels) - 1)


@dataclass(frozen=True, kw_only=True)
class _Axes:
    """Middle of a line (row, col), its direction, and its length in px."""

    middle: NDArray[np.float64]
    along: NDArray[np.float64]
    length_px: float

    @classmethod
    def of(cls, ends: Sequence[float]) -> "_Axes":
        start, stop = np.asarray(ends[:2], dtype=np.float64), np.asarray(ends[2:], dtype=np.float64)
        length = max(float(np.linalg.norm(stop - start)), LEAST_PX)
        return cls(middle=0.5 * (start + stop), along=(stop - start) / length, length_px=length)


def _cut(
    picture: Picture, axes: _Axes, sampled: tuple[int, int], step_px: tuple[float, float], level: int, samples: tuple[int, int]
) -> Array:
    """Samples (across, along) of the picture about a line, each the mean of some; outside the frame 0.

    sampled, step_px : number and distance across and along; samples : how many of them are left.
    """
    across, along = ((np.arange(n) - 0.5 * (n - 1)) * step for n, step in zip(sampled, step_px, strict=True))
    row = axes.middle[0] + across[:, None] * -axes.along[1] + along * axes.along[0]
    col = axes.middle[1] + across[:, None] * axes.along[0] + along * axes.along[1]
    rows, cols = picture.shape
    inside = (row > -0.5) & (row < rows - 0.5) & (col > -0.5) & (col < cols - 0.5)
    scale = 0.5**level
    x, y = (((each + 0.5) * scale - 0.5).astype(np.float32) for each in (col, row))
    values = cv2.remap(picture.levels[level], x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT_101)
    blocks = samples[0], sampled[0] // samples[0], samples[1], sampled[1] // samples[1]
    mean, seen = values.reshape(blocks).mean(axis=(1, 3)), inside.reshape(blocks).mean(axis=(1, 3)) > SEEN
    told = mean[seen] if seen.any() else mean.ravel()
    middle = np.median(told)
    scatter = ROBUST_SIGMA * np.median(np.abs(told - middle)) + 1e-9
    stretched = np.where(seen, np.arcsinh((mean - middle) / scatter), 0.0)
    return np.asarray(np.clip(stretched, *LIMITS), dtype=np.float32)


def _own_strip(picture: Picture, axes: _Axes) -> Array:
    """Pixels of the frame to both sides of a line, `STRIP` samples."""
    number = max(math.ceil(2.0 * axes.length_px / STRIP[1]), 1) * STRIP[1]
    return _cut(picture, axes, (STRIP[0], number), (1.0, 2.0 * axes.length_px / number), 0, STRIP)


def _wide_strip(picture: Picture, axes: _Axes) -> Array:
    """A strip whose width is in proportion to its length, `STRIP` samples."""
    step = 2.0 * axes.length_px / STRIP[1]
    level = picture.level_of(step)
    step_across = max(WIDE * axes.length_px / STRIP[0], 1.0)
    along, across = (STRIP[k] * max(1, round(each / 2**level)) for k, each in ((1, step), (0, step_across)))
    return _cut(picture, axes, (across, along), (step_across * STRIP[0] / across, 2.0 * axes.length_px / along), level, STRIP)


def _square(picture: Picture, axes: _Axes) -> Array:
    """The square about a line, (`SQUARE`, `SQUARE`) samples."""
    step = max(2.5 * axes.length_px, SQUARE_PX) / SQUARE
    level = picture.level_of(step)
    each = max(1, round(step / 2**level))
    return _cut(picture, axes, (SQUARE * each,) * 2, (step / each,) * 2, level, (SQUARE, SQUARE))


def _light(strip: Array) -> tuple[Array, float]:
    """Light along a strip's line above what lies beside it, and its mean within the line, away from zero."""
    light = strip[ON_LINE].mean(axis=0) - np.median(strip[BESIDE], axis=0)
    return light, abs(float(light[WITHIN].mean())) + LEAST_LIGHT


def numbers_of(picture: Picture, ends: Sequence[float]) -> NDArray[np.float64]:
    """The numbers (7,) of `NAMES` for a line from (row0, col0) to (row1, col1)."""
    axes = _Axes.of(ends)
    own, wide, square = _own_strip(picture, axes), _wide_strip(picture, axes), _square(picture, axes)
    light, own_light = _light(own)
    wide_light, wide_mean = _light(wide)
    beside = [wide[side] for side in SIDES]
    level, steep = (sum(float(np.abs(np.diff(side, axis=axis)).mean()) for side in beside) for axis in (1, 0))
    highest = ndimage.maximum_filter(square, 3) == square
    peaks = highest & (square - ndimage.median_filter(square, 7) > PEAK_SIGMAS)
    rows, cols = picture.shape
    place = (axes.middle + 0.5) / (rows, cols)
    return np.array(
        [
            float(own[BESIDE, OF_LINE].std()),
            min(float(wide_light[BEFORE].mean()), float(wide_light[BEHIND].mean())) / wide_mean,
            math.log((level + SMALL) / (steep + SMALL)),
            float(light[WITHIN].std()) / own_light,
            math.log(float(ndimage.gaussian_gradient_magnitude(square, LARGE_SAMPLES).mean()) + 0.5 * SMALL),
            math.log1p(int(peaks[OFF_LINE].sum())),
            float(min(*place, *(1.0 - place))),
        ]
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Surroundings:
    """The numbers of a frame's lines. ends : (k, 4) of the lines; numbers : (k, 7) in the order of `NAMES`."""

    ends: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 4)))
    numbers: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, len(NAMES))))

    @classmethod
    def of(cls, picture: Picture, lines: Sequence[Sequence[float]]) -> "Surroundings":
        """Of lines (row0, col0, row1, col1) in a picture."""
        told = [numbers_of(picture, line) for line in lines]
        return cls(ends=np.array(lines, dtype=np.float64).reshape(-1, 4), numbers=np.array(told).reshape(-1, len(NAMES)))

    def about(self, fits: Sequence[StreakFit]) -> NDArray[np.float64]:
        """Numbers (n, 7) of fits: those of the line whose ends are nearest. NaN where there is none."""
        if not len(self.ends):
            return np.full((len(fits), len(NAMES)), math.nan)
        out = np.empty((len(fits), len(NAMES)))
        for k, fit in enumerate(fits):
            here = np.array([fit.row0, fit.col0, fit.row1, fit.col1])
            apart = [np.hypot(*(self.ends[:, i : i + 2] - here[j : j + 2]).T) for i, j in ((0, 0), (2, 2), (0, 2), (2, 0))]
            out[k] = self.numbers[int(np.argmin(np.minimum(apart[0] + apart[1], apart[2] + apart[3])))]
        return out
