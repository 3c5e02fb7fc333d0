"""Stars identified through a WCS that came with a frame: no attitude is solved, but the zero point needs the stars."""

from dataclasses import replace
from typing import Any, Final

import numpy as np
from scipy.special import pdtrc

from ground.astrometry.astrometer import UNUSABLE_CATALOGUE, unsolved
from ground.astrometry.camera import Camera
from ground.astrometry.matching import mutual_pairs, vote_offset
from ground.sky.apparent import jyear_of, mid_frame_tai_ns
from ground.sky.sphere import unit_vectors
from sboc_e2e.catalogue import CatalogueFlag, StarCatalogue
from sboc_e2e.icd.downlink import DownlinkFrame
from sboc_e2e.icd.flags import FrameFlag
from sboc_e2e.icd.frame import NominalCamera
from sboc_e2e.icd.products import FrameSolution

SEARCH_PX: Final = 20.0
"""How far a header's WCS may be off."""

LARGEST_CHANCE: Final = 1e-3
"""Largest probability that this many stars match by chance at any offset although the WCS is of another field. `Vote.significant`
serves searches that are a hundred times as wide, and requires eight stars where this requires five."""

MATCH_SIGMAS: Final = 4.0
"""Reach of a match in PSF sigmas (in px where these are smaller): room for local distortion. Chosen, not measured."""
LARGEST_FIELD_DEG: Final = 30.0
"""Radius. Beyond it, a WCS is wrong or an all-sky projection; the cone holds 7 % of the sky. Chosen, not measured."""


def identify_by_header(frame: DownlinkFrame, wcs: Any, catalogue: StarCatalogue, camera: NominalCamera) -> FrameSolution:
    """A record without attitude (NO_SOLUTION) that names the list stars which the header's WCS puts on catalogue stars.

    It names no star if the same number could match by chance, because the WCS of another field would give a wrong zero point.
    """
    nothing = unsolved(frame, Camera.nominal(camera), FrameFlag.NO_SOLUTION)
    header = frame.header
    corner_col = np.array([0.0, header.cols - 1.0, 0.0, header.cols - 1.0, 0.5 * header.cols])
    corner_row = np.array([0.0, 0.0, header.rows - 1.0, header.rows - 1.0, 0.5 * header.rows])
    ra, dec = (np.radians(a) for a in wcs.all_pix2world(corner_col, corner_row, 0))
    vectors = unit_vectors(ra, dec)
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
    predicted = predicted + np.array([vote.d_row_px, vote.d_col_px])
    index, chosen = mutual_pairs(listed, predicted, MATCH_SIGMAS * max(1.0, camera.psf_sigma_px))
    residual = listed[index] - predicted[chosen]
    star = inside[chosen]
    colour = np.where(stars.flags[star] & CatalogueFlag.ONE_BAND, np.float32(np.nan), stars.b_v[star])
    return replace(
        nothing,
        n_stars=len(index),
        rms_px=float(np.sqrt(np.mean(residual**2))) if len(index) else float("nan"),
        star_index=index.astype(np.int32),
        star_v_mag=stars.v_mag[star],
        star_b_v=colour.astype(np.float32),
        star_residual_px=residual.astype(np.float32),
    )
