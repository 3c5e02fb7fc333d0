"""A star that a slow mover hides is known from the frames in which it stood beside it."""

from dataclasses import replace

import numpy as np
import pytest

from ground.astrometry.camera import Camera
from ground.photometry.star_memory import EarlierStars, with_hidden_stars
from ground.sky.pixel_sky import mid_frame_pixels
from sboc_e2e.icd.downlink import DownlinkFrame
from sboc_e2e.icd.flags import FrameFlag, StreakFlag
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.products import FrameSolution
from sboc_e2e.icd.signals import Detection, RoiGroup, StarList
from tests.downlink import bare_frame

FOCAL_PX = 40_000.0
STAR = np.array([0.001, -0.002, 1.0])
"""Direction of the star; 40 px right of and 80 px above the axis."""


def solution(number: int, turn_rad: float) -> FrameSolution:
    """A camera of no distortion, turned about its row axis."""
    none = np.zeros(0)
    return FrameSolution(
        frame=number,
        flags=FrameFlag(0),
        quaternion=np.array([np.sin(0.5 * turn_rad), 0.0, 0.0, np.cos(0.5 * turn_rad)]),
        rate_rad_s=np.zeros(3),
        covariance_rad2=np.zeros((3, 3)),
        camera=Camera(focal_px=FOCAL_PX, center_row=500.0, center_col=500.0, k1=0.0, k2=0.0, p1=0.0, p2=0.0),
        n_stars=0,
        rms_px=0.0,
        star_index=none.astype(np.int32),
        star_v_mag=none.astype(np.float32),
        star_b_v=none.astype(np.float32),
        star_residual_px=np.zeros((0, 2), dtype=np.float32),
    )


def frame_of(number: int, mover: tuple[float, float], stars: np.ndarray) -> DownlinkFrame:
    """A frame with one point-like region and the stars (n, 2) sent with it."""
    row, col = mover
    detection = Detection(row0=row, col0=col, row1=row, col1=col, snr=50.0, flags=StreakFlag.POINT_LIKE)
    header = FrameHeader(frame=number, t_start_tai_ns=1 + number, exposure_ns=1, line_time_ns=0, rows=1000, cols=1000)
    sent = StarList(
        row=stars[:, 0],
        col=stars[:, 1],
        flux_e=np.full(len(stars), 200.0, dtype=np.float32),
        snr=np.full(len(stars), 15.0, dtype=np.float32),
        flags=np.zeros(len(stars), dtype=np.uint8),
    )
    return bare_frame(header, rois=(RoiGroup(roi_id=0, detection=detection, n_strips=0, strips=()),), remembered=sent)


def star_at(number: int) -> tuple[float, float]:
    """Where the star is in a frame; the camera turns by 7 px from frame to frame."""
    solved = solution(number, number * 7.0 / FOCAL_PX)
    row, col = mid_frame_pixels(solved, (STAR / np.linalg.norm(STAR))[None])
    return float(row[0]), float(col[0])


def passage(n: int) -> list[tuple[DownlinkFrame, tuple[float, float]]]:
    """A mover that goes over the star at 2 px per frame; the star is sent where it is farther than 3 px from the mover."""
    out = []
    for k in range(n):
        row, col = star_at(k)
        mover = (row, col - 8.0 + 2.0 * k)
        stars = np.array([[row, col]]) if abs(mover[1] - col) > 3.0 else np.zeros((0, 2))
        out.append((frame_of(k, mover, stars), (row, col)))
    return out


def test_a_hidden_star_comes_from_the_frames_before() -> None:
    memory: tuple[EarlierStars, ...] = ()
    seen = []
    for k, (frame, place) in enumerate(passage(9)):
        memory, filled = with_hidden_stars(memory, frame, solution(k, k * 7.0 / FOCAL_PX))
        assert len(filled.remembered) == 1
        assert (filled.remembered.row[0], filled.remembered.col[0]) == pytest.approx(place, abs=1e-3)
        assert filled.remembered.flux_e[0] == 200.0
        seen.append(len(frame.remembered))
    assert seen == [1, 1, 1, 0, 0, 0, 1, 1, 1]


def test_what_was_at_a_place_once_is_no_star() -> None:
    """The list of one frame may hold the mover itself."""
    (first, place), *_ = passage(1)
    memory, _ = with_hidden_stars((), first, solution(0, 0.0))
    again = frame_of(1, place, np.zeros((0, 2)))
    _, filled = with_hidden_stars(memory, again, solution(1, 0.0))
    assert filled is again


def test_without_a_solution_nothing_is_known() -> None:
    frame = frame_of(0, (500.0, 500.0), np.zeros((0, 2)))
    unsolved = replace(solution(0, 0.0), flags=FrameFlag.NO_SOLUTION)
    assert with_hidden_stars((), frame, unsolved) == ((), frame)
