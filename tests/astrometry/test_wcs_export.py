"""The exported TAN-SIP header says what the solution says, in astropy's reading, for frames and for cut-outs."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import GCRS, ICRS, CartesianRepresentation, SkyCoord
from astropy.time import Time
from astropy.wcs import WCS

from ground.astrometry.astrometer import CameraFit
from ground.astrometry.header_wcs import identify_by_header
from ground.astrometry.wcs_export import of_binned, of_cut_out, pixel_icrs, sip_header, without_inverse
from ground.sky.apparent import mid_frame_tai_ns, observer_at
from ground.sky.pixel_sky import HeaderSky, SolvedSky
from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.icd.flags import FrameFlag
from sboc_e2e.icd.tai import to_jd_parts
from tests.astrometry.star_fields import ARCSEC, grid, make_field


@pytest.fixture(scope="module")
def solved():
    catalogue = StarCatalogue.embedded()
    fit = CameraFit()
    field = make_field(catalogue, 2)
    return field, fit.solve(fit.initial_state(field.calibration, catalogue), field.frame)[1]


def _icrs_by_astropy(field, solution, row, col):
    """Apparent directions of pixels at mid-frame, turned into ICRS by astropy."""
    header = field.frame.header
    middle = mid_frame_tai_ns(header)
    sky = SolvedSky(header=header, solution=solution)
    apparent = sky.apparent(row, col, np.full(len(row), middle))
    position, velocity = observer_at(header.observer, middle)
    frame = GCRS(
        obstime=Time(*to_jd_parts(middle), format="jd", scale="tai"),
        obsgeoloc=CartesianRepresentation(position * u.m),
        obsgeovel=CartesianRepresentation(velocity * u.m / u.s),
    )
    ra, dec = np.arctan2(apparent[:, 1], apparent[:, 0]), np.arcsin(apparent[:, 2])
    return SkyCoord(ra=ra * u.rad, dec=dec * u.rad, frame=frame).transform_to(ICRS())


def _wcs(field, solution):
    header = field.frame.header
    return sip_header(pixel_icrs(header, solution), header.rows, header.cols)


def test_header_agrees_with_the_solution_and_inverts(solved):
    field, solution = solved
    wcs = WCS(_wcs(field, solution))
    row, col = grid(4096, 11)
    ra, dec = wcs.all_pix2world(col, row, 0)
    want = _icrs_by_astropy(field, solution, row, col)
    apart = SkyCoord(ra=ra * u.deg, dec=dec * u.deg).separation(want).arcsec
    assert apart.max() < 0.002
    back_col, back_row = wcs.all_world2pix(ra, dec, 0)
    assert np.abs(back_row - row).max() < 1e-3
    assert np.abs(back_col - col).max() < 1e-3
    # the inverse polynomials alone, without iteration: u = U + sum AP_pq U^p V^q about CRPIX
    linear = wcs.wcs_world2pix(np.column_stack((ra, dec)), 1) - wcs.wcs.crpix
    for coefficients, axis, want_px in ((wcs.sip.ap, 0, col), (wcs.sip.bp, 1, row)):
        got = linear[:, axis] + np.polynomial.polynomial.polyval2d(linear[:, 0], linear[:, 1], coefficients)
        assert np.abs(got + wcs.wcs.crpix[axis] - 1.0 - want_px).max() < 0.01


@pytest.mark.parametrize("corner", [(0, 0), (1000, 2500), (3800, 10)])
def test_a_cut_out_has_the_directions_of_its_frame(solved, corner):
    """Its corner moves the reference pixel; without inverse polynomials, which astropy iterates."""
    field, solution = solved
    header = of_cut_out(without_inverse(_wcs(field, solution)), *corner)
    wcs = WCS(header)
    row, col = (a.ravel().astype(float) for a in np.meshgrid(np.arange(0, 290, 29), np.arange(0, 500, 50), indexing="ij"))
    ra, dec = wcs.all_pix2world(col, row, 0)
    want = _icrs_by_astropy(field, solution, row + corner[0], col + corner[1])
    assert SkyCoord(ra=ra * u.deg, dec=dec * u.deg).separation(want).arcsec.max() < 0.002
    back_col, back_row = wcs.all_world2pix(ra, dec, 0)
    assert np.abs(back_row - row).max() < 1e-3
    assert np.abs(back_col - col).max() < 1e-3
    # pixels of the frame, as viewers show them
    assert (0 - header["LTV2"], 0 - header["LTV1"]) == corner


def test_a_binned_image_has_the_directions_of_its_cells_centres(solved):
    field, solution = solved
    header = of_binned(_wcs(field, solution), 64)
    cell_row, cell_col = grid(64, 9)
    ra, dec = WCS(header).all_pix2world(cell_col, cell_row, 0)
    row, col = 64.0 * cell_row + 31.5, 64.0 * cell_col + 31.5
    want = _icrs_by_astropy(field, solution, row, col)
    assert SkyCoord(ra=ra * u.deg, dec=dec * u.deg).separation(want).arcsec.max() < 0.002
    back_col, back_row = WCS(header).all_world2pix(ra, dec, 0)
    assert np.abs(back_row - cell_row).max() < 1e-4
    assert np.abs(back_col - cell_col).max() < 1e-4
    assert (row + 1.0) * header["LTM2_2"] + header["LTV2"] - 1.0 == pytest.approx(cell_row)


def test_a_wcs_that_came_with_the_frame_is_what_is_exported(solved):
    field, solution = solved
    header, unsolved = field.frame.header, replace(solution, flags=FrameFlag.NO_SOLUTION)
    assert pixel_icrs(header, unsolved) is None
    given = WCS(_wcs(field, solution))
    row, col = grid(4096, 7)
    icrs = pixel_icrs(header, unsolved, given)
    got = WCS(sip_header(icrs, header.rows, header.cols)).all_pix2world(col, row, 0)
    want = SkyCoord(*given.all_pix2world(col, row, 0), unit="deg")
    assert SkyCoord(*got, unit="deg").separation(want).arcsec.max() < 0.002


def test_directions_through_a_header_are_those_of_the_solution(solved):
    """Frames from outside bring a WCS: aberration is put back, so both roads give the same apparent direction."""
    field, solution = solved
    header = field.frame.header
    row, col = grid(4096, 5)
    epochs = np.full(len(row), mid_frame_tai_ns(header))
    through_header = HeaderSky(header=header, wcs=WCS(_wcs(field, solution))).apparent(row, col, epochs)
    direct = SolvedSky(header=header, solution=solution).apparent(row, col, epochs)
    assert np.linalg.norm(through_header - direct, axis=1).max() < 0.002 * ARCSEC


def test_stars_are_identified_through_a_header(solved):
    field, solution = solved
    wcs = WCS(_wcs(field, solution))
    found = identify_by_header(field.frame, wcs, StarCatalogue.embedded(), field.calibration.camera)
    assert found.flags & FrameFlag.NO_SOLUTION  # no attitude, but names
    assert found.n_stars > 200
    by_camera = dict(zip(solution.star_index.tolist(), solution.star_v_mag.tolist(), strict=True))
    common = [
        (v, by_camera[i]) for i, v in zip(found.star_index.tolist(), found.star_v_mag.tolist(), strict=True) if i in by_camera
    ]
    assert len(common) > 200
    assert sum(a == b for a, b in common) > 0.99 * len(common)


def test_a_header_of_another_field_names_no_stars(solved):
    field, solution = solved
    text = _wcs(field, solution)
    text["CRVAL1"] = text["CRVAL1"] + 40.0
    found = identify_by_header(field.frame, WCS(text), StarCatalogue.embedded(), field.calibration.camera)
    assert found.n_stars < 5
