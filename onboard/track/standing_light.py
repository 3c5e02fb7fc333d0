"""What stands still at a track's places: light that the other frames show there too is not the track's own.

Stars too faint for the list, and what is left of those that were taken out, stand in every frame. To the noise of lines they add
2 %. But a short trail needs only one or two of them: of 17 false tracks among 25,000 stars a frame (seed 55000) eight were below
15 px, and in those below 20 px stars made 1.8 of the joint S/N.
"""

import math
from typing import Final, NamedTuple

import numba as nb
import numpy as np
from numpy.typing import NDArray

from onboard.track.frames import Frames
from onboard.track.packed import PIXELS, STEP, ZERO, code_at
from onboard.track.trail_sums import placed

LIT: Final = 3.0 * 16.0 / STEP
"""A pixel is left out where the sum of the other frames there exceeds so many steps for the root of their number: 3 sigma. With
2.5 tracks among stars lose more, with 3.5 more of what is false stays (seeds 105, 55000 and 55100)."""

STATIC_ERRORS: Final = 2.0
"""What the other frames show on average at the places of a track's other pixels counts above so many errors of its mean. Above
one error noise alone takes so much that 5 of 129 objects of two frames among stars were lost (seed 105)."""


class Standing(NamedTuple):
    """Of a trail in one frame. static : S/N that what stands still gives to it, by the mean of the other frames. lit, pixels :
    sum, in steps of a code, and number of its pixels where they are lit. rest : as static, without these pixels."""

    static: float
    lit: float
    pixels: int
    rest: float


@nb.njit(cache=True)
def others(frames: Frames) -> float:
    """Frames of full resolution beside a trail's own, one at least."""
    return float(max(frames.n_frames - frames.n_old - 1.0, 1.0))


@nb.njit(cache=True)
def standing(
    frames: Frames,
    images: tuple[NDArray[np.uint64], ...],
    own: int,
    line: NDArray[np.float64],
    unit: float,
    place: NDArray[np.float64],
) -> Standing:
    """What stands still at a segment of frame `own`: pixel by pixel, what the other frames show at its place among the stars.

    images : as `packed.packed`. Frames at half resolution are not looked at. line (4,) : row0, col0, row1, col1 in the centre
    frame. unit : noise of a sum, for the root of a pixel, steps of a code. place (4,) : work space.
    """
    length = math.hypot(line[2] - line[0], line[3] - line[1])
    u_row, u_col = (line[2] - line[0]) / length, (line[3] - line[1]) / length
    steep = placed(line, frames.transforms[own], place)
    slope = place[3] / place[2]
    total = known = rest = rest_known = lit = pixels = weight = 0
    for major in range(math.ceil(place[0]), math.floor(place[0] + place[2] * length) + 1):
        away = major - place[0]
        minor = math.floor(place[1] + slope * away + 0.5)
        code = 0
        if own >= frames.n_old:
            code = _code(images[own], major, minor) if steep else _code(images[own], minor, major)
        weight += int(code > 0)
        row, col = line[0] + away / place[2] * u_row, line[1] + away / place[2] * u_col
        light = n = 0
        for frame in range(frames.n_old, frames.n_frames):
            if frame != own:
                way = frames.transforms[frame]
                i = math.floor(way[0, 0] * row + way[0, 1] * col + way[0, 2] + 0.5)
                j = math.floor(way[1, 0] * row + way[1, 1] * col + way[1, 2] + 0.5)
                beside = _code(images[frame], i, j)
                if beside > 0:
                    light += beside - ZERO
                    n += 1
        total += light
        known += n
        if code > 0 and light > LIT * math.sqrt(n):
            lit += code - ZERO
            pixels += 1
        else:
            rest += light
            rest_known += n
    root = math.sqrt(float(weight) if own >= frames.n_old else known / others(frames)) / unit
    return Standing(total / max(known, 1) * root, float(lit), pixels, rest / max(rest_known, 1) * root)


@nb.njit(cache=True, inline="always")
def _code(image: NDArray[np.uint64], row: int, col: int) -> int:
    """Code of a pixel, 0 outside the image."""
    if row < 0 or col < 0 or row >= image.shape[0] or col >= PIXELS * (image.shape[1] - 2):
        return 0
    return code_at(image, row, col)
