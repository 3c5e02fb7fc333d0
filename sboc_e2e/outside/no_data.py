"""Areas of a frame that hold one value below the sky: gaps between the chips of a mosaic, corners of a turned stack.

Nothing was measured there. Left in, their edges are the straightest lines of the frame, and every trail that crosses a gap is in
pieces. Where the sky itself is cut off at black, the value is that of the sky, and nothing is taken out.
"""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

SIDE_PX: Final = 5
"""Side of a square of equal values from which on they are no chance: noise of one count has 25 equal ones in 10^10 squares."""

SIGMAS: Final = 3.0
"""Least depth below the sky, in its noise."""

QUARTER_SIGMAS: Final = 0.6745  # of a normal distribution, from its middle to its quarter

LEAST_AREA_PX: Final = 250
"""Pixels of an area. A dead pixel with its neighbours has fewer, and the gap along a chip of 50 px as many. Chosen."""

LEAST_SHARP: Final = 0.7
"""Share of the pixels just outside that are nearer to the sky than to the value: the dark corner of a lens fades, a gap does not.
The rest is for stars and trails. Chosen, not measured."""

ALIKE: Final = 0.2
"""Of the step from the value to the sky: what lies so near to the value belongs to the area. In pictures that were coded as JPEG
no edge is sharper. Chosen."""

MARGIN_PX: Final = 2
"""Pixels beside an area that are left out too: a resampled edge is mixed of both. Chosen."""


def without_data(pixels: NDArray[Any]) -> NDArray[np.bool_] | None:
    """Pixels (rows, cols) that hold no data, with a margin; None where there are none.

    pixels : (rows, cols) uint16 or float32, NaN where there is no number.
    """
    lines = np.asarray(pixels[::SIDE_PX], dtype=np.float32)  # each square has one of them
    equal = lines[:, 1:] == lines[:, :-1]
    if not _has_run(equal):
        return None
    changing = lines[:, 1:][~equal][::SIDE_PX]
    changing = changing[np.isfinite(changing)].astype(np.float64)
    if changing.size == 0:
        return None
    quarter, sky = np.quantile(changing, (0.25, 0.5))  # in double precision, which has room for any number of a frame
    deepest = sky - SIGMAS * (sky - quarter) / QUARTER_SIGMAS  # the darker half has no stars
    if not _has_run(equal & (lines[:, 1:] < deepest)):
        return None
    return _areas(np.where(np.isnan(pixels), pixels.dtype.type(sky), pixels), deepest, sky)


def _has_run(equal: NDArray[np.bool_]) -> bool:
    """Whether a line (n, cols) has as many equal neighbours in a row as a square has."""
    width = equal.shape[1] - SIDE_PX + 2
    together = np.ones((equal.shape[0], max(width, 0)), dtype=np.bool_)
    for k in range(SIDE_PX - 1):
        together &= equal[:, k : k + width]
    return bool(together.any())


def _areas(pixels: NDArray[Any], deepest: float, sky: float) -> NDArray[np.bool_] | None:
    """The areas below a value whose rim is sharp."""
    import cv2  # frames without such areas do not need it here

    def square(side_px: int) -> NDArray[np.uint8]:
        return np.ones((side_px, side_px), dtype=np.uint8)

    same = (cv2.erode(pixels, square(SIDE_PX)) == cv2.dilate(pixels, square(SIDE_PX))) & (pixels < deepest)
    if not same.any():
        return None
    value = np.median(pixels[same].astype(np.float64))
    alike = (pixels < min(deepest, value + ALIKE * (sky - value))).astype(np.uint8)
    dark = cv2.morphologyEx(alike, cv2.MORPH_OPEN, square(3))
    n, label, stats, _ = cv2.connectedComponentsWithStats(dark, connectivity=8)
    inner, outer = 2 * MARGIN_PX + 1, 2 * MARGIN_PX + SIDE_PX
    rim = np.where(cv2.dilate(dark, square(inner)) == 0, cv2.dilate(label.astype(np.float32), square(outer)), 0.0)
    of = rim[rim > 0.0].astype(np.int32)
    sharp = np.bincount(of[pixels[rim > 0.0] > 0.5 * (value + sky)], minlength=n)
    kept = (stats[:, cv2.CC_STAT_AREA] >= LEAST_AREA_PX) & (sharp >= LEAST_SHARP * np.bincount(of, minlength=n)) & (sharp > 0)
    kept &= np.bincount(label[same], minlength=n) > 0
    kept[0] = False
    if not kept.any():
        return None
    return np.asarray(cv2.dilate(kept[label].astype(np.uint8), square(inner)) > 0)
