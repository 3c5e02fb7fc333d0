"""Errors of magnitudes of faint frames of a track, against drawn fluxes."""

from dataclasses import replace

import numpy as np
import pytest

from ground.photometry.usual_light import with_errors_of_usual_light
from ground.photometry.zero_point import POGSON
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.products import StreakMeasurement
from tests.link.sky_scene import Camera, streak


def members(light: np.ndarray, error: float, track: int) -> list[StreakMeasurement]:
    """Streaks of these fluxes (n,) with normal errors of one size."""
    ends = np.array([[10.0, 10.0], [30.0, 40.0]])
    one = replace(streak(Camera(), 0, 0, ends, 0.3, 0.1, StreakFlag.DIRECTION_RESOLVED), track=track)
    return [replace(one, mag=float(-2.5 * np.log10(x)), mag_err=float(POGSON * error / x)) for x in light]


@pytest.mark.parametrize("snr", [3.5, 5.0, 7.0])
def test_magnitudes_of_faint_frames_err_as_stated(snr: float) -> None:
    """400 tracklets of eight frames whose light varies by 10 %: pulls 0.9 to 1.1, and magnitudes stay."""
    rng = np.random.default_rng(round(snr))
    pulls = []
    for _ in range(400):
        true = rng.normal(1.0, 0.1, 8)
        light = np.maximum(true + rng.normal(0.0, 1.0 / snr, 8), 0.05)
        before = members(light, 1.0 / snr, track=3)
        after = with_errors_of_usual_light(before)
        pulls += [(m.mag + 2.5 * np.log10(t)) / m.mag_err for m, t in zip(after, true, strict=True)]
        assert [m.mag for m in after] == [m.mag for m in before]
    assert np.sqrt(np.mean(np.square(pulls))) == pytest.approx(1.0, abs=0.1)


def test_errors_of_bright_frames_and_of_trails_of_no_track_stay() -> None:
    """S/N 100 in a track: to 1 %. Anything without a track: exactly."""
    light = np.array([1.0, 1.3, 0.8])
    bright = members(light, 0.01, track=3)
    assert [m.mag_err for m in with_errors_of_usual_light(bright)] == pytest.approx([m.mag_err for m in bright], rel=0.01)
    alone = members(light, 0.2, track=-1)
    assert with_errors_of_usual_light(alone) == alone
