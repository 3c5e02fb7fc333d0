"""Light from other sources on a trail: stars under it, crossing streaks, particle hits. It is found in the residuals and masked.

A frame holds a star above S/N 5 in every 500 pixels, so most trails cross one that no list names. Point sources are looked for
with the PSF on the residuals of the trail; where the trail itself is bright enough to vary, on the residuals of its
running median, because tumbling is slower than a PSF.
"""

import math
from dataclasses import replace
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import median_filter
from scipy.spatial import KDTree

from ground.streaks.centre_line import LineFit
from ground.streaks.no_trail import NoTrailError, Reason
from ground.streaks.trail_model import DENSITY, END0, END1, mean_all
from ground.streaks.trail_pixels import TrailPixels
from sboc_e2e.icd.signals import Detection

POINT_SIGMAS: Final = 4.2
"""Matched-filter S/N of a point source that is masked: one by chance in a hundred trails of 100 px."""

SEED_SIGMAS: Final = 1.5
"""Pixels this far above the model are tried as centres of a point source."""

CLEAN_SIGMAS: Final = 0.3
"""The mask reaches to where the source's light falls below this part of a pixel's noise."""

MOST_MASKED: Final = 0.35
"""A larger share of the trail masked means that the model, not the sky, is at fault; then only what outshines it can be."""

OUTSHINES: Final = 3.0
"""Times the brightness of a trail, as its detection tells it, from which light is none of it where sources cover more than
`MOST_MASKED` of it. Of 2, 3 and 5 it was chosen at one trail of S/N 470 across a cluster, whose stars are up to 200 times as
bright."""
OUTSHONE_SIGMAS: Final = 5.0
"""And so many times the noise more: pixels of faint trails are noise."""
OUTSHONE_WIDTHS: Final = 2.0
"""As near to such a pixel the light is a star's too."""
OUTSHONE_LENGTH_WIDTHS: Final = 40.0
"""Shorter lines keep all their light: hits of particles beside each other would leave a trail."""
MOST_OUTSHONE: Final = 0.7
"""Share of a trail that stars may outshine; with less of it left nothing is left out."""

POINT_REACH: Final = 3.0
"""Widths from a point source within which its light is summed: 1 % of it lies farther out."""

SEED_TURNS: Final = 16
"""Every sixteenth seed is looked at first: a line of some hundred seeds that is masked all along is known from ten. Chosen."""

MEDIAN_WIDTHS: Final = 21
"""Slices of the running median, one PSF width each: a star covers some six, less than half, and does not move it."""
MEDIAN_SNR: Final = 2.0
"""Slices (one PSF width each) of the running median, and the S/N of a slice from which it replaces the smooth model."""


def slice_densities(line: LineFit) -> tuple[NDArray[np.float64], float, NDArray[np.bool_]]:
    """Density of each slice of one PSF width between the ends, u of the first, and which slices hold enough pixels.

    Raises `NoTrailError` where no pixel is left at the line.
    """
    pixels, p = line.pixels, line.parameters
    if pixels.u.size == 0:
        raise NoTrailError(Reason.TOO_FEW_PIXELS)
    low, high = max(p[END0], float(pixels.u.min())), min(p[END1], float(pixels.u.max()))
    across = line.across_px
    lit = (pixels.u > low) & (pixels.u < high) & (np.abs(across) < 2.0 * line.width_px)
    u, weight = pixels.u[lit], np.exp(-0.5 * (across[lit] / line.width_px) ** 2)
    if u.size < 20:
        return np.zeros(0), low, np.zeros(0, dtype=np.bool_)
    slices = ((u - low) / line.width_px).astype(np.int64)
    norm = np.bincount(slices, weight**2)
    full = norm > 0.3 * norm.max()
    peak = 1.0 / (math.sqrt(2.0 * math.pi) * line.width_px)
    return np.bincount(slices, weight * pixels.value_e[lit]) / (np.maximum(norm, 1e-12) * peak), low, full


def at_median_brightness(line: LineFit) -> LineFit:
    """The line with the median density of its slices where that is lower: one bright star does not lift a median."""
    densities, _, full = slice_densities(line)
    if not full.any():
        return line
    parameters = line.parameters.copy()
    parameters[DENSITY] = min(parameters[DENSITY], max(float(np.median(densities[full])), 0.0))
    return replace(line, parameters=parameters)


def expected_light(line: LineFit) -> NDArray[np.float64]:
    """(n,) electrons of the trail: the model, following the running median of a bright trail."""
    pixels = line.pixels
    mean = mean_all(line.parameters, pixels.u, pixels.v, line.scale)
    densities, low, full = slice_densities(line)
    dark = not line.parameters[DENSITY] > 0.0
    if dark or np.count_nonzero(full) < MEDIAN_WIDTHS or line.snr**2 / full.size < MEDIAN_SNR**2:
        return mean
    places = np.flatnonzero(full)
    running = median_filter(densities[full], size=MEDIAN_WIDTHS, mode="nearest")
    ratio = np.clip(running / line.parameters[DENSITY], 0.0, 5.0)
    return mean * np.interp((pixels.u - low) / line.width_px - 0.5, places, ratio)


@njit(cache=True, error_model="numpy")
def profile_by_distance(width: float) -> NDArray[np.float64]:
    """A point source's light at squared distances 0, 1, 2.. px^2 from its middle, 1 there, up to `POINT_REACH` widths.

    Pixels lie on a square lattice in any axes, so that squared distances of two of them are whole numbers.
    """
    squared = np.arange(math.ceil((POINT_REACH * width) ** 2))
    return np.exp(-0.5 * squared / (width * width))


@njit(cache=True, error_model="numpy")
def point_source_snr(
    i: int,
    u: NDArray[np.float64],
    v: NDArray[np.float64],
    weighted_e: NDArray[np.float64],
    precision: NDArray[np.float64],
    profile: NDArray[np.float64],
    reach: float,
) -> float:
    """Matched-filter S/N of a point source at pixel `i` of pixels (n,) by ascending u.

    precision : 1 / variance, e^-2. weighted_e : residual in electrons, times it. profile : to `reach` px.
    """
    signal, information = 0.0, 0.0
    u0, v0 = u[i], v[i]
    for j in range(np.searchsorted(u, u0 - reach), np.searchsorted(u, u0 + reach, side="right")):
        squared = int((u[j] - u0) ** 2 + (v[j] - v0) ** 2 + 0.5)
        if squared < profile.size:
            weight = profile[squared]
            signal += weight * weighted_e[j]
            information += weight * weight * precision[j]
    return signal / math.sqrt(information)


@njit(cache=True, error_model="numpy")
def mask_sources(
    mask: NDArray[np.bool_],
    seeds: NDArray[np.int64],
    needed: NDArray[np.float64],
    u: NDArray[np.float64],
    v: NDArray[np.float64],
    residual_e: NDArray[np.float64],
    variance_e2: NDArray[np.float64],
    width: float,
    inside: NDArray[np.bool_],
    most: float,
) -> tuple[float, int]:
    """Mask (n,) point sources whose S/N exceeds what is needed at their seed; the share masked inside, and seeds looked at.

    No seed is looked at once more than the share `most` of the pixels inside is masked: the mask only grows. Seeds far apart come
    one after the other, so that a trail that is masked all along is known from a few.
    """
    precision, all_inside = 1.0 / variance_e2, max(int(np.count_nonzero(inside)), 1)
    weighted_e, profile = residual_e * precision, profile_by_distance(width)
    masked, looked = 0, 0
    for first in range(SEED_TURNS):
        for k in range(first, seeds.size, SEED_TURNS):
            if masked / all_inside > most:
                return masked / all_inside, looked
            i = seeds[k]
            snr = point_source_snr(i, u, v, weighted_e, precision, profile, POINT_REACH * width)
            looked += 1
            if not snr > needed[k]:
                continue
            # amplitude over noise of the brightest pixel of a point source of this S/N
            peak = snr / (math.sqrt(math.pi) * width)
            radius = width * math.sqrt(2.0 * math.log(max(peak / CLEAN_SIGMAS, 2.0)))
            for j in range(np.searchsorted(u, u[i] - radius), np.searchsorted(u, u[i] + radius)):
                if not mask[j] and (u[j] - u[i]) ** 2 + (v[j] - v[i]) ** 2 < radius * radius:
                    mask[j] = True
                    masked += inside[j]
    return masked / all_inside, looked


def needed_snr(
    line: LineFit,
    seeds: NDArray[np.int64],
    variance_e2: NDArray[np.float64],
    end_error_px: tuple[float, float],
    model_error: float,
) -> NDArray[np.float64]:
    """S/N above which the light at each seed is an intruder's, shape (seeds,).

    On the line, light may be the trail's own. A fully lit trail has a point-source S/N of density over pixel noise. The model
    leaves over at most the share `model_error` of it. Near an end that may lie farther out it can leave over all of it.
    """
    pixels, p, width = line.pixels, line.parameters, line.width_px
    u = pixels.u[seeds]
    guard0, guard1 = (4.0 * error + 2.0 * width for error in end_error_px)
    near_end = (np.abs(u - p[END0]) < guard0) | (np.abs(u - p[END1]) < guard1)
    share = np.where(near_end, 1.3, model_error) * (np.abs(line.across_px[seeds]) < 2.5 * width)
    return POINT_SIGMAS + share * p[DENSITY] / np.sqrt(variance_e2[seeds])


def outshining(pixels: TrailPixels, detection: Detection, width_px: float) -> NDArray[np.bool_]:
    """(n,) pixels that are too bright for a detected trail, and those about them.

    None of short ones, and none where they would be most of it.
    """
    if detection.length_px < OUTSHONE_LENGTH_WIDTHS * width_px:
        return np.zeros(pixels.u.size, dtype=np.bool_)
    noise = np.sqrt(pixels.variance_e2)
    # S/N of a line of length L and width w, of so much light on its middle: light sqrt(L w sqrt(pi)) / noise
    light = detection.snr * float(np.median(noise)) / math.sqrt(detection.length_px * width_px * math.sqrt(math.pi))
    bright = pixels.value_e > OUTSHINES * light + OUTSHONE_SIGMAS * noise
    if not bright.any():
        return bright
    places = np.column_stack((pixels.u, pixels.v))
    reach = OUTSHONE_WIDTHS * width_px
    near = np.isfinite(KDTree(places[bright]).query(places, distance_upper_bound=reach)[0])
    core = np.abs(pixels.v) < width_px
    return near if np.count_nonzero(near[core]) <= MOST_OUTSHONE * np.count_nonzero(core) else np.zeros_like(bright)


def intruder_mask(
    line: LineFit,
    width_px: float,
    end_error_px: tuple[float, float],
    model_error: float = 0.35,
    ends_given: bool = False,
) -> tuple[NDArray[np.bool_], float]:
    """(n,) pixels to leave out, and the share of the trail that intruders cover; none are left out where that is too large.

    end_error_px : how far off the model's ends may be. model_error : of its brightness.
    ends_given : ends and direction are an on-board track's. Light that the model lacks is a star's then, however much of the
    trail it hides.
    """
    pixels = line.pixels
    mask = np.zeros(pixels.u.size, dtype=np.bool_)
    mean = expected_light(line)
    residual, variance = pixels.value_e - mean, pixels.variance_e2 + np.maximum(mean, 0.0)
    seeds = np.flatnonzero(residual > SEED_SIGMAS * np.sqrt(variance))
    if seeds.size == 0:
        return mask, 0.0
    needed = needed_snr(line, seeds, variance, end_error_px, model_error)
    inside = (pixels.u > line.parameters[END0]) & (pixels.u < line.parameters[END1]) & (np.abs(line.across_px) < 1.5 * width_px)
    most = 1.0 if ends_given else MOST_MASKED
    # pixels are ordered along the detection's line, and a fit turns it
    order = np.argsort(pixels.u, kind="stable")
    place = np.empty_like(order)
    place[order] = np.arange(order.size)
    u, v, residual, variance = (values[order] for values in (pixels.u, pixels.v, residual, variance))
    share, _ = mask_sources(mask, place[seeds], needed, u, v, residual, variance, width_px, inside[order], most)
    return np.zeros_like(mask) if share > most else mask[place], share
