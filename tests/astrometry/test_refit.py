"""A frame whose ends a star has spoilt gets them from the motion of the tracklet's other frames."""

from dataclasses import replace

import numpy as np

from ground.refit import carried
from ground.streaks.joint_evidence import TrackletFrame
from ground.streaks.joint_motion import Motion
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.products import StreakFit, StreakPixels

RATE_PX_S, ACCELERATION_PX_S2, SCALE_ARCSEC = 500.0, 12.0, 4.6
NO_PIXELS = StreakPixels(
    row=np.zeros(0),
    col=np.zeros(0),
    value_e=np.zeros(0),
    variance_e2=np.zeros(0),
    psf_sigma_px=0.9,
    frame_shape=(4096, 4096),
)


def _position_px(t_s: float) -> float:
    return RATE_PX_S * t_s + 0.5 * ACCELERATION_PX_S2 * t_s**2


def _frame(k: int) -> TrackletFrame:
    """Frame k of a mover along (0.6, 0.8) in rows and cols, global shutter, ends good to 0.3 px."""
    opened, closed = 0.25 * k, 0.25 * k + 0.2
    start, stop = _position_px(opened), _position_px(closed)
    fit = StreakFit(
        row0=500.0 + 0.6 * start,
        col0=300.0 + 0.8 * start,
        row1=500.0 + 0.6 * stop,
        col1=300.0 + 0.8 * stop,
        covariance_px2=np.eye(4) * 0.09,
        end_interval_px=np.array([[-0.3, 0.3], [-0.3, 0.3]]),
        sigma_cross_px=0.05,
        flux_e=1000.0,
        flux_err_e=30.0,
        snr=20.0,
        sagitta_px=0.0,
        sagitta_err_px=0.1,
        gradient=0.0,
        width_px=0.9,
        width_err_px=0.05,
        chi2_nu=1.0,
        n_pixels=500,
        flags=StreakFlag(0),
        light_curve_e_px=np.zeros(0, dtype=np.float32),
    )
    return TrackletFrame(
        pixels=NO_PIXELS,
        fit=fit,
        along0=SCALE_ARCSEC * start,
        along1=SCALE_ARCSEC * stop,
        along_per_px=SCALE_ARCSEC,
        t_open_s=opened,
        t_close_s=closed,
        line_time_s=0.0,
    )


def _spoilt(k: int, by_px: float) -> TrackletFrame:
    """Frame k with end 0 moved outwards, as a star beyond it does, and brighter in proportion."""
    good = _frame(k)
    fit = replace(
        good.fit, row0=good.fit.row0 - 0.6 * by_px, col0=good.fit.col0 - 0.8 * by_px, flux_e=1000.0 * (1.0 + by_px / 100.0)
    )
    return replace(good, fit=fit, along0=good.along0 - SCALE_ARCSEC * by_px)


def _motion(sigma_px: float) -> Motion:
    """The motion that the other frames showed: its place known to this, its rate to as much each second."""
    mean = SCALE_ARCSEC * np.array([_position_px(0.5), RATE_PX_S + 0.5 * ACCELERATION_PX_S2, ACCELERATION_PX_S2])
    return Motion(mean, SCALE_ARCSEC * sigma_px * np.diag([1.0, 1.0, 0.0]), 0.5)


def _along_sigma(fit: StreakFit, end: int) -> float:
    along = np.array([0.6, 0.8])
    return float(np.sqrt(along @ np.asarray(fit.covariance_px2)[2 * end : 2 * end + 2, 2 * end : 2 * end + 2] @ along))


def test_spoilt_ends_come_back_to_where_they_were():
    fit = carried(_spoilt(2, 11.0), _motion(0.1))
    want = _frame(2).fit
    assert np.hypot(fit.row0 - want.row0, fit.col0 - want.col0) < 0.01
    assert np.hypot(fit.row1 - want.row1, fit.col1 - want.col1) < 0.01
    assert abs(fit.flux_e / want.flux_e - 1.0) < 0.02
    assert fit.flags & StreakFlag.REFIT
    # along the trail as uncertain as the motion there, across as before
    assert abs(_along_sigma(fit, 0) - 0.1) < 1e-6  # at t = 0.5 s, the motion's epoch
    assert abs(_along_sigma(fit, 1) - 0.1 * np.hypot(1.0, 0.2)) < 1e-6
    across = np.array([-0.8, 0.6])
    assert abs(np.sqrt(across @ fit.covariance_px2[2:, 2:] @ across) - 0.3) < 0.01


def test_the_motion_is_carried_beyond_its_frames_as_far_as_it_is_known():
    """The first frame of a tracklet, 8 px too long by a star, came back as it was: only frames between others were mended."""
    fit = carried(_spoilt(6, 8.0), _motion(0.1))
    assert np.hypot(fit.row0 - _frame(6).fit.row0, fit.col0 - _frame(6).fit.col0) < 0.01
    assert abs(_along_sigma(fit, 0) - 0.1 * np.hypot(1.0, 1.0)) < 1e-6
    vague = _spoilt(6, 8.0)
    assert carried(vague, _motion(10.0)) is vague.fit


def test_an_end_on_the_edge_stays_there():
    spoilt = _spoilt(2, 8.0)
    spoilt = replace(spoilt, fit=replace(spoilt.fit, flags=StreakFlag.EDGE0))
    fit = carried(spoilt, _motion(0.1))
    assert (fit.row0, fit.col0) == (spoilt.fit.row0, spoilt.fit.col0)
    assert fit.end_interval_px[0].tolist() == [0.0, 0.0]


def test_an_end_that_the_motion_puts_beyond_the_edge_is_on_it():
    """A fit that stopped 8 px before the border. The motion leaves the frame there, 37 px before the shutter closes."""
    good = _frame(2)
    pixels = replace(NO_PIXELS, frame_shape=(690, 4096))
    border_px = (689.5 - 500.0) / 0.6
    stop = border_px - 8.0
    short = replace(good.fit, row1=500.0 + 0.6 * stop, col1=300.0 + 0.8 * stop)
    fit = carried(replace(good, pixels=pixels, fit=short, along1=SCALE_ARCSEC * stop), _motion(0.1))
    assert abs(fit.row1 - 689.5) < 1e-6
    assert abs(fit.col1 - (300.0 + 0.8 * border_px)) < 1e-6
    assert StreakFlag.EDGE1 in fit.flags
    assert StreakFlag.EDGE0 not in fit.flags
    assert fit.end_interval_px[1].tolist() == [0.0, 0.0]
