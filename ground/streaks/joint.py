"""Joint refit of all frames of a tracklet: its common rate and the known epochs determine the ends along the track.

In one faint frame the ends are change points, good to 4.39 L / S^2. But all frames of a tracklet show one motion: two
numbers (where, how fast) or three (with a change of rate) fix the 2 n ends of n frames, because the epochs of shutter
open and close are known at every row. The frames' end likelihoods (`end_posterior.EndTables`), each as a function of
its two ends, are multiplied along this motion and integrated by importance sampling; every frame's ends and flux are
then the posterior means under the common motion.

For the caller (after linking): build one `TrackletFrame` for each streak, ends in time order (`reversed_ends`), and
call `refit_tracklet`; the refitted `StreakFit` of each frame comes back in the same order, flagged REFIT, with the errors
that all of them share. Only the along-track coordinate changes. Frames without information (edge to edge, failed) are returned
unchanged. Pointing errors common to a frame are not known here. Where they matter, give their along-track sigma as `sigma_frame`.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from ground.importance import Draws, Gaussian, Proposals, adapted
from ground.streaks import known_width
from ground.streaks.beyond_pixels import log_stopped
from ground.streaks.centre_line import LineFit, effective_width_px, uniform_trail
from ground.streaks.common_direction import common_turns
from ground.streaks.end_posterior import EndTables, end_tables, lit_length
from ground.streaks.end_search import COVERED_PX, coarse_ends
from ground.streaks.fit_record import pixel_covariance
from ground.streaks.forced import has_given_ends
from ground.streaks.intruders import intruder_mask
from ground.streaks.trail_fit import CHANGE_POINT_SNR2, OVERLAP_WIDTHS
from ground.streaks.trail_frame import TrailFrame
from ground.streaks.trail_model import N_PARAMETERS, Q1, SAGITTA, V_MID, profiles
from ground.streaks.trail_pixels import TrailPixels, usable_pixels
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.products import StreakFit, StreakPixels

LEAST_PIXELS: Final = 20
"""Fewer lit pixels give no brightness."""

LEAST_LIT: Final = 1e-3
"""Least light of a pixel, relative to the brightest pixel, that is used for the brightness of the trail."""

SPOILT: Final = 0.02
"""Share of faint trails whose ends tell nothing of the motion: a star below the list's limit lies at one of them. Measured as the
share that makes the true ends of 535 simulated trails most likely: 0.021 [0.008, 0.040] (95 %; three runs of `sso_antisun` and
five of `nadir_rotation`, S/N 6 to 60; 0.07 below S/N 10, 0.01 above)."""

REACH_OF_SPOILT: Final = 30.0
"""How far the motion may lie from that of all frames as they are, in its sigmas, when some frames are spoilt."""

REACH_OF_TRACK: Final = 6.0
"""How far the motion may lie from that of an on-board track, in the track's sigmas. The track is the most likely motion in whole
frames, while ends beyond the pixels that came down would be as likely as any. So wide that the same pixels hardly count twice.
In 50 tracks each of two frames of S/N 5.5 and three of 5, 200 px long, rms errors of a middle are 15 and 11 px; without it 190
and 170 px, because a few go astray."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TrackletFrame:
    """One frame of a tracklet.

    fit : ends in time order (end 0 where the exposure began). along0, along1 : coordinate along the tracklet's path of
    the fitted ends, in one unit for all frames (say arcsec along the great circle); along_per_px : its derivative along
    the trail, from end 0 to end 1 (positive). t_open_s, t_close_s : shutter open on the row of end 0 and shutter close
    on the row of end 1, from a common zero, also where these are the image's edge. line_time_s : signed. sigma_frame :
    pointing error along the path, in the same unit; sigma_turn, sigma_sway : of the attitude at shutter open and close
    about it, opposite at both ends and alike.
    """

    pixels: StreakPixels
    fit: StreakFit
    along0: float
    along1: float
    along_per_px: float
    t_open_s: float
    t_close_s: float
    line_time_s: float
    sigma_frame: float = 0.0
    sigma_turn: float = 0.0
    sigma_sway: float = 0.0


@dataclass(frozen=True, kw_only=True, eq=False)
class _Evidence:
    """Likelihood of a frame's ends, as displacements (px, along the trail) from the fitted ones.

    spoilt : log likelihood of ends that lie anywhere within reach of the pixels, whatever the motion, times their share.
    seen : whether the on-board detector, which chose the ends, saw what lies before the first pixel and behind the last one.
    """

    frame: TrackletFrame
    tables: EndTables | None
    seen: tuple[bool, bool]
    precision: NDArray[np.float64]
    rows_per_px: float
    spoilt: float


class AccelerationPrior(NamedTuple):
    """Prior of the change of rate, unit of `along` per s^2: Student's t with two degrees of freedom about the usual one.

    The change is 2 w^2 c for an object that passes at the rate w. c is the cotangent of the angle of its relative velocity with
    the line of sight. Directions at random give c the density (1 + c^2)^(-3/2) / 2.
    """

    usual: float
    scale: float

    @property
    def wide(self) -> float:
        """95 % lie within it."""
        return 3.0 * self.scale

    def log_density(self, change: NDArray[np.float64]) -> NDArray[np.float64]:
        """Log density but for a constant."""
        return np.asarray(-1.5 * np.log1p(((change - self.usual) / self.scale) ** 2))


class Motion(NamedTuple):
    """Common motion of a tracklet: posterior mean (p,) of its parameters at an epoch, and a root (p, p) of their covariance."""

    mean: NDArray[np.float64]
    root: NDArray[np.float64]
    zero_s: float

    def at(self, t_s: float) -> tuple[float, float]:
        """Place and rate at an epoch."""
        t = t_s - self.zero_s
        change = float(self.mean[2]) if len(self.mean) > 2 else 0.0
        return float(_basis(t, len(self.mean)) @ self.mean), float(self.mean[1]) + change * t

    def sigma(self, t_s: float) -> float:
        """Error of the place at an epoch."""
        return float(np.linalg.norm(_basis(t_s - self.zero_s, len(self.mean)) @ self.root))

    def errors(self, frame: TrackletFrame) -> NDArray[np.float64]:
        """(2, 3) errors of both ends of a frame, in the unit of `along`: their covariance is this times its transpose."""
        n = len(self.mean)
        out = np.zeros((2, 3))
        out[:, :n] = _basis(np.array([frame.t_open_s, frame.t_close_s]) - self.zero_s, n) @ self.root
        return out


class JointRefit(NamedTuple):
    """Refitted streaks, one for each frame in the same order, and the common part of their ends' errors along the path.

    shared : (n, 2, 3) in the unit of `along`: ends i and j have the covariance ``shared[i] @ shared[j]``, pointing apart. It is
    that of the motion: every end is a linear function of the motion. Zero for frames that came back as they were.
    misfit : (n,) twice the log likelihood that the motion's ends lose against the frame's own best ones: chi-square where ends
    are Gaussian, less where the light of a faint trail tells little of them. Zero for frames that came back as they were, and for
    ends that an on-board track gave: all of them shift together when the track was off, which makes none of them wrong.
    motion : None where nothing was fitted.
    """

    fits: tuple[StreakFit, ...]
    shared: NDArray[np.float64]
    misfit: NDArray[np.float64]
    motion: Motion | None


def refit_tracklet(frames: Sequence[TrackletFrame], *, prior: AccelerationPrior | None = None) -> JointRefit:
    """All frames of one motion fitted together.

    prior : of the change of rate; None for a constant rate.
    """
    shared, misfit = np.zeros((len(frames), 2, 3)), np.zeros(len(frames))
    unchanged = JointRefit(tuple(frame.fit for frame in frames), shared, misfit, None)
    n_given = sum(has_given_ends(frame.fit) for frame in frames)
    turns = common_turns([f.fit for f in frames])
    evidence = [_evidence(frame, turn, n_given) for frame, turn in zip(frames, turns, strict=True)]
    ends = sum(2 - _edge_count(e.frame.fit) for e in evidence if e is not None)
    if ends < 3:
        return unchanged
    used = [e for e in evidence if e is not None]
    zero = float(np.mean([0.5 * (e.frame.t_open_s + e.frame.t_close_s) for e in used]))
    start = _linear_start(used, zero, prior)
    if start is None:
        return unchanged
    motion, weight = _sample(used, zero, prior, *start)
    mean = np.asarray(weight @ motion, dtype=np.float64)
    scatter = motion - mean
    variance, axes = np.linalg.eigh((scatter * weight[:, None]).T @ scatter)
    common = Motion(mean, np.asarray(axes * np.sqrt(np.maximum(variance, 0.0))), zero)
    for k, e in enumerate(evidence):
        if e is not None:
            shared[k] = common.errors(e.frame)
            x0, x1 = _seen_displacements(e, mean[None, :], zero)
            if not has_given_ends(e.frame.fit):
                misfit[k] = 2.0 * (_best(e) - float(_of_ends(e, x0, x1)[0]))
    fits = (frame.fit if e is None else _refitted(e, motion, weight, zero) for frame, e in zip(frames, evidence, strict=True))
    return JointRefit(tuple(fits), shared, misfit, common)


def _edge_count(fit: StreakFit) -> int:
    """Ends that are the image's edge."""
    return int(StreakFlag.EDGE0 in fit.flags) + int(StreakFlag.EDGE1 in fit.flags)


def _evidence(frame: TrackletFrame, turn_rad: float, n_given: int) -> _Evidence | None:
    """End likelihood of a frame along its line, turned by this about its middle; None where it has no end or no fit.

    n_given : frames with given ends. Their motion is one, of two numbers: each frame has its share of what is known of it.
    """
    fit = frame.fit
    length = fit.length_px
    if StreakFlag.FIT_FAILED in fit.flags or _edge_count(fit) == 2 or not frame.along_per_px > 0.0:
        return None
    if StreakFlag.POINT_LIKE in fit.flags or length < 1.0:
        return None
    trail = TrailFrame.of_chord(fit.row0, fit.col0, fit.row1, fit.col1)
    along = np.array([trail.sin, trail.cos])
    covariance = np.array(
        [[along @ fit.covariance_px2[2 * i : 2 * i + 2, 2 * j : 2 * j + 2] @ along for j in range(2)] for i in range(2)]
    )
    turn, sway = frame.sigma_turn / frame.along_per_px, frame.sigma_sway / frame.along_per_px
    if has_given_ends(fit):
        covariance *= max(0.5 * n_given, 1.0)
    covariance += sway**2 + turn**2 * np.array([[1.0, -1.0], [-1.0, 1.0]])
    free = [StreakFlag.EDGE0 not in fit.flags, StreakFlag.EDGE1 not in fit.flags]
    precision = np.zeros((2, 2))
    index = np.flatnonzero(free)
    precision[np.ix_(index, index)] = np.linalg.inv(covariance[np.ix_(index, index)])
    turned = trail.turned(0.0, 0.0, turn_rad)
    tables = _tables(frame, turned) if has_change_points(frame) else None
    seen = (False, False) if tables is None or has_given_ends(fit) else _seen_beyond(tables, turned, frame)
    spoilt = -math.inf if tables is None else math.log(SPOILT) + _mean(tables, free)
    return _Evidence(frame=frame, tables=tables, seen=seen, precision=precision, rows_per_px=trail.sin, spoilt=spoilt)


def has_change_points(frame: TrackletFrame) -> bool:
    """Whether the ends of a trail are change points, so that a sigma says little of how far off they may be."""
    width, length = effective_width_px(frame.pixels.psf_sigma_px), frame.fit.length_px
    return frame.fit.snr**2 < 3.0 * CHANGE_POINT_SNR2 * length / width and length > OVERLAP_WIDTHS * width


def _mean(tables: EndTables, free: Sequence[bool]) -> float:
    """Log of the mean likelihood over the places of both ends that are not the image's edge, summed over densities."""
    log0 = tables.log0 if free[0] else tables.log0[:, :1]
    log1 = tables.log1 if free[1] else tables.log1[:, -1:]
    sides = (np.logaddexp.reduce(log, axis=1) - math.log(log.shape[1]) for log in (log0, log1))
    return float(np.logaddexp.reduce(sum(sides)))


def _tables(frame: TrackletFrame, trail: TrailFrame) -> EndTables | None:
    """`end_tables` along a line near the fit's, with u from the middle of its chord."""
    near, template, width = _lit_pixels(frame, trail, frame.fit.gradient)
    half, density, edges = _segment(frame.fit)
    coarse = coarse_ends(
        near.u, template, near.value_e, near.variance_e2,
        guess=(-half, half, density), edges=edges, image_limits=trail.image_limits(frame.pixels.frame_shape),
    )  # fmt: skip
    if coarse is None or coarse.edges != edges:
        return None
    coarse = replace(coarse, density_e_px=density, edges=(False, False))
    tables = end_tables(near.u, template, near.value_e, near.variance_e2, width_px=width, coarse=coarse)
    # of a track, the reach says what is known of places beyond the pixels
    return replace(tables, snr2_per_px=np.zeros_like(tables.densities)) if has_given_ends(frame.fit) else tables


def _seen_beyond(tables: EndTables, trail: TrailFrame, frame: TrackletFrame) -> tuple[bool, bool]:
    """Whether the image goes on before the first node and behind the last one."""
    low, high = trail.image_limits(frame.pixels.frame_shape)
    return bool(tables.grid0[0] - low > COVERED_PX), bool(high - tables.grid1[-1] > COVERED_PX)


def _segment(fit: StreakFit) -> tuple[float, float, tuple[bool, bool]]:
    """Half length, density and which ends are the image's edge."""
    half = 0.5 * fit.length_px
    return half, fit.flux_e / (2.0 * half), (StreakFlag.EDGE0 in fit.flags, StreakFlag.EDGE1 in fit.flags)


def _lit_pixels(frame: TrackletFrame, trail: TrailFrame, gradient: float) -> tuple[TrailPixels, NDArray[np.float64], float]:
    """Pixels near the fit's line without intruders, electrons per unit density of each when fully lit, width of the profile.

    gradient : of the brightness, relative change from end to end.
    """
    fit, pixels = frame.fit, frame.pixels
    width = effective_width_px(pixels.psf_sigma_px)
    if abs(fit.width_px - pixels.psf_sigma_px) > 4.0 * fit.width_err_px and fit.width_px > 0.0:
        width = effective_width_px(fit.width_px)
    half, density, edges = _segment(fit)
    near = usable_pixels(pixels, trail, 5.0 * width + abs(fit.sagitta_px)).near(math.inf)
    parameters = uniform_trail(density, half, edges, width)
    parameters[SAGITTA], parameters[V_MID], parameters[Q1] = fit.sagitta_px, 2.0 / 3.0 * fit.sagitta_px, 0.5 * fit.gradient
    near = _without_intruders(near, parameters, fit, width).near(2.7 * width + abs(fit.sagitta_px))
    parameters[Q1] = 0.5 * gradient
    return near, profiles(parameters, near.u, near.v, half, trail.angle_rad), width


def flux_between(frame: TrackletFrame, shift0: float, shift1: float) -> tuple[float, float]:
    """Flux and error of a frame's trail whose ends lie by these px along the trail from the fitted ones.

    A fit with other ends counted other pixels as lit, so its density is not that of the trail.
    """
    fit = frame.fit
    near, template, width = _lit_pixels(frame, TrailFrame.of_chord(fit.row0, fit.col0, fit.row1, fit.col1), gradient=0.0)
    half, density, edges = _segment(fit)
    end0, end1 = shift0 - half, half + shift1
    length = end1 - end0
    # the PSF spreads each end over its neighbours
    share0 = 1.0 if edges[0] else ndtr((near.u - end0) / width)
    share1 = 1.0 if edges[1] else ndtr((end1 - near.u) / width)
    template = template * np.clip(share0 + share1 - 1.0, 0.0, 1.0)
    lit = template > LEAST_LIT * template.max(initial=0.0)
    if np.count_nonzero(lit) < LEAST_PIXELS:
        return density * length, fit.flux_err_e * length / (2.0 * half)
    template, value, variance = template[lit], near.value_e[lit], near.variance_e2[lit]
    # polynomials that add no light between the ends: how the brightness changes along the trail does not touch the flux
    x = (2.0 * near.u[lit] - end0 - end1) / length
    shapes = [np.ones_like(x), x, x * x - 1.0 / 3.0] if StreakFlag.VARIABLE in fit.flags else [np.ones_like(x)]
    columns = template * np.stack(shapes)
    weighted = columns / (variance + density * template)
    covariance = np.linalg.pinv(weighted @ columns.T, rcond=1e-9, hermitian=True)
    found = float(covariance[0] @ (weighted @ value))
    return found * length, math.hypot(math.sqrt(covariance[0, 0]), found * _width_error(frame)) * length


def _without_intruders(pixels: TrailPixels, parameters: NDArray[np.float64], fit: StreakFit, width_px: float) -> TrailPixels:
    """Pixels by ascending u without the stars and crossing streaks that the single fit left out too."""
    if pixels.u.size == 0:
        return pixels
    errors = np.sqrt(np.maximum([0.5 * np.trace(fit.covariance_px2[i : i + 2, i : i + 2]) for i in (0, 2)], 0.0))
    line = LineFit(
        pixels=pixels,
        parameters=parameters,
        covariance=np.zeros((N_PARAMETERS, N_PARAMETERS)),
        half_px=0.5 * fit.length_px,
        blur_px=(float(errors[0]), float(errors[1])),
        free=(),
        chi2=math.nan,
        snr=fit.snr,
        n_pixels=pixels.u.size,
    )
    mask, _ = intruder_mask(line, width_px, line.blur_px, ends_given=has_given_ends(fit))
    return pixels.take(~mask)


def _basis(t_s: NDArray[np.float64] | float, n_parameters: int) -> NDArray[np.float64]:
    """(1, t, t^2 / 2) truncated to the parameters of the motion, stacked on the last axis."""
    t = np.asarray(t_s, dtype=np.float64)
    return np.stack([np.ones_like(t), t, 0.5 * t * t][:n_parameters], axis=-1)


def _linear_start(
    used: list[_Evidence], zero_s: float, prior: AccelerationPrior | None
) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Weighted least squares on the fitted ends: (parameters, covariance) of the motion."""
    n = 2 if prior is None else 3
    normal, right = np.zeros((n, n)), np.zeros(n)
    if prior is not None:
        normal[2, 2] = prior.wide**-2
        right[2] = normal[2, 2] * prior.usual
    for e in used:
        f = e.frame
        basis = _basis(np.array([f.t_open_s - zero_s, f.t_close_s - zero_s]), n)
        spread = e.precision / f.along_per_px**2
        normal += basis.T @ spread @ basis
        right += basis.T @ spread @ np.array([f.along0, f.along1])
    if np.linalg.matrix_rank(normal) < n:
        return None
    covariance = np.asarray(np.linalg.inv(normal), dtype=np.float64)
    return covariance @ right, covariance


def displacements(
    frame: TrackletFrame, rows_per_px: float, motion: NDArray[np.float64], zero_s: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Displacements (m,) of both ends by a motion (m, p), px along the trail from the fitted ones.

    An end that moves by x px lies ``x * rows_per_px`` rows further on and is exposed that many line times later:
    along + along_per_px x = a(t + c x), c = rows_per_px * line_time; linear in x but for the acceleration over c x.
    """
    n = motion.shape[1]
    delay = rows_per_px * frame.line_time_s
    out = []
    for along, t_s in ((frame.along0, frame.t_open_s - zero_s), (frame.along1, frame.t_close_s - zero_s)):
        rate = motion[:, 1] + (motion[:, 2] * t_s if n == 3 else 0.0)
        out.append((motion @ _basis(t_s, n) - along) / (frame.along_per_px - rate * delay))
    return out[0], out[1]


def _seen_displacements(
    e: _Evidence, motion: NDArray[np.float64], zero_s: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """`displacements` of what the image shows: a trail that the shutter would end beyond the image's edge ends on the edge.

    A motion too slow to have reached the edge ends the trail inside, where the pixels have light.
    """
    x0, x1 = displacements(e.frame, e.rows_per_px, motion, zero_s)
    flags = e.frame.fit.flags
    return np.maximum(x0, 0.0) if flags & StreakFlag.EDGE0 else x0, np.minimum(x1, 0.0) if flags & StreakFlag.EDGE1 else x1


def _log_likelihood(e: _Evidence, x0: NDArray[np.float64], x1: NDArray[np.float64]) -> NDArray[np.float64]:
    """(m,) log likelihood of motions that put the ends there: of ends that show the motion, or of spoilt ones."""
    return np.asarray(np.logaddexp(math.log1p(-SPOILT) + _of_ends(e, x0, x1), e.spoilt))


def _of_ends(e: _Evidence, x0: NDArray[np.float64], x1: NDArray[np.float64]) -> NDArray[np.float64]:
    """(m,) log likelihood of end displacements."""
    if e.tables is None:
        x = np.stack([x0, x1], axis=1)
        quadratic: NDArray[np.float64] = -0.5 * np.einsum("mi,ij,mj->m", x, e.precision, x)
        return quadratic
    half = 0.5 * e.frame.fit.length_px
    log = _per_density(e.tables, e.seen, x0 - half, x1 + half)
    top = log.max(axis=0)
    return np.asarray(top + np.log(np.exp(log - top).sum(axis=0)))


def _best(e: _Evidence) -> float:
    """Largest log likelihood of any ends and any density."""
    return 0.0 if e.tables is None else float((e.tables.log0.max(axis=1) + e.tables.log1.max(axis=1)).max())


def _per_density(
    tables: EndTables, seen: tuple[bool, bool], end0: NDArray[np.float64], end1: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(K, m) log likelihood of both ends (u, px) and density.

    Beyond the tables it falls off steadily; beyond the pixels as far as the on-board detector has `seen` what is there.
    """
    total = np.zeros((tables.densities.size, end0.size))
    for grid, log, position, border, is_open, was_seen in (
        (tables.grid0, tables.log0, end0, 0, tables.open0, seen[0]),
        (tables.grid1, tables.log1, end1, -1, tables.open1, seen[1]),
    ):
        step = grid[1] - grid[0]
        place = np.clip((position - grid[0]) / step, 0.0, grid.size - 1.000001)
        left = place.astype(np.int64)
        share = place - left
        total += log[:, left] * (1.0 - share) + log[:, left + 1] * share
        inward, outward = position - grid[-1], grid[0] - position
        if border == -1:
            inward, outward = outward, inward
        steady = inward if is_open else np.maximum(inward, outward)
        total -= np.maximum(steady, 0.0) / (4.0 * step)
        out = np.flatnonzero(outward > 0.0)
        if is_open and was_seen:
            fall = log.max(axis=1) - log[:, border]
            total[:, out] += log_stopped(outward[out], fall[:, None], tables.snr2_per_px[:, None])
    return total


def _sample(
    used: list[_Evidence],
    zero_s: float,
    prior: AccelerationPrior | None,
    center: NDArray[np.float64],
    covariance: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Draws (m, p) of the motion and their weights (m,), by adaptive importance sampling with a Student-t proposal.

    First with the ends of all frames as they are: their likelihoods slope towards the motion from anywhere. A share of spoilt
    frames is flat where the motion is not, so draws that miss a narrow peak would not find it. It comes second, about the motion
    that was found. This keeps the posterior proper: if all frames were spoilt, any motion would do.
    """
    proposals = Proposals.of(center.size)
    on_track = any(has_given_ends(e.frame.fit) for e in used)
    track = (center, covariance * REACH_OF_TRACK**2) if on_track else None
    first = _adapted(proposals, used, zero_s, prior, (center, covariance), track, _of_ends)
    if all(e.spoilt == -math.inf for e in used):
        return first.points, first.weight
    found, spread = first.mean, first.covariance
    about = track or (found, spread * REACH_OF_SPOILT**2)
    second = _adapted(proposals, used, zero_s, prior, (found, spread + covariance), about, _log_likelihood)
    return second.points, second.weight


def _adapted(
    proposals: Proposals,
    used: list[_Evidence],
    zero_s: float,
    prior: AccelerationPrior | None,
    start: Gaussian,
    about: Gaussian | None,
    likelihood: Callable[[_Evidence, NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]],
) -> Draws:
    """Draws of the motion.

    likelihood : of the ends of a frame. about : normal prior of the motion, mean and covariance.
    """

    slowest = 1e-3 * abs(float(start[0][1])) + 1e-12

    def log_density(motion: NDArray[np.float64]) -> NDArray[np.float64]:
        # even in the logarithm of the rate, as single trails are in that of their length: faster ones are not all as likely
        rate = motion[:, 1]
        total = np.where(rate > slowest, -np.log(np.maximum(rate, slowest)), -1e3)
        if prior is not None:
            total += prior.log_density(motion[:, 2])
        if about is not None:
            off = np.linalg.solve(np.linalg.cholesky(about[1]), (motion - about[0]).T)
            total -= 0.5 * np.sum(off**2, axis=0)
        for e in used:
            total += likelihood(e, *_seen_displacements(e, motion, zero_s))
        return total

    return adapted(proposals, start, log_density)


def _quantile(values: NDArray[np.float64], weight: NDArray[np.float64], levels: tuple[float, float]) -> tuple[float, float]:
    """Weighted quantiles."""
    order = np.argsort(values)
    total = np.cumsum(weight[order])
    low, high = np.interp(levels, total / total[-1], values[order])
    return float(low), float(high)


def _refitted(e: _Evidence, motion: NDArray[np.float64], weight: NDArray[np.float64], zero_s: float) -> StreakFit:
    """The frame's fit with ends and flux as the common motion has them."""
    frame, fit = e.frame, e.frame.fit
    at_edge = (StreakFlag.EDGE0 in fit.flags, StreakFlag.EDGE1 in fit.flags)
    seen = _seen_displacements(e, motion, zero_s)
    x0, x1 = (np.zeros_like(x) if edge else x for x, edge in zip(seen, at_edge, strict=True))
    shift0, shift1 = float(weight @ x0), float(weight @ x1)
    d0, d1 = x0 - shift0, x1 - shift1
    pointing = (frame.sigma_frame / frame.along_per_px) ** 2
    covariance = np.array([[weight @ d0**2, weight @ (d0 * d1)], [weight @ (d0 * d1), weight @ d1**2]])
    covariance += pointing * np.outer(~np.array(at_edge), ~np.array(at_edge))
    trail = TrailFrame.of_chord(fit.row0, fit.col0, fit.row1, fit.col1)
    across_axis = np.array([trail.cos, -trail.sin])
    across = np.array(
        [
            [across_axis @ fit.covariance_px2[2 * i : 2 * i + 2, 2 * j : 2 * j + 2] @ across_axis for j in range(2)]
            for i in range(2)
        ]
    )
    interval0 = _quantile(d0, weight, (0.158655, 0.841345))
    interval1 = _quantile(d1, weight, (0.158655, 0.841345))
    half = 0.5 * fit.length_px
    # a chord turns about the old line: the ends stay on it
    row0, col0 = trail.to_pixel(-half + shift0, 0.0)
    row1, col1 = trail.to_pixel(half + shift1, 0.0)
    flux, flux_err = _flux(e, x0, x1, weight)
    kurtosis = max(float(weight @ d**4) / max(float(weight @ d**2), 1e-30) ** 2 for d in (d0, d1))
    flags = (fit.flags | StreakFlag.REFIT) & ~StreakFlag.ENDS_NOT_GAUSSIAN
    return replace(
        fit,
        row0=row0,
        col0=col0,
        row1=row1,
        col1=col1,
        covariance_px2=pixel_covariance(trail, covariance, across),
        end_interval_px=np.array([[-interval0[1], -interval0[0]], [interval1[0], interval1[1]]]),
        flux_e=flux,
        flux_err_e=flux_err,
        flags=flags | StreakFlag.ENDS_NOT_GAUSSIAN if kurtosis > 4.5 else flags,
    )


def _flux(e: _Evidence, x0: NDArray[np.float64], x1: NDArray[np.float64], weight: NDArray[np.float64]) -> tuple[float, float]:
    """Flux and error with the ends as drawn: the density given the ends, times the lit length between them."""
    fit = e.frame.fit
    if e.tables is None:
        return fit.flux_e, fit.flux_err_e
    half = 0.5 * fit.length_px
    brightness = (half, 0.5 * fit.gradient, 0.0)
    length = lit_length(x1 + half, brightness) - lit_length(x0 - half, brightness)
    log = _per_density(e.tables, e.seen, x0 - half, x1 + half)
    share = np.exp(log - log.max(axis=0))
    share /= share.sum(axis=0)
    first = e.tables.densities @ share
    second = e.tables.densities**2 @ share
    flux = float(weight @ (first * length))
    given_width = math.sqrt(max(float(weight @ (second * length**2)) - flux**2, 0.0))
    error = math.hypot(given_width, flux * _width_error(e.frame))
    # densities are positive, so that the lowest alone may be left of a frame of S/N 1; with its ends given, the fit's own error
    # is the least that there can be
    return flux, max(error, fit.flux_err_e) if has_given_ends(fit) else error


def _width_error(frame: TrackletFrame) -> float:
    """Relative error of the flux from the remaining error of the PSF width in the single fit."""
    fit, variance = frame.fit, frame.pixels.variance_e2
    width = effective_width_px(fit.width_px)
    _, error = known_width.posterior(0.0, fit.width_err_px * fit.width_px / width**2)
    noise = float(np.median(variance[np.isfinite(variance)]))
    return known_width.flux_slope(fit.flux_e / max(fit.length_px, 1.0), noise, width) * error
