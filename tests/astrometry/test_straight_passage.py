"""A straight passage is one motion from its first frame to its last, however its rate changes."""

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from ground.refit import refit_frames
from ground.straight_passage import straight_passage
from ground.streaks import TrackletFrame, TrailedPsfFitter
from ground.streaks.fit_record import reversed_ends
from sboc_e2e.icd.flags import StreakFlag
from tests.streaks.trail_rendering import Trail, expose, trail_at

ARCSEC = math.radians(1.0 / 3600.0)
SCALE_ARCSEC, EXPOSURE_S, PERIOD_S = 4.64, 0.2, 0.25


def angle_arcsec(t_s: NDArray[np.float64], *, range_km: float, transverse_km_s: float, radial_km_s: float) -> NDArray[np.float64]:
    """Angle of a body that moves uniformly in a plane, from its place at t = 0."""
    return np.arctan2(transverse_km_s * t_s, range_km + radial_km_s * t_s) / ARCSEC


@pytest.mark.parametrize("radial_km_s", [-10.0, 0.0, 10.0])
def test_the_motion_is_uniform_in_the_time_of_the_passage(radial_km_s: float) -> None:
    """300 km, 10 km/s across: over 6 s a parabola of the angle is off by more than 1 arcsec, the passage by none."""
    t_s = np.linspace(0.0, 6.0, 48)
    along = angle_arcsec(t_s - 2.0, range_km=300.0, transverse_km_s=10.0, radial_km_s=radial_km_s)
    seen = along.copy()
    seen[[5, 30]] += (40.0, -60.0)  # stars at two ends
    passage = straight_passage(t_s, seen, np.full(48, 0.01))
    time = np.array([passage.time(t) for t in t_s])
    place = np.array([passage.place(a) for a in along])
    off = place - np.polynomial.Polynomial.fit(time, place, 1)(time)
    assert np.abs(off).max() < 0.1
    assert np.abs(along - np.polynomial.Polynomial.fit(t_s, along, 2)(t_s)).max() > 1.0
    np.testing.assert_allclose([passage.epoch(x) for x in time], t_s, atol=1e-9)
    step = 1e-4
    assert passage.pace(1.0) == pytest.approx((passage.time(1.0 + step) - passage.time(1.0 - step)) / (2.0 * step), rel=1e-6)
    assert passage.stretch(900.0) == pytest.approx(passage.place(900.5) - passage.place(899.5), rel=1e-6)


@pytest.mark.parametrize("radial_km_s", [-10.0, 0.0, 10.0])
def test_the_middle_of_a_trail_is_not_passed_in_the_middle_of_the_exposure(radial_km_s: float) -> None:
    """300 km, 10 km/s across, one second: the closed form is 6 to 60 arcsec from the middle of the ends; told to 0.05."""
    t_s = np.linspace(0.0, 6.0, 48)
    along = angle_arcsec(t_s - 2.0, range_km=300.0, transverse_km_s=10.0, radial_km_s=radial_km_s)
    passage = straight_passage(t_s, along, np.full(48, 0.01))
    away = []
    for start_s in (0.0, 2.5, 5.0):
        epochs = np.array([start_s, start_s + 0.5, start_s + 1.0])
        first, middle, last = angle_arcsec(epochs - 2.0, range_km=300.0, transverse_km_s=10.0, radial_km_s=radial_km_s)
        away.append(middle - 0.5 * (first + last))
        assert passage.ahead((start_s, start_s + 1.0), (first, last)) == pytest.approx(away[-1], abs=0.05)
    assert np.abs(away).max() > 5.0


def test_few_ends_give_no_change_of_range() -> None:
    passage = straight_passage(np.array([0.0, 0.2]), np.array([0.0, 900.0]), np.ones(2))
    assert passage.kappa_per_s == 0.0
    assert passage.time(0.1) == 0.0


def passing(rng: np.random.Generator, n_frames: int, snr: float) -> tuple[list[TrackletFrame], list[Trail]]:
    """Frames of an object that comes nearer, as the chain hands them over, and the true trails."""
    fitter, frames, truths = TrailedPsfFitter(), [], []
    turn = float(rng.uniform(-1.3, 1.3))
    for k in range(n_frames):
        t_s = k * PERIOD_S + np.array([0.0, EXPOSURE_S])
        along = angle_arcsec(t_s - 1.5, range_km=400.0, transverse_km_s=13.5, radial_km_s=-4.0)
        shot = expose(rng, trail_at(rng, float(np.diff(along)[0]) / SCALE_ARCSEC, angle_rad=turn), snr)
        fit, trail = fitter.fit(shot.pixels, shot.detection), shot.trail
        if (fit.row1 - fit.row0) * trail.axes[1] + (fit.col1 - fit.col0) * trail.axes[0] < 0.0:
            fit = reversed_ends(fit)
        off = _off_px(trail, fit)
        frames.append(
            TrackletFrame(
                pixels=shot.pixels, fit=fit, along0=along[0] + SCALE_ARCSEC * off[0], along1=along[1] + SCALE_ARCSEC * off[1],
                along_per_px=SCALE_ARCSEC, t_open_s=t_s[0], t_close_s=t_s[1], line_time_s=0.0,
            )
        )  # fmt: skip
        truths.append(trail)
    return frames, truths


def _off_px(trail: Trail, fit) -> NDArray[np.float64]:
    cos, sin = trail.axes
    first = (fit.row0 - trail.row0) * sin + (fit.col0 - trail.col0) * cos
    return np.array([first, (fit.row1 - trail.row1) * sin + (fit.col1 - trail.col1) * cos])


def test_a_star_at_one_end_near_the_end_of_a_tracklet_does_not_stay() -> None:
    """13 frames, S/N 34, 320 px; the eleventh fitted 7 px too long. In stretches of three frames its end stayed 7 to 9 px off in
    each of four tracklets, and the rms of all ends was 1.6 to 1.9 px; as one motion they are good to 0.7 and 0.6 px."""
    for seed in range(2):
        frames, truths = passing(np.random.default_rng([33, seed]), 13, 34.0)
        fit = frames[10].fit
        unit = np.array([fit.row1 - fit.row0, fit.col1 - fit.col0]) / fit.length_px
        late = replace(fit, row1=fit.row1 + 7.0 * unit[0], col1=fit.col1 + 7.0 * unit[1])
        frames[10] = replace(frames[10], fit=late, along1=frames[10].along1 + 7.0 * SCALE_ARCSEC)
        joint, shared, _, _ = refit_frames(frames)
        assert set(joint) == set(range(13))
        assert joint[10].flags & StreakFlag.REFIT
        assert np.abs(_off_px(truths[10], joint[10])).max() < 1.5
        assert np.sqrt(np.mean([np.square(_off_px(truths[k], joint[k])) for k in joint])) < 1.0
        assert len({number for number, _ in shared.values()}) == 1


def test_a_star_at_the_end_of_the_first_frame_does_not_stay() -> None:
    """Six frames, S/N 60; the motion of the other five reaches back to it."""
    frames, truths = passing(np.random.default_rng([34, 0]), 6, 60.0)
    fit = frames[0].fit
    unit = np.array([fit.row1 - fit.row0, fit.col1 - fit.col0]) / fit.length_px
    late = replace(fit, row0=fit.row0 - 8.0 * unit[0], col0=fit.col0 - 8.0 * unit[1])
    frames[0] = replace(frames[0], fit=late, along0=frames[0].along0 - 8.0 * SCALE_ARCSEC)
    joint, shared, _, _ = refit_frames(frames)
    assert np.abs(_off_px(truths[0], joint[0])).max() < 2.0
    assert set(shared) == set(range(6))
