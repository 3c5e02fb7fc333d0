"""TDM and OEM say what was measured: read back by an independent reader to 1e-9 deg and microseconds."""

import re
import warnings

import erfa
import numpy as np
import pytest
from astropy.time import Time

from ground.options import ProductOptions
from ground.products.oem import oem_text
from ground.products.tdm import tdm_text
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.frame import FrameHeader, ObserverState
from sboc_e2e.icd.products import Tracklet
from sboc_e2e.icd.tai import to_jd_parts

ndm_io = pytest.importorskip("ccsds_ndm.ndm_io", reason="the conformance reader ccsds-ndm is not installed")

T0_TAI_NS = 2_179_872_037_123_456_789  # 2027-01-28


def _observer(k: int) -> ObserverState:
    return ObserverState(
        tai_ns=T0_TAI_NS + k * 250_000_000,
        position_m=np.array([7.078e6, 1.5e3 * k, -2.5e3]),
        velocity_m_s=np.array([-1.5, 1234.567891, 7345.678912]),
        sigma_position_m=10.0,
        sigma_velocity_m_s=0.1,
    )


def _headers(observed: bool = True) -> list[FrameHeader]:
    return [
        FrameHeader(
            frame=k,
            t_start_tai_ns=T0_TAI_NS + k * 250_000_000,
            exposure_ns=200_000_000,
            line_time_ns=10_000,
            rows=64,
            cols=64,
            observer=_observer(k) if observed else None,
        )
        for k in range(4)
    ]


def _tracklet(number: int = 17) -> Tracklet:
    rng = np.random.default_rng(number)
    m = 6
    return Tracklet(
        tracklet_id=number,
        streak_ids=np.arange(3),
        frames=np.arange(3),
        t_tai_ns=T0_TAI_NS + np.arange(m) * 111_111_111,
        ra_deg=np.array([359.999999, 0.0, 57.123456789, 123.0, 180.0, 270.0]),
        dec_deg=rng.uniform(-80.0, 80.0, m),
        sigma_along_arcsec=np.full(m, 0.5),
        sigma_cross_arcsec=np.full(m, 0.25),
        t_ref_tai_ns=T0_TAI_NS,
        ra_ref_deg=57.0,
        dec_ref_deg=20.0,
        rate_deg_s=1.0,
        rate_err_deg_s=0.01,
        position_angle_deg=10.0,
        mag=12.0,
        mag_err=0.1,
        chi2_nu=1.0,
        probability=0.99,
        direction_resolved=True,
        flags=StreakFlag(0),
    )


def _read(text: str, tmp_path):
    path = tmp_path / "message.kvn"
    path.write_text(text)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the reader's own dependencies warn
        return ndm_io.NdmIo().from_path(path)


def _tai_ns(utc: str) -> float:
    t = Time(utc, format="isot", scale="utc").tai
    jd1, jd2 = to_jd_parts(T0_TAI_NS)
    return ((t.jd1 - jd1) + (t.jd2 - jd2)) * 86400e9 + T0_TAI_NS


def test_tdm_reads_back_with_angles_epochs_and_conventions(tmp_path):
    tracklet = _tracklet()
    text = tdm_text([tracklet], [[]], _headers(), ProductOptions(), oem_name="observer.oem")
    message = _read(text, tmp_path)
    (segment,) = message.body.segment
    meta = segment.metadata
    assert meta.track_id == "SBOC-T000017"
    assert meta.path == "2,1"
    assert str(meta.angle_type.value if hasattr(meta.angle_type, "value") else meta.angle_type) == "RADEC"
    assert "EME2000" in str(meta.reference_frame)
    assert meta.ephemeris_name_1 == "observer.oem"
    got = {"angle_1": [], "angle_2": []}
    for row in segment.data.observation:
        for name, values in got.items():
            angle = getattr(row, name)
            if angle is not None:
                values.append((float(getattr(angle, "value", angle)), _tai_ns(str(row.epoch))))
    # EME2000 by an independent route: ERFA's bias angles of 2000 (Chapront et al. 2002)
    dpsibi, depsbi, dra = erfa.bi00()
    rb = _bias_by_angles(dpsibi, depsbi, dra)
    ra, dec = np.radians(tracklet.ra_deg), np.radians(tracklet.dec_deg)
    want = rb @ np.stack((np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)))
    want_ra, want_dec = np.degrees(np.arctan2(want[1], want[0])) % 360.0, np.degrees(np.arcsin(want[2]))
    d_ra = (np.array([a for a, _ in got["angle_1"]]) - want_ra + 180.0) % 360.0 - 180.0
    assert np.abs(d_ra).max() < 1e-9
    assert np.abs(np.array([a for a, _ in got["angle_2"]]) - want_dec).max() < 1e-9
    assert np.abs(np.array([t for _, t in got["angle_1"]]) - tracklet.t_tai_ns).max() < 1000.0  # 1 us
    assert "annual aberration NOT removed" in text
    assert "CORRECTION_ABERRATION_YEARLY" not in text


def _bias_by_angles(dpsibi, depsbi, dra):
    """Frame bias as three rotations: R1(-deps) R2(dpsi sin eps0) R3(dra), IERS Conventions 2003, eq. 28 f."""
    eps0 = np.radians(84381.448 / 3600.0)
    a, b, c = dra, dpsibi * np.sin(eps0), -depsbi
    r3 = np.array([[np.cos(a), np.sin(a), 0], [-np.sin(a), np.cos(a), 0], [0, 0, 1]])
    r2 = np.array([[np.cos(b), 0, -np.sin(b)], [0, 1, 0], [np.sin(b), 0, np.cos(b)]])
    r1 = np.array([[1, 0, 0], [0, np.cos(c), np.sin(c)], [0, -np.sin(c), np.cos(c)]])
    return r1 @ r2 @ r3


def test_each_tracklet_has_its_segment_and_segments_hold_no_blank_line(tmp_path):
    text = tdm_text([_tracklet(1), _tracklet(2)], [[], []], _headers(), ProductOptions(), oem_name=None)
    assert len(_read(text, tmp_path).body.segment) == 2
    for segment in re.findall(r"META_START.*?DATA_STOP", text, flags=re.DOTALL):
        assert "\n\n" not in segment
    assert "EPHEMERIS_NAME" not in text


def test_tdm_without_observer_says_that_aberration_stayed():
    text = tdm_text([_tracklet()], [[]], _headers(observed=False), ProductOptions(), oem_name="observer.oem")
    assert "geocentric velocity NOT removed" in text
    assert "EPHEMERIS_NAME" not in text


def test_creation_date_is_the_last_frame_so_that_bytes_repeat():
    texts = {tdm_text([_tracklet()], [[]], _headers(), ProductOptions(), oem_name=None) for _ in range(2)}
    assert len(texts) == 1
    assert "CREATION_DATE = 2027-01-2" in texts.pop()


def test_no_state_no_oem():
    assert oem_text(_headers(observed=False), ProductOptions()) is None
