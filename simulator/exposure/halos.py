"""Light far from bright points: rings of diffraction, aureole, spikes and ghosts, outside the squares that tables fill."""

import numpy as np
from numpy.typing import NDArray

from simulator.exposure.tables import FAINTEST_E, FARTHEST_PX, add_arms, add_discs, add_rings
from simulator.optics.halo import Halo
from simulator.optics.psf_field import HALF_PX

_PER_PX = 4  # nodes of the round profile in a px: linear between them, r^-3 errs by 0.2 % at 7 px (h^2 f'' / 8 f)


def render_halos(
    image_e: NDArray[np.float32],
    row: NDArray[np.float64],
    col: NDArray[np.float64],
    flux_e: NDArray[np.float64],
    halo: Halo,
    axis: tuple[float, float],
    faintest_e: float = FAINTEST_E,
) -> None:
    """Add the halos of points, in place.

    axis : row and col of the optical axis, about which ghosts lie. faintest_e : what a pixel may miss.
    """
    profile = _profile(halo)
    bright = flux_e * profile[HALF_PX * _PER_PX] > faintest_e
    if bright.any():
        points = (row[bright], col[bright], flux_e[bright])
        add_rings(image_e, *points, profile, _PER_PX, HALF_PX, faintest_e)
    if len(halo.arms):
        add_arms(image_e, row, col, flux_e, halo.arms, halo.arm_share, halo.arm_core_px, halo.arm_sigma_px, HALF_PX, faintest_e)
    if halo.ghost.share > 0.0:
        ghost_row, ghost_col = (a + halo.ghost.magnification * (x - a) for a, x in zip(axis, (row, col), strict=True))
        add_discs(image_e, ghost_row, ghost_col, halo.ghost.share * flux_e, halo.ghost.diameter_px, faintest_e)


def reach_px(halo: Halo, flux_e_px: float, faintest_e: float = FAINTEST_E) -> float:
    """Distance from a long line, with these electrons per pixel of its length, to which its light is drawn: twice that of a
    point."""
    profile = _profile(halo) * np.arange(_profile(halo).size) / _PER_PX * 2.0
    far = np.flatnonzero(flux_e_px * profile[HALF_PX * _PER_PX :] > faintest_e)
    return 0.0 if far.size == 0 else float(HALF_PX + far[-1] / _PER_PX)


def _profile(halo: Halo) -> NDArray[np.float64]:
    """Round part of a halo at every quarter of a pixel."""
    r = np.arange(int(FARTHEST_PX * _PER_PX) + 2) / _PER_PX
    return halo.ring(np.maximum(r, 1.0))
