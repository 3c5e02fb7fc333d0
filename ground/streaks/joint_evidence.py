"""What one frame of a tracklet says of its trail's ends along the track: their likelihood, and flux between given ends."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from ground.streaks import known_width
from ground.streaks.beyond_pixels import log_stopped
from ground.streaks.centre_line import LineFit, effective_width_px, uniform_trail
from ground.streaks.end_posterior import EndTables, end_tables
from ground.streaks.end_search import COVERED_PX, coarse_ends
from ground.streaks.fit_record import edges_of
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

SPOILT_MEMBERS: Final = ((3.5, 0.21), (4.5, 0.14), (6.0, 0.05), (8.5, SPOILT))
"""The same share of members of on-board tracks at these S/N: the fainter a trail, the fainter the stars that outshine its end.
Measured likewise on 978 trails of `sso_faint` with many objects (seeds 41024 and 41026): 0.21 [0.13, 0.31], 0.14 [0.07, 0.21],
0.05 [0.02, 0.09], 0.02 [0.00, 0.05]."""


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
class Evidence:
    """Likelihood of a frame's ends, as displacements (px, along the trail) from the fitted ones.

    spoilt : log likelihood of ends that lie anywhere within reach of the pixels, whatever the motion, times their share; sound :
    log of the share of the others.
    seen : whether the on-board detector, which chose the ends, saw what lies before the first pixel and behind the last one.
    """

    frame: TrackletFrame
    tables: EndTables | None
    seen: tuple[bool, bool]
    precision: NDArray[np.float64]
    rows_per_px: float
    spoilt: float
    sound: float


def evidence_of(frame: TrackletFrame, turn_rad: float, n_given: int, given_snr: float) -> Evidence | None:
    """End likelihood of a frame along its line, turned by this about its middle; None where it has no end or no fit.

    n_given : frames with given ends. Their motion is one, of two numbers: each frame has its share of what is known of it.
    given_snr : typical S/N of these; that of a spoilt frame itself is a star's.
    """
    fit = frame.fit
    length = fit.length_px
    if StreakFlag.FIT_FAILED in fit.flags or all(edges_of(fit.flags)) or not frame.along_per_px > 0.0:
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
    free = [not edge for edge in edges_of(fit.flags)]
    precision = np.zeros((2, 2))
    index = np.flatnonzero(free)
    precision[np.ix_(index, index)] = np.linalg.inv(covariance[np.ix_(index, index)])
    turned = trail.turned(0.0, 0.0, turn_rad)
    tables = _tables(frame, turned) if has_change_points(frame) else None
    seen = (False, False) if tables is None or has_given_ends(fit) else _seen_beyond(tables, turned, frame)
    share = float(np.interp(given_snr, *np.transpose(SPOILT_MEMBERS))) if has_given_ends(fit) else SPOILT
    spoilt = -math.inf if tables is None else math.log(share) + _mean(tables, free)
    return Evidence(
        frame=frame,
        tables=tables,
        seen=seen,
        precision=precision,
        rows_per_px=trail.sin,
        spoilt=spoilt,
        sound=math.log1p(-share),
    )


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
    return half, fit.flux_e / (2.0 * half), edges_of(fit.flags)


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
    return found * length, math.hypot(math.sqrt(covariance[0, 0]), found * width_error(frame)) * length


def width_error(frame: TrackletFrame) -> float:
    """Relative error of the flux from the remaining error of the PSF width in the single fit."""
    fit, variance = frame.fit, frame.pixels.variance_e2
    width = effective_width_px(fit.width_px)
    _, error = known_width.posterior(0.0, fit.width_err_px * fit.width_px / width**2)
    noise = float(np.median(variance[np.isfinite(variance)]))
    return known_width.flux_slope(fit.flux_e / max(fit.length_px, 1.0), noise, width) * error


def log_likelihood(e: Evidence, x0: NDArray[np.float64], x1: NDArray[np.float64]) -> NDArray[np.float64]:
    """(m,) log likelihood of motions that put the ends there: of ends that show the motion, or of spoilt ones."""
    return np.asarray(np.logaddexp(e.sound + of_ends(e, x0, x1), e.spoilt))


def of_ends(e: Evidence, x0: NDArray[np.float64], x1: NDArray[np.float64]) -> NDArray[np.float64]:
    """(m,) log likelihood of end displacements."""
    if e.tables is None:
        x = np.stack([x0, x1], axis=1)
        quadratic: NDArray[np.float64] = -0.5 * np.einsum("mi,ij,mj->m", x, e.precision, x)
        return quadratic
    half = 0.5 * e.frame.fit.length_px
    log = per_density(e.tables, e.seen, x0 - half, x1 + half)
    top = log.max(axis=0)
    return np.asarray(top + np.log(np.exp(log - top).sum(axis=0)))


def best_of(e: Evidence) -> float:
    """Largest log likelihood of any ends and any density."""
    return 0.0 if e.tables is None else float((e.tables.log0.max(axis=1) + e.tables.log1.max(axis=1)).max())


def per_density(
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
