"""Borders of a raw frame that saw no sky: overscan, prescan, covered columns, and the bright edge next to them.

Between them and the sky the level steps in every row alike, within a pixel or two. Trails do not; bad columns step back at once.
Left in, such a step is the straightest and brightest line of the frame. Where columns without data lie between, as in subframes,
level and noise tell such a border from another chip, and interference in it makes lines side by side.
"""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.outside.no_data import QUARTER_SIGMAS

BORDER: Final = 0.25
"""Share of a side in which the step is looked for."""

SAME_SIGN: Final = 0.95
"""Share of the lines that step the same way: 2.3 sigma of two pixels' difference."""

STEP_SIGMAS: Final = 8.0
"""Height of the step over the scatter of the other steps between neighbouring columns."""

STAYS: Final = 0.5
"""Share of the step that is left between the levels on both sides; a bad column leaves none."""

BESIDE_PX: Final = 10
"""Columns of sky beside the step whose median is its level: more than a bad column or a charge tail is wide. Chosen, not
measured."""

QUIET: Final = 0.7
"""Noise of a border over that of the sky. Light that adds less than the readout's noise tells nothing. Chosen."""

MOST_LINES: Final = 512
"""Lines that are looked at, evenly spaced."""


def without_sky(pixels: NDArray[Any]) -> tuple[slice, slice] | None:
    """Rows and columns that saw the sky, None where all did or nothing is certain.

    pixels : (rows, cols), NaN where there is no number.
    """
    cols = _seen(pixels)
    rows = _seen(pixels.T)
    return None if (rows, cols) == (slice(0, pixels.shape[0]), slice(0, pixels.shape[1])) else (rows, cols)


def _seen(pixels: NDArray[Any]) -> slice:
    """Columns between the steps at both borders."""
    n_rows, n = pixels.shape
    lines = np.asarray(pixels[:: max(n_rows // MOST_LINES, 1)], dtype=np.float32)
    steps = np.diff(lines, axis=1)
    step = np.nan_to_num(np.median(steps, axis=0))
    alike = (np.sign(steps) == np.sign(step)).mean(axis=0)
    scatter = 1.4826 * float(np.median(np.abs(step - np.median(step))))
    sure = (np.abs(step) > max(STEP_SIGMAS * scatter, 1e-6)) & (alike >= SAME_SIGN)
    reach = int(BORDER * n)
    empty = np.asarray(np.isnan(lines).all(axis=0))
    low, high = _beyond_gap(lines, empty, reach), n - _beyond_gap(lines[:, ::-1], empty[::-1], reach)
    if not (sure[:reach].any() or sure[n - 1 - reach :].any()):
        return slice(low, high)
    level = np.nan_to_num(np.median(lines, axis=0))
    for k in np.flatnonzero(sure[:reach])[::-1]:  # the innermost first
        if _stays(level[: k + 1], level[k + 1 : k + 1 + BESIDE_PX], step[k]):
            low = max(low, int(k) + 2)
            break
    for k in np.flatnonzero(sure[n - 1 - reach :]) + n - 1 - reach:
        if _stays(level[k + 1 :], level[max(k + 1 - BESIDE_PX, 0) : k + 1], step[k]):
            high = min(high, int(k))
            break
    return slice(low, high)


def _beyond_gap(lines: NDArray[Any], empty: NDArray[np.bool_], reach: int) -> int:
    """First column of sky where columns without data end a border that saw none; 0 where it is none."""
    if empty[0] or not empty[:reach].any():
        return 0
    end = int(np.argmax(empty))
    if empty[end:].all():
        return 0
    sky = end + int(np.argmin(empty[end:]))
    border, beside = (_level_and_noise(part) for part in (lines[:, :end], lines[:, sky : sky + end]))
    dark = beside[0] - border[0] > STEP_SIGMAS * border[1] and border[1] < QUIET * beside[1]
    return sky if dark else 0


def _level_and_noise(part: NDArray[Any]) -> tuple[float, float]:
    """Median and half of what lies between the quarters, in sigma."""
    quarter, level, upper = np.nanquantile(part, (0.25, 0.5, 0.75))
    return float(level), float(upper - quarter) / (2.0 * QUARTER_SIGMAS)


def _stays(outer: NDArray[Any], inner: NDArray[Any], step: float) -> bool:
    """Whether the level beyond a step differs from the one before it, as a whole."""
    return bool(abs(float(np.median(outer)) - float(np.median(inner))) > STAYS * abs(step))
