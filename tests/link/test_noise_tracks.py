"""On-board tracks that no single frame shows: published by their light, on board and on ground, and not by their line."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from ground.link import MotionLinker
from ground.link.noise_tracks import MOST_FALSE, joint_snr, log_odds_of_tracks, noise_per_frame
from sboc_e2e.icd.products import Tracklet
from tests.link.sky_scene import Camera, observe, pixel_mover

WHOLE = (4096.0, 4096.0)


def linked(snr: float, track_snr: float) -> tuple[Tracklet, ...]:
    """Tracklets of one mover in four frames of ten, all of whose trails have one S/N."""
    camera = Camera()
    mover = pixel_mover(camera, 1000.0, 1000.0, 100.0, 280.0, t_s=0.3)
    headers, streaks, _ = observe(camera, [mover], 4, np.random.default_rng(2), sigma_along=2.0)
    headers += tuple(camera.header(frame) for frame in range(4, 10))
    tracked = [replace(s, track=4, track_snr=track_snr, fit=replace(s.fit, snr=snr)) for s in streaks]
    return MotionLinker().link(headers, tracked)


def test_a_track_that_ground_sees_as_bright_as_the_board_did_is_published_and_one_that_it_does_not_is_not() -> None:
    """Joint S/N 8.4 on board; on ground 8.4, or 5.0. Both lie on one motion to a pixel, as foretold places do."""
    (seen,) = linked(4.3, 8.4)
    assert seen.probability > 0.9
    assert linked(2.7, 7.6) == ()


def test_the_odds_are_those_of_the_light_and_not_of_the_line() -> None:
    (seen,) = linked(3.98, 7.7)
    odds = log_odds_of_tracks(np.array([0.5 * (7.7 + joint_snr(np.full(4, 3.98)))]), 10, WHOLE)[0]
    assert seen.probability == pytest.approx(1.0 / (1.0 + np.exp(-odds)), abs=1e-6)
    assert 0.5 < seen.probability < 0.95


def test_a_streak_that_its_own_frame_shows_is_linked_as_others_are() -> None:
    """And where the S/N on board is not known."""
    assert linked(7.5, 14.0)[0].probability > 0.999
    assert linked(2.7, 0.0)[0].probability > 0.9


def test_the_more_objects_a_run_holds_the_more_a_faint_track_is_one() -> None:
    few = log_odds_of_tracks(np.array([7.5]), 24, WHOLE)[0]
    many = log_odds_of_tracks(np.array([7.5, *[12.0] * 9]), 24, WHOLE)
    assert many[0] == pytest.approx(few + np.log(9.5 / 0.5))
    assert (many[1:] > 15.0).all()


def noise_above(snr: float, shape: tuple[float, float]) -> float:
    """Tracks of noise of an S/N and more in a frame, by summing over it."""
    step = 1e-3
    grid: NDArray[np.float64] = np.arange(snr, snr + 10.0, step)
    return float(noise_per_frame(grid, shape).sum() * step)


@pytest.mark.parametrize("side", [1024.0, 4096.0])
def test_no_more_noise_is_published_than_is_allowed_however_many_objects_there_are(side: float) -> None:
    """A frame of half the side has an eighth of the tracks to try."""
    shape, snr = (side, side), np.linspace(5.0, 9.0, 401)
    crowd = np.concatenate([snr, np.full(500, 20.0)])
    faintest = snr[np.isfinite(log_odds_of_tracks(crowd, 24, shape)[: len(snr)])].min()
    assert noise_above(float(faintest), shape) == pytest.approx(MOST_FALSE, rel=0.05)
    assert noise_per_frame(snr, shape) == pytest.approx((side / 4096.0) ** 3 * noise_per_frame(snr, WHOLE))


def test_the_joint_snr_is_that_of_equal_shares_of_the_noise() -> None:
    """Squares less one: the place across was free in each frame."""
    assert joint_snr(np.sqrt(np.array([10.0, 17.0, 26.0]))) == pytest.approx(12.0 / np.sqrt(3.0))
    assert joint_snr(np.array([np.nan, 0.5])) == 0.0
