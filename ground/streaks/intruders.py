"""Light that is not the trail's: stars under it, crossing streaks, particle hits. Found in the residuals, then left out."""

import math
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ground.streaks.centre_line import LineFit
from ground.streaks.trail_model import DENSITY, END0, END1, mean_all

ALONE_SIGMAS: Final = 7.0
"""Residual of a single pixel that starts a mask (Poisson tails of a faint sky pass 6 sigmas now and then)."""

PAIR_SIGMAS: Final = (5.0, 2.5)
"""Or: residual of a pixel, and of another one beside it."""

GROW_WIDTHS: Final = 2.5
"""Radius of the mask around such a pixel, in PSF widths."""

MOST_MASKED: Final = 0.35
"""A larger share of the trail masked means that the model, not the sky, is at fault; then nothing is masked."""


def at_median_brightness(line: LineFit) -> LineFit:
    """The line with the median density of its slices where that is lower: one bright star does not lift a median."""
    pixels, p = line.pixels, line.parameters
    lit = (pixels.u > max(p[END0], pixels.u.min())) & (pixels.u < min(p[END1], pixels.u.max()))
    lit &= np.abs(pixels.v) < 2.0 * line.width_px
    if np.count_nonzero(lit) < 20:
        return line
    u, weight = pixels.u[lit], np.exp(-0.5 * (pixels.v[lit] / line.width_px) ** 2)
    slices = ((u - u.min()) / line.width_px).astype(np.int64)
    norm = np.bincount(slices, weight**2)
    full = norm > 0.3 * norm.max()
    profile_peak = 1.0 / (math.sqrt(2.0 * math.pi) * line.width_px)
    densities = np.bincount(slices, weight * pixels.value_e[lit])[full] / (norm[full] * profile_peak)
    parameters = p.copy()
    parameters[DENSITY] = min(p[DENSITY], max(float(np.median(densities)), 0.0))
    return replace(line, parameters=parameters)


def residual_sigmas(line: LineFit) -> NDArray[np.float64]:
    """(n,) residuals over their expected noise, the object's own included."""
    mean = mean_all(line.parameters, line.pixels.u, line.pixels.v, line.half_px, line.blur_px[0], line.blur_px[1])
    return (line.pixels.value_e - mean) / np.sqrt(line.pixels.variance_e2 + np.maximum(mean, 0.0))


def intruder_mask(line: LineFit, width_px: float) -> tuple[NDArray[np.bool_], bool]:
    """(n,) pixels to leave out, and whether any of them lies on the trail."""
    pixels = line.pixels
    sigmas = residual_sigmas(line)
    bright = np.flatnonzero(sigmas > PAIR_SIGMAS[0])
    mask = np.zeros(pixels.u.size, dtype=np.bool_)
    if bright.size == 0:
        return mask, False
    radius = GROW_WIDTHS * width_px
    order = np.argsort(pixels.u, kind="stable")
    sorted_u = pixels.u[order]
    for seed in bright:
        low, high = np.searchsorted(sorted_u, (pixels.u[seed] - radius, pixels.u[seed] + radius))
        around = order[low:high]
        distance = np.hypot(pixels.u[around] - pixels.u[seed], pixels.v[around] - pixels.v[seed])
        paired = np.count_nonzero(sigmas[around[distance < 1.5]] > PAIR_SIGMAS[1]) > 1
        if paired or sigmas[seed] > ALONE_SIGMAS:
            mask[around[distance < radius]] = True
    inside = (pixels.u > line.parameters[END0]) & (pixels.u < line.parameters[END1]) & (np.abs(pixels.v) < 1.5 * width_px)
    share = float(mask[inside].mean()) if inside.any() else 0.0
    if share > MOST_MASKED:
        return np.zeros_like(mask), False
    return mask, share > 0.0 and math.isfinite(share)
