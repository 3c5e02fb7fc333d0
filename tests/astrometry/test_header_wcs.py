"""A WCS that came with a frame names stars only where more of them fall together than chance has it."""

import numpy as np
import pytest
from astropy.wcs import WCS

from ground.astrometry.header_wcs import SEARCH_PX, doubt_of, identify_by_header
from ground.sky.measure import pointing_sigma_arcsec
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


def truth_and_header(catalogue: StarCatalogue, seed: int, n: int = 200) -> tuple[np.ndarray, WCS]:
    """Stars of a field with centroid errors of 0.05 px, and the field's true WCS."""
    rng = np.random.default_rng(seed)
    wcs = random_wcs(rng)
    places = stars_of(catalogue, wcs, n)
    return places + rng.normal(0.0, 0.05, places.shape), wcs


def turned(wcs: WCS, degrees: float) -> WCS:
    """The same pointing, turned about the reference pixel."""
    out, angle = wcs.deepcopy(), np.radians(degrees)
    out.wcs.cd = wcs.wcs.cd @ np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return out


@pytest.mark.parametrize("seed", range(3))
def test_a_shift_of_the_header_is_measured_and_said(catalogue: StarCatalogue, seed: int) -> None:
    """CRPIX moved by (6, -4) px moves every place by as much: hypot is 7.2 px, 144 arcsec."""
    places, wcs = truth_and_header(catalogue, 200 + seed)
    header = wcs.deepcopy()
    header.wcs.crpix = [wcs.wcs.crpix[0] + 6.0, wcs.wcs.crpix[1] - 4.0]
    solution = identify_by_header(frame_of(places), header, catalogue, CAMERA)
    assert solution.n_stars >= 0.9 * len(places)
    assert np.median(solution.star_residual_px, axis=0) == pytest.approx([4.0, -6.0], abs=0.03)
    assert solution.rms_px == pytest.approx(np.sqrt(0.5 * 52.0), rel=0.01)
    assert pointing_sigma_arcsec(solution.covariance_rad2) == pytest.approx(20.0 * np.sqrt(52.0), rel=0.01)
    text = doubt_of(solution, 1.0)
    assert text is not None
    assert text.startswith("stars lie 7.2 px (")


@pytest.mark.parametrize("seed", range(3))
def test_a_turn_of_the_header_is_measured_to_the_border(catalogue: StarCatalogue, seed: int) -> None:
    """A turn by 0.5 deg moves a star at r px from the reference pixel by 2 r sin(0.25 deg)."""
    places, wcs = truth_and_header(catalogue, 210 + seed)
    solution = identify_by_header(frame_of(places), turned(wcs, 0.5), catalogue, CAMERA)
    assert solution.n_stars >= 0.9 * len(places)
    radius = np.hypot(*(places[solution.star_index] - 511.0).T)
    moved = 2.0 * np.sin(np.radians(0.25)) * radius
    assert np.hypot(*solution.star_residual_px.T) == pytest.approx(moved, abs=0.3)
    assert pointing_sigma_arcsec(solution.covariance_rad2) == pytest.approx(20.0 * np.sqrt(np.mean(moved**2)), rel=0.02)
    text = str(doubt_of(solution, 1.0))
    assert float(text.removeprefix("stars lie ").partition(" ")[0]) == pytest.approx(np.median(moved), abs=0.1)


@pytest.mark.parametrize("seed", range(3))
def test_a_true_header_is_doubted_by_nobody_and_a_mismatch_is_left_out(catalogue: StarCatalogue, seed: int) -> None:
    places, wcs = truth_and_header(catalogue, 220 + seed)
    places[7] += [2.4, -2.4]
    solution = identify_by_header(frame_of(places), wcs, catalogue, CAMERA)
    assert doubt_of(solution, 1.0) is None
    assert 7 not in solution.star_index
    assert solution.rms_px == pytest.approx(0.05, rel=0.2)
    assert pointing_sigma_arcsec(solution.covariance_rad2) < 20.0 * 0.02
    nobody = identify_by_header(frame_of(np.random.default_rng(1).uniform(0.0, SIZE - 1.0, (50, 2))), wcs, catalogue, CAMERA)
    assert nobody.n_stars == 0
    assert "not confirmed by stars" in str(doubt_of(nobody, 1.0))


@pytest.mark.parametrize("mirrored", [True, False])
@pytest.mark.parametrize("n", [0, 200])
def test_the_parity_is_that_of_the_header(catalogue: StarCatalogue, mirrored: bool, n: int) -> None:
    """North up and east to the left is mirrored, as a solution of the stars says (`Camera`)."""
    wcs = random_wcs(np.random.default_rng(230))  # east against the columns, north along the rows, turned
    if not mirrored:
        wcs.wcs.cd = wcs.wcs.cd @ np.diag([-1.0, 1.0])
    solution = identify_by_header(frame_of(stars_of(catalogue, wcs, n)), wcs, catalogue, CAMERA)
    assert (solution.n_stars > 0) == (n > 0)
    assert solution.camera.mirrored == mirrored
