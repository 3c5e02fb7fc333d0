"""Width of the PSF over the field, from the star list alone.

A matched-filter S/N is ``flux sqrt(sum p^2) / sigma``, p the PSF that the extractor measured where the star stands. Flux,
S/N and the background's sigma thus give the PSF's noise-equivalent area ``1 / sum p^2 = 4 pi sigma_psf^2`` (King 1983,
PASP 95, 163) all over the field. Its scale depends on the sigma that the extractor used, but its relative change over the
field does not. Only this change is used: the width grows as the square of the distance from the axis. On the axis the width is
the one that the frame has from the extractor's fits, or the nominal one.
"""

from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ground.photometry.background import background_at, gain_e_adu
from ground.photometry.zero_point import UNUSABLE
from ground.streaks.psf_field import PsfField
from ground.streaks.trail_model import PIXEL_VARIANCE_PX2
from sboc_e2e.icd.downlink import DownlinkFrame

Array = NDArray[np.float64]

FEWEST_STARS: Final = 40
"""So many stars of `STAR_SCATTER` over a square field give the growth to 0.03, which is `GROWTH_ERROR`; fewer tell less."""
PRIOR_GROWTH: Final = 0.15
"""One sigma of the relative growth from the axis to the corner, before stars are looked at."""

STAR_SCATTER: Final = 0.04
"""Relative scatter of one star's width: steps of the transmitted S/N, neighbours, noise of the mesh."""

GROWTH_ERROR: Final = 0.03
"""Of the growth from one star list; taken once in a run, because the lists of all frames err alike."""

LARGEST_GROWTH: Final = 0.8
"""No camera's corner is nearly twice as wide as its axis: beyond, the list is wrong. Chosen, not measured."""
N_ITERATIONS: Final = 5
"""Reweighted steps; chosen, not measured."""


def in_frame(field: PsfField, frame: DownlinkFrame) -> PsfField:
    """The field scaled to the width that the frame's own stars showed on board: focus and seeing change from frame to frame."""
    return field if frame.psf_sigma_px is None else replace(field, nominal_px=frame.psf_sigma_px)


def with_star_list(field: PsfField, frame: DownlinkFrame) -> PsfField:
    """The field of a run after the growth that a frame's star list shows; unchanged where stars are too few to tell."""
    growth = growth_of(frame, field.center_row, field.center_col)
    if growth is None:
        return field
    weight = GROWTH_ERROR**-2
    evidence = np.diag([0.0, weight])
    # PsfField holds ln sigma = a + b r^2
    return replace(field, normal=field.normal + evidence, right=field.right + evidence @ np.array([0.0, np.log1p(growth)]))


def growth_of(frame: DownlinkFrame, center_row: float, center_col: float) -> float | None:
    """Relative widening of the PSF from the centre to the corner; None where stars are too few to tell."""
    header, stars = frame.header, frame.stars
    clean = np.flatnonzero(((stars.flags & UNUSABLE) == 0) & (stars.flux_e > 0.0) & (stars.snr > 0.0))
    if len(clean) < FEWEST_STARS or frame.background is None:
        return None
    row, col = stars.row[clean], stars.col[clean]
    near_row = np.clip(np.rint(row), 0, header.rows - 1).astype(np.intp)
    near_col = np.clip(np.rint(col), 0, header.cols - 1).astype(np.intp)
    _, sigma_adu = background_at(frame, near_row, near_col)
    area_px = (stars.flux_e[clean] / (stars.snr[clean] * sigma_adu * gain_e_adu(header))) ** 2
    width = np.sqrt(np.maximum(area_px / (4.0 * np.pi) - PIXEL_VARIANCE_PX2, 1e-3))
    half2 = 0.25 * (header.rows**2 + header.cols**2)
    growth = _relative_growth(width, ((row - center_row) ** 2 + (col - center_col) ** 2) / half2)
    return growth if abs(growth) < LARGEST_GROWTH else None


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
