"""Frames that a lens does not fill: the circle in which it shows the sky, and what lies beyond it.

All-sky lenses and lenses made for smaller sensors leave the corners dark. The rim between both is the straightest and brightest
structure of such a frame, and the dark corners have another noise than the sky. So the circle is looked for in a coarse copy of
the frame: the one across whose rim the level falls most, over the angles that the frame shows. Vignetting falls off too, but not
within some per cent of a radius.
"""

import math
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import scipy  # scipy.ndimage is loaded where it is used, as in `border_slopes`
from numpy.typing import NDArray

if TYPE_CHECKING:
    from ground.vetting.rim import ImageCircle

COARSE: Final = 256
"""Cells along the longer side of the coarse copy. Chosen, so that a rim of 1 % of the radius is a cell wide."""
LEAST_CONTRAST: Final = 6.0
"""Level of the middle above the dark, over the noise of the coarse copy, from which on a rim is looked for."""
CORNER: Final = 0.1
"""Share of a side that a corner takes."""
DARK_CORNER: Final = 0.4
"""Level of a dark corner, at most, over that of the middle (0 is the darkest fiftieth of the frame). Chosen, not measured."""
FEWEST_DARK_CORNERS: Final = 3  # of four; a lamp or a line of text may stand in one

ANGLES: Final = 72
"""Angles at which a rim is looked at."""
INSIDE: Final = (0.93, 0.96)
"""Shares of a radius at which the level before the rim is read; the higher one counts."""
OUTSIDE: Final = 1.04
"""Share of a radius at which the level behind the rim is read."""
SOFTENED: Final = 0.05
"""Added to both levels before their ratio is taken: 5 % of the middle's."""
MOST_FALL: Final = math.log(4.0)
"""Fall of one angle that counts, at most: a street lamp at the horizon is no rim of its own."""
FALL: Final = math.log(1.8)
"""Fall from which on an angle shows a rim. Isophotes of vignetting fall by a tenth to a third between the two places."""
LEAST_SHARE: Final = 0.55
"""Share of the visible angles that must show it. 22 of 23 pictures of three all-sky cameras have 0.60 to 1.0, one in moonlit
clouds 0.54; nine other pictures with dark corners 0.15 to 0.46 or too few angles. Chosen in view of them."""
BRIGHT_BEYOND: Final = 0.5
"""Level behind a rim that is no darkness, over that of the middle. Chosen, not measured."""
MOST_BRIGHT: Final = 0.15
"""Share of the visible angles that may have that level without a fall: the light of a square field goes on beyond its inscribed
circle in a quarter of them. Chosen, not measured."""
FEWEST_ANGLES: Final = 30
"""Visible angles, at least: 150 deg. Corners of vignetted frames show 20 to 27."""
SMALLEST: Final = 0.35
"""Smallest radius that is tried, as a share of the shorter side."""
LARGEST: Final = 0.62
"""Largest radius that is tried, as a share of the longer side."""
OFF_CENTRE: Final = 0.1
"""How far from the middle of the frame a centre may lie, as a share of the side."""
STEPS: Final = 7
"""Places tried along each axis of the centre, coarse to fine; radii are tried by threes of cells at first."""

MARGIN: Final = 0.07
"""Outer part of the radius that is masked with what lies beyond: a rim is not sharp, and roofs stand in it. 6 deg above the
horizon where the distance from the middle is as the angle."""


def image_circle(pixels: NDArray[Any]) -> "ImageCircle | None":
    """The circle of a frame (rows, cols), NaN where there is no number; None where the light fills it or nothing is certain."""
    step = max(-(-max(pixels.shape) // COARSE), 1)
    level = _levels(np.asarray(pixels[::step, ::step], dtype=np.float32))
    if level is None:
        return None
    rows, cols = level.shape
    side = min(rows, cols)
    offset = np.linspace(-OFF_CENTRE, OFF_CENTRE, STEPS)
    tried = (
        0.5 * (rows - 1) + offset * rows,
        0.5 * (cols - 1) + offset * cols,
        np.arange(SMALLEST * side, LARGEST * max(rows, cols), 3.0),
    )
    best, share, bright, seen = _best(level, *tried)
    about = np.linspace(-side, side, STEPS)
    for centre, radius in ((0.02, 0.03), (0.005, 0.008)):
        best, share, bright, seen = _best(level, best[0] + centre * about, best[1] + centre * about, best[2] + radius * about)
    if share < LEAST_SHARE or bright > MOST_BRIGHT or seen < FEWEST_ANGLES:
        return None
    from ground.vetting.rim import ImageCircle  # with the fits of streaks, which a frame without a circle can be read without

    row, col, radius_px = (step * each for each in best)
    return ImageCircle(row=row, col=col, radius_px=radius_px)


def beyond(circle: "ImageCircle", shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Pixels of a frame (rows, cols) that lie beyond a circle or in its margin."""
    row = (np.arange(shape[0], dtype=np.float32) - np.float32(circle.row)) ** 2
    col = (np.arange(shape[1], dtype=np.float32) - np.float32(circle.col)) ** 2
    return np.asarray(row[:, None] + col > np.float32(((1.0 - MARGIN) * circle.radius_px) ** 2))


def _levels(coarse: NDArray[np.float32]) -> NDArray[np.float32] | None:
    """Levels of the coarse copy, 0 (the dark) to 1 (the middle and what is brighter); None where its corners are not dark."""
    known = np.isfinite(coarse)
    if min(coarse.shape) < 3 * ANGLES // 4 or not known.any():
        return None
    image = scipy.ndimage.median_filter(np.where(known, coarse, coarse[known].min()), 3)
    rows, cols = image.shape
    dark = float(np.percentile(image, 2.0))
    middle = float(np.median(image[rows // 4 : 3 * rows // 4, cols // 4 : 3 * cols // 4])) - dark
    noise = 1.4826 * float(np.median(np.abs(np.diff(image, axis=1)))) / math.sqrt(2.0)
    if not middle > LEAST_CONTRAST * noise:
        return None
    level = np.clip((image - dark) / middle, 0.0, 1.0).astype(np.float32)
    high, wide = max(int(CORNER * rows), 1), max(int(CORNER * cols), 1)
    corners = [level[a, b] for a in (slice(0, high), slice(-high, None)) for b in (slice(0, wide), slice(-wide, None))]
    return level if sum(float(np.median(each)) < DARK_CORNER for each in corners) >= FEWEST_DARK_CORNERS else None


def _best(
    level: NDArray[np.float32], rows: NDArray[np.float64], cols: NDArray[np.float64], radii: NDArray[np.float64]
) -> tuple[tuple[float, float, float], float, float, int]:
    """Of the circles about centres (rows x cols) with these radii, all in cells, the one with the greatest fall.

    Beside it: the shares of its visible angles that show a rim and that are bright on both sides, and their number.
    """
    angle = np.linspace(0.0, 2.0 * np.pi, ANGLES, endpoint=False)
    away = radii[:, None, None] * np.array([*INSIDE, OUTSIDE])[:, None]
    row = np.rint(rows[:, None, None, None] + away * np.sin(angle)).astype(np.int32)[:, None]
    col = np.rint(cols[:, None, None, None] + away * np.cos(angle)).astype(np.int32)[None]
    inside = ((row >= 0) & (row < level.shape[0])) & ((col >= 0) & (col < level.shape[1]))
    value = level[np.clip(row, 0, level.shape[0] - 1), np.clip(col, 0, level.shape[1] - 1)] + np.float32(SOFTENED)
    visible = inside.all(axis=-2)
    fall = np.where(visible, np.log(value[..., :2, :].max(axis=-2) / value[..., 2, :]), 0.0)
    total = np.clip(fall, -MOST_FALL, MOST_FALL).sum(axis=-1)
    k = np.unravel_index(int(total.argmax()), total.shape)
    seen = int(visible[k].sum())
    share = float((fall[k] > FALL).sum()) / max(seen, 1)
    bright = float((visible[k] & (fall[k] <= FALL) & (value[..., 2, :][k] > BRIGHT_BEYOND + SOFTENED)).sum()) / max(seen, 1)
    return (float(rows[k[0]]), float(cols[k[1]]), float(radii[k[2]])), share, bright, seen
