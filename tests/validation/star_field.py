"""A real star field without a header becomes FITS with one: lost-in-space solution, then a TAN-SIP fit to the catalogue's stars.

`python -m tests.validation.star_field FRAME.tiff OUT.fits` (extra `solve`). The frames of the tetra3 test data (ESA, Apache-2.0)
hold 12 bits in the upper ones of 16 and say time and pointing in their names.
"""

import sys
from pathlib import Path

import cv2
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.io import fits
from astropy.wcs import WCS
from astropy.wcs.utils import fit_wcs_from_points
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ground.astrometry import lost_in_space
from ground.astrometry.camera import Camera
from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.icd.signals import StarList
from sboc_e2e.validation.background import measure_background
from sboc_e2e.validation.sources import Sources, find_sources

WIDTH_DEG = 11.42
EPOCH_JYEAR = 2019.574
BRIGHTEST_DETECTED = 8.0
"""V to which stars take part in the fit."""
SIP_DEGREE = 3


def solve_field(tiff: Path, out: Path) -> int:
    """Write the frame in 12-bit units as FITS with its fitted WCS; returns how many stars the fit used."""
    pixels = cv2.imread(str(tiff), cv2.IMREAD_UNCHANGED)
    assert pixels is not None, f"{tiff} is no image"
    image = (pixels >> 4).astype(np.int16)
    sources = find_sources(measure_background(image.astype(np.float32)), 2.5)
    catalogue = StarCatalogue.embedded()
    wcs, used = fitted_wcs(sources, image.shape, catalogue)
    header = wcs.to_header(relax=True)
    header["DATE-OBS"] = "2019-07-29T20:47:26"
    fits.PrimaryHDU(image, header=header).writeto(out, overwrite=True)
    return used


def fitted_wcs(sources: Sources, shape: tuple[int, int], catalogue: StarCatalogue) -> tuple[WCS, int]:
    """TAN-SIP through the stars of a solved field: nearest catalogue stars in a radius that shrinks from 4 px to 1."""
    rows, cols = shape
    focal_px = 0.5 * cols / np.tan(np.radians(0.5 * WIDTH_DEG))
    turn = _attitude(sources, rows, cols, focal_px, catalogue)
    boresight = turn[2]
    ra, dec = np.degrees(np.arctan2(boresight[1], boresight[0])) % 360.0, np.degrees(np.arcsin(boresight[2]))
    stars = catalogue.cone(float(ra), float(dec), 0.8 * WIDTH_DEG, epoch_jyear=EPOCH_JYEAR)
    stars = stars.take(stars.v_mag < BRIGHTEST_DETECTED)
    sky = SkyCoord(stars.ra_deg, stars.dec_deg, unit="deg")
    seen = sky.cartesian.xyz.value.T @ turn.T
    ahead = seen[:, 2] > 0.5
    place = np.full((len(stars), 2), 1e6)
    place[ahead] = 0.5 * np.array([cols - 1, rows - 1]) + focal_px * seen[ahead, :2] / seen[ahead, 2:]
    measured = np.stack([sources.col, sources.row], axis=1)
    wcs, near = WCS(naxis=2), np.zeros(0, dtype=np.intp)
    for radius_px in (4.0, 2.0, 1.0):
        distance, star = cKDTree(place).query(measured)
        near = np.flatnonzero(distance < radius_px)
        near = near[np.unique(star[near], return_index=True)[1]]
        wcs = fit_wcs_from_points(
            measured[near].T, sky[star[near]], proj_point=SkyCoord(ra, dec, unit="deg"), sip_degree=SIP_DEGREE
        )
        inside = np.flatnonzero(ahead)
        place[inside] = np.stack(wcs.world_to_pixel(sky[inside]), axis=1)
    return wcs, len(near)


def _attitude(sources: Sources, rows: int, cols: int, focal_px: float, catalogue: StarCatalogue) -> NDArray[np.float64]:
    camera = Camera(focal_px=focal_px, center_row=0.5 * (rows - 1), center_col=0.5 * (cols - 1), k1=0.0, k2=0.0, p1=0.0, p2=0.0)
    n = len(sources)
    stars = StarList(
        row=sources.row,
        col=sources.col,
        flux_e=sources.flux.astype(np.float32),
        snr=sources.snr.astype(np.float32),
        flags=np.zeros(n, dtype=np.uint8),
    )
    seen = lost_in_space.find_attitude(stars, camera, cols, rows, catalogue, "")
    assert seen is not None, "no star pattern fits"
    assert not seen.mirrored, "the frame is mirrored"
    return seen.matrix


if __name__ == "__main__":
    sys.stdout.write(f"{solve_field(Path(sys.argv[1]), Path(sys.argv[2]))} stars in the fit\n")
