"""On-board tracks that no single frame shows: published by their light, on board and on ground, and not by their line."""

from dataclasses import replace

import numpy as np
import pytest

from ground.link import MotionLinker
from ground.link.noise_tracks import joint_snr, log_odds_of_tracks, noise_per_frame
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
    """Joint S/N 8.4 on board; on ground 8.6, or 5.4. Both lie on one motion to a pixel, as foretold places do."""
    (seen,) = linked(4.3, 8.4)
    assert seen.probability > 0.9
    assert linked(2.7, 7.6) == ()


def test_the_odds_are_those_of_the_light_and_not_of_the_line() -> None:
    """Joint S/N 7.7 twice: noise makes such a track once in a few hundred frames."""
    (seen,) = linked(3.85, 7.7)
    expected = 1.0 / (1.0 + np.exp(-log_odds_of_tracks(np.array([7.7]), 10, WHOLE)[0]))
    assert seen.probability == pytest.approx(expected, abs=1e-6)
    assert 0.5 < seen.probability < 0.99


def test_a_streak_that_its_own_frame_shows_is_linked_as_others_are() -> None:
    """And where the S/N on board is not known."""
    assert linked(7.5, 14.0)[0].probability > 0.999
    assert linked(2.7, 0.0)[0].probability > 0.9


def test_the_more_objects_a_run_holds_the_more_a_faint_track_is_one() -> None:
    few = log_odds_of_tracks(np.array([7.5]), 24, WHOLE)[0]
    many = log_odds_of_tracks(np.array([7.5, *[12.0] * 9]), 24, WHOLE)
    assert many[0] == pytest.approx(few + np.log(9.5 / 0.5))
    assert (many[1:] > 20.0).all()


def test_noise_falls_as_a_gaussian_and_with_the_number_of_tracks_to_try() -> None:
    """Area times longest trail: a frame of half the side has an eighth of them."""
    snr = np.array([7.0, 7.5, 8.0])
    whole = noise_per_frame(snr, WHOLE)
    assert np.log(whole[:-1] / whole[1:]) == pytest.approx(0.5 * np.diff(snr**2))
    assert noise_per_frame(snr, (2048.0, 2048.0)) == pytest.approx(whole / 8.0)


def test_the_joint_snr_is_that_of_equal_shares_of_the_noise() -> None:
    assert joint_snr(np.array([3.0, 4.0, np.nan, 5.0])) == pytest.approx(6.0)
