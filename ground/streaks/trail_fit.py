"""Fit of one trail: centre line by Fisher scoring, ends and flux by their posterior, alternately.

1. Axes along the detection's chord; the line is found with a widened PSF, then with the true one (coarse to fine).
2. Posterior of both ends and the density along that line (`end_posterior`).
3. The line again with the ends as found, each blurred by its own uncertainty (the expected template); then 2 again.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ground.streaks.end_posterior import EndPosterior, end_posterior, interval_68
from ground.streaks.fit_record import in_pixel_order, pixel_covariance
from ground.streaks.point_source import fit_point
from ground.streaks.trail_frame import TrailFrame
from ground.streaks.trail_model import (
    DENSITY,
    END0,
    END1,
    LN_WIDTH,
    N_PARAMETERS,
    PIXEL_VARIANCE_PX2,
    SLOPE,
    V_MID,
    fisher_scoring,
    quartic_px4,
)
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.products import StreakFit, StreakPixels
from sboc_e2e.icd.signals import Detection

BEYOND_PX = 1e7
"""Where an end is put that lies beyond the frame's edge."""

GAUSSIAN_ENDS_SNR2 = 7.3
"""Ends are change points below S^2 = 7.3 L / sigma (the Cramer-Rao bound and the change-point law cross there)."""


@dataclass(frozen=True, kw_only=True)
class FitOptions:
    """Options of `fit_trail` (see `TrailedPsfFitter`)."""

    max_shift_px: float
    max_iterations: int


@dataclass(frozen=True, kw_only=True, eq=False)
class TrailPixels:
    """Usable pixels near the trail in its frame, by ascending u; all (n,) float64, electrons and px."""

    frame: TrailFrame
    u: NDArray[np.float64]
    v: NDArray[np.float64]
    value_e: NDArray[np.float64]
    variance_e2: NDArray[np.float64]

    @classmethod
    def select(cls, pixels: StreakPixels, usable: NDArray[np.bool_], frame: TrailFrame, reach_px: float) -> "TrailPixels":
        """Usable pixels within `reach_px` of the line v = 0."""
        u, v = frame.to_trail(pixels.row, pixels.col)
        index = np.flatnonzero(usable & (np.abs(v) <= reach_px))
        index = index[np.argsort(u[index], kind="stable")]
        return cls(
            frame=frame,
            u=u[index],
            v=v[index],
            value_e=pixels.value_e[index].astype(np.float64),
            variance_e2=pixels.variance_e2[index].astype(np.float64),
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class LineFit:
    """Parameters of `trail_model` with their covariance, and the frame they refer to."""

    frame: TrailFrame
    parameters: NDArray[np.float64]
    covariance: NDArray[np.float64]
    half_px: float
    chi2: float
    snr: float
    n_pixels: int


def fit_trail(pixels: StreakPixels, detection: Detection, options: FitOptions) -> StreakFit | None:
    """The fitted trail, or None where the pixels do not allow one."""
    usable = np.isfinite(pixels.variance_e2) & np.isfinite(pixels.value_e) & (pixels.variance_e2 > 0.0)
    if np.count_nonzero(usable) < 8:
        return None
    if StreakFlag.POINT_LIKE in detection.flags or detection.length_px < 2.0 * pixels.psf_sigma_px:
        return _point_record(pixels, detection, usable)
    frame = TrailFrame.of_chord(detection.row0, detection.col0, detection.row1, detection.col1)
    edges = (StreakFlag.EDGE0 in detection.flags, StreakFlag.EDGE1 in detection.flags)
    half = 0.5 * detection.length_px
    line = _find_line(pixels, usable, frame, half, edges, options)
    if line is None:
        return None
    ends = _ends(pixels, usable, line, edges, (-half, half))
    if ends is None:
        return None
    for _ in range(2):
        middle, half = 0.5 * (ends.end0 + ends.end1), max(0.5 * (ends.end1 - ends.end0), 1.0)
        line = _refine_line(pixels, usable, line, ends, middle, half, edges, options)
        ends = _ends(pixels, usable, line, edges, (-half, half))
        if ends is None:
            return None
    if ends.end1 - ends.end0 < 2.0 * pixels.psf_sigma_px:
        return _point_record(pixels, detection, usable)
    return _record(pixels, detection, line, ends, edges)


def _start(density: float, half: float, edges: tuple[bool, bool], width: float) -> NDArray[np.float64]:
    """Parameter vector of a straight, uniform trail."""
    parameters = np.zeros(N_PARAMETERS)
    parameters[DENSITY] = density
    parameters[END0] = -BEYOND_PX if edges[0] else -half
    parameters[END1] = BEYOND_PX if edges[1] else half
    parameters[LN_WIDTH] = math.log(width)
    return parameters


def _free(*names: int) -> NDArray[np.bool_]:
    """Mask of free parameters."""
    free = np.zeros(N_PARAMETERS, dtype=np.bool_)
    free[list(names)] = True
    return free


def _limits(width: float) -> NDArray[np.float64]:
    """Largest step of each parameter in one iteration: lengths of the PSF's size, the density free (it is linear)."""
    limits = np.full(N_PARAMETERS, 0.7 * width)
    limits[DENSITY] = np.inf
    limits[LN_WIDTH] = 0.3
    return limits


def _effective_width(psf_sigma_px: float) -> float:
    """Width of the PSF integrated over pixels."""
    return math.sqrt(psf_sigma_px**2 + PIXEL_VARIANCE_PX2)


def _find_line(
    pixels: StreakPixels,
    usable: NDArray[np.bool_],
    frame: TrailFrame,
    half: float,
    edges: tuple[bool, bool],
    options: FitOptions,
) -> LineFit | None:
    """The centre line from the detection's ends, coarse to fine; None where it runs away."""
    width = _effective_width(pixels.psf_sigma_px)
    near = TrailPixels.select(pixels, usable, frame, options.max_shift_px + 5.0 * width)
    if near.u.size < 8:
        return None
    parameters = _start(0.0, half, edges, width)
    free = _free(DENSITY, V_MID, SLOPE)
    covariance = np.zeros((N_PARAMETERS, N_PARAMETERS))
    chi2 = snr2 = 0.0
    used = 0
    for widening, iterations in ((2.5, 4), (1.6, 4), (1.0, options.max_iterations)):
        parameters[LN_WIDTH] = math.log(widening * width)
        parameters, covariance, chi2, snr2, used, _ = fisher_scoring(
            parameters, free, _limits(widening * width), near.u, near.v, near.value_e, near.variance_e2,
            0.0, half, 0.0, 0.0, 0.0, iterations,
        )  # fmt: skip
    if not parameters[DENSITY] > 0.0 or abs(parameters[V_MID]) + abs(parameters[SLOPE]) > 3.0 * options.max_shift_px:
        return None
    turned = frame.turned(0.0, parameters[V_MID], parameters[SLOPE] / half)
    parameters[V_MID] = parameters[SLOPE] = 0.0
    return LineFit(
        frame=turned, parameters=parameters, covariance=covariance, half_px=half, chi2=chi2, snr=math.sqrt(snr2), n_pixels=used
    )


def _refine_line(
    pixels: StreakPixels,
    usable: NDArray[np.bool_],
    line: LineFit,
    ends: EndPosterior,
    middle: float,
    half: float,
    edges: tuple[bool, bool],
    options: FitOptions,
) -> LineFit:
    """The line with the ends as found; its frame is centred between them and turned along it."""
    width = _effective_width(pixels.psf_sigma_px)
    frame = line.frame.turned(middle, 0.0, 0.0)
    near = TrailPixels.select(pixels, usable, frame, 5.0 * width + 1.0)
    blur = np.sqrt(np.maximum(np.diag(ends.covariance_px2), 0.0))
    parameters, covariance, chi2, snr2, used, _ = fisher_scoring(
        _start(ends.density_e_px, half, edges, width), _free(DENSITY, V_MID, SLOPE), _limits(width),
        near.u, near.v, near.value_e, near.variance_e2,
        0.0, half, float(blur[0]), float(blur[1]), quartic_px4(frame.angle_rad), options.max_iterations,
    )  # fmt: skip
    turned = frame.turned(0.0, parameters[V_MID], parameters[SLOPE] / half)
    parameters[V_MID] = parameters[SLOPE] = 0.0
    return LineFit(
        frame=turned, parameters=parameters, covariance=covariance, half_px=half, chi2=chi2, snr=math.sqrt(snr2), n_pixels=used
    )


def _ends(
    pixels: StreakPixels, usable: NDArray[np.bool_], line: LineFit, edges: tuple[bool, bool], guess: tuple[float, float]
) -> EndPosterior | None:
    """Posterior of the ends along the line; an end at the frame's edge is where the line leaves the image."""
    width = _effective_width(pixels.psf_sigma_px)
    near = TrailPixels.select(pixels, usable, line.frame, 2.7 * width)
    quartic = quartic_px4(line.frame.angle_rad)
    template = _profiles(near.v, width, quartic)
    limits = line.frame.image_limits(pixels.frame_shape)
    fixed = (limits[0] if edges[0] else None, limits[1] if edges[1] else None)
    return end_posterior(
        near.u, template, near.value_e, near.variance_e2,
        width_px=width, guess=(guess[0], guess[1], float(line.parameters[DENSITY])), fixed=fixed, line_parameters=2,
    )  # fmt: skip


def _profiles(v: NDArray[np.float64], width: float, quartic: float) -> NDArray[np.float64]:
    """`trail_model.profile` of each pixel."""
    t2 = (v / width) ** 2
    correction = 1.0 + quartic / (24.0 * width**4) * (t2 * t2 - 6.0 * t2 + 3.0)
    return np.exp(-0.5 * t2) / (math.sqrt(2.0 * math.pi) * width) * correction


def _record(
    pixels: StreakPixels, detection: Detection, line: LineFit, ends: EndPosterior, edges: tuple[bool, bool]
) -> StreakFit:
    """The product record of a fitted trail."""
    v = line.covariance[V_MID, V_MID]
    vs = line.covariance[V_MID, SLOPE]
    s = line.covariance[SLOPE, SLOPE]
    across = np.array([[v - 2.0 * vs + s, v - s], [v - s, v + 2.0 * vs + s]])
    row0, col0 = line.frame.to_pixel(ends.end0, 0.0)
    row1, col1 = line.frame.to_pixel(ends.end1, 0.0)
    low0, high0 = interval_68(ends.grid0, ends.mass0, ends.end0)
    low1, high1 = interval_68(ends.grid1, ends.mass1, ends.end1)
    flags = detection.flags & ~StreakFlag.POINT_LIKE
    length = ends.end1 - ends.end0
    if not all(edges) and line.snr**2 < GAUSSIAN_ENDS_SNR2 * length / pixels.psf_sigma_px:
        flags |= StreakFlag.ENDS_NOT_GAUSSIAN
    return in_pixel_order(
        StreakFit(
            row0=row0,
            col0=col0,
            row1=row1,
            col1=col1,
            covariance_px2=pixel_covariance(line.frame, ends.covariance_px2, across),
            end_interval_px=np.array([[-high0, -low0], [low1, high1]]),
            sigma_cross_px=math.sqrt(v),
            flux_e=ends.flux_e,
            flux_err_e=ends.flux_err_e,
            snr=line.snr,
            sagitta_px=0.0,
            sagitta_err_px=0.0,
            gradient=0.0,
            width_px=pixels.psf_sigma_px,
            width_err_px=0.0,
            chi2_nu=line.chi2 / max(line.n_pixels - 5, 1),
            n_pixels=line.n_pixels,
            flags=flags,
            light_curve_e_px=np.zeros(0, dtype=np.float32),
        )
    )


def _point_record(pixels: StreakPixels, detection: Detection, usable: NDArray[np.bool_]) -> StreakFit | None:
    """The product record of a source that does not trail: both ends at its centre."""
    start = (0.5 * (detection.row0 + detection.row1), 0.5 * (detection.col0 + detection.col1))
    data = [np.asarray(a[usable], dtype=np.float64) for a in (pixels.row, pixels.col, pixels.value_e, pixels.variance_e2)]
    point = fit_point(data[0], data[1], data[2], data[3], start=start, psf_sigma_px=pixels.psf_sigma_px, free_width=False)
    if point is None:
        return None
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
        snr=point.snr,
        sagitta_px=0.0,
        sagitta_err_px=0.0,
        gradient=0.0,
        width_px=math.sqrt(max(point.width_px**2 - PIXEL_VARIANCE_PX2, 0.0)),
        width_err_px=0.0,
        chi2_nu=point.chi2 / max(point.n_pixels - 3, 1),
        n_pixels=point.n_pixels,
        flags=detection.flags | StreakFlag.POINT_LIKE,
        light_curve_e_px=np.zeros(0, dtype=np.float32),
    )
