"""Stars identified through a WCS that came with a frame: no attitude is solved, but the zero point needs the stars."""

from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import pdtrc

from ground.astrometry.astrometer import UNUSABLE_CATALOGUE, unsolved
from ground.astrometry.camera import Camera
from ground.astrometry.matching import mutual_pairs, vote_offset
from ground.sky.apparent import jyear_of, mid_frame_tai_ns
from ground.sky.sphere import ARCSEC_RAD, unit_vectors
from sboc_e2e.catalogue import CatalogueFlag, StarCatalogue
from sboc_e2e.icd.downlink import DownlinkFrame
from sboc_e2e.icd.flags import FrameFlag
from sboc_e2e.icd.frame import NominalCamera
from sboc_e2e.icd.products import FrameSolution

Array = NDArray[np.float64]

SEARCH_PX: Final = 20.0
"""How far a header's WCS may be off."""

LARGEST_CHANCE: Final = 1e-3
"""Largest probability that this many stars match by chance at any offset although the WCS is of another field. `Vote.significant`
serves searches that are a hundred times as wide, and requires eight stars where this requires five."""

MATCH_SIGMAS: Final = 4.0
"""Reach of a match in PSF sigmas (in px where these are smaller): room for local distortion. Chosen, not measured."""
LARGEST_FIELD_DEG: Final = 30.0
"""Radius. Beyond it, a WCS is wrong or an all-sky projection; the cone holds 7 % of the sky. Chosen, not measured."""


LEAST_SIGMA_PX: Final = 0.2
"""Floor of a star's error: full stars, undersampled ones and those where a header leaves distortion out stay. Chosen."""
REJECTED_SIGMAS: Final = 5.0
"""A star farther off than so many errors is a mismatch or a blend. Gaussian errors go beyond in 4 of 1,000,000 pairs."""
SHIFT_STARS: Final = 8
"""With fewer stars the header's error is one shift: a plane through them would follow single stars. Chosen, not measured."""
PLANE_STARS: Final = 24
"""With fewer it is a plane, shift, turn and scale; with more a second-order surface. Chosen, not measured."""
ROUNDS: Final = 3
"""Rounds of pairing and fit: a header that is turned leads to stars of the middle first. Chosen, not measured."""

FAR_OFF_PX: Final = 1.0
"""Least distance of stars from a header's places that is said, or the PSF's sigma where that is more: headers that were fitted to
stars are good to a tenth of it."""


def identify_by_header(frame: DownlinkFrame, wcs: Any, catalogue: StarCatalogue, camera: NominalCamera) -> FrameSolution:
    """A record without attitude (NO_SOLUTION) that names the list stars which the header's WCS puts on catalogue stars.

    Residuals, their rms and the pointing's covariance are those of the header's WCS as it is, since directions follow it: a WCS
    that is off is not mended. It names no star if the same number could match by chance, because the WCS of another field would
    give a wrong zero point.
    """
    header = frame.header
    corner_col = np.array([0.0, header.cols - 1.0, 0.0, header.cols - 1.0, 0.5 * header.cols])
    corner_row = np.array([0.0, 0.0, header.rows - 1.0, header.rows - 1.0, 0.5 * header.rows])
    ra, dec = (np.radians(a) for a in wcs.all_pix2world(corner_col, corner_row, 0))
    vectors = unit_vectors(ra, dec)
    mirrored, pixel_rad = _pixel_of(wcs, corner_row[4], corner_col[4])
    nothing = unsolved(frame, replace(Camera.nominal(camera), mirrored=mirrored), FrameFlag.NO_SOLUTION)
    radius_deg = float(np.degrees(np.arccos(np.clip((vectors[:4] @ vectors[4]).min(), -1.0, 1.0))))
    if not radius_deg < LARGEST_FIELD_DEG:
        return nothing
    stars = catalogue.cone(
        float(np.degrees(ra[4])), float(np.degrees(dec[4])), radius_deg, epoch_jyear=jyear_of(mid_frame_tai_ns(header))
    )
    stars = stars.take((stars.flags & UNUSABLE_CATALOGUE) == 0)
    if len(stars) == 0 or len(frame.stars) == 0:
        return nothing
    col, row = wcs.all_world2pix(stars.ra_deg, stars.dec_deg, 0, quiet=True)
    inside = np.flatnonzero((row > -0.5) & (row < header.rows - 0.5) & (col > -0.5) & (col < header.cols - 0.5))
    predicted = np.stack((row[inside], col[inside]), axis=1)
    listed = np.stack((frame.stars.row, frame.stars.col), axis=1)
    bin_px = max(1.0, camera.psf_sigma_px)
    vote = vote_offset(
        listed,
        predicted,
        center=np.array([0.5 * header.rows, 0.5 * header.cols]),
        reach_px=SEARCH_PX,
        bin_px=bin_px,
        roll_limit_rad=0.0,
        half_size_px=0.5 * float(np.hypot(header.rows, header.cols)),
    )
    offsets = (2.0 * SEARCH_PX / bin_px + 1.0) ** 2
    if vote.votes == 0 or offsets * pdtrc(vote.votes - 1, vote.chance) > LARGEST_CHANCE:
        return nothing
    catalogue_px = stars.sigma_mas[inside].astype(np.float64) * 1e-3 * ARCSEC_RAD / pixel_rad
    centroid_px = np.hypot(camera.psf_sigma_px / np.maximum(frame.stars.snr.astype(np.float64), 1.0), LEAST_SIGMA_PX)
    error = np.tile([vote.d_row_px, vote.d_col_px], (len(predicted), 1))
    scale = 0.5 * np.array([header.rows, header.cols])
    for _ in range(ROUNDS):
        index, chosen = mutual_pairs(listed, predicted + error, MATCH_SIGMAS * bin_px)
        if len(index) == 0:
            return nothing
        sigma_px = np.hypot(centroid_px[index], catalogue_px[chosen])
        residual = listed[index] - predicted[chosen]
        surface, used = _error_surface(predicted[chosen] / scale - 1.0, residual, sigma_px, error[chosen])
        error = _terms(predicted / scale - 1.0, len(surface)) @ surface
    index, chosen, residual = index[used], chosen[used], residual[used]
    star = inside[chosen]
    colour = np.where(stars.flags[star] & CatalogueFlag.ONE_BAND, np.float32(np.nan), stars.b_v[star])
    # of an axis: the error is not random, and may lie along any
    pointing_rad = pixel_rad * float(np.sqrt(np.mean((error[chosen] ** 2).sum(axis=1))))
    roll_rad = pointing_rad / (pixel_rad * float(np.hypot(*scale)))
    return replace(
        nothing,
        covariance_rad2=np.diag([pointing_rad**2, pointing_rad**2, roll_rad**2]),
        n_stars=len(index),
        rms_px=float(np.sqrt(np.mean(residual**2))),
        star_index=index.astype(np.int32),
        star_v_mag=stars.v_mag[star],
        star_b_v=colour.astype(np.float32),
        star_residual_px=residual.astype(np.float32),
    )


def doubt_of(solution: FrameSolution, psf_sigma_px: float) -> str | None:
    """What the stars that `identify_by_header` named say against the header's WCS; None where they lie where it has them."""
    if solution.n_stars == 0:
        return "the header's WCS is not confirmed by stars of the catalogue: directions are as good as it is"
    off_px = np.hypot(*solution.star_residual_px.T.astype(np.float64))
    middle_px = float(np.median(off_px))
    if not middle_px > max(FAR_OFF_PX, psf_sigma_px):
        return None
    return (
        f"stars lie {middle_px:.1f} px ({off_px.min():.1f} to {off_px.max():.1f}) from where the header's WCS has them, and "
        "directions follow it; --wcs solve measures them"
    )


def _pixel_of(wcs: Any, row: float, col: float) -> tuple[bool, float]:
    """Whether the image is mirrored (`Camera`) at a pixel, and the side of a square of its area, rad."""
    ra, dec = (np.radians(a) for a in wcs.all_pix2world(col + np.array([0.0, 1.0, 0.0]), row + np.array([0.0, 0.0, 1.0]), 0))
    here, along_col, along_row = unit_vectors(ra, dec)
    area = float(np.cross(along_col - here, along_row - here) @ here)
    return area < 0.0, float(np.sqrt(abs(area)))


def _terms(place: Array, n: int) -> Array:
    """The first n terms (k, n) of a second-order surface at places (k, 2)."""
    y, x = place.T
    return np.stack([np.ones(len(place)), y, x, y * y, y * x, x * x][:n], axis=1)


def _error_surface(place: Array, residual: Array, sigma_px: Array, before: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Coefficients (n, 2) of the header's error over the frame, and which stars (k,) agree with it.

    place : (k, 2), 1 at the border; before : (k, 2), the error as known so far, from which mismatches are told.
    """
    off = np.hypot(*(residual - before).T)
    used = np.ones(len(off), dtype=bool)
    for _ in range(ROUNDS):
        k = int(used.sum())
        n = 1 if k < SHIFT_STARS else 3 if k < PLANE_STARS else 6
        weight = (1.0 / sigma_px[used])[:, None]
        surface = np.linalg.lstsq(_terms(place[used], n) * weight, residual[used] * weight, rcond=None)[0]
        off = np.hypot(*(residual - _terms(place, n) @ surface).T) / sigma_px
        # the median of a length of two coordinates of sigma 1 is 1.177
        used = off <= REJECTED_SIGMAS * max(1.0, float(np.median(off[used])) / 1.177)
    return np.asarray(surface), np.asarray(used)
