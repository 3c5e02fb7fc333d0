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
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ground.importance import Draws, Gaussian, Proposals, adapted
from ground.streaks.common_direction import common_turns
from ground.streaks.end_posterior import lit_length
from ground.streaks.fit_record import edges_of, pixel_covariance, with_edge_flags
from ground.streaks.forced import has_given_ends
from ground.streaks.joint_evidence import (
    Evidence,
    TrackletFrame,
    best_of,
    evidence_of,
    log_likelihood,
    of_ends,
    per_density,
    width_error,
)
from ground.streaks.joint_motion import AccelerationPrior, Motion, linear_start, seen_displacements
from ground.streaks.trail_frame import TrailFrame
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.products import StreakFit

REACH_OF_SPOILT: Final = 30.0
"""How far the motion may lie from that of all frames as they are, in its sigmas, when some frames are spoilt."""

REACH_OF_TRACK: Final = 6.0
"""How far the motion may lie from that of an on-board track, in the track's sigmas. The track is the most likely motion in whole
frames, while ends beyond the pixels that came down would be as likely as any. So wide that the same pixels hardly count twice.
In 50 tracks each of two frames of S/N 5.5 and three of 5, 200 px long, rms errors of a middle are 15 and 11 px; without it 190
and 170 px, because a few go astray."""


EDGE_ERROR_PX: Final = 0.5
"""Ends of the motion that are nearer to the image's edge are on it: half a pixel."""

LEAST_CUT: Final = 0.05
"""Share of the motions that reach the image's edge from which on a trail that was taken for cut is one. A trail of 33 px that ran
along a border at 7 deg and ended 1.6 px beside it was lengthened by 14 px. Chosen, not measured."""


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
    given = [frame.fit.snr for frame in frames if has_given_ends(frame.fit)]
    n_given, given_snr = len(given), float(np.median(given)) if given else 0.0
    turns = common_turns([f.fit for f in frames])
    evidence = [evidence_of(frame, turn, n_given, given_snr) for frame, turn in zip(frames, turns, strict=True)]
    used = [e for e in evidence if e is not None]
    if len(used) < 2:
        return unchanged
    zero = float(np.mean([0.5 * (e.frame.t_open_s + e.frame.t_close_s) for e in used]))
    start = linear_start(used, zero, prior)
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
            x0, x1 = seen_displacements(e, mean[None, :], zero)
            if not has_given_ends(e.frame.fit):
                misfit[k] = 2.0 * (best_of(e) - float(of_ends(e, x0, x1)[0]))
    fits = (frame.fit if e is None else _refitted(e, motion, weight, zero) for frame, e in zip(frames, evidence, strict=True))
    return JointRefit(tuple(fits), shared, misfit, common)


def _sample(
    used: list[Evidence],
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
    first = _adapted(proposals, used, zero_s, prior, (center, covariance), track, of_ends)
    if all(e.spoilt == -math.inf for e in used):
        return first.points, first.weight
    found, spread = first.mean, first.covariance
    about = track or (found, spread * REACH_OF_SPOILT**2)
    second = _adapted(proposals, used, zero_s, prior, (found, spread + covariance), about, log_likelihood)
    return second.points, second.weight


def _adapted(
    proposals: Proposals,
    used: list[Evidence],
    zero_s: float,
    prior: AccelerationPrior | None,
    start: Gaussian,
    about: Gaussian | None,
    likelihood: Callable[[Evidence, NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]],
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
            total += likelihood(e, *seen_displacements(e, motion, zero_s))
        return total

    return adapted(proposals, start, log_density)


def _quantile(values: NDArray[np.float64], weight: NDArray[np.float64], levels: tuple[float, float]) -> tuple[float, float]:
    """Weighted quantiles."""
    order = np.argsort(values)
    total = np.cumsum(weight[order])
    low, high = np.interp(levels, total / total[-1], values[order])
    return float(low), float(high)


def _refitted(e: Evidence, motion: NDArray[np.float64], weight: NDArray[np.float64], zero_s: float) -> StreakFit:
    """The frame's fit with ends and flux as the common motion has them."""
    frame, fit = e.frame, e.frame.fit
    seen = seen_displacements(e, motion, zero_s)
    reached = [float(weight @ (np.abs(x) < EDGE_ERROR_PX)) for x in seen]
    edge0, edge1 = edges_of(fit.flags)
    at_edge = edge0 and reached[0] > LEAST_CUT, edge1 and reached[1] > LEAST_CUT
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
    flags = with_edge_flags((fit.flags | StreakFlag.REFIT) & ~StreakFlag.ENDS_NOT_GAUSSIAN, at_edge)
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


def _flux(e: Evidence, x0: NDArray[np.float64], x1: NDArray[np.float64], weight: NDArray[np.float64]) -> tuple[float, float]:
    """Flux and error with the ends as drawn: the density given the ends, times the lit length between them."""
    fit = e.frame.fit
    if e.tables is None:
        return fit.flux_e, fit.flux_err_e
    half = 0.5 * fit.length_px
    brightness = (half, 0.5 * fit.gradient, 0.0)
    length = lit_length(x1 + half, brightness) - lit_length(x0 - half, brightness)
    log = per_density(e.tables, e.seen, x0 - half, x1 + half)
    share = np.exp(log - log.max(axis=0))
    share /= share.sum(axis=0)
    first = e.tables.densities @ share
    second = e.tables.densities**2 @ share
    flux = float(weight @ (first * length))
    given_width = math.sqrt(max(float(weight @ (second * length**2)) - flux**2, 0.0))
    error = math.hypot(given_width, flux * width_error(e.frame))
    # densities are positive, so that the lowest alone may be left of a frame of S/N 1; with its ends given, the fit's own error
    # is the least that there can be
    return flux, max(error, fit.flux_err_e) if has_given_ends(fit) else error
