"""Trails before a camera that rolls: the arc of a straight motion, against the path itself and the Coriolis formula."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ground.sky.bend import bent
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.products import StreakMeasurement
from tests.astrometry.test_slew_inside_frame import FOCAL_PX, POINTING, SIZE, header_of, solution_of
from tests.link.sky_scene import Camera, streak

ROLL_RAD_S = np.radians(3.6 / 60.0)
"""Once in an orbit of 100 minutes."""


@pytest.mark.parametrize("length_px", [60.0, 420.0])
@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_line_through_an_arc_is_put_back_onto_its_ends(length_px: float, sense: float) -> None:
    """1 s of roll, motion on a great circle: ends right to 0.005 px; the line's are two thirds of a sagitta off."""
    header = replace(header_of(), exposure_ns=10**9, line_time_ns=0)
    middle_ns = header.t_start_tai_ns + header.exposure_ns // 2

    def body(t_s: float) -> Rotation:
        return POINTING * Rotation.from_rotvec([0.0, 0.0, sense * ROLL_RAD_S * t_s])

    solution = solution_of(body, np.array([0.0, 0.0, sense * ROLL_RAD_S]))
    start = POINTING.apply([0.004, 0.003, 1.0])
    pole = POINTING.apply(np.cross([0.004, 0.003, 1.0], [0.6, 0.8, 0.0]))
    spin = pole / np.linalg.norm(pole) * length_px / FOCAL_PX
    t_s = np.linspace(-0.5, 0.5, 401)
    seen = np.array([body(t).inv().apply(Rotation.from_rotvec(spin * t).apply(start)) for t in t_s])
    path = 0.5 * (SIZE - 1) + FOCAL_PX * seen[:, [1, 0]] / seen[:, 2:]
    along = (path[-1] - path[0]) / np.linalg.norm(path[-1] - path[0])
    side = np.array([along[1], -along[0]])
    u, v = (path - path[0]) @ along, (path - path[0]) @ side
    line = np.polynomial.Polynomial.fit(u, v, 1)
    ends = np.array([path[0] + u[k] * along + line(u[k]) * side for k in (0, -1)])
    assert np.abs((ends - path[[0, -1]]) @ side).min() > 0.6 * ROLL_RAD_S * length_px / 4.0

    given = streak(Camera(), 0, 1, ends, 0.3, 0.1, StreakFlag.DIRECTION_RESOLVED)
    given = replace(given, t_tai_ns=middle_ns + np.array([-500_000_000, 0, 500_000_000]))
    made = bent(given, header, solution)
    found = np.array([[made.fit.row0, made.fit.col0], [made.fit.row1, made.fit.col1]])
    np.testing.assert_allclose(found, path[[0, -1]], atol=0.005)
    np.testing.assert_allclose([made.row_mid, made.col_mid], path[200], atol=0.005)
    assert abs(made.fit.sagitta_px) == pytest.approx(ROLL_RAD_S * length_px / 4.0, rel=0.03)


def test_a_camera_at_rest_bends_nothing() -> None:
    """No end moves by 1e-6 px."""
    given, header = _still()
    at_rest = bent(given, header, solution_of(lambda t_s: POINTING, np.zeros(3)))
    assert abs(at_rest.fit.row0 - given.fit.row0) < 1e-6


def test_an_arc_that_the_camera_shook_is_taken_back_to_its_line() -> None:
    """A fit that bends with the shake has its ends off the mean attitude by two thirds of the sagitta: 0.13 px of 0.2.

    The error of the sagitta leaves the ends with it; that of their distance and of the slope stays.
    """
    given, header = _still()
    side = np.array([400.0, -200.0]) / np.hypot(200.0, 400.0)
    sagitta, error, slope, line = 0.2, 0.03, 0.02, 0.01
    both, apart = np.tile(side, 2), np.concatenate([-side, side])
    covariance = (line**2 + (2.0 / 3.0 * error) ** 2) * np.outer(both, both) + slope**2 * np.outer(apart, apart)
    fit = replace(given.fit, sagitta_px=sagitta, sagitta_err_px=error, covariance_px2=covariance)
    arc = replace(given, fit=fit, row_mid=given.row_mid + sagitta * side[0], col_mid=given.col_mid + sagitta * side[1])
    made = bent(arc, header, solution_of(lambda t_s: POINTING, np.zeros(3)))
    np.testing.assert_allclose([made.fit.row0 - fit.row0, made.fit.col0 - fit.col0], 2.0 / 3.0 * sagitta * side, atol=1e-6)
    np.testing.assert_allclose(
        [made.row_mid - given.row_mid, made.col_mid - given.col_mid], 2.0 / 3.0 * sagitta * side, atol=1e-6
    )
    assert made.fit.sagitta_px == pytest.approx(0.0, abs=1e-6)
    want = line**2 * np.outer(both, both) + slope**2 * np.outer(apart, apart)
    np.testing.assert_allclose(made.fit.covariance_px2, want, atol=1e-9)


def test_a_bend_beyond_the_camera_s_is_taken_back_where_a_track_says_that_the_motion_is_straight() -> None:
    """A star bends a fit by 3 px: the member of an on-board track becomes its line, a trail of one frame stays as fitted."""
    given, header = _still()
    arc = replace(given, fit=replace(given.fit, sagitta_px=3.0, sagitta_err_px=0.5))
    at_rest = solution_of(lambda t_s: POINTING, np.zeros(3))
    assert bent(arc, header, at_rest) is arc
    made = bent(replace(arc, track=7), header, at_rest)
    assert made.fit.sagitta_px == pytest.approx(0.0, abs=1e-6)
    side = np.array([400.0, -200.0]) / np.hypot(200.0, 400.0)
    np.testing.assert_allclose([made.fit.row0 - given.fit.row0, made.fit.col0 - given.fit.col0], 2.0 * side, atol=1e-6)


def _still() -> tuple[StreakMeasurement, FrameHeader]:
    """A straight trail of one second."""
    header = replace(header_of(), exposure_ns=10**9, line_time_ns=0)
    ends = np.array([[1500.0, 1500.0], [1700.0, 1900.0]])
    given = streak(Camera(), 0, 1, ends, 0.3, 0.1, StreakFlag.DIRECTION_RESOLVED)
    return replace(given, t_tai_ns=header.t_start_tai_ns + np.array([0, 500_000_000, 10**9])), header
