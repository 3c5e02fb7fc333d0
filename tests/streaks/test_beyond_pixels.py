"""Light beyond the pixels that came down, and trails that leave the image: what the joint refit makes of them."""

import math
from dataclasses import replace

import numpy as np
import pytest

from ground.straight_passage import straight_passage
from ground.streaks import TrackletFrame, TrailedPsfFitter, refit_tracklet
from ground.streaks.beyond_pixels import log_stopped
from ground.streaks.fit_record import reversed_ends
from ground.streaks.joint_motion import AccelerationPrior, Motion
from ground.trail_epochs import edge_passed_s
from sboc_e2e.icd.flags import StreakFlag
from tests.streaks.test_joint_refit import EXPOSURE_S, PERIOD_S, along_errors
from tests.streaks.trail_rendering import expose, trail_at


@pytest.mark.parametrize("fall", [1.0, 3.0, 7.0])
def test_the_detector_stops_as_often_as_drawn_walks_do(fall: float) -> None:
    """20,000 sums of pixels of S/N 0.1, which add s^2 / 2 on average, over 300 to 3,000 of them.

    A walk that is looked at once a step passes later than a continuous one, as if the line were 0.5826 steps higher (Broadie,
    Glasserman & Kou 1997, Mathematical Finance 7, 325).
    """
    s, rng, walks = 0.1, np.random.default_rng(5), 20_000
    place, top = np.zeros(walks), np.full(walks, -np.inf)
    for px in range(1, 3001):
        place += rng.normal(0.5 * s * s, s, walks)
        top = np.maximum(top, place)
        if px in (300, 1000, 3000):
            seen = float(np.mean(top + 0.5826 * s < fall))
            told = math.exp(float(log_stopped(np.array(float(px)), np.array(fall), np.array(s * s))))
            assert seen == pytest.approx(told, abs=4.0 * math.sqrt(max(told, 1e-4) / walks) + 0.02 * told)


def test_the_motion_of_a_trail_that_leaves_the_image_reaches_the_edge() -> None:
    """Two frames of S/N 8, 300 px in an exposure. Of the first, on board cut out the last 170 px and the fit ends there; the
    second leaves the image after 270 px. The first alone says 170 px in an exposure, with which the edge is not reached.

    Ten tracklets. At shutter close their motions were 32 to 121 px short of the edge when its epoch was free, and middles of the
    second trails up to 3.8 of their errors behind. Now some are short by 17 px, and the middles are off by up to 1.7.
    """
    angle, length, pulls = 0.4, 300.0, []
    for seed in range(10):
        rng, fitter = np.random.default_rng([71, seed]), TrailedPsfFitter()
        frames, truths = [], []
        for k in range(2):
            t_s = k * PERIOD_S
            trail = trail_at(rng, length, angle_rad=angle)
            shot = expose(rng, trail, 8.0)
            pixels, detection, cos, sin = shot.pixels, shot.detection, math.cos(angle), math.sin(angle)
            u = (pixels.col - trail.col0) * cos + (pixels.row - trail.row0) * sin
            keep = u > 90.0 if k == 0 else u < 270.0
            shape = (4096, 4096) if k == 0 else (4096, int(trail.col0 + 270.0 * cos))
            keep &= pixels.col < shape[1]
            pixels = replace(
                pixels, row=pixels.row[keep], col=pixels.col[keep], value_e=pixels.value_e[keep],
                variance_e2=pixels.variance_e2[keep], frame_shape=shape,
            )  # fmt: skip
            lit = (130.0, length) if k == 0 else (0.0, 270.0)
            place = {"row0": trail.row0 + lit[0] * sin, "col0": trail.col0 + lit[0] * cos}
            place |= {"row1": trail.row0 + lit[1] * sin, "col1": trail.col0 + lit[1] * cos}
            flags = StreakFlag(0) if k == 0 else StreakFlag.EDGE1
            fit = fitter.fit(pixels, replace(detection, **place, flags=flags))
            if (fit.row1 - fit.row0) * sin + (fit.col1 - fit.col0) * cos < 0.0:
                fit = reversed_ends(fit)
            error = along_errors(trail, fit)
            begin = length / EXPOSURE_S * t_s
            frames.append(
                TrackletFrame(
                    pixels=pixels, fit=fit, along0=begin + error[0], along1=begin + length + error[1], along_per_px=1.0,
                    t_open_s=t_s, t_close_s=t_s + EXPOSURE_S, line_time_s=0.0,
                )
            )  # fmt: skip
            truths.append(trail)
        joint = refit_tracklet(frames, prior=AccelerationPrior(0.0, 170.0))
        assert joint.motion is not None
        cut = frames[1]
        assert cut.fit.flags & StreakFlag.EDGE1
        assert cut.along1 - joint.motion.at(cut.t_close_s)[0] < 30.0
        still = straight_passage(np.zeros(2), np.zeros(2), np.ones(2))
        passed_s = edge_passed_s(cut, 1, joint.motion, still, 0.0)
        middle_s = 0.5 * (cut.t_open_s + passed_s)
        pulls.append((joint.motion.at(middle_s)[0] - length / EXPOSURE_S * middle_s) / joint.motion.sigma(middle_s))
    assert np.abs(pulls).max() < 2.5


def test_the_edge_is_passed_when_the_motion_has_come_to_its_turning_pixel() -> None:
    """1,000 arcsec/s, changing by 200; the edge stands at 110 at shutter close, 0.2 s, and moves by 50 arcsec/s as the camera
    turns."""
    motion = Motion(np.array([0.0, 1000.0, 200.0]), np.zeros((3, 3)), 0.0)
    rng = np.random.default_rng(2)
    shot = expose(rng, trail_at(rng, 60.0), 20.0)
    fit = TrailedPsfFitter().fit(shot.pixels, shot.detection)
    frame = TrackletFrame(
        pixels=shot.pixels, fit=fit, along0=0.0, along1=110.0, along_per_px=1.0, t_open_s=0.0, t_close_s=0.2, line_time_s=0.0
    )
    still = straight_passage(np.zeros(2), np.zeros(2), np.ones(2))
    passed_s = edge_passed_s(frame, 1, motion, still, 50.0)
    # 1000 t + 100 t^2 = 110 + 50 (t - 0.2)
    assert passed_s == pytest.approx((-950.0 + math.sqrt(950.0**2 + 4.0 * 100.0 * 100.0)) / 200.0, abs=1e-6)
    assert edge_passed_s(frame, 1, Motion(np.array([0.0, 400.0]), np.zeros((2, 2)), 0.0), still, 0.0) == 0.2
