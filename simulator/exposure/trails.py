"""Trails onto pixels: the sum of a moving, possibly defocused and varying point over bins of time.

Flux sits at the mean position of each bin, so that the centroid of a trail is exact however long it is; curved and
varying trails need nothing special. With bins of at most half a pixel the ripple along a trail,
``2 exp(-2 pi^2 sigma^2 / step^2)``, is below 1e-6 for any sigma above 0.43 px; at 0.3 px and steps of 0.45 px it is 3e-4, of
which pixels leave 3e-5. The cost is linear in length.
"""

import numpy as np
from numpy.typing import NDArray

from simulator.exposure.stars import STAMP_LOSS_E, add_gaussian_points
from simulator.exposure.tables import FAINTEST_E, add_table_points
from simulator.optics.defocus import SMALLEST_DISC_SIGMA, add_defocused_points, defocused_kernel
from simulator.optics.psf_field import PHASES, reach_of

_FINEST_PHASES = 16  # nodes per px of a disc's table, fewer for wider, smoother discs: ripple against time; chosen, not measured
OVERLAPPING_BINS = 30.0  # bins of half a pixel that reach one pixel: 2 x 7 px of table over 0.45 px of step make 31


def render_trail(
    image_e: NDArray[np.float32],
    row: NDArray[np.float64],
    col: NDArray[np.float64],
    flux_e: NDArray[np.float64],
    sigma_px: float,
    defocus_px: float = 0.0,
    obstruction: float = 0.0,
) -> None:
    """Add a trail to an image of electrons, in place.

    Parameters
    ----------
    image_e : (rows, cols) float32, electrons per pixel; what falls outside is lost.
    row, col : (n,) px, mean positions of the time bins; neighbours at most 0.5 px apart.
    flux_e : (n,) electrons of each bin.
    sigma_px : Gaussian sigma of the PSF.
    defocus_px, obstruction : diameter of the blur disc and its linear central obstruction.
    """
    row = np.ascontiguousarray(row, dtype=np.float64)
    col = np.ascontiguousarray(col, dtype=np.float64)
    flux_e = np.ascontiguousarray(flux_e, dtype=np.float64)
    if row.size == 0:
        return
    if defocus_px <= SMALLEST_DISC_SIGMA * sigma_px:
        sigma = np.full(row.size, sigma_px)
        # The loss is shared out among the bins that overlap one pixel, about six sigma of half-pixel steps.
        add_gaussian_points(image_e, row, col, flux_e, sigma, STAMP_LOSS_E / (12.0 * max(sigma_px, 1.0)))
        return
    phases = max(2, min(_FINEST_PHASES, int(_FINEST_PHASES * 24.0 / (24.0 + defocus_px))))
    table, half, phases = defocused_kernel(defocus_px, obstruction, sigma_px, phases=phases)
    add_defocused_points(image_e, row, col, flux_e, table, half, phases)


def render_trail_table(
    image_e: NDArray[np.float32],
    row: NDArray[np.float64],
    col: NDArray[np.float64],
    flux_e: NDArray[np.float64],
    table: NDArray[np.float32],
) -> None:
    """Add a trail whose PSF is a table of `simulator.optics.psf_field`, in place; parameters as those of `render_trail`."""
    if row.size:
        rows, cols, light_e = (np.ascontiguousarray(x, dtype=np.float64) for x in (row, col, flux_e))
        nodes, faintest_e = np.zeros(row.size, dtype=np.int64), FAINTEST_E / OVERLAPPING_BINS
        # A pixel sees bins from either side. Each may leave out its share of what is too faint.
        add_table_points(image_e, rows, cols, light_e, nodes, table[None], reach_of(table), PHASES, faintest_e)
