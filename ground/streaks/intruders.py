"""Light that is not the trail's: stars under it, crossing streaks, particle hits. Found in the residuals, then left out."""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ground.streaks.centre_line import LineFit
from ground.streaks.trail_model import END0, END1, mean_all

DETECT_SIGMAS: Final = 5.0
"""Residual of one pixel that starts a mask: 3e-7 of Gaussian pixels."""

GROW_WIDTHS: Final = 2.5
"""Radius of the mask around such a pixel, in PSF widths."""

MOST_MASKED: Final = 0.35
"""A larger share of the trail masked means that the model, not the sky, is at fault; then nothing is masked."""


def residual_sigmas(line: LineFit) -> NDArray[np.float64]:
    """(n,) residuals over their expected noise, the object's own included."""
    mean = mean_all(line.parameters, line.pixels.u, line.pixels.v, line.half_px, line.blur_px[0], line.blur_px[1])
    return (line.pixels.value_e - mean) / np.sqrt(line.pixels.variance_e2 + np.maximum(mean, 0.0))


def intruder_mask(line: LineFit, width_px: float) -> tuple[NDArray[np.bool_], bool]:
    """(n,) pixels to leave out, and whether any of them lies on the trail."""
    pixels = line.pixels
    bright = np.flatnonzero(residual_sigmas(line) > DETECT_SIGMAS)
    mask = np.zeros(pixels.u.size, dtype=np.bool_)
    if bright.size == 0:
        return mask, False
    radius = GROW_WIDTHS * width_px
    order = np.argsort(pixels.u, kind="stable")
    sorted_u = pixels.u[order]
    for seed in bright:
        low, high = np.searchsorted(sorted_u, (pixels.u[seed] - radius, pixels.u[seed] + radius))
        around = order[low:high]
        mask[around[np.hypot(pixels.u[around] - pixels.u[seed], pixels.v[around] - pixels.v[seed]) < radius]] = True
    inside = (pixels.u > line.parameters[END0]) & (pixels.u < line.parameters[END1]) & (np.abs(pixels.v) < 1.5 * width_px)
    share = float(mask[inside].mean()) if inside.any() else 0.0
    if share > MOST_MASKED:
        return np.zeros_like(mask), False
    return mask, share > 0.0 and math.isfinite(share)
