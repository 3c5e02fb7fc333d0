"""Joint refit of a tracklet: its input from the pixels of all frames, and its result as measurements."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ground.sky.measure import middle_of, redated
from ground.sky.rotation import turn
from ground.sky.shake_model import STEADY, EndShake
from ground.sky.sphere import ARCSEC_RAD, unit_vectors
from ground.straight_passage import ROBUST_ITERATIONS, StraightPassage, straight_passage
from ground.streaks.fit_record import edges_of, with_edge_flags
from ground.streaks.joint import JointRefit, refit_tracklet
from ground.streaks.joint_evidence import TrackletFrame, flux_between, has_change_points
from ground.streaks.joint_motion import AccelerationPrior, Motion, displacements
from ground.streaks.trail_frame import TrailFrame
from ground.trail_epochs import along_of, cut_end, edge_passed_s, timed_by_shutter, with_ends, with_middle_epoch
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.products import FrameSolution, StreakFit, StreakMeasurement, StreakPixels, Tracklet

Array = NDArray[np.float64]

UNUSABLE: Final = StreakFlag.NO_SKY | StreakFlag.POINT_LIKE | StreakFlag.FIT_FAILED | StreakFlag.FAST_ROWS
FLUX_AGREEMENT_SIGMAS: Final = 3.5
"""Of both errors together: a right frame in 2,000 is beyond it."""
OFF_MOTION_CHI2: Final = 25.0
"""Misfit of a frame's ends beyond which it does not belong to the joint motion: a right frame in 300,000 if they are Gaussian."""

OFF_MOTION_SIGMAS: Final = 3.5
"""A normal end in 2,000 is beyond it; the tails of change points reach farther, and such frames are left out, too."""
UNUSUAL_CHI2: Final = 12.0
"""Of two degrees of freedom, brightness and width: a usual frame in 400 is beyond it."""
SIGNIFICANT_SHIFT: Final = 2.0
"""Sigmas of the motion by which it must shift an end if it knows the place of that end less well than the single fit."""

LEAST_WIDTH_ERROR: Final = 0.03
"""Error of a width from what brightness and place in the frame do to the PSF, relative."""

TUMBLING: Final = 0.1
"""Largest relative change of brightness from frame to frame that counts as usual."""

NEIGHBOURS: Final = 7
"""Frames that the brightness of one is compared with, itself included."""

PARABOLA_ERROR: Final = 0.3
"""Largest departure of the motion from a straight passage, in units of the median error of an end (most 1 arcsec)."""

LEAST_END_VARIANCE_PX2: Final = 0.01
"""0.1 px: ends of bright trails err by the PSF's model, not by their noise. Chosen, not measured."""
SHORTEST_WINDOW: Final = 3
"""Frames: three places make an acceleration."""
GRAVITY_ARCSEC_S2: Final = 1.0
"""Change of rate by differential gravity, beyond that of a straight passage."""

OVERTAKING_RAD_S: Final = 2.0 * 7.6 / 500.0
"""Twice the speed in low orbit over a near range, 7.6 km/s over 500 km. An object on an orbit like the observer's, whose heading
differs by h, passes at 7.6 km/s * 2 sin(h/2)^2 over its range, if the observer looks across its own flight. Its velocity leans
towards the line of sight by c = cot(h/2), so that 1 + c^2 is this rate over that of the passage: the slower, the more."""

LEAST_APPROACH_PER_S: Final = 1e-4
"""Least rate, relative to the distance, at which the geometry of a passage changes."""


SharedErrors = dict[int, tuple[int, Array]]
"""By streak: number of the window that was fitted together, and (2, 3) the part of both ends' errors along the path that is
common to the streaks of the window, arcsec (`streaks.joint.JointRefit`)."""

CutErrors = dict[int, float]
"""By streak that the frame's edge cuts: error of its middle along the path, arcsec. Its epoch follows from the motion."""


class FramesRefit(NamedTuple):
    """Changed fits and common errors of the frames of a tracklet, and the motion of each changed one, by their numbers."""

    fits: dict[int, StreakFit]
    shared: SharedErrors
    motions: dict[int, Motion]
    passage: StraightPassage
    """That the motions are in."""


def refit_streaks(
    streaks: Sequence[StreakMeasurement],
    tracklet: Tracklet,
    headers: Sequence[FrameHeader],
    solution_of: Callable[[int], FrameSolution],
    pixels_of: Callable[[StreakMeasurement], StreakPixels],
    sigma_rate_of: Callable[[int], float],
    end_shake: EndShake = STEADY,
) -> tuple[tuple[StreakMeasurement, ...], SharedErrors, CutErrors]:
    """Refit the streaks of a tracklet together, and return them with their common errors and those of middles of cut ones.

    Streaks whose direction is not resolved are returned unchanged.

    streaks : with directions at their epochs. solution_of : of a frame, by its number; pixels_of : calibrated pixels of a streak;
    sigma_rate_of : error of the rate at which the camera turned in a frame, rad/s; end_shake : expected errors at the ends.
    Sky positions in the result are still those of the old fit. The caller measures them again.
    """
    header_of = {header.frame: header for header in headers}
    at = {streak.streak_id: k for k, streak in enumerate(streaks)}
    members = [streaks[at[int(i)]] for i in tracklet.streak_ids]
    # Two members in one frame are fragments of one trail. The shutter did not make their inner ends.
    often = Counter(m.frame for m in members)
    members = [m for m in members if m.flags & StreakFlag.DIRECTION_RESOLVED and not m.flags & UNUSABLE and often[m.frame] == 1]
    if len(members) < 2:
        return tuple(streaks), {}, {}
    # the ends follow from the steady light; that of flashes comes back at the end
    flash_e = {m.streak_id: m.fit.flash_e for m in members}
    members = [_without_flashes(timed_by_shutter(m, header_of[m.frame])) for m in members]
    path, zero_ns = _path_of(members), int(members[0].t_tai_ns[0])
    seen = [
        _tracklet_frame(
            m, header_of[m.frame], solution_of(m.frame), pixels_of(m), path, zero_ns, sigma_rate_of(m.frame), end_shake
        )
        for m in members
    ]
    joint, common, motions, passage = refit_frames(seen)
    shared = {members[k].streak_id: errors for k, errors in common.items()}
    cut: CutErrors = {}
    out = list(streaks)
    for k, member in enumerate(members):
        frame = seen[k]
        if (fit := joint.get(k, member.fit)) is not member.fit:
            line_ns = header_of[member.frame].line_time_ns
            row_mid, col_mid = middle_of(fit)
            shift_px = np.array([fit.row0, row_mid, fit.row1]) - np.array([member.fit.row0, member.row_mid, member.fit.row1])
            changed = StreakFlag.REFIT | StreakFlag.ENDS_NOT_GAUSSIAN | StreakFlag.EDGE0 | StreakFlag.EDGE1
            epochs = member.t_tai_ns + np.rint(line_ns * shift_px).astype(np.int64)
            frame = with_ends(frame, fit, epochs, zero_ns)
            if (end := cut_end(fit)) is not None:
                passed_s = edge_passed_s(frame, end, motions[k], passage, _turning_arcsec_s(member, 2 * end, path))
                epochs[2 * end] = zero_ns + round(passed_s * 1e9)
                frame = with_ends(frame, fit, epochs, zero_ns)
                cut[member.streak_id] = _middle_sigma(
                    frame, 0.5e-9 * float(epochs[0] + epochs[2] - 2 * zero_ns), motions[k], passage
                )
            member = replace(
                member,
                fit=replace(fit, flux_e=fit.flux_e + flash_e[member.streak_id], flash_e=flash_e[member.streak_id]),
                row_mid=row_mid,
                col_mid=col_mid,
                t_tai_ns=epochs,
                flags=member.flags & ~changed | fit.flags & changed,
            )
        else:
            member = streaks[at[member.streak_id]]
        out[at[member.streak_id]] = redated(member, with_middle_epoch(member.t_tai_ns, frame, passage))
    return tuple(out), shared, cut


def refit_frames(frames: Sequence[TrackletFrame]) -> FramesRefit:
    """The frames of a tracklet fitted together."""
    passage = _passage_of(frames)
    straight = [_straightened(frame, passage) for frame in frames]
    out = FramesRefit({}, {}, {}, passage)
    for number, (window, prior) in enumerate(_windows(frames, passage)):
        fits, common, motion = _refit_window(straight, window, prior)
        out.fits.update(fits)
        out.shared.update({k: (number, _along_path_again(frames[k], passage, errors)) for k, errors in common.items()})
        if motion is not None:
            out.motions.update(dict.fromkeys(fits, motion))
    return out


def _middle_sigma(frame: TrackletFrame, epoch_s: float, motion: Motion, passage: StraightPassage) -> float:
    """Error of the motion along the path at the middle of a trail, arcsec."""
    return motion.sigma(passage.time(epoch_s)) / passage.stretch(0.5 * (frame.along0 + frame.along1))


def _turning_arcsec_s(streak: StreakMeasurement, point: int, path: Array) -> float:
    """Rate at which one of the three points of a streak moves along the path as the camera turns."""
    seen = unit_vectors(np.radians(streak.ra_deg[point]), np.radians(streak.dec_deg[point]))[None]
    before, after = (_along_path(turn(seen, seconds * streak.turn_rad_s[None]), path)[0] for seconds in (-0.5, 0.5))
    return float(after - before)


def _without_flashes(member: StreakMeasurement) -> StreakMeasurement:
    """The streak without the light of its flashes."""
    fit = member.fit
    return replace(member, fit=replace(fit, flux_e=fit.flux_e - fit.flash_e, flash_e=0.0)) if fit.flash_e else member


def _passage_of(frames: Sequence[TrackletFrame]) -> StraightPassage:
    """The straight passage that most ends of single fits lie on."""
    ends = [end for frame in frames for end in _shutter_ends(frame)]
    t_s, along, sigma = (np.array([end[k] for end in ends]) for k in range(3))
    return straight_passage(t_s, along, sigma)


def _straightened(frame: TrackletFrame, passage: StraightPassage) -> TrackletFrame:
    """The frame in the time and the place in which the passage is uniform."""
    stretch = passage.stretch(0.5 * (frame.along0 + frame.along1))
    return replace(
        frame,
        along0=passage.place(frame.along0),
        along1=passage.place(frame.along1),
        along_per_px=frame.along_per_px * stretch,
        t_open_s=passage.time(frame.t_open_s),
        t_close_s=passage.time(frame.t_close_s),
        line_time_s=frame.line_time_s * passage.pace(0.5 * (frame.t_open_s + frame.t_close_s)),
        sigma_frame=frame.sigma_frame * stretch,
        sigma_turn=frame.sigma_turn * stretch,
        sigma_sway=frame.sigma_sway * stretch,
    )


def _along_path_again(frame: TrackletFrame, passage: StraightPassage, errors: Array) -> Array:
    """Errors (2, 3) of both ends in the tangent plane of the passage as errors along the path."""
    return errors / np.array([[passage.stretch(frame.along0)], [passage.stretch(frame.along1)]])


def _windows(frames: Sequence[TrackletFrame], passage: StraightPassage) -> list[tuple[list[int], AccelerationPrior]]:
    """Frames of a tracklet in stretches that a straight passage describes, and the prior of the change of rate in each.

    Differential gravity adds a constant change of the rate, which the fit follows. That change varies as the geometry does, which
    the fit does not follow: over +-h seconds the passage is off by the product of both and h^3.
    """
    t_s = np.array([[f.t_open_s, f.t_close_s] for f in frames])
    along = np.array([[f.along0, f.along1] for f in frames])
    span_s = float(t_s.max() - t_s.min())
    rate = max(float(np.ptp(along)) / max(span_s, 1e-6), 1e-3)
    # in the time of the passage a range that does not change shows as 2 w kappa
    leaning = float(np.sqrt(1.0 + OVERTAKING_RAD_S / (rate * ARCSEC_RAD)))
    prior = AccelerationPrior(2.0 * rate * passage.kappa_per_s, 2.0 * rate**2 * ARCSEC_RAD * leaning + GRAVITY_ARCSEC_S2)
    approach = float(np.hypot(rate * ARCSEC_RAD, passage.kappa_per_s)) + LEAST_APPROACH_PER_S
    errors = [sigma for frame in frames for _, _, sigma in _shutter_ends(frame)]
    error = min(PARABOLA_ERROR * float(np.median(errors)), 1.0) if errors else 1.0
    half_s = float(np.cbrt(error / (GRAVITY_ARCSEC_S2 * approach)))
    n_windows = max(1, min(int(np.ceil(span_s / (2.0 * half_s))), len(frames) // SHORTEST_WINDOW))
    return [(part.tolist(), prior) for part in np.array_split(np.arange(len(frames)), n_windows)]


def _shutter_ends(frame: TrackletFrame) -> list[tuple[float, float, float]]:
    """Epoch, place and one sigma along the path of each end of a single fit, without ends on the frame's edge."""
    unit, _ = along_of(frame.fit)
    covariance = np.asarray(frame.fit.covariance_px2)
    ends = ((StreakFlag.EDGE0, frame.t_open_s, frame.along0), (StreakFlag.EDGE1, frame.t_close_s, frame.along1))
    out = []
    for k, (flag, epoch, position) in enumerate(ends):
        if not frame.fit.flags & flag:
            variance = float(unit @ covariance[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] @ unit)
            out.append((epoch, position, float(np.sqrt(max(variance, LEAST_END_VARIANCE_PX2))) * frame.along_per_px))
    return out


def _refit_window(
    frames: Sequence[TrackletFrame], window: Sequence[int], prior: AccelerationPrior
) -> tuple[dict[int, StreakFit], dict[int, Array], Motion | None]:
    """Changed fits of the frames of one window, by their numbers; (2, 3) shared errors of those that the motion was fitted to;
    the motion."""
    members = [frames[k] for k in window]
    used, (fits, common, misfits, motion) = _refit_of_agreeing(members, prior)
    fitted = dict(zip(used, fits, strict=True))
    shared = dict(zip(used, common, strict=True))
    off = {k for k, misfit in zip(used, misfits, strict=True) if misfit > OFF_MOTION_CHI2}
    joint = {
        k: fit for k, fit in fitted.items() if fit.flags & StreakFlag.REFIT and k not in off and _same_light(members[k].fit, fit)
    }
    shared = {k: shared[k] for k in joint}
    if len(joint) >= 2 and motion is not None:
        for k, member in enumerate(members):
            if k not in joint:
                joint[k] = carried(member, motion)
                if joint[k] is not member.fit:
                    shared[k] = motion.errors(member)
    return {window[k]: fit for k, fit in joint.items()}, {window[k]: errors for k, errors in shared.items()}, motion


def _refit_of_agreeing(frames: Sequence[TrackletFrame], prior: AccelerationPrior) -> tuple[list[int], JointRefit]:
    """Joint fits of the frames that agree on one motion of one source, and their numbers.

    An unlisted star under or beside one trail would bend the common motion of all frames. Such a frame is recognised by its
    brightness and width, or by ends that the joint fit moves further than their errors allow.
    """
    usual = _usual([frame.fit for frame in frames]) & _on_one_motion(frames, prior)
    used = [int(k) for k in np.flatnonzero(usual)]
    while True:
        if len(used) < 2:
            return [], JointRefit((), np.zeros((0, 2, 3)), np.zeros(0), None)
        joint = refit_tracklet([frames[k] for k in used], prior=prior)
        if joint.misfit.max() <= OFF_MOTION_CHI2 or len(used) < 4:
            return used, joint
        used.pop(int(np.argmax(joint.misfit)))


def carried(frame: TrackletFrame, motion: Motion) -> StreakFit:
    """Fit of an outlying frame, with its ends placed by the motion of the other frames and with that motion's errors.

    An end that the motion puts beyond the frame's edge is on it. Ends that were there already, and the density of the light, do
    not change.
    """
    unit, length = along_of(frame.fit)
    displacement_px = displacements(frame, float(unit[0]), motion.mean[None, :], motion.zero_s)
    shifts, edges = _within_frame(frame, [float(shift[0]) for shift in displacement_px])
    if all(edges):
        return frame.fit
    free = ~np.array(edges)
    errors = motion.errors(frame) / frame.along_per_px * free[:, None]
    spread = errors @ errors.T + (frame.sigma_frame / frame.along_per_px) ** 2 * np.outer(free, free)
    sigma = np.sqrt(np.diag(spread))
    if not _worth_carrying(frame.fit, shifts, sigma):
        return frame.fit
    lit = length + shifts[1] - shifts[0]
    if lit < 0.2 * length or max(map(abs, shifts)) > length + 10.0:
        return frame.fit
    flux, flux_err = flux_between(frame, *shifts)
    if not flux > 0.0:
        return frame.fit
    across = np.array([-unit[1], unit[0]])
    keep = np.kron(np.eye(2), np.outer(across, across))
    covariance = keep @ np.asarray(frame.fit.covariance_px2) @ keep + np.kron(spread, np.outer(unit, unit))
    return replace(
        frame.fit,
        row0=frame.fit.row0 + shifts[0] * unit[0],
        col0=frame.fit.col0 + shifts[0] * unit[1],
        row1=frame.fit.row1 + shifts[1] * unit[0],
        col1=frame.fit.col1 + shifts[1] * unit[1],
        covariance_px2=covariance,
        end_interval_px=np.array([[-1.0, 1.0], [-1.0, 1.0]]) * sigma[:, None],
        flux_e=flux,
        flux_err_e=flux_err,
        flags=with_edge_flags(frame.fit.flags & ~StreakFlag.ENDS_NOT_GAUSSIAN | StreakFlag.REFIT, edges),
    )


def _within_frame(frame: TrackletFrame, shifts: Sequence[float]) -> tuple[list[float], tuple[bool, bool]]:
    """Shifts of both ends that leave them in the frame, px, and which ends lie on its edge; those that did already stay."""
    fit = frame.fit
    half = 0.5 * fit.length_px
    begin, stop = TrailFrame.of_chord(fit.row0, fit.col0, fit.row1, fit.col1).image_limits(frame.pixels.frame_shape)
    edge0, edge1 = edges_of(fit.flags)
    first = 0.0 if edge0 else max(shifts[0], begin + half)
    last = 0.0 if edge1 else min(shifts[1], stop - half)
    return [first, last], (edge0 or first <= begin + half, edge1 or last >= stop - half)


def _worth_carrying(single: StreakFit, shifts: Sequence[float], sigma: Array) -> bool:
    """Whether a motion knows the ends better than the single fit, or the single fit is clearly off it."""
    unit, _ = along_of(single)
    covariance = np.asarray(single.covariance_px2)
    own = np.sqrt([max(float(unit @ covariance[i : i + 2, i : i + 2] @ unit), LEAST_END_VARIANCE_PX2) for i in (0, 2)])
    return bool(np.all(sigma <= own) or np.any(np.abs(shifts) > SIGNIFICANT_SHIFT * sigma))


def _usual(fits: Sequence[StreakFit]) -> NDArray[np.bool_]:
    """Whether each fit's brightness per length agrees with the median of its neighbours, and its width with that of all.

    Range, phase and a slow rotation change the brightness over a tracklet by more than a star does in one frame.
    """
    density = np.array([fit.flux_e / max(fit.length_px, 1.0) for fit in fits])
    density_err = np.array([fit.flux_err_e / max(fit.length_px, 1.0) for fit in fits])
    width, width_err = np.array([fit.width_px for fit in fits]), np.array([fit.width_err_px for fit in fits])
    first = np.clip(np.arange(len(fits)) - NEIGHBOURS // 2, 0, max(len(fits) - NEIGHBOURS, 0))
    near = np.array([np.median(density[k : k + NEIGHBOURS]) for k in first])
    by_density = (density - near) / np.hypot(density_err, TUMBLING * near)
    by_width = (width - np.median(width)) / np.hypot(width_err, LEAST_WIDTH_ERROR * np.median(width))
    return np.asarray(by_density**2 + np.nan_to_num(by_width) ** 2 < UNUSUAL_CHI2)


def _on_one_motion(frames: Sequence[TrackletFrame], prior: AccelerationPrior) -> NDArray[np.bool_]:
    """Whether the ends of each single fit lie on the parabola that most ends lie on (Cauchy weights, iterated).

    Ends that are change points err by many of their sigmas. Their frames stay: the joint refit knows their likelihood.
    """
    ends = [(k, *end) for k, frame in enumerate(frames) for end in _shutter_ends(frame)]
    good = np.ones(len(frames), dtype=bool)
    if len(ends) < 6:
        return good
    owner, t, y, error = (np.array(column) for column in zip(*ends, strict=True))
    design = np.stack((np.ones_like(t), t - t.mean(), 0.5 * (t - t.mean()) ** 2), axis=1)
    information = np.diag([0.0, 0.0, prior.wide**-2])
    weight = np.ones_like(t)
    z = np.zeros_like(t)
    for _ in range(ROBUST_ITERATIONS):
        weighted = design * (weight / error**2)[:, None]
        motion = np.linalg.solve(weighted.T @ design + information, weighted.T @ y + information @ [0.0, 0.0, prior.usual])
        z = (y - design @ motion) / error
        weight = 1.0 / (1.0 + (z / 2.0) ** 2)
    np.logical_and.at(good, owner, np.abs(z) < OFF_MOTION_SIGMAS)
    return good | [has_change_points(frame) for frame in frames]


def _same_light(single: StreakFit, joint: StreakFit) -> bool:
    """Whether the joint fit has the flux of the single fit. A different flux means another source, such as a star on the
    track."""
    error = float(np.hypot(single.flux_err_e, joint.flux_err_e))
    return abs(joint.flux_e - single.flux_e) <= FLUX_AGREEMENT_SIGMAS * error


def _path_of(members: Sequence[StreakMeasurement]) -> Array:
    """Axes (3, 3) of the tracklet's great circle: its middle, along it in the sense of time, its pole."""
    ends = np.concatenate([unit_vectors(np.radians(m.ra_deg), np.radians(m.dec_deg)) for m in members])
    middle = ends.mean(axis=0)
    middle /= np.linalg.norm(middle)
    pole = np.linalg.svd(ends)[2][2]
    along = np.cross(pole, middle)
    along /= np.linalg.norm(along)
    if float(along @ (ends[-1] - ends[0])) < 0.0:
        along = -along
    return np.stack((middle, along, np.cross(middle, along)))


def _tracklet_frame(
    streak: StreakMeasurement,
    header: FrameHeader,
    solution: FrameSolution,
    pixels: StreakPixels,
    path: Array,
    zero_tai_ns: int,
    sigma_rate_rad_s: float,
    end_shake: EndShake,
) -> TrackletFrame:
    """One frame of the refit: coordinates along the path in arcsec, times in seconds from `zero_tai_ns`."""
    seen = unit_vectors(np.radians(streak.ra_deg), np.radians(streak.dec_deg))
    along = _along_path(seen, path)
    # The scale of a pixel is taken at one epoch, because the camera turned between the two ends.
    seconds = (streak.t_tai_ns[1] - streak.t_tai_ns) * 1e-9
    at_once = _along_path(turn(seen, np.outer(seconds, streak.turn_rad_s)), path)
    pointing = np.asarray(solution.covariance_rad2)
    turning = sigma_rate_rad_s / ARCSEC_RAD * 0.5 * abs(float(seconds[2] - seconds[0]))
    return TrackletFrame(
        pixels=pixels,
        fit=streak.fit,
        along0=float(along[0]),
        along1=float(along[2]),
        along_per_px=float(at_once[2] - at_once[0]) / max(streak.fit.length_px, 1e-6),
        t_open_s=float(streak.t_tai_ns[0] - zero_tai_ns) * 1e-9,
        t_close_s=float(streak.t_tai_ns[2] - zero_tai_ns) * 1e-9,
        line_time_s=header.line_time_ns * 1e-9,
        sigma_frame=float(np.sqrt(0.5 * max(pointing[0, 0] + pointing[1, 1], 0.0))) / ARCSEC_RAD,
        sigma_turn=end_shake.turn * turning,
        sigma_sway=end_shake.sway(streak.fit.length_px, pixels.psf_sigma_px) * turning,
    )


def _along_path(unit: Array, path: Array) -> Array:
    """Coordinates (n,) along the path of directions (n, 3), arcsec."""
    seen = unit @ path.T
    return np.asarray(np.arctan2(seen[:, 1], seen[:, 0]) / ARCSEC_RAD)
