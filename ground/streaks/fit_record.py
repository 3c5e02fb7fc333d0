"""`StreakFit` records from trail coordinates: order of the ends, covariances, and the record of a failed fit."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, TypedDict

import numpy as np
from numpy.typing import NDArray

from ground.streaks import known_width
from ground.streaks.centre_line import LineFit
from ground.streaks.end_posterior import EndPosterior, interval_68
from ground.streaks.flashes import Flash
from ground.streaks.light_curve import LightCurve
from ground.streaks.point_source import PointFit
from ground.streaks.trail_frame import TrailFrame
from ground.streaks.trail_model import DENSITY, LN_WIDTH, PIXEL_VARIANCE_PX2, Q1, Q2, SAGITTA, SLOPE, V_MID
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.products import StreakFit, StreakPixels
from sboc_e2e.icd.signals import Detection

SHARP: Final = 0.75
"""Fitted over expected width below which a trail is COSMIC_LIKE, if by three sigmas: particles have no PSF. Chosen, not
measured."""
WIDE: Final = 1.2
"""Fitted over expected width below or above which a trail is COSMIC_LIKE or DEFOCUSED, if by three sigmas."""

EXTENDED_SIGMAS: Final = 3.0
"""Excess of width from which a point-like source is taken as wider than the PSF."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TrailResult:
    """Result of the fit. `ends` refers to axes whose origin lies `shift_px` before that of `line`, along the trail."""

    line: LineFit
    ends: EndPosterior
    shift_px: float
    edges: tuple[bool, bool]
    crosses: bool
    ln_width: float
    ln_width_err: float
    curve: LightCurve
    flashes: Sequence[Flash]


def pixel_covariance(frame: TrailFrame, along_px2: NDArray[np.float64], across_px2: NDArray[np.float64]) -> NDArray[np.float64]:
    """(4, 4) covariance of (row0, col0, row1, col1) from the (2, 2) covariances of the ends along and across the trail."""
    out = np.empty((4, 4))
    along, across = np.array([frame.sin, frame.cos]), np.array([frame.cos, -frame.sin])
    for i in range(2):
        for j in range(2):
            block = along_px2[i, j] * np.outer(along, along) + across_px2[i, j] * np.outer(across, across)
            out[2 * i : 2 * i + 2, 2 * j : 2 * j + 2] = block
    return out


def edges_of(flags: StreakFlag) -> tuple[bool, bool]:
    """Which ends the image's edge cuts off."""
    return StreakFlag.EDGE0 in flags, StreakFlag.EDGE1 in flags


def swap_edge_flags(flags: StreakFlag) -> StreakFlag:
    """The flags when the ends change places."""
    edge0, edge1 = edges_of(flags)
    return with_edge_flags(flags, (edge1, edge0))


def with_edge_flags(flags: StreakFlag, edges: tuple[bool, bool]) -> StreakFlag:
    """The flags where the image's edge cuts off these ends and no other."""
    flags &= ~(StreakFlag.EDGE0 | StreakFlag.EDGE1)
    for edge, flag in zip(edges, (StreakFlag.EDGE0, StreakFlag.EDGE1), strict=True):
        flags |= flag if edge else StreakFlag(0)
    return flags


def in_pixel_order(fit: StreakFit) -> StreakFit:
    """The fit with its ends by growing col, then row."""
    if (fit.col0, fit.row0) <= (fit.col1, fit.row1):
        return fit
    return reversed_ends(fit)


def reversed_ends(fit: StreakFit) -> StreakFit:
    """The same trail with end 0 and end 1 exchanged; signed quantities change with the direction."""
    order = [2, 3, 0, 1]
    return replace(
        fit,
        row0=fit.row1,
        col0=fit.col1,
        row1=fit.row0,
        col1=fit.col0,
        covariance_px2=fit.covariance_px2[np.ix_(order, order)],
        end_interval_px=fit.end_interval_px[::-1],
        light_interval_px=fit.light_interval_px[::-1],
        sagitta_px=-fit.sagitta_px,
        gradient=-fit.gradient,
        flags=swap_edge_flags(fit.flags),
        light_curve_e_px=fit.light_curve_e_px[::-1],
        light_curve_err_e_px=fit.light_curve_err_e_px[::-1],
    )


def failed_fit(detection: Detection, pixels: StreakPixels, reason: str) -> StreakFit:
    """The detection's own values, flagged FIT_FAILED, with the reason and uncertainties as wide as the detection can be off."""
    length = max(detection.length_px, 1.0)
    snr = max(detection.snr, 1.0)
    width = pixels.psf_sigma_px
    along = max(4.39 * length / snr**2, math.sqrt(2.0 * math.sqrt(math.pi) * width * length) / snr) + 1.0
    frame = TrailFrame.of_chord(detection.row0, detection.col0, detection.row1, detection.col1)
    usable = np.isfinite(pixels.variance_e2) & np.isfinite(pixels.value_e)
    noise_e = math.sqrt(float(np.median(pixels.variance_e2[usable]))) if usable.any() else 1.0
    flux = snr * noise_e * math.sqrt(2.0 * math.sqrt(math.pi) * width * (length + 2.0 * math.sqrt(math.pi) * width))
    return in_pixel_order(
        StreakFit(
            row0=detection.row0,
            col0=detection.col0,
            row1=detection.row1,
            col1=detection.col1,
            covariance_px2=pixel_covariance(frame, np.eye(2) * along**2, np.eye(2)),
            end_interval_px=np.array([[-along, along], [-along, along]]),
            sigma_cross_px=1.0,
            flux_e=flux,
            flux_err_e=flux,
            snr=detection.snr,
            sagitta_px=detection.sagitta_px,
            sagitta_err_px=1.0,
            gradient=0.0,
            width_px=width,
            width_err_px=width,
            chi2_nu=math.nan,
            n_pixels=int(usable.sum()),
            flags=detection.flags | StreakFlag.FIT_FAILED | StreakFlag.ENDS_NOT_GAUSSIAN,
            light_curve_e_px=np.zeros(0, dtype=np.float32),
            failure=str(reason),
        )
    )


Pair = tuple[float, float] | NDArray[np.float64]


class PixelEnds(TypedDict):
    """Both ends of a trail (px)."""

    row0: float
    col0: float
    row1: float
    col1: float


def ends_in_pixels(frame: TrailFrame, u: Pair, v: Pair) -> PixelEnds:
    """Rows and columns of the ends at two places (u, v) of a trail frame."""
    (row0, col0), (row1, col1) = frame.to_pixel(u[0], v[0]), frame.to_pixel(u[1], v[1])
    return {"row0": row0, "col0": col0, "row1": row1, "col1": col1}


def trail_record(pixels: StreakPixels, detection: Detection, result: TrailResult, *, gaussian_ends: bool) -> StreakFit:
    """The product record of a fitted trail."""
    line, ends = result.line, result.ends
    p, c = line.parameters, line.covariance
    frame = line.pixels.frame
    u = np.array([ends.end0, ends.end1]) - result.shift_px
    x = u / line.half_px
    # centre line at the ends and its derivatives by (V_MID, SLOPE, SAGITTA)
    v = p[V_MID] + p[SLOPE] * x + p[SAGITTA] * (1.0 / 3.0 - x * x)
    index = np.array([V_MID, SLOPE, SAGITTA])
    jacobian = np.stack([np.ones(2), x, 1.0 / 3.0 - x * x], axis=1)
    block = c[np.ix_(index, index)]
    across = jacobian @ block @ jacobian.T
    middle = np.array([1.0, 0.0, 1.0 / 3.0])
    sigma_cross = math.sqrt(float(middle @ block @ middle))
    low0, high0 = interval_68(ends.grid0, ends.mass0, ends.end0)
    low1, high1 = interval_68(ends.grid1, ends.mass1, ends.end1)
    width, width_err = psf_width(result.ln_width, result.ln_width_err)
    flux, flux_err = _flux(result)
    flash_e, flash_variance = (sum(flash[k] for flash in result.flashes) for k in range(2))
    return in_pixel_order(
        StreakFit(
            **ends_in_pixels(frame, u, v),
            covariance_px2=pixel_covariance(frame, ends.covariance_px2, across),
            end_interval_px=np.array([[-high0, -low0], [low1, high1]]),
            sigma_cross_px=sigma_cross,
            flux_e=flux + flash_e,
            flux_err_e=math.hypot(flux_err, math.sqrt(flash_variance)),
            flash_e=flash_e,
            snr=line.snr,
            sagitta_px=float(p[SAGITTA]),
            sagitta_err_px=math.sqrt(c[SAGITTA, SAGITTA]),
            gradient=float(2.0 * p[Q1]),
            width_px=width,
            width_err_px=width_err,
            chi2_nu=line.chi2 / max(line.n_pixels - len(line.free) - 2, 1),
            n_pixels=line.n_pixels,
            flags=_trail_flags(pixels, detection, result, gaussian_ends),
            light_curve_e_px=result.curve.density_e_px.astype(np.float32),
            light_curve_err_e_px=result.curve.sigma_e_px.astype(np.float32),
            period_fraction=result.curve.period_fraction,
        )
    )


def psf_width(ln_width: float, ln_width_err: float) -> tuple[float, float]:
    """PSF sigma and error (px) from the width as seen by pixels; 0.05 px where the light is narrower than a pixel."""
    width = math.exp(ln_width)
    sigma = math.sqrt(max(width**2 - PIXEL_VARIANCE_PX2, 0.05**2))
    return sigma, min(ln_width_err * width**2 / sigma, 1e3)


def _flux(result: TrailResult) -> tuple[float, float]:
    """Flux and error, the width's share included: the density scales with it, whether it was free or known within a prior."""
    line, ends = result.line, result.ends
    if LN_WIDTH not in line.free:
        excess, error = known_width.posterior(result.ln_width - line.parameters[LN_WIDTH], result.ln_width_err)
        slope = known_width.flux_slope(ends.density_e_px, float(np.median(line.pixels.variance_e2)), line.width_px)
        flux = ends.flux_e * math.exp(slope * excess)
        return flux, math.hypot(ends.flux_err_e, flux * slope * error)
    density = line.covariance[DENSITY, DENSITY]
    ln_width = max(line.covariance[LN_WIDTH, LN_WIDTH], 1e-300)
    share = line.covariance[DENSITY, LN_WIDTH] ** 2 / (density * ln_width)
    return ends.flux_e, math.sqrt(ends.flux_err_e**2 + share * density * (ends.end1 - ends.end0) ** 2)


def _trail_flags(pixels: StreakPixels, detection: Detection, result: TrailResult, gaussian_ends: bool) -> StreakFlag:
    """The detection's flags, with those of the fit in place of the detector's guesses."""
    guessed = StreakFlag.POINT_LIKE | StreakFlag.EDGE0 | StreakFlag.EDGE1 | StreakFlag.CURVED | StreakFlag.COSMIC_LIKE
    flags = detection.flags & ~guessed
    parameters = result.line.parameters
    expected = 0.5 * math.log(pixels.psf_sigma_px**2 + PIXEL_VARIANCE_PX2)
    excess = result.ln_width - expected
    chosen = (
        (result.edges[0], StreakFlag.EDGE0),
        (result.edges[1], StreakFlag.EDGE1),
        (not gaussian_ends, StreakFlag.ENDS_NOT_GAUSSIAN),
        (SAGITTA in result.line.free, StreakFlag.CURVED),
        (result.crosses, StreakFlag.CROSSES_STAR),
        (result.curve.variable or parameters[Q1] != 0.0 or parameters[Q2] != 0.0, StreakFlag.VARIABLE),
        (excess < math.log(SHARP) and excess < -3.0 * result.ln_width_err, StreakFlag.COSMIC_LIKE),
        (excess > math.log(WIDE) and excess > 3.0 * result.ln_width_err, StreakFlag.DEFOCUSED),
    )
    for true, flag in chosen:
        if true:
            flags |= flag
    return flags


def point_record(pixels: StreakPixels, detection: Detection, point: PointFit, wide: PointFit | None) -> StreakFit:
    """The product record of a source that does not trail: both ends at its centre; `wide`: the fit with free width.

    A bright source that moves by a pixel or two is visibly wider than the PSF. Its light comes from the wide fit.
    """
    matched_snr = point.snr
    width, width_err = (pixels.psf_sigma_px, math.inf)
    flags = (detection.flags & ~(StreakFlag.COSMIC_LIKE | StreakFlag.CURVED)) | StreakFlag.POINT_LIKE
    if wide is not None:
        ln_err = math.sqrt(wide.covariance[3, 3])
        width, width_err = psf_width(math.log(wide.width_px), ln_err)
        excess = math.log(wide.width_px / point.width_px)
        if excess < math.log(SHARP) and excess < -3.0 * ln_err:
            flags |= StreakFlag.COSMIC_LIKE
        if excess > math.log(WIDE) and excess > 3.0 * ln_err:
            flags |= StreakFlag.DEFOCUSED
        if excess > EXTENDED_SIGMAS * ln_err:
            point = wide
    position = point.covariance[1:3, 1:3]
    sigma = math.sqrt(0.5 * float(np.trace(position)))
    return StreakFit(
        row0=point.row,
        col0=point.col,
        row1=point.row,
        col1=point.col,
        covariance_px2=np.tile(position, (2, 2)),
        end_interval_px=np.array([[-sigma, sigma], [-sigma, sigma]]),
        sigma_cross_px=sigma,
        flux_e=point.flux_e,
        flux_err_e=math.sqrt(point.covariance[0, 0]),
        snr=matched_snr,
        sagitta_px=0.0,
        sagitta_err_px=0.0,
        gradient=0.0,
        width_px=width,
        width_err_px=width_err,
        chi2_nu=point.chi2 / max(point.n_pixels - 3, 1),
        n_pixels=point.n_pixels,
        flags=flags,
        light_curve_e_px=np.zeros(0, dtype=np.float32),
    )
