"""Readers of messages against texts by hand, the reference messages, and what another program makes of them."""

import warnings
from pathlib import Path

import erfa
import numpy as np
import pytest
from astropy.time import Time

from sboc_e2e.icd.errors import UserError
from sboc_e2e.score.published.axes import gcrs_from, orbital_axes
from sboc_e2e.score.published.epochs import tai_ns
from sboc_e2e.score.published.kvn import UnreadableProduct
from sboc_e2e.score.published.oem_reader import read_oem
from sboc_e2e.score.published.opm_reader import read_opm
from sboc_e2e.score.published.tdm_reader import TdmSegment, read_tdm
from tests.score.published.conftest import HandMade

REFERENCE = Path(__file__).parents[2] / "products"
"""Reference messages of other hands, read in several tests."""


def rewritten(path: Path, out: Path) -> Path:
    """The message read and written again by the conformance library, with its own spacing and comments."""
    ndm_io = pytest.importorskip("ccsds_ndm.ndm_io", reason="the conformance reader ccsds-ndm is not installed")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the reader's own dependencies warn
        io = ndm_io.NdmIo()
        out.write_text(io.to_string(io.from_path(path), ndm_io.NDMFileFormats.KVN))
    return out


@pytest.mark.parametrize("again", [False, True], ids=["as it is", "rewritten"])
def test_reference_tracking_data_message(tmp_path: Path, again: bool) -> None:
    path = REFERENCE / "reference.tdm"
    (segment,) = read_tdm(rewritten(path, tmp_path / "again.tdm") if again else path)
    assert segment.tracklet_id == 17
    want = Time(["2026-11-20T12:00:00", "2026-11-20T12:00:00.25", "2026-11-20T12:00:00.5"], scale="utc").tai
    want_ns = np.rint(((want.jd1 - 2436204.5) + want.jd2) * 86_400 * 4).astype(np.int64) * 250_000_000
    np.testing.assert_array_equal(segment.angle_tai_ns, want_ns)
    np.testing.assert_array_equal(segment.mag_tai_ns, want_ns)
    np.testing.assert_allclose(segment.mag, [12.34, 12.31, 12.36])
    # back to EME2000 by ERFA's own bias matrix
    unit = segment.direction @ np.asarray(erfa.bp06(2451545.0, 0.0)[0]).T
    ra, dec = np.degrees(np.arctan2(unit[:, 1], unit[:, 0])), np.degrees(np.arcsin(unit[:, 2]))
    np.testing.assert_allclose(ra, [57.123456789, 57.623456789, 58.123456789], atol=1e-9)
    np.testing.assert_allclose(dec, [19.987654321, 20.087654321, 20.187654321], atol=1e-9)


@pytest.mark.parametrize("again", [False, True], ids=["as it is", "rewritten"])
def test_reference_ephemeris_message(tmp_path: Path, again: bool) -> None:
    path = REFERENCE / "reference.oem"
    (ephemeris,) = read_oem(rewritten(path, tmp_path / "again.oem") if again else path)
    state = ephemeris.state.reshape(-1, 2, 3) @ np.asarray(erfa.bp06(2451545.0, 0.0)[0]).T
    np.testing.assert_allclose(state[3, 0], [7074.424079, 0.0, 224.962108], atol=1e-6)
    np.testing.assert_allclose(state[3, 1], [-0.238374655, 0.0, 7.496210878], atol=1e-9)
    np.testing.assert_array_equal(np.diff(ephemeris.t_tai_ns), [10_000_000_000] * 3)
    assert np.isnan(ephemeris.covariance).all()


def test_messages_by_hand_survive_another_program(hand_made: HandMade, tmp_path: Path) -> None:
    path = hand_made.write_tdm()
    for a, b in zip(read_tdm(path), read_tdm(rewritten(path, tmp_path / "again.tdm")), strict=True):
        assert a.tracklet_id == b.tracklet_id
        np.testing.assert_array_equal(a.angle_tai_ns, b.angle_tai_ns)
        np.testing.assert_allclose(a.direction, b.direction, atol=1e-13)
    path = hand_made.write_oem(covariance=True)
    (first,), (second,) = read_oem(path), read_oem(rewritten(path, tmp_path / "again.oem"))
    np.testing.assert_allclose(first.state, second.state, rtol=1e-12)
    np.testing.assert_allclose(first.covariance, second.covariance, rtol=1e-9, atol=1e-18)
    assert np.isfinite(first.covariance).all()
    path = hand_made.write_opm(102, np.zeros(6), np.diag([4.0, 5.0, 6.0, 1e-4, 2e-4, 3e-4]))
    one, other = read_opm(path), read_opm(rewritten(path, tmp_path / "again.opm"))
    assert (one.tracklet_id, one.t_tai_ns) == (other.tracklet_id, other.t_tai_ns) == (102, one.t_tai_ns)
    np.testing.assert_allclose(one.state, other.state, rtol=1e-12)
    np.testing.assert_allclose(one.covariance, other.covariance, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(one.covariance, np.diag([4.0, 5.0, 6.0, 1e-4, 2e-4, 3e-4]), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(
    ("text", "calendar"),
    [
        ("2027-01-29T00:00:01.25", "2027-01-29T00:00:01.25"),
        ("2027-029T00:00:01.250000Z", "2027-01-29T00:00:01.25"),
        ("2016-12-31T23:59:60.5", "2016-12-31T23:59:60.5"),
        ("2017-01-01T00:00:00", "2017-01-01T00:00:00"),
    ],
)
def test_epochs_agree_with_astropy(text: str, calendar: str) -> None:
    time = Time(calendar, format="isot", scale="utc").tai
    want_s = ((time.jd1 - 2436204.5) + time.jd2) * 86_400.0
    assert tai_ns([text], "UTC")[0] == pytest.approx(want_s * 1e9, abs=2e3)
    assert tai_ns([text], "UTC")[0] % 250_000_000 == 0


def test_scales_differ_by_what_they_must() -> None:
    utc, gps, tai = (int(tai_ns(["2027-01-29T00:00:00"], scale)[0]) for scale in ("UTC", "GPS", "TAI"))
    assert (utc - tai, gps - tai) == (37 * 10**9, 19 * 10**9)
    with pytest.raises(UserError, match="TIME_SYSTEM is UT1"):
        tai_ns(["2027-01-29T00:00:00"], "UT1")
    with pytest.raises(UserError, match="is no epoch"):
        tai_ns(["2027-02-30T00:00:00"], "UTC")


def test_axes_are_those_of_erfa() -> None:
    """The bias of 2000 and that of 2006 agree to 0.1 mas."""
    np.testing.assert_allclose(gcrs_from("EME2000").T, erfa.bp06(2451545.0, 0.0)[0], atol=5e-10)
    np.testing.assert_allclose(gcrs_from("EME2000") @ gcrs_from("EME2000").T, np.eye(3), atol=1e-15)
    rtn = orbital_axes(np.array([7000.0, 0, 0]), np.array([0.1, 0, 7.5]))
    np.testing.assert_allclose(rtn, np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]]).astype(float), atol=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "phrase"),
    [
        ("ANGLE_TYPE = RADEC", "ANGLE_TYPE = AZEL", "ANGLE_TYPE = RADEC in the segment before it, not AZEL"),
        ("TIMETAG_REF = RECEIVE", "TIMETAG_REF = TRANSMIT", "TIMETAG_REF = RECEIVE"),
        ("REFERENCE_FRAME = EME2000", "REFERENCE_FRAME = TOD", "axes TOD are not read"),
        ("TIME_SYSTEM = UTC", "TIME_SYSTEM = MET", "TIME_SYSTEM is MET"),
        ("CCSDS_TDM_VERS = 2.0", "CCSDS_OEM_VERS = 2.0", "line 1: expected CCSDS_TDM_VERS"),
        ("T00:00:00.000000 ", "T00:00:00.900000 ", "expected one"),
        ("DATA_STOP", "DATA_STOPPED", "expected DATA_STOP"),
    ],
)
def test_tracking_messages_of_another_meaning_are_refused(hand_made: HandMade, old: str, new: str, phrase: str) -> None:
    path = hand_made.write_tdm()
    text = path.read_text().replace(old, new)
    path.write_text(text.replace("T00:00:00.200000 ", "T00:00:00.900000 ") if "900000" in new else text)
    with pytest.raises(UnreadableProduct, match=phrase) as error:
        read_tdm(path)
    assert "tracklets.tdm" in str(error.value)


def test_ephemerides_and_states_that_are_cut_short_are_refused(hand_made: HandMade) -> None:
    path = hand_made.write_oem()
    path.write_text(path.read_text().rsplit(" ", 1)[0])
    with pytest.raises(UnreadableProduct, match=r"observer.oem line \d+: expected an epoch and 6 or 9 numbers"):
        read_oem(path)
    path = hand_made.write_opm(100, np.zeros(6), np.eye(6))
    text = path.read_text()
    path.write_text("\n".join(line for line in text.splitlines() if not line.startswith("CZ_X ")))
    with pytest.raises(UnreadableProduct, match="all 21 elements"):
        read_opm(path)
    path.write_text("\n".join(line for line in text.splitlines() if not line.startswith("Z_DOT ")))
    with pytest.raises(UnreadableProduct, match="expected Z_DOT"):
        read_opm(path)


def test_a_covariance_without_axes_of_its_own_is_on_those_of_the_states(hand_made: HandMade) -> None:
    """CCSDS 502.0-B-2, 5.2.5: each matrix names its axes, or they are those of REF_FRAME."""
    path = hand_made.write_oem(covariance=True)
    blocks = path.read_text().split("COV_REF_FRAME = RTN\n")
    # the second matrix has no axes of its own, and tells them apart
    second = blocks[2].replace("2.5e-05", "1e-06", 1)
    path.write_text("COV_REF_FRAME = RTN\n".join([blocks[0], blocks[1]]) + second)
    (ephemeris,) = read_oem(path)
    turn = np.asarray(erfa.bp06(2451545.0, 0.0)[0])
    np.testing.assert_allclose(turn @ ephemeris.covariance[1, :3, :3] @ turn.T, np.diag([1e-6, 2.5e-5, 2.5e-5]), atol=1e-12)


def test_corrections_of_angles_that_were_not_applied_are_added(hand_made: HandMade) -> None:
    """CCSDS 503.0-B-2, 3.3: what CORRECTIONS_APPLIED = NO leaves to the reader."""
    path = hand_made.write_tdm()
    text = path.read_text()
    plain = read_tdm(path)[0]
    stated = "CORRECTION_ANGLE_1 = 0.01\nCORRECTION_ANGLE_2 = -0.02\nCORRECTION_MAG = 0.3\n"

    def with_lines(lines: str) -> TdmSegment:
        path.write_text(text.replace("META_STOP", f"{lines}META_STOP"))
        return read_tdm(path)[0]

    def angles_of(segment: TdmSegment) -> np.ndarray:
        unit = segment.direction @ np.asarray(erfa.bp06(2451545.0, 0.0)[0]).T
        return np.degrees([np.arctan2(unit[:, 1], unit[:, 0]), np.arcsin(unit[:, 2])])

    left = with_lines(f"{stated}CORRECTIONS_APPLIED = NO\n")
    moved = (angles_of(left) - angles_of(plain) + 180.0) % 360.0 - 180.0
    np.testing.assert_allclose(moved, [[0.01] * moved.shape[1], [-0.02] * moved.shape[1]], atol=1e-9)
    np.testing.assert_allclose(left.mag - plain.mag, 0.3)
    np.testing.assert_array_equal(with_lines(f"{stated}CORRECTIONS_APPLIED = YES\n").direction, plain.direction)
    with pytest.raises(UnreadableProduct, match="CORRECTIONS_APPLIED = YES or NO"):
        with_lines(stated)
    with pytest.raises(UnreadableProduct, match="CORRECTION_ABERRATION_YEARLY applied"):
        with_lines("CORRECTION_ABERRATION_YEARLY = 0.005\nCORRECTIONS_APPLIED = NO\n")
    with pytest.raises(UnreadableProduct, match="a number as CORRECTION_ANGLE_1 in the segment before it, not 'much'"):
        with_lines("CORRECTION_ANGLE_1 = much\nCORRECTIONS_APPLIED = NO\n")
