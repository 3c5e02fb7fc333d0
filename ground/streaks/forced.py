"""A trail measured where a track over several frames has it, because its own frame does not show where it ends.

Below S/N 7 a frame alone puts the ends anywhere: on a peak of the noise, a third of the way along. The track knows them from all
of its frames. So ends and direction are taken as given here; brightness and the place across the trail are the frame's own.

A track of points rests on many more frames than come down. It knows places and rate better than all frames that do, so
that only the brightness is measured. The measurement is linear and keeps what noise has made negative: a mean of
fluxes from which the negative ones are missing is too bright.
"""

import math
from dataclasses import replace
from typing import Final

import numpy as np

from ground.streaks import known_width
from ground.streaks.centre_line import LineFit, effective_width_px, score, uniform_trail
from ground.streaks.fit_record import ends_in_pixels, in_pixel_order, pixel_covariance, with_edge_flags
from ground.streaks.intruders import at_median_brightness, intruder_mask
from ground.streaks.no_trail import NoTrailError, Reason
from ground.streaks.trail_frame import TrailFrame, cut_ends
from ground.streaks.trail_model import DENSITY, LN_WIDTH, V_MID
from ground.streaks.trail_pixels import usable_pixels
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.products import StreakFit, StreakPixels
from sboc_e2e.icd.signals import Detection

FORCED_SNR: Final = 7.0
"""Members of tracks that are fainter than this in their own frame are measured so."""

END_LAW: Final = 5.1
"""Ends of the most likely change points err by sqrt(26) L / S^2, S of the whole track."""

LEAST_END_PX: Final = 0.5
"""Floor of the ends' blur: the foretold place errs by this much for other causes. Chosen, not measured."""
ACROSS_PX: Final = 2.5
"""A frame may put its trail so far across from where the track has it; what goes farther is noise or a star."""

READING_PX2: Final = 1.0 / 3.0
"""Variance that reading between pixels adds: 1/6 px^2 on average each time, of frames into groups and of groups into tracks."""

ITERATIONS: Final = 8
"""One or two linear parameters from a near start; chosen, not measured."""


def forced_fit(pixels: StreakPixels, detection: Detection, track_snr: float) -> StreakFit:
    """The trail on the segment of a track's member. Raises `NoTrailError` where the frame has no light there."""
    width, length = effective_width_px(pixels.psf_sigma_px), max(detection.length_px, 1.0)
    frame, half = TrailFrame.of_chord(detection.row0, detection.col0, detection.row1, detection.col1), 0.5 * length
    edges = cut_ends(detection, pixels.frame_shape)
    along = max(END_LAW * length / max(track_snr, 1.0) ** 2, LEAST_END_PX)
    if StreakFlag.POINT_LIKE in detection.flags:
        return _foretold(pixels, detection, frame, edges, width, track_snr)
    blur = (0.0 if edges[0] else along, 0.0 if edges[1] else along)
    near = usable_pixels(pixels, frame, 5.0 * width + ACROSS_PX).near(math.inf)
    if near.u.size < 8:
        raise NoTrailError(Reason.NO_LINE)
    start = uniform_trail(0.0, half, edges, width)
    line = score(near, start, (DENSITY,), half_px=half, blur_px=blur, iterations=ITERATIONS)
    mask, covered = (
        intruder_mask(at_median_brightness(line), width, blur, ends_given=True)
        if line.regular
        else (np.zeros(near.u.size, dtype=bool), 0.0)
    )
    near = near.take(~mask)
    line = score(near, start, (DENSITY,), half_px=half, blur_px=blur, iterations=ITERATIONS)
    if not line.regular:
        raise NoTrailError(Reason.NO_SOURCE)
    placed = score(near, line.parameters, (DENSITY, V_MID), half_px=half, blur_px=blur, iterations=ITERATIONS)
    if placed.regular and abs(placed.parameters[V_MID]) < ACROSS_PX:
        line = placed
    across = math.sqrt(line.covariance[V_MID, V_MID]) if V_MID in line.free else ACROSS_PX / math.sqrt(3.0)
    return _record(pixels, detection, line, edges, along, across, covered > 0.0)


def has_given_ends(fit: StreakFit) -> bool:
    """Whether the ends along the trail are an on-board track's, so that all of its members are off together.

    A forced fit states the whole width as its error, to the last digit, which no fitted width does; a failed one does too, and
    is none. Brightness and place across are the frame's own.
    """
    return fit.width_err_px == fit.width_px and not fit.flags & (StreakFlag.REFIT | StreakFlag.FIT_FAILED)


def track_error_px(width_px: float, length_px: float, track_snr: float) -> float:
    """Error of a place that a track of points foretells for the last frame of its window, rms of both axes.

    A filter of width f finds a Gaussian of width g with S to ``(f^2 + g^2) / (sqrt(2) f S)`` (from the curvature of the filtered
    image and the variance of its noise's slope), in the middle of the window. Reading between pixels widens both; the way
    within an exposure widens g along it. At the window's ends the error is twice that. Monte Carlo (640 points in noise, 1.8 px
    an exposure): 1.39 +- 0.04 and 1.23 +- 0.04 sqrt(2) width / S along and across; here 1.36 and 1.21, and 1.29 for both.
    """
    seen = width_px**2 + READING_PX2
    across = math.sqrt(2.0 * seen)
    along = (2.0 * seen + length_px**2 / 12.0) / across
    return 2.0 * math.sqrt(0.5 * (along**2 + across**2)) / max(track_snr, 1.0)


def _foretold(
    pixels: StreakPixels,
    detection: Detection,
    frame: TrailFrame,
    edges: tuple[bool, bool],
    width_px: float,
    track_snr: float,
) -> StreakFit:
    """The light of a point where its track foretells it; the light's width includes what the place may be off."""
    length = max(detection.length_px, 1.0)
    error = track_error_px(width_px, length, track_snr)
    half, blur = 0.5 * length, (0.0 if edges[0] else error, 0.0 if edges[1] else error)
    near = usable_pixels(pixels, frame, 5.0 * width_px + ACROSS_PX).near(math.inf)
    if near.u.size < 8:
        raise NoTrailError(Reason.NO_LINE)
    start = uniform_trail(0.0, half, edges, math.hypot(width_px, error))
    line = score(near, start, (DENSITY,), half_px=half, blur_px=blur, iterations=ITERATIONS)
    if not (np.isfinite(line.parameters).all() and line.covariance[DENSITY, DENSITY] > 0.0):
        raise NoTrailError(Reason.SINGULAR)
    fit = _record(pixels, detection, line, edges, error, error, crosses=False)
    # each frame has the same share of the track's S/N squared
    frames = round((track_snr / max(detection.snr, 1e-3)) ** 2)
    lit = line.parameters[DENSITY] > 0.0
    return replace(fit, snr=fit.snr if lit else 0.0, track_frames=float(max(frames, 1)))


def _record(
    pixels: StreakPixels,
    detection: Detection,
    line: LineFit,
    edges: tuple[bool, bool],
    along_px: float,
    across_px: float,
    crosses: bool,
) -> StreakFit:
    """The product record: ends of the track, moved across to where the frame has the trail."""
    frame, p, c = line.pixels.frame, line.parameters, line.covariance
    length, density = 2.0 * line.half_px, float(p[DENSITY])
    slope = known_width.flux_slope(density, float(np.median(line.pixels.variance_e2)), math.exp(p[LN_WIDTH]))
    free = np.diag([0.0 if edge else along_px**2 for edge in edges])
    interval = np.array([[-1.0, 1.0], [-1.0, 1.0]]) * np.sqrt(np.diag(free))[:, None]
    flags = with_edge_flags(detection.flags & ~StreakFlag.COSMIC_LIKE | StreakFlag.ENDS_NOT_GAUSSIAN, edges)
    return in_pixel_order(
        StreakFit(
            **ends_in_pixels(frame, (-line.half_px, line.half_px), (float(p[V_MID]), float(p[V_MID]))),
            covariance_px2=pixel_covariance(frame, free, np.full((2, 2), across_px**2)),
            end_interval_px=interval,
            sigma_cross_px=across_px,
            flux_e=density * length,
            flux_err_e=math.hypot(math.sqrt(c[DENSITY, DENSITY]), density * slope * known_width.PRIOR) * length,
            snr=line.snr,
            sagitta_px=0.0,
            sagitta_err_px=0.0,
            gradient=0.0,
            width_px=pixels.psf_sigma_px,
            width_err_px=pixels.psf_sigma_px,
            chi2_nu=line.chi2 / max(line.n_pixels - len(line.free), 1),
            n_pixels=line.n_pixels,
            flags=flags | (StreakFlag.CROSSES_STAR if crosses else StreakFlag(0)),
            light_curve_e_px=np.zeros(0, dtype=np.float32),
        )
    )
