"""Errors of places that one track of points foretells, against straight lines fitted to drawn places."""

from dataclasses import replace

import numpy as np
import pytest

from ground.link.foretold import AT_THE_END, with_track_errors
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.products import StreakFit, StreakMeasurement

FRAMES, SENT, FRAME_S = 32, 7, 0.25
MIDDLE_PX = 0.2


def header(frame: int) -> FrameHeader:
    return FrameHeader(
        frame=frame, t_start_tai_ns=10**18 + frame * 250_000_000, exposure_ns=200_000_000, line_time_ns=0, rows=64, cols=64
    )


def member(frame: int, track_frames: float = FRAMES) -> StreakMeasurement:
    """A point whose fit states the error of the window's end."""
    variance = (AT_THE_END * MIDDLE_PX) ** 2
    fit = StreakFit(
        row0=1.0, col0=1.0, row1=1.0, col1=2.0, covariance_px2=np.kron(np.ones((2, 2)), variance * np.eye(2)),
        end_interval_px=np.zeros((2, 2)), sigma_cross_px=1.0, flux_e=1.0, flux_err_e=1.0, snr=1.0, sagitta_px=0.0,
        sagitta_err_px=1.0, gradient=0.0, width_px=0.9, width_err_px=0.1, chi2_nu=1.0, n_pixels=50, flags=StreakFlag.POINT_LIKE,
        light_curve_e_px=np.zeros(0, dtype=np.float32), track_frames=track_frames,
    )  # fmt: skip
    return StreakMeasurement(
        frame=frame, streak_id=frame, roi_id=0, fit=fit, row_mid=1.0, col_mid=1.5, ra_deg=np.zeros(3), dec_deg=np.zeros(3),
        t_tai_ns=np.zeros(3, np.int64), sigma_along_arcsec=1.0, sigma_cross_arcsec=1.0, mag=12.0, mag_err=0.1, probability=1.0,
        tracklet_id=0, flags=StreakFlag.POINT_LIKE,
    )  # fmt: skip


def test_errors_of_the_last_places_are_those_of_a_line_through_the_window() -> None:
    """Covariance of 20,000 least-squares lines at the epochs of the last seven of 32 frames."""
    rng = np.random.default_rng(6)
    t = FRAME_S * np.arange(FRAMES)
    drawn = rng.normal(0.0, MIDDLE_PX * np.sqrt(FRAMES), (FRAMES, 20_000))
    lines = np.vander(t[-SENT:], 2) @ np.polyfit(t, drawn, 1)
    frames = range(FRAMES - SENT, FRAMES)
    members, shared = with_track_errors([member(k) for k in frames], {k: header(k) for k in frames}, FRAME_S)
    errors = np.array([shared[k][1][0] for k in frames])
    np.testing.assert_allclose(errors @ errors.T, np.cov(lines), rtol=0.04)
    stated = [m.fit.covariance_px2[0, 0] for m in members]
    np.testing.assert_allclose(stated, np.diag(errors @ errors.T), rtol=1e-12)
    assert {number for number, _ in shared.values()} == {0}


def test_windows_are_apart_and_other_members_stay_as_they_are() -> None:
    frames = [30, 31, 62, 63, 64]
    given = [replace(m, fit=replace(m.fit, track_frames=0.0)) if m.frame == 64 else m for m in (member(k) for k in frames)]
    members, shared = with_track_errors(given, {k: header(k) for k in frames}, FRAME_S)
    assert [shared[k][0] for k in frames[:4]] == [0, 0, 1, 1]
    assert members[4] is given[4]
    assert 64 not in shared
    assert shared[63][1][0] == pytest.approx(shared[31][1][0])
    _, later = with_track_errors(given, {k: header(k) for k in frames}, FRAME_S, 3)
    assert [later[k][0] for k in frames[:4]] == [3, 3, 4, 4], "motions of a joint fit have the first numbers"
