"""Joint refit: the common motion of a tracklet pins the ends of its faint trails."""

import math
from dataclasses import replace

import numpy as np
import pytest

from ground.refit import OFF_MOTION_CHI2, refit_frames
from ground.streaks import TrackletFrame, TrailedPsfFitter, refit_tracklet
from ground.streaks.common_direction import common_turns
from ground.streaks.fit_record import reversed_ends
from ground.streaks.forced import END_LAW, forced_fit
from ground.streaks.joint_evidence import flux_between
from ground.streaks.joint_motion import AccelerationPrior
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.signals import Detection
from tests.streaks.trail_rendering import Trail, expose, render, trail_at

ARCSEC = math.pi / 648000.0
EXPOSURE_S = 0.2
PERIOD_S = 0.25


def tracklet(
    rng: np.random.Generator, length_px: float, snr: float, n_frames: int, line_time_s: float
) -> tuple[list[TrackletFrame], list[Trail]]:
    """Frames of one straight, uniform motion as the chain hands them over, and the true trails."""
    fitter = TrailedPsfFitter()
    angle, speed_px_s = float(rng.uniform(-1.3, 1.3)), length_px / EXPOSURE_S
    lit_px = length_px / (1.0 - speed_px_s * math.sin(angle) * line_time_s)
    frames, truths = [], []
    for k in range(n_frames):
        shot = expose(rng, trail_at(rng, lit_px, angle_rad=angle), snr)
        fit, trail, start_s = fitter.fit(shot.pixels, shot.detection), shot.trail, k * PERIOD_S
        cos, sin = trail.axes
        if (fit.row1 - fit.row0) * sin + (fit.col1 - fit.col0) * cos < 0.0:
            fit = reversed_ends(fit)
        origin = speed_px_s * (start_s + trail.row0 * line_time_s)
        along = [
            origin + (row - trail.row0) * sin + (col - trail.col0) * cos
            for row, col in ((fit.row0, fit.col0), (fit.row1, fit.col1))
        ]
        frames.append(
            TrackletFrame(
                pixels=shot.pixels,
                fit=fit,
                along0=along[0],
                along1=along[1],
                along_per_px=1.0,
                t_open_s=start_s + fit.row0 * line_time_s,
                t_close_s=start_s + EXPOSURE_S + fit.row1 * line_time_s,
                line_time_s=line_time_s,
            )
        )
        truths.append(trail)
    return frames, truths


def given_tracklet(
    rng: np.random.Generator, length_px: float, snr: float, n_frames: int
) -> tuple[list[TrackletFrame], list[Trail]]:
    """Frames of a motion that no single frame shows, with ends of an on-board track that is off by 2.5 times the law of ends."""
    angle, track_snr = float(rng.uniform(-1.3, 1.3)), snr * math.sqrt(n_frames)
    law = END_LAW * length_px / track_snr**2
    last_s = (n_frames - 1) * PERIOD_S + EXPOSURE_S
    first_px, last_px = np.clip(rng.normal(0.0, 2.5 * law, 2), -0.3 * length_px, 0.3 * length_px)
    frames, truths = [], []
    for k in range(n_frames):
        shot = expose(rng, trail_at(rng, length_px, angle_rad=angle), snr, margin_px=10.0 + 0.3 * length_px + 4.0 * law)
        trail, opened_s = shot.trail, k * PERIOD_S
        off = [first_px + (last_px - first_px) * t_s / last_s for t_s in (opened_s, opened_s + EXPOSURE_S)]
        guess = trail.moved(*off, *rng.normal(0.0, 0.3, 2), 0.0)
        ends = {"row0": guess.row0, "col0": guess.col0, "row1": guess.row1, "col1": guess.col1}
        fit = forced_fit(shot.pixels, Detection(**ends, snr=snr), track_snr)
        begin_px = length_px / EXPOSURE_S * opened_s
        error = along_errors(trail, fit)
        frames.append(
            TrackletFrame(
                pixels=shot.pixels,
                fit=fit,
                along0=begin_px + error[0],
                along1=begin_px + length_px + error[1],
                along_per_px=1.0,
                t_open_s=opened_s,
                t_close_s=opened_s + EXPOSURE_S,
                line_time_s=0.0,
            )
        )
        truths.append(trail)
    return frames, truths


def along_errors(trail: Trail, fit) -> np.ndarray:
    """(2,) px."""
    cos, sin = trail.axes
    return np.array(
        [
            (fit.row0 - trail.row0) * sin + (fit.col0 - trail.col0) * cos,
            (fit.row1 - trail.row1) * sin + (fit.col1 - trail.col1) * cos,
        ]
    )


@pytest.mark.parametrize("line_time_s", [0.0, 2e-4])
def test_faint_ends_become_several_times_better(line_time_s: float) -> None:
    """L = 60, S = 10, six frames: single frames 3 px, together below 1 px; errors as quoted; the shutter's rows accounted for."""
    single, joint, z, covered = [], [], [], []
    for seed in range(12):
        frames, truths = tracklet(np.random.default_rng([21, seed]), 60.0, 10.0, 6, line_time_s)
        for frame, trail, fit in zip(frames, truths, refit_tracklet(frames).fits, strict=True):
            assert StreakFlag.REFIT in fit.flags
            cos, sin = trail.axes
            direction = np.array([sin, cos])
            sigma = [math.sqrt(direction @ fit.covariance_px2[i : i + 2, i : i + 2] @ direction) for i in (0, 2)]
            error = along_errors(trail, fit)
            single.append(along_errors(trail, frame.fit))
            joint.append(error)
            z.append(error / sigma)
            outward = error * np.array([1.0, -1.0])
            covered.append((fit.end_interval_px[:, 0] <= outward) & (outward <= fit.end_interval_px[:, 1]))
    rms_single, rms_joint = (float(np.sqrt(np.mean(np.square(x)))) for x in (single, joint))
    assert rms_single > 2.0
    assert rms_joint < 0.4 * rms_single
    # 12 tracklets of two free numbers each: 24 independent errors, scatter of their rms 15 %
    assert 0.6 < float(np.sqrt(np.mean(np.square(z)))) < 1.5
    assert 0.4 < float(np.mean(covered)) < 0.9


@pytest.mark.parametrize(("length_px", "snr", "n_frames", "largest_px"), [(60.0, 4.5, 4, 30.0), (200.0, 5.5, 2, 120.0)])
def test_a_track_that_is_off_along_its_motion_makes_none_of_its_members_wrong(
    length_px: float, snr: float, n_frames: int, largest_px: float
) -> None:
    """All members are refitted, and middles along have the errors stated (rms of pulls 1.5 to 1.9 when members far from the joint
    motion were left as the track had them). None goes astray where ends may lie beyond the pixels."""
    pulls, errors = [], []
    for seed in range(40):
        frames, truths = given_tracklet(np.random.default_rng([31, seed, n_frames]), length_px, snr, n_frames)
        joint = refit_frames(frames).fits
        assert len(joint) == n_frames
        for k, trail in enumerate(truths):
            cos, sin = trail.axes
            half = 0.5 * np.tile([sin, cos], 2)
            errors.append(float(along_errors(trail, joint[k]).mean()))
            pulls.append(errors[-1] / math.sqrt(half @ joint[k].covariance_px2 @ half))
    # errors of one track are nearly one: 40 of them scatter by 11 %
    assert 0.65 < float(np.sqrt(np.mean(np.square(pulls)))) < 1.35
    assert np.abs(errors).max() < largest_px


def receding_tracklet(rng: np.random.Generator, length_px: float, snr: float, n_frames: int) -> tuple[list[TrackletFrame], float]:
    """Frames of an object that recedes at twice its speed across, 5 arcsec a pixel, and its rate in the middle, arcsec/s.

    Its path is that of a straight passage, x = w t / (1 + k t) about the middle with k = 2 w.
    """
    angle, scale = float(rng.uniform(-1.3, 1.3)), 5.0
    rate = scale * length_px / EXPOSURE_S
    middle_s = 0.5 * ((n_frames - 1) * PERIOD_S + EXPOSURE_S)
    frames = []
    for k in range(n_frames):
        opened_s = k * PERIOD_S
        begin, end = passage_arcsec(rate, np.array([opened_s, opened_s + EXPOSURE_S]) - middle_s)
        shot = expose(rng, trail_at(rng, float(end - begin) / scale, angle_rad=angle), snr)
        trail = shot.trail
        ends = {"row0": trail.row0, "col0": trail.col0, "row1": trail.row1, "col1": trail.col1}
        fit = forced_fit(shot.pixels, Detection(**ends, snr=snr), snr * math.sqrt(min(n_frames, 7)))
        error = along_errors(trail, fit)
        frames.append(
            TrackletFrame(
                pixels=shot.pixels, fit=fit, along0=begin + scale * error[0], along1=end + scale * error[1], along_per_px=scale,
                t_open_s=opened_s, t_close_s=opened_s + EXPOSURE_S, line_time_s=0.0,
            )
        )  # fmt: skip
    return frames, rate


def passage_arcsec(rate: float, t_s: np.ndarray) -> np.ndarray:
    """Angle along the path from the middle; the passage is straight in the tangent plane there."""
    across = rate * t_s * ARCSEC
    return np.arctan(across / (1.0 + 2.0 * rate * ARCSEC * t_s)) / ARCSEC


def test_changes_of_rate_of_slow_objects_that_all_recede_are_not_drawn_to_none() -> None:
    """450 arcsec/s, S/N 4.5: the pixels tell the change of rate to about 2 w^2. Sixteen that recede at twice their speed across
    have changes that are right in the mean of their errors; with directions at random as prior they were 0.7 too large."""
    z = []
    for seed in range(16):
        frames, rate = receding_tracklet(np.random.default_rng([34, seed]), 18.0, 4.5, 20)
        refit = refit_frames(frames)
        motion, passage = next(iter(refit.motions.values())), refit.passage
        t_s = np.linspace(frames[0].t_open_s, frames[-1].t_close_s, 41)
        place = [passage.place(x) for x in passage_arcsec(rate, t_s - 0.5 * (t_s[0] + t_s[-1]))]
        time = np.array([passage.time(t) for t in t_s]) - motion.zero_s
        true_change = 2.0 * np.polyfit(time, place, 2)[0]
        z.append((motion.mean[2] - true_change) / np.linalg.norm(motion.root[2]))
    # a mean of 16 errors of one sigma scatters by 0.25
    assert abs(np.mean(z)) < 0.6
    assert np.std(z) < 1.5


def test_a_member_that_noise_has_dimmed_keeps_the_error_of_its_light() -> None:
    """S/N 1 is left of it, and no density below that is tried: their spread alone would be an error of nothing."""
    frames, truths = given_tracklet(np.random.default_rng(33), 30.0, 4.5, 6)
    dimmed, trail = frames[2], truths[2]
    pixels = dimmed.pixels
    light = render(replace(trail, flux_e=dimmed.fit.flux_e), pixels.row, pixels.col)
    pixels = replace(pixels, value_e=pixels.value_e - 0.85 * light)
    ends = {name: getattr(dimmed.fit, name) for name in ("row0", "col0", "row1", "col1")}
    fit = forced_fit(pixels, Detection(**ends, snr=4.5), 4.5 * math.sqrt(6.0))
    assert 0.0 < fit.snr < 1.3
    frames[2] = replace(dimmed, pixels=pixels, fit=fit)
    joint = refit_frames(frames).fits
    assert all(joint[k].flux_err_e >= frame.fit.flux_err_e for k, frame in enumerate(frames))


def test_a_bright_window_keeps_its_motion_though_frames_may_be_spoilt() -> None:
    """L = 340, S = 64, three frames, one fitted 6 px too long with an error of 1 px: the peak of the motion is far narrower than
    the start is off. Ends lie within 5 px of the truth; they were off by 1e3 sigma when every frame could pass as spoilt."""
    for seed in range(4):
        frames, truths = tracklet(np.random.default_rng([64, seed]), 340.0, 64.0, 3, 1e-5)
        fit = frames[1].fit
        unit = np.array([fit.row1 - fit.row0, fit.col1 - fit.col0]) / fit.length_px
        late = replace(
            fit, row1=fit.row1 + 6.0 * unit[0], col1=fit.col1 + 6.0 * unit[1], flux_e=fit.flux_e * (1.0 + 6.0 / fit.length_px)
        )
        frames[1] = replace(frames[1], fit=late, along1=frames[1].along1 + 6.0)
        for trail, joint in zip(truths, refit_tracklet(frames, prior=AccelerationPrior(0.0, 170.0)).fits, strict=True):
            assert np.abs(along_errors(trail, joint)).max() < 5.0


def test_a_line_that_noise_turned_is_turned_back_unless_the_lines_really_differ() -> None:
    """Towards the mean of the others, by as much as its own error lets it; never by more than that."""
    rng = np.random.default_rng(8)
    frames, _ = tracklet(rng, 60.0, 12.0, 5, 0.0)
    fits = [frame.fit for frame in frames]
    angles = np.array([math.atan2(fit.row1 - fit.row0, fit.col1 - fit.col0) for fit in fits])
    turns = common_turns(fits)
    assert 0.0 < np.std(angles + turns) < 0.3 * np.std(angles)
    fanned = [replace(fit, row1=fit.row1 + 4.0 * k) for k, fit in enumerate(fits)]
    assert not common_turns(fanned).any()
    assert not common_turns(fits[:1]).any()
    failed = [replace(fits[0], flags=StreakFlag.FIT_FAILED), *fits[1:]]
    assert common_turns(failed)[0] == 0.0


def test_a_wrong_shutter_sign_would_be_seen() -> None:
    """With the line time's sign reversed the same frames contradict each other by many pixels."""
    frames, truths = tracklet(np.random.default_rng(22), 200.0, 40.0, 4, 2e-4)
    wrong = [
        replace(
            f,
            line_time_s=-f.line_time_s,
            t_open_s=f.t_open_s - 2.0 * f.fit.row0 * f.line_time_s,
            t_close_s=f.t_close_s - 2.0 * f.fit.row1 * f.line_time_s,
        )
        for f in frames
    ]
    good = np.abs([along_errors(t, f) for t, f in zip(truths, refit_tracklet(frames).fits, strict=True)]).max()
    bad = np.abs([along_errors(t, f) for t, f in zip(truths, refit_tracklet(wrong).fits, strict=True)]).max()
    assert good < 2.0
    assert bad > 5.0


def test_an_end_beyond_the_pixels_comes_from_the_other_frames() -> None:
    """The detector saw half of the middle trail and sent its pixels only; the fit ends there, the joint refit where it ended."""
    frames, truths = tracklet(np.random.default_rng(77), 200.0, 16.0, 5, 0.0)
    cut, trail = frames[2], truths[2]
    cos, sin = trail.axes
    u = (cut.pixels.row - trail.row0) * sin + (cut.pixels.col - trail.col0) * cos
    kept = u < 100.0
    columns = {name: getattr(cut.pixels, name)[kept] for name in ("row", "col", "value_e", "variance_e2")}
    # half of the trail is all that those pixels show
    half = (cut.fit.row0 + cut.fit.row1) / 2.0, (cut.fit.col0 + cut.fit.col1) / 2.0
    short = replace(cut.fit, row1=half[0], col1=half[1], flux_e=0.5 * cut.fit.flux_e, snr=cut.fit.snr / math.sqrt(2.0))
    frames[2] = replace(cut, pixels=replace(cut.pixels, **columns), fit=short, along1=0.5 * (cut.along0 + cut.along1))
    fit = refit_tracklet(frames).fits[2]
    assert np.abs(along_errors(trail, fit)).max() < 6.0


def test_light_between_other_ends_is_measured_there() -> None:
    """A fit that saw two thirds of a trail, a quarter too bright: its density does not hold for the rest."""
    frames, truths = tracklet(np.random.default_rng(78), 150.0, 40.0, 2, 0.0)
    frame, trail = frames[0], truths[0]
    fit = frame.fit
    third = (fit.row0 + 2.0 * fit.row1) / 3.0, (fit.col0 + 2.0 * fit.col1) / 3.0
    short = replace(fit, row1=third[0], col1=third[1], flux_e=1.25 * 2.0 / 3.0 * fit.flux_e)
    flux, error = flux_between(replace(frame, fit=short), 0.0, fit.length_px / 3.0)
    assert abs(flux - trail.flux_e) < 3.0 * error
    assert error < 0.04 * flux


@pytest.mark.parametrize("gradient", [0.0, 1.2])
def test_light_of_a_short_bright_trail_is_whole(gradient: float) -> None:
    """The PSF spreads both ends of 20 px over 4 % of the light, and a fit that ended early has the wrong gradient."""
    rng = np.random.default_rng(79)
    errors = []
    for _ in range(16):
        shot = expose(rng, trail_at(rng, 20.0, angle_rad=0.4, gradient=gradient), 200.0)
        fit = TrailedPsfFitter().fit(shot.pixels, shot.detection)
        frame = TrackletFrame(
            pixels=shot.pixels, fit=fit, along0=0.0, along1=20.0, along_per_px=1.0,
            t_open_s=0.0, t_close_s=EXPOSURE_S, line_time_s=0.0,
        )  # fmt: skip
        ends = along_errors(shot.trail, fit)
        flux, error = flux_between(frame, -float(ends[0]), -float(ends[1]))
        errors.append((flux - shot.trail.flux_e) / error)
    assert abs(np.mean(errors)) < 1.0


def test_frames_without_ends_come_back_as_they_went() -> None:
    """Edge-to-edge trails and failed fits say nothing; too few ends change nothing."""
    frames, _ = tracklet(np.random.default_rng(23), 80.0, 20.0, 3, 0.0)
    crossing = replace(frames[0], fit=replace(frames[0].fit, flags=StreakFlag.EDGE0 | StreakFlag.EDGE1))
    failed = replace(frames[1], fit=replace(frames[1].fit, flags=StreakFlag.FIT_FAILED))
    out = refit_tracklet([crossing, failed, frames[2]]).fits
    assert [fit is f.fit for fit, f in zip(out, [crossing, failed, frames[2]], strict=True)] == [True, True, True]
    out = refit_tracklet([crossing, *frames]).fits
    assert out[0] is crossing.fit
    assert [StreakFlag.REFIT in fit.flags for fit in out[1:]] == [True] * 3
    assert refit_tracklet([]).fits == ()


def test_a_trail_that_ended_beside_a_border_is_not_lengthened_to_it() -> None:
    """The last of five trails runs along a border at a small angle. Its fit took it for cut, and went on by 14 px."""
    frames, truths = tracklet(np.random.default_rng(41), 33.0, 12.0, 5, 0.0)
    last = frames[-1]
    cos, sin = truths[-1].axes
    longer = replace(
        last.fit, row1=last.fit.row1 + 14.0 * sin, col1=last.fit.col1 + 14.0 * cos, flags=last.fit.flags | StreakFlag.EDGE1
    )
    frames[-1] = replace(last, fit=longer, along1=last.along1 + 14.0)
    fit = refit_tracklet(frames).fits[-1]
    assert StreakFlag.EDGE1 not in fit.flags
    assert StreakFlag.REFIT in fit.flags
    assert np.abs(along_errors(truths[-1], fit)).max() < 1.5


def test_a_prior_on_the_acceleration_widens_the_errors_and_nothing_breaks() -> None:
    frames, truths = tracklet(np.random.default_rng(24), 60.0, 12.0, 5, 0.0)
    free, rigid = refit_tracklet(frames, prior=AccelerationPrior(0.0, 17.0)).fits, refit_tracklet(frames).fits
    for loose, stiff, trail in zip(free, rigid, truths, strict=True):
        assert np.trace(loose.covariance_px2) >= 0.99 * np.trace(stiff.covariance_px2)
        assert np.abs(along_errors(trail, loose)).max() < 6.0


def test_the_same_frames_give_the_same_bytes() -> None:
    frames, _ = tracklet(np.random.default_rng(25), 60.0, 12.0, 4, 0.0)
    a, b = refit_tracklet(frames).fits, refit_tracklet(frames).fits
    for one, two in zip(a, b, strict=True):
        assert (one.row0, one.col1, one.flux_e) == (two.row0, two.col1, two.flux_e)


def test_frames_of_one_faint_object_fit_one_motion_though_their_ends_lie_many_sigmas_off() -> None:
    """L = 60, S = 5: change points have tails. In sigmas some frames seem to belong elsewhere; by their likelihood none does."""
    misfit, by_sigmas = list[float](), list[float]()
    for seed in range(12):
        frames, _ = tracklet(np.random.default_rng([31, seed, 60]), 60.0, 5.0, 6, 0.0)
        joint = refit_tracklet(frames)
        misfit += list(joint.misfit)
        for frame, fit in zip(frames, joint.fits, strict=True):
            along = np.array([frame.fit.row1 - frame.fit.row0, frame.fit.col1 - frame.fit.col0]) / frame.fit.length_px
            shift = np.array(
                [[fit.row0 - frame.fit.row0, fit.col0 - frame.fit.col0], [fit.row1 - frame.fit.row1, fit.col1 - frame.fit.col1]]
            )
            variance = [along @ frame.fit.covariance_px2[i : i + 2, i : i + 2] @ along for i in (0, 2)]
            by_sigmas.append(float(np.sum((shift @ along) ** 2 / variance)))
    assert max(misfit) < OFF_MOTION_CHI2 < max(by_sigmas)


def test_a_frame_of_another_object_does_not_fit_the_motion() -> None:
    """Six bright frames, one of them 10 px ahead of the others."""
    frames, _ = tracklet(np.random.default_rng(32), 20.0, 100.0, 6, 0.0)
    frames[3] = replace(frames[3], along0=frames[3].along0 + 10.0, along1=frames[3].along1 + 10.0)
    misfit = refit_tracklet(frames).misfit
    assert int(np.argmax(misfit)) == 3
    assert misfit[3] > OFF_MOTION_CHI2
