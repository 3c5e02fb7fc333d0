"""A WCS that came with a frame names stars only where more of them fall together than chance has it."""

import numpy as np
import pytest
from astropy.wcs import WCS

from ground.astrometry.header_wcs import SEARCH_PX, identify_by_header
from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.icd.downlink import DownlinkFrame
from sboc_e2e.icd.frame import FrameHeader, NominalCamera
from sboc_e2e.icd.signals import StarList
from tests.downlink import bare_frame

SIZE, SCALE_DEG = 1024, 20.0 / 3600.0
FIELDS = 16
CAMERA = NominalCamera(
    name="other", rows=SIZE, cols=SIZE, focal_px=float(np.degrees(1.0)) / SCALE_DEG, center_row=511.5, center_col=511.5,
    psf_sigma_px=1.0, gain_e_adu=1.0, read_noise_e=3.0, saturation_adu=65535.0, full_well_e=60000.0, zero_point_e_s=None,
    aperture_m=0.2,
)  # fmt: skip


@pytest.fixture(scope="module")
def catalogue() -> StarCatalogue:
    return StarCatalogue.embedded()


def random_wcs(rng: np.random.Generator) -> WCS:
    """A field of 5.7 deg anywhere on the sky, turned by any angle."""
    wcs = WCS(naxis=2)
    wcs.wcs.ctype = ["RA---TAN", "DEC--TAN"]
    wcs.wcs.crpix = [0.5 * SIZE, 0.5 * SIZE]
    wcs.wcs.crval = [rng.uniform(0.0, 360.0), np.degrees(np.arcsin(rng.uniform(-1.0, 1.0)))]
    turn = rng.uniform(0.0, 2.0 * np.pi)
    wcs.wcs.cd = SCALE_DEG * np.array([[-np.cos(turn), np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    return wcs


def stars_of(catalogue: StarCatalogue, wcs: WCS, n: int) -> np.ndarray:
    """Row and column (n, 2) of the brightest stars of a field, away from its border."""
    stars = catalogue.cone(*wcs.wcs.crval, 0.71 * SIZE * SCALE_DEG, epoch_jyear=2027.0)
    col, row = wcs.all_world2pix(stars.ra_deg, stars.dec_deg, 0, quiet=True)
    inside = np.flatnonzero((row > SEARCH_PX) & (row < SIZE - SEARCH_PX) & (col > SEARCH_PX) & (col < SIZE - SEARCH_PX))
    bright = inside[np.argsort(stars.v_mag[inside])][:n]
    return np.stack((row[bright], col[bright]), axis=1)


def frame_of(places: np.ndarray) -> DownlinkFrame:
    """A frame with stars at places (n, 2), the first the brightest."""
    header = FrameHeader(
        frame=0, t_start_tai_ns=2_177_000_000 * 10**9, exposure_ns=10**9, line_time_ns=0, rows=SIZE, cols=SIZE, gain_e_adu=1.0
    )
    flux = np.geomspace(1e5, 1e3, len(places)).astype(np.float32)
    stars = StarList(row=places[:, 0], col=places[:, 1], flux_e=flux, snr=np.sqrt(flux), flags=np.zeros(len(places), np.uint8))
    return bare_frame(header, stars=stars)


@pytest.mark.parametrize("listed", ["random places", "stars of another field"])
def test_the_wcs_of_another_field_names_no_star(catalogue: StarCatalogue, listed: str) -> None:
    """As many as five named stars would give a zero point."""
    for seed in range(FIELDS):
        rng = np.random.default_rng(seed)
        wcs, other = random_wcs(rng), random_wcs(rng)
        places = rng.uniform(0.0, SIZE - 1.0, (300, 2)) if listed == "random places" else stars_of(catalogue, other, 300)
        assert identify_by_header(frame_of(places), wcs, catalogue, CAMERA).n_stars == 0


def test_ten_stars_among_twenty_false_ones_are_named_through_a_wcs_that_is_off_by_pixels(catalogue: StarCatalogue) -> None:
    """As in narrow fields: five of them at least, which give a zero point, in nine of ten fields."""
    found = 0
    for seed in range(FIELDS):
        rng = np.random.default_rng(100 + seed)
        wcs = random_wcs(rng)
        true = stars_of(catalogue, wcs, 10) + rng.normal(0.0, 0.1, (10, 2)) + rng.uniform(-8.0, 8.0, 2)
        solution = identify_by_header(
            frame_of(np.concatenate((true, rng.uniform(0.0, SIZE - 1.0, (20, 2))))), wcs, catalogue, CAMERA
        )
        found += np.count_nonzero(solution.star_index < 10) >= 5
    assert found >= 0.9 * FIELDS
