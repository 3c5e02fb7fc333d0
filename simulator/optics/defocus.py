"""Near-field defocus: an object at finite range is a disc of angle aperture / range, annular behind an obstruction.

A 20 cm telescope focused at infinity blurs a point at 1 km into 41 arcsec.
"""

import math
from functools import lru_cache
from typing import Final

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.special import chndtr

SMALLEST_DISC_SIGMA: Final = 0.05
"""A disc of less than this diameter (in PSF sigmas) changes no pixel by 1e-4 of the peak: its second moment d^2/16 adds
1.6e-4 sigma^2."""


def disc_profile(radius_px: NDArray[np.float64], diameter_px: float, obstruction: float, sigma_px: float) -> NDArray[np.float64]:
    """Surface brightness (per px^2, unit flux) of an annular disc blurred by a Gaussian, at given radii.

    A uniform disc of radius a blurred by a Gaussian has ``(1/(pi a^2)) P[chi2_nc(2, (r/s)^2) < (a/s)^2]``, the non-central
    chi-square distribution (one minus Marcum's Q_1): the Gaussian around r puts that share of its mass inside the disc.
    The annulus is the difference of two such discs.

    obstruction : linear, inner over outer diameter, 0 <= obstruction < 1.
    """
    nc = (radius_px / sigma_px) ** 2
    outer = 0.5 * diameter_px
    inner = obstruction * outer
    mass = chndtr((outer / sigma_px) ** 2, 2.0, nc)
    if inner > 0.0:
        mass = mass - chndtr((inner / sigma_px) ** 2, 2.0, nc)
    return np.asarray(mass / (math.pi * (outer**2 - inner**2)), dtype=np.float64)


@lru_cache(maxsize=16)
def defocused_kernel(
    diameter_px: float, obstruction: float, sigma_px: float, *, phases: int = 16
) -> tuple[NDArray[np.float32], int, int]:
    """Pixel-integrated image of a defocused point on a grid of 1/phases px.

    Returns ``(table, half, phases)``: ``table[i, j]`` is the share of the flux in a pixel whose centre lies
    ``(i / phases - half, j / phases - half)`` from the point; `table` is square with ``2 half phases + 1`` nodes.
    The profile is integrated over pixels by the trapezoidal rule on the same grid; the whole is scaled such that the
    pixels of any phase sum to one on average, what is cut beyond `half` being below 1e-6. The last tables are kept, because a
    trail is rendered on its frame and again alone; they are read-only.
    """
    half = math.ceil(0.5 * diameter_px + 5.0 * sigma_px + 1.0)
    reach = half + 0.5
    n = round(2 * reach * phases) + 1
    axis = np.arange(n) / phases - reach
    radii = np.arange(0.0, reach * math.sqrt(2.0) + 0.1, 0.02 * min(1.0, sigma_px))
    profile = disc_profile(radii, diameter_px, obstruction, sigma_px)
    radius = np.sqrt(axis[:, None] ** 2 + axis[None, :] ** 2)
    point = np.interp(radius.ravel(), radii, profile).reshape(n, n)
    table = _box_mean(_box_mean(point, phases, 0), phases, 1)
    table *= phases**2 / table.sum()
    kernel = table.astype(np.float32)
    kernel.flags.writeable = False
    return kernel, half, phases


def _box_mean(values: NDArray[np.float64], width: int, axis: int) -> NDArray[np.float64]:
    """Trapezoidal mean over windows of `width` steps along an axis; the result is `width` nodes shorter."""
    moved = np.moveaxis(values, axis, 0)
    steps = 0.5 * (moved[1:] + moved[:-1])
    total = np.concatenate([np.zeros((1, *steps.shape[1:])), np.cumsum(steps, axis=0)])
    return np.moveaxis((total[width:] - total[:-width]) / width, 0, axis)


@numba.njit(cache=True)
def add_defocused_points(
    image_e: NDArray[np.float32],
    row: NDArray[np.float64],
    col: NDArray[np.float64],
    flux_e: NDArray[np.float64],
    table: NDArray[np.float32],
    half: int,
    phases: int,
) -> None:
    """Add points with the kernel of `defocused_kernel`, interpolated bilinearly between its phases, in place."""
    rows, cols = image_e.shape
    last = table.shape[0] - 1
    for p in range(row.size):
        if flux_e[p] == 0.0:
            continue
        r_first = math.ceil(row[p] - half)
        c_first = math.ceil(col[p] - half)
        x = (r_first - row[p] + half) * phases
        y = (c_first - col[p] + half) * phases
        i0 = int(x)
        j0 = int(y)
        fx = x - i0
        fy = y - j0
        w00 = flux_e[p] * (1.0 - fx) * (1.0 - fy)
        w01 = flux_e[p] * (1.0 - fx) * fy
        w10 = flux_e[p] * fx * (1.0 - fy)
        w11 = flux_e[p] * fx * fy
        for k in range(2 * half + 1):
            r = r_first + k
            i = i0 + k * phases
            if i > last:
                break
            if r < 0 or r >= rows:
                continue
            i1 = min(i + 1, last)
            for m in range(2 * half + 1):
                c = c_first + m
                j = j0 + m * phases
                if j > last:
                    break
                if c < 0 or c >= cols:
                    continue
                j1 = min(j + 1, last)
                image_e[r, c] += np.float32(w00 * table[i, j] + w01 * table[i, j1] + w10 * table[i1, j] + w11 * table[i1, j1])
