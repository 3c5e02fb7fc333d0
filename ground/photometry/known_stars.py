"""Stars to subtract from streak pixels: from the memory of earlier frames, from the catalogue, else as measured."""

from dataclasses import dataclass, fields

import numpy as np
import scipy  # scipy.spatial is loaded where it is used: frames without a solution need none
from numpy.typing import NDArray

from ground.photometry.zero_point import SUN_B_V, flat_at
from ground.sky.apparent import apparent_directions, jyear_of, mid_frame_tai_ns, observer_at
from ground.sky.pixel_sky import mid_frame_directions, mid_frame_pixels
from ground.streaks.psf_field import PsfField
from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.icd.downlink import DownlinkFrame
from sboc_e2e.icd.flags import FrameFlag, StarFlag
from sboc_e2e.icd.frame import Calibration, FrameHeader
from sboc_e2e.icd.products import FrameSolution, PhotometricSolution
from sboc_e2e.icd.signals import StarList

Array = NDArray[np.float64]

SAME_STAR_SIGMAS = 3.0
"""A list star this many PSF widths from a predicted one is that star."""


@dataclass(frozen=True, kw_only=True, eq=False)
class KnownStars:
    """Stars to be taken out: positions (px) and fluxes (e-) in one exposure, (n,) each.

    unspoilt : the flux is a prediction (catalogue, earlier frames), which a trail over the star cannot have changed.
    inverse_snr : noise of the flux over the flux; its place errs by as many PSF widths. 0 for catalogue stars.
    """

    row: Array
    col: Array
    flux_e: Array
    unspoilt: NDArray[np.bool_]
    inverse_snr: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class FrameLight:
    """Known stars, which are subtracted from the pixels of a frame's streaks, and the PSF width of the fits."""

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
    """Positions and fluxes of all stars that ground knows in this frame, each once."""
    same_px = SAME_STAR_SIGMAS * calibration.camera.psf_sigma_px
    old = _measured(frame.remembered, np.ones(len(frame.remembered), dtype=bool), unspoilt=True)
    usable = (frame.stars.flags & int(StarFlag.TRAILED | StarFlag.COSMIC_LIKE)) == 0
    listed = _measured(frame.stars, usable, unspoilt=False)
    listed = _part(listed, ~_among(listed, old, same_px)[0])
    if solution.flags & FrameFlag.NO_SOLUTION:
        return _joined(old, listed)
    predicted = _predicted(frame.header, solution, photometry, calibration, catalogue)
    predicted = _part(predicted, ~_among(predicted, old, same_px)[0])
    known, nearest = _among(listed, predicted, same_px)
    # the measured place of an identified star is better than the predicted one (catalogue error)
    same = np.flatnonzero(known)
    predicted.row[nearest[same]], predicted.col[nearest[same]] = listed.row[same], listed.col[same]
    return _joined(old, predicted, _part(listed, ~known))


def _measured(stars: StarList, usable: NDArray[np.bool_], *, unspoilt: bool) -> KnownStars:
    """Usable entries of a star list."""
    return KnownStars(
        row=stars.row[usable],
        col=stars.col[usable],
        flux_e=stars.flux_e[usable].astype(np.float64),
        unspoilt=np.full(int(usable.sum()), unspoilt),
        inverse_snr=1.0 / np.maximum(stars.snr[usable].astype(np.float64), 1.0),
    )


def _part(stars: KnownStars, keep: NDArray[np.bool_]) -> KnownStars:
    """Some of the stars."""
    return KnownStars(**{field.name: getattr(stars, field.name)[keep] for field in fields(KnownStars)})


def _joined(*parts: KnownStars) -> KnownStars:
    """All stars of some parts."""
    return KnownStars(
        **{field.name: np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(KnownStars)}
    )


def _among(stars: KnownStars, others: KnownStars, same_px: float) -> tuple[NDArray[np.bool_], NDArray[np.intp]]:
    """Which stars are nearer than `same_px` to one of the others, and the index of the nearest of those."""
    if len(stars.row) == 0 or len(others.row) == 0:
        return np.zeros(len(stars.row), dtype=bool), np.zeros(len(stars.row), dtype=np.intp)
    tree = scipy.spatial.cKDTree(np.column_stack((others.row, others.col)))
    distance, nearest = tree.query(np.column_stack((stars.row, stars.col)))
    return distance <= same_px, nearest


def _predicted(
    header: FrameHeader,
    solution: FrameSolution,
    photometry: PhotometricSolution,
    calibration: Calibration,
    catalogue: StarCatalogue,
) -> KnownStars:
    """The catalogue stars inside a solved frame with a zero point."""
    middle = mid_frame_tai_ns(header)
    last_row, last_col = header.rows - 1.0, header.cols - 1.0
    corners = mid_frame_directions(solution, np.array([0.0, 0.0, last_row, last_row]), np.array([0.0, last_col, 0.0, last_col]))
    axis = corners.mean(axis=0)
    axis /= np.linalg.norm(axis)
    stars = catalogue.cone(
        float(np.degrees(np.arctan2(axis[1], axis[0]))),
        float(np.degrees(np.arcsin(axis[2]))),
        float(np.degrees(np.arccos((corners @ axis).min()))) + 0.02,
        epoch_jyear=jyear_of(middle),
    )
    apparent = apparent_directions(stars.ra_deg, stars.dec_deg, middle, *observer_at(header.observer, middle))
    row, col = mid_frame_pixels(solution, apparent)
    inside = np.flatnonzero((row > -0.5) & (row < header.rows - 0.5) & (col > -0.5) & (col < header.cols - 0.5))
    if not np.isfinite(photometry.zero_point_mag):
        inside = inside[:0]  # without a zero point nothing is known of their light
    row, col = row[inside], col[inside]
    magnitude = stars.v_mag[inside] - photometry.colour_term * (stars.b_v[inside] - SUN_B_V)
    rate_e_s = 10.0 ** (0.4 * (photometry.zero_point_mag - magnitude))
    return KnownStars(
        row=row,
        col=col,
        flux_e=rate_e_s * header.exposure_ns * 1e-9 * flat_at(calibration, row, col),
        unspoilt=np.ones(len(row), dtype=bool),
        inverse_snr=np.zeros(len(row)),
    )
