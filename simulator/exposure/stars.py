"""Stars onto pixels: each a Gaussian integrated over pixels, in a square stamp whose size follows the flux."""

import math
from typing import Final

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray

from simulator.optics.psf import cut_radius_px, pixel_weights

STAMP_LOSS_E: Final = 0.02
"""Electrons of a star that may fall outside its stamp, under 1 % of the noise of one pixel; 1e-4 of the flux if that is less."""

_LARGEST_STAMP: Final = 257
"""Pixels across the largest stamp, which bounds its memory: sigmas of 18 px fit at the 7 sigma of a star of 1e9 electrons."""


def render_stars(image_e: NDArray[np.float32], row: ArrayLike, col: ArrayLike, flux_e: ArrayLike, sigma_px: ArrayLike) -> None:
    """Add stars to an image of electrons, in place.

    Parameters
    ----------
    image_e : (rows, cols) float32, electrons per pixel; what falls outside is lost.
    row, col : (n,) px, PSF centres.
    flux_e : (n,) electrons of each star.
    sigma_px : scalar or (n,), Gaussian sigma.
    """
    row = np.ascontiguousarray(row, dtype=np.float64)
    sigma = np.ascontiguousarray(np.broadcast_to(np.asarray(sigma_px, dtype=np.float64), row.shape))
    add_gaussian_points(
        image_e,
        row,
        np.ascontiguousarray(col, dtype=np.float64),
        np.ascontiguousarray(flux_e, dtype=np.float64),
        sigma,
        STAMP_LOSS_E,
    )


@numba.njit(cache=True)
def add_gaussian_points(
    image_e: NDArray[np.float32],
    row: NDArray[np.float64],
    col: NDArray[np.float64],
    flux_e: NDArray[np.float64],
    sigma_px: NDArray[np.float64],
    loss_e: float,
) -> None:
    """Add pixel-integrated Gaussians (separable: one profile of error-function differences for each axis)."""
    rows, cols = image_e.shape
    across = np.empty(_LARGEST_STAMP)
    along = np.empty(_LARGEST_STAMP)
    for p in range(row.size):
        flux = flux_e[p]
        if not flux > 0.0:
            continue
        radius = min(cut_radius_px(flux, sigma_px[p], loss_e) + 0.5, 0.5 * (_LARGEST_STAMP - 3))
        if not (-radius < row[p] < rows + radius and -radius < col[p] < cols + radius):
            continue
        r0 = max(0, math.ceil(row[p] - radius))
        r1 = min(rows - 1, math.floor(row[p] + radius))
        c0 = max(0, math.ceil(col[p] - radius))
        c1 = min(cols - 1, math.floor(col[p] + radius))
        if r1 < r0 or c1 < c0:
            continue
        n_rows = r1 - r0 + 1
        n_cols = c1 - c0 + 1
        pixel_weights(row[p], r0, sigma_px[p], across, n_rows)
        pixel_weights(col[p], c0, sigma_px[p], along, n_cols)
        for i in range(n_rows):
            share = flux * across[i]
            line = image_e[r0 + i]
            for j in range(n_cols):
                line[c0 + j] += np.float32(share * along[j])
