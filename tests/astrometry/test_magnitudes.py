"""Magnitudes: exposed time under a rolling shutter against brute force, and sizes against published values."""

from dataclasses import replace

import numpy as np
import pytest

from ground.orbit.size import diameter_m
from ground.photometry.magnitude import crossing_time_s, exposed_time_s, magnitude_at_1deg_s, streak_magnitude
from ground.photometry.zero_point import robust_linear_fit
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.products import PhotometricSolution, StreakFit, StreakMeasurement
from simulator.platform.earth import AU_KM
from simulator.scene.reflection import lambert_flux

EXPOSURE_NS, LINE_NS, ROWS = 200_000_000, 100_000, 2048


def _header() -> FrameHeader:
    return FrameHeader(frame=0, t_start_tai_ns=10**18, exposure_ns=EXPOSURE_NS, line_time_ns=LINE_NS, rows=ROWS, cols=ROWS)


def measured_streak(row0: float, row1: float, t_ns, flux_e: float, flags: StreakFlag) -> StreakMeasurement:
    fit = StreakFit(
        row0=row0,
        col0=100.0,
        row1=row1,
        col1=100.0,
        covariance_px2=np.eye(4) * 0.01,
        end_interval_px=np.zeros((2, 2)),
        sigma_cross_px=0.1,
        flux_e=flux_e,
        flux_err_e=0.01 * flux_e,
        snr=50.0,
        sagitta_px=0.0,
        sagitta_err_px=0.1,
        gradient=0.0,
        width_px=0.9,
        width_err_px=0.1,
        chi2_nu=1.0,
        n_pixels=100,
        flags=flags,
        light_curve_e_px=np.zeros(0, dtype=np.float32),
    )
    return StreakMeasurement(
        frame=0,
        streak_id=0,
        roi_id=0,
        fit=fit,
        row_mid=0.5 * (row0 + row1),
        col_mid=100.0,
        ra_deg=np.zeros(3),
        dec_deg=np.zeros(3),
        t_tai_ns=np.asarray(t_ns, dtype=np.int64),
        sigma_along_arcsec=1.0,
        sigma_cross_arcsec=1.0,
        mag=float("nan"),
        mag_err=float("nan"),
        probability=1.0,
        tracklet_id=0,
        flags=flags,
    )


def _brute_force(row_at_start: float, rows_per_s: float) -> tuple[float, float, float, float]:
    """Rows and times of first and last light of a mover, from which rows are open when it passes (fine time steps)."""
    t = np.arange(-0.5, 1.5, 1e-6)
    row = row_at_start + rows_per_s * t
    opens = LINE_NS * 1e-9 * row
    lit = (t >= opens) & (t <= opens + EXPOSURE_NS * 1e-9)
    k = np.flatnonzero(lit)
    return row[k[0]], row[k[-1]], t[k[0]], t[k[-1]]


@pytest.mark.parametrize("rows_per_s", [-3000.0, -500.0, 500.0, 2000.0, 3000.0])
def test_exposed_time_of_a_mover_is_that_of_brute_force(rows_per_s):
    row0, row1, t0, t1 = _brute_force(1000.0, rows_per_s)
    exposed = t1 - t0
    assert abs(exposed - EXPOSURE_NS * 1e-9 / abs(1.0 - rows_per_s * LINE_NS * 1e-9)) < 1e-5
    # after linking, ends carry the epochs of shutter open and close on their rows
    epochs = [10**18 + round(LINE_NS * row0), 0, 10**18 + round(LINE_NS * row1) + EXPOSURE_NS]
    streak = measured_streak(row0, row1, epochs, 1e4, StreakFlag.DIRECTION_RESOLVED)
    seconds, error = exposed_time_s(streak, _header(), None)
    assert abs(seconds - exposed) < 1e-5
    assert error == 0.0
    zero_point = PhotometricSolution(
        frame=0, zero_point_mag=21.0, zero_point_err_mag=0.003, colour_term=0.0, n_stars=100, rms_mag=0.02
    )
    mag, mag_err = streak_magnitude(streak, _header(), zero_point, 0.9, None)
    assert abs(mag - (21.0 - 2.5 * np.log10(1e4 / exposed / 0.9))) < 1e-4
    assert abs(mag_err - np.hypot(0.01086, 0.003)) < 1e-4


def test_a_piece_of_a_trail_has_the_magnitude_of_the_whole():
    """Motion dates both ends of a piece: a third of the light of a steady object was collected in a third of the exposure."""
    zero_point = PhotometricSolution(
        frame=0, zero_point_mag=21.0, zero_point_err_mag=0.0, colour_term=0.0, n_stars=9, rms_mag=0.0
    )
    whole, piece = (
        measured_streak(
            row0, row1, (10**18 + round(from_ns), 0, 10**18 + round(to_ns)), 1e4 * share, StreakFlag.DIRECTION_RESOLVED
        )
        for row0, row1, from_ns, to_ns, share in (
            (100.0, 100.0, LINE_NS * 100, LINE_NS * 100 + EXPOSURE_NS, 1.0),
            (100.0, 100.0, LINE_NS * 100, LINE_NS * 100 + EXPOSURE_NS / 3, 1.0 / 3.0),
        )
    )
    piece = replace(piece, fit=replace(piece.fit, col1=150.0))
    found, short = (streak_magnitude(streak, _header(), zero_point, 1.0, None) for streak in (whole, piece))
    assert short[0] == pytest.approx(found[0], abs=1e-6)
    # 0.1 px at both ends of 50 px
    assert short[1] == pytest.approx(np.hypot(0.010857, 1.0857 * np.hypot(0.1, 0.1) / 50.0), rel=1e-3)


def test_an_end_beyond_the_motion_does_not_lengthen_the_exposure():
    """No light was collected after the shutter closed."""
    streak = measured_streak(100.0, 100.0, (0, EXPOSURE_NS // 2, int(1.2 * EXPOSURE_NS)), 1000.0, StreakFlag.DIRECTION_RESOLVED)
    assert exposed_time_s(streak, _header(), None) == (pytest.approx(EXPOSURE_NS * 1e-9, rel=1e-12), 0.0)


def test_before_the_direction_is_known_both_directions_are_in_the_error():
    row0, row1, t0, t1 = _brute_force(1000.0, 2000.0)
    streak = measured_streak(row0, row1, [10**18] * 3, 1e4, StreakFlag(0))
    seconds, error = exposed_time_s(streak, _header(), None)
    assert abs(seconds * (1.0 + error) - (t1 - t0)) < 2e-4 or abs(seconds * (1.0 - error) - (t1 - t0)) < 2e-4


def test_a_trail_cut_by_the_edge_has_a_magnitude_only_with_a_rate():
    streak = measured_streak(0.0, 300.0, [10**18] * 3, 1e4, StreakFlag.EDGE0 | StreakFlag.EDGE1)
    assert exposed_time_s(streak, _header(), None) is None
    assert exposed_time_s(streak, _header(), 0.04)[0] == 0.04
    zero_point = PhotometricSolution(
        frame=0, zero_point_mag=21.0, zero_point_err_mag=0.0, colour_term=0.0, n_stars=9, rms_mag=0.0
    )
    assert np.isnan(streak_magnitude(streak, _header(), zero_point, 1.0, None)[0])
    mag, _ = streak_magnitude(streak, _header(), zero_point, 1.0, 0.04)
    assert abs(mag - (21.0 - 2.5 * np.log10(1e4 / 0.04))) < 1e-9


@pytest.mark.parametrize("rows_per_s", [-20_000.0, -5_000.0, 5_000.0, 20_000.0])
def test_a_crosser_s_magnitude_follows_from_its_rate_under_a_rolling_shutter(rows_per_s):
    """Light of fine time steps of an object of magnitude 12 on those rows of 0 to 300 that are open when it passes."""
    t = np.arange(-0.5, 0.5, 1e-6)
    row = 150.0 + rows_per_s * (t - 0.1)
    opens = LINE_NS * 1e-9 * row
    lit = (t >= opens) & (t <= opens + EXPOSURE_NS * 1e-9) & (row >= 0.0) & (row <= 300.0)
    assert np.ptp(row[lit]) > 299.0
    rate_e_s, deg_px = 10.0 ** (-0.4 * (12.0 - 21.0)), 5.28 / 4096
    streak = measured_streak(0.0, 300.0, [10**18] * 3, rate_e_s * 1e-6 * lit.sum(), StreakFlag.EDGE0 | StreakFlag.EDGE1)
    streak = replace(streak, dec_deg=np.array([0.0, 150.0, 300.0]) * deg_px)
    zero_point = PhotometricSolution(
        frame=0, zero_point_mag=21.0, zero_point_err_mag=0.003, colour_term=0.0, n_stars=100, rms_mag=0.02
    )
    at_rate, error = magnitude_at_1deg_s(streak, _header(), zero_point, 1.0)
    rate_deg_s = abs(rows_per_s) * deg_px
    assert at_rate - 2.5 * np.log10(rate_deg_s) == pytest.approx(12.0, abs=0.002)
    assert 0.01 < error < 0.02
    # the same as for a tracklet that knows the rate
    known = streak_magnitude(streak, _header(), zero_point, 1.0, crossing_time_s(streak, rate_deg_s))
    assert known == pytest.approx((at_rate - 2.5 * np.log10(rate_deg_s), error))
    inside = replace(streak, flags=StreakFlag(0))
    assert np.isnan(magnitude_at_1deg_s(inside, _header(), zero_point, 1.0)).all()


@pytest.mark.parametrize(
    ("size_m", "range_km", "v_mag"),
    [
        (0.01, 50.0, 10.6),
        (0.01, 200.0, 13.6),
        (0.05, 500.0, 12.1),
        (0.1, 1000.0, 12.1),
        (0.1, 2000.0, 13.6),
        (1.0, 35786.0, 14.9),
    ],
)
def test_sizes_are_those_of_the_lambert_sphere_at_full_phase(size_m, range_km, v_mag):
    """Magnitudes of spheres of albedo 0.175 at full phase, to the 0.1 mag they are quoted with."""
    assert abs(2.5 * np.log10((diameter_m(v_mag, range_km, 0.175, 0.0) / size_m) ** 2)) < 0.1


def test_a_sphere_at_quadrature_is_as_bright_as_the_simulator_makes_it():
    flux = lambert_flux(0.02, 0.13, np.array([100.0, 0.0, 0.0]), np.zeros(3), np.array([0.0, AU_KM, 0.0]))
    assert diameter_m(float(-2.5 * np.log10(flux)), 100.0, 0.13, 0.5 * np.pi) == pytest.approx(0.02, rel=1e-3)


def test_robust_fit_ignores_outliers_and_keeps_priors():
    rng = np.random.default_rng(2)
    design = np.column_stack((np.ones(200), rng.normal(size=200), rng.normal(size=200)))
    value = design @ np.array([21.5, 0.3, 0.0]) + rng.normal(0.0, 0.02, 200)
    value[:20] += 0.7  # variable stars
    fit, covariance, rms, n_used = robust_linear_fit(
        design, value, np.full(200, 0.02), np.array([0.0, 0.25, 0.0]), np.array([np.inf, 0.1, 1e-6])
    )
    assert abs(fit[0] - 21.5) < 0.006
    assert abs(fit[1] - 0.3) < 0.006
    assert abs(fit[2]) < 1e-5
    assert n_used <= 182
    assert abs(rms - 0.02) < 0.004
    assert 0.0010 < np.sqrt(covariance[0, 0]) < 0.0022
