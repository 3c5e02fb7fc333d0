"""The coordinate module against astropy's WCS (wcslib): TAN, and distortion written out as SIP polynomials."""

import numpy as np
import pytest
from astropy.wcs import WCS
from astropy.wcs import Sip as AstropySip
from hypothesis import given
from hypothesis import strategies as st

from sboc_e2e.icd.errors import UserError
from simulator.optics.instrument import DistortionOptions, InstrumentOptions, SipTermOptions
from simulator.optics.projection import Distortion, Projection
from simulator.optics.sip import Sip
from simulator.platform.rotation import matrix_of_boresight
from simulator.scene.stars import unit_vectors

FOCAL_PX = 44444.4


@pytest.mark.parametrize(("ra", "dec", "roll"), [(131.0, 18.2, 0.0), (10.0, -62.0, 77.0), (359.9, 80.0, -130.0)])
def test_gnomonic_within_1e_6_px_of_wcslib(ra, dec, roll):
    projection = Projection(focal_px=FOCAL_PX, center_row=2047.5, center_col=2049.25)
    boresight = unit_vectors(np.array(ra), np.array(dec))
    frame = matrix_of_boresight(boresight, np.radians(roll))
    wcs = WCS(naxis=2)
    wcs.wcs.ctype = ["RA---TAN", "DEC--TAN"]
    wcs.wcs.crval = [ra, dec]
    wcs.wcs.crpix = [2049.25 + 1.0, 2047.5 + 1.0]
    scale = np.degrees(1.0 / FOCAL_PX)
    c, s = np.cos(np.radians(roll)), np.sin(np.radians(roll))
    # at roll 0 columns grow to the west and rows to the south
    wcs.wcs.cd = scale * np.array([[-c, s], [-s, -c]])
    rng = np.random.default_rng(1)
    row, col = rng.uniform(0.0, 4095.0, (2, 500))
    sky = wcs.all_pix2world(np.stack([col, row], axis=1), 0)
    own_row, own_col = projection.to_pixels(unit_vectors(sky[:, 0], sky[:, 1]) @ frame.T)
    assert np.abs(own_row - row).max() < 1e-6
    assert np.abs(own_col - col).max() < 1e-6


def test_distortion_within_1e_6_px_of_sip():
    """Brown's third-order terms are polynomials of pixel offsets, which SIP's inverse coefficients hold exactly."""
    k1, p1, p2, f = -1.0, 2e-5, -1e-5, FOCAL_PX
    projection = Projection(focal_px=f, center_row=2047.5, center_col=2047.5, distortion=Distortion(k1=k1, p1=p1, p2=p2))
    ap, bp = np.zeros((4, 4)), np.zeros((4, 4))  # [power of u (col), power of v (row)], offsets in px
    ap[3, 0] = ap[1, 2] = bp[0, 3] = bp[2, 1] = k1 / f**2
    ap[1, 1], ap[2, 0], ap[0, 2] = 2 * p1 / f, 3 * p2 / f, p2 / f
    bp[0, 2], bp[2, 0], bp[1, 1] = 3 * p1 / f, p1 / f, 2 * p2 / f
    sip = AstropySip(None, None, ap, bp, [2048.5, 2048.5])
    rng = np.random.default_rng(2)
    u, v = rng.uniform(-0.046, 0.046, (2, 400))
    row, col = projection.tangent_to_pixels(u, v)
    # foc2pix takes offsets from CRPIX and returns pixels that count from 1
    reference = sip.foc2pix(np.stack([u * f, v * f], axis=1), 1) - 1.0
    assert np.abs(reference[:, 0] - col).max() < 1e-6
    assert np.abs(reference[:, 1] - row).max() < 1e-6
    assert np.abs(col - 2047.5 - u * f).max() > 3.0  # the distortion that is compared


@given(
    row=st.floats(-300.0, 4400.0),
    col=st.floats(-300.0, 4400.0),
    k1=st.floats(-3.0, 3.0),
    p1=st.floats(-1e-3, 1e-3),
    p2=st.floats(-1e-3, 1e-3),
)
def test_pixels_to_vectors_and_back(row, col, k1, p1, p2):
    projection = Projection(
        focal_px=FOCAL_PX, center_row=2040.0, center_col=2051.0, distortion=Distortion(k1=k1, k2=20.0, p1=p1, p2=p2)
    )
    back = projection.to_pixels(projection.to_vectors(np.array([row]), np.array([col])))
    assert back[0][0] == pytest.approx(row, abs=1e-8)
    assert back[1][0] == pytest.approx(col, abs=1e-8)


def test_directions_beyond_the_fold_of_the_distortion_are_nowhere():
    projection = Projection(focal_px=FOCAL_PX, center_row=2047.5, center_col=2047.5, distortion=Distortion(k1=-1.0))
    row, _ = projection.to_pixels(np.array([[0.0, 1.0, 1.0], [0.0, 0.0, -1.0], [0.02, 0.0, 1.0]]))
    assert np.isnan(row[0])  # 45 deg: the polynomial would put it onto the centre
    assert np.isnan(row[1])
    assert np.isfinite(row[2])


def test_binning_and_window_keep_directions():
    whole = Projection(focal_px=FOCAL_PX, center_row=100.0, center_col=50.0, distortion=Distortion(k1=-1.0))
    part = whole.delivered(bin_rows=4, bin_cols=4, window_row0=20, window_col0=8)
    vector = np.array([[0.01, -0.02, 1.0]])
    row, col = whole.to_pixels(vector)
    binned_row, binned_col = part.to_pixels(vector)
    # delivered pixel 0 covers detector pixels 20 to 23, whose mean is 21.5
    assert binned_row[0] == pytest.approx((row[0] - 21.5) / 4.0, abs=1e-9)
    assert binned_col[0] == pytest.approx((col[0] - 9.5) / 4.0, abs=1e-9)


SIP_A = ((2, 0, 1.1e-6), (1, 1, -6e-7), (0, 2, 3e-7), (3, 0, -9e-11), (1, 2, -8e-11), (2, 3, 4e-18))
SIP_B = ((2, 0, -4e-7), (1, 1, 9e-7), (0, 2, -7e-7), (0, 3, -9.5e-11), (2, 1, -7e-11))


def sip_matrix(terms):
    out = np.zeros((6, 6))
    for p, q, coefficient in terms:
        out[p, q] = coefficient
    return out


def test_forward_sip_and_its_inverse_within_1e_6_px_of_astropy():
    """Pixel to sky by astropy's SIP and TAN, sky to pixel by ours."""
    sip = Sip(a=SIP_A, b=SIP_B, radius_px=1.25 * 2896.3)
    projection = Projection(focal_px=FOCAL_PX, center_row=2047.5, center_col=2049.25, sip=sip)
    frame = matrix_of_boresight(unit_vectors(np.array(131.0), np.array(18.2)), 0.0)
    wcs = WCS(naxis=2)
    wcs.wcs.ctype = ["RA---TAN-SIP", "DEC--TAN-SIP"]
    wcs.wcs.crval, wcs.wcs.crpix = [131.0, 18.2], [2050.25, 2048.5]
    wcs.wcs.cd = np.diag([-1.0, -1.0]) * np.degrees(1.0 / FOCAL_PX)
    wcs.sip = AstropySip(sip_matrix(SIP_A), sip_matrix(SIP_B), None, None, [2050.25, 2048.5])
    row, col = np.random.default_rng(3).uniform(0.0, 4095.0, (2, 2000))
    sky = wcs.all_pix2world(np.stack([col, row], axis=1), 0)
    own_row, own_col = projection.to_pixels(unit_vectors(sky[:, 0], sky[:, 1]) @ frame.T)
    assert np.abs(own_row - row).max() < 1e-6
    assert np.abs(own_col - col).max() < 1e-6
    back_row, back_col = projection.to_pixels(projection.to_vectors(row, col))
    assert max(np.abs(back_row - row).max(), np.abs(back_col - col).max()) < 1e-8
    plain_row, plain_col = wcs.wcs_world2pix(sky, 0).T[::-1]
    assert np.hypot(plain_row - row, plain_col - col).max() > 5.0  # the distortion that is compared


def test_sip_in_binned_pixels_keeps_directions():
    whole = Projection(focal_px=FOCAL_PX, center_row=1000.0, center_col=900.0, sip=Sip(a=SIP_A, b=SIP_B, radius_px=3000.0))
    part = whole.delivered(bin_rows=4, bin_cols=4, window_row0=20, window_col0=8)
    row, col = whole.to_pixels(np.array([[0.01, -0.02, 1.0]]))
    binned_row, binned_col = part.to_pixels(np.array([[0.01, -0.02, 1.0]]))
    assert binned_row[0] == pytest.approx((row[0] - 21.5) / 4.0, abs=1e-9)
    assert binned_col[0] == pytest.approx((col[0] - 9.5) / 4.0, abs=1e-9)


def test_what_is_known_of_a_sip_camera_is_its_best_radial_and_tangential_fit():
    """Radial terms that SIP can write are recovered; what is left of others is stated by the fit's residual, not hidden."""
    k1, f = -1.0, FOCAL_PX
    radial = Projection(focal_px=f, center_row=2047.5, center_col=2047.5, distortion=Distortion(k1=k1))
    inverse = -k1 / f**2  # to first order
    cubic = ((3, 0, inverse), (1, 2, inverse)), ((0, 3, inverse), (2, 1, inverse))
    nominal = InstrumentOptions(
        distortion=DistortionOptions(
            k1=0.0,
            p1=0.0,
            p2=0.0,
            sip_a=tuple(SipTermOptions(col_power=p, row_power=q, coefficient=c) for p, q, c in cubic[0]),
            sip_b=tuple(SipTermOptions(col_power=p, row_power=q, coefficient=c) for p, q, c in cubic[1]),
        )
    )
    known = nominal.known_projection()
    assert known.sip is None
    assert known.distortion.k1 == pytest.approx(k1, rel=0.01)
    assert known.focal_px == pytest.approx(nominal.focal_px, rel=1e-5)
    row, col = np.random.default_rng(4).uniform(0.0, 4095.0, (2, 500))
    there = known.to_pixels(nominal.nominal_projection().to_vectors(row, col))
    assert max(np.abs(there[0] - row).max(), np.abs(there[1] - col).max()) < 0.01
    assert np.abs(radial.to_vectors(row, col) - known.to_vectors(row, col)).max() < 0.1 / f
    assert InstrumentOptions().known_projection() == InstrumentOptions().nominal_projection()


@pytest.mark.parametrize(
    ("terms", "words"),
    [
        ((SipTermOptions(col_power=1, row_power=0, coefficient=1e-3),), "sums of 2 to 9"),
        ((SipTermOptions(col_power=2, row_power=0, coefficient=1e-3),), "shifts of up to"),
        ((SipTermOptions(col_power=9, row_power=0, coefficient=-6e-30),), "areas shrink"),
    ],
)
def test_impossible_sip_is_refused_by_name(terms, words):
    with pytest.raises(UserError, match=r"instrument\.distortion\.sip_a.*" + words):
        InstrumentOptions(distortion=DistortionOptions(sip_a=terms))
