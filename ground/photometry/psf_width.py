"""Width of the PSF over the field, from the star list alone.

A matched-filter S/N is ``flux sqrt(sum p^2) / sigma``, p the PSF that the extractor measured where the star stands. Flux,
S/N and the background's sigma thus give the PSF's noise-equivalent area ``1 / sum p^2 = 4 pi sigma_psf^2`` (King 1983,
PASP 95, 163) all over the field. Its scale hangs on the sigma that the extractor used; its run over the field does not, and
only that is taken: the width grows as the square of the distance from the axis, from the nominal width on it.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ground.photometry.background import background_at, gain_e_adu
from ground.photometry.zero_point import UNUSABLE
from sboc_e2e.icd.downlink import DownlinkFrame
from sboc_e2e.icd.frame import NominalCamera

Array = NDArray[np.float64]

FEWEST_STARS: Final = 40
PIXEL_VARIANCE_PX2: Final = 1.0 / 12.0
PRIOR_GROWTH: Final = 0.15
"""One sigma of the relative growth from the axis to the corner, before stars are looked at."""

STAR_SCATTER: Final = 0.04
"""Relative scatter of one star's width: steps of the transmitted S/N, neighbours, noise of the mesh."""

N_ITERATIONS: Final = 5


@dataclass(frozen=True, kw_only=True)
class PsfWidth:
    """``sigma_px (1 + growth r^2)``, r the distance from the optical axis in half diagonals of the frame."""

    sigma_px: float
    growth: float
    center_row: float
    center_col: float
    half_diagonal_px: float

    def at(self, row: float, col: float) -> float:
        """PSF sigma (px) at a pixel."""
        r2 = ((row - self.center_row) ** 2 + (col - self.center_col) ** 2) / self.half_diagonal_px**2
        return self.sigma_px * (1.0 + self.growth * r2)


def psf_width(frame: DownlinkFrame, camera: NominalCamera) -> PsfWidth:
    """The PSF's width over a frame; the nominal one everywhere where stars are too few to tell."""
    header, stars = frame.header, frame.stars
    half = 0.5 * float(np.hypot(header.rows, header.cols))
    clean = np.flatnonzero(((stars.flags & UNUSABLE) == 0) & (stars.flux_e > 0.0) & (stars.snr > 0.0))
    growth = 0.0
    if len(clean) >= FEWEST_STARS and frame.background is not None:
        row, col = stars.row[clean], stars.col[clean]
        near_row = np.clip(np.rint(row), 0, header.rows - 1).astype(np.intp)
        near_col = np.clip(np.rint(col), 0, header.cols - 1).astype(np.intp)
        _, sigma_adu = background_at(frame, near_row, near_col)
        area_px = (stars.flux_e[clean] / (stars.snr[clean] * sigma_adu * gain_e_adu(header))) ** 2
        width = np.sqrt(np.maximum(area_px / (4.0 * np.pi) - PIXEL_VARIANCE_PX2, 1e-3))
        r2 = ((row - camera.center_row) ** 2 + (col - camera.center_col) ** 2) / half**2
        growth = _relative_growth(width, r2)
    return PsfWidth(
        sigma_px=camera.psf_sigma_px,
        growth=growth,
        center_row=camera.center_row,
        center_col=camera.center_col,
        half_diagonal_px=half,
    )


def _relative_growth(width: Array, r2: Array) -> float:
    """Slope over intercept of width against r2, robust, with a prior of no growth."""
    design = np.column_stack((np.ones(len(width)), r2))
    scale = float(np.median(width))
    weight = np.ones(len(width))
    parameters = np.array([scale, 0.0])
    for _ in range(N_ITERATIONS):
        normal = (design * weight[:, None]).T @ design / (STAR_SCATTER * scale) ** 2
        normal[1, 1] += 1.0 / (PRIOR_GROWTH * scale) ** 2
        parameters = np.linalg.solve(normal, design.T @ (weight * width) / (STAR_SCATTER * scale) ** 2)
        residual = (width - design @ parameters) / (STAR_SCATTER * scale)
        weight = 1.0 / (1.0 + (residual / 2.0) ** 2)
    return float(parameters[1] / parameters[0])
