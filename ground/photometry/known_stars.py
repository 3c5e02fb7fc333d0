"""Stars to take out of streak pixels: catalogue stars as predicted, other list stars as measured."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ground.astrometry.apparent import apparent_directions, jyear_of, mid_frame_tai_ns, observer_at
from ground.astrometry.camera import Camera
from ground.astrometry.rotation import matrix_of
from ground.photometry.zero_point import SUN_B_V, flat_at
from ground.streaks.psf_field import PsfField
from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.icd.downlink import DownlinkFrame
from sboc_e2e.icd.flags import FrameFlag, StarFlag
from sboc_e2e.icd.frame import Calibration
from sboc_e2e.icd.products import FrameSolution, PhotometricSolution

Array = NDArray[np.float64]

SAME_STAR_SIGMAS = 3.0
"""A list star this many PSF widths from a predicted one is that star."""


@dataclass(frozen=True, kw_only=True, eq=False)
class KnownStars:
    """Stars to be taken out: positions (px) and fluxes (e-) in one exposure, (n,) each.

    from_catalogue : the flux is a prediction, which a trail over the star cannot have spoilt.
    """

    row: Array
    col: Array
    flux_e: Array
    from_catalogue: NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True, eq=False)
class FrameLight:
    """What the pixels of a frame's streaks are freed from and fitted with: the known stars, the PSF's width."""

    stars: KnownStars
    psf: PsfField


def frame_light(
    frame: DownlinkFrame,
    solution: FrameSolution,
    photometry: PhotometricSolution,
    calibration: Calibration,
    catalogue: StarCatalogue,
    psf: PsfField,
) -> FrameLight:
    """Known stars and PSF width of a frame."""
    return FrameLight(stars=known_stars(frame, solution, photometry, calibration, catalogue), psf=psf)


def known_stars(
    frame: DownlinkFrame,
    solution: FrameSolution,
    photometry: PhotometricSolution,
    calibration: Calibration,
    catalogue: StarCatalogue,
) -> KnownStars:
    """Positions and fluxes of all stars that ground knows in this frame."""
    listed = np.flatnonzero((frame.stars.flags & int(StarFlag.TRAILED | StarFlag.COSMIC_LIKE)) == 0)
    row, col = frame.stars.row[listed], frame.stars.col[listed]
    flux = frame.stars.flux_e[listed].astype(np.float64)
    if solution.flags & FrameFlag.NO_SOLUTION:
        return KnownStars(row=row, col=col, flux_e=flux, from_catalogue=np.zeros(len(row), dtype=bool))
    cat_row, cat_col, cat_flux = _predicted(frame, solution, photometry, calibration, catalogue)
    new = np.ones(len(row), dtype=bool)
    if len(cat_row) and len(row):
        distance, nearest = cKDTree(np.column_stack((cat_row, cat_col))).query(np.column_stack((row, col)))
        new = distance > SAME_STAR_SIGMAS * calibration.camera.psf_sigma_px
        # the measured place of an identified star is better than the predicted one (catalogue error)
        same = np.flatnonzero(~new)
        cat_row[nearest[same]], cat_col[nearest[same]] = row[same], col[same]
    return KnownStars(
        row=np.concatenate((cat_row, row[new])),
        col=np.concatenate((cat_col, col[new])),
        flux_e=np.concatenate((cat_flux, flux[new])),
        from_catalogue=np.concatenate((np.ones(len(cat_row), dtype=bool), np.zeros(int(new.sum()), dtype=bool))),
    )


def _predicted(
    frame: DownlinkFrame,
    solution: FrameSolution,
    photometry: PhotometricSolution,
    calibration: Calibration,
    catalogue: StarCatalogue,
) -> tuple[Array, Array, Array]:
    """Rows, cols and fluxes of the catalogue stars inside a solved frame."""
    header, camera = frame.header, Camera.solved(solution)
    matrix = matrix_of(np.asarray(solution.quaternion))
    middle = mid_frame_tai_ns(header)
    corners = camera.unproject(
        np.array([0.0, 0.0, header.rows - 1.0, header.rows - 1.0]), np.array([0.0, header.cols - 1.0, 0.0, header.cols - 1.0])
    ) @ matrix  # fmt: skip
    axis = corners.mean(axis=0)
    axis /= np.linalg.norm(axis)
    stars = catalogue.cone(
        float(np.degrees(np.arctan2(axis[1], axis[0]))),
        float(np.degrees(np.arcsin(axis[2]))),
        float(np.degrees(np.arccos((corners @ axis).min()))) + 0.02,
        epoch_jyear=jyear_of(middle),
    )
    apparent = apparent_directions(stars.ra_deg, stars.dec_deg, middle, *observer_at(header.observer, middle))
    row, col = camera.project(apparent @ matrix.T)
    inside = np.flatnonzero((row > -0.5) & (row < header.rows - 0.5) & (col > -0.5) & (col < header.cols - 0.5))
    row, col = row[inside], col[inside]
    magnitude = stars.v_mag[inside] - photometry.colour_term * (stars.b_v[inside] - SUN_B_V)
    rate_e_s = 10.0 ** (0.4 * (photometry.zero_point_mag - magnitude))
    return row, col, rate_e_s * header.exposure_ns * 1e-9 * flat_at(calibration, row, col)
