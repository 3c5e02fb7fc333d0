"""Fit of one trail, in order: line, ends, intruders, refinements, local centre line, posterior of the ends, record.

The centre line and the shape are found by Fisher scoring with the ends as known so far, each blurred by its own
uncertainty (the expected template); ends and flux come from their posterior along that line (`end_posterior`).
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ground.streaks.centre_line import LineFit, effective_width_px, find_line, moved_to_middle, score, turned_along
from ground.streaks.changing_light import LightSeries, end_variance_px2, light_series
from ground.streaks.end_posterior import EndPosterior, end_posterior, end_tables, short_trail_posterior
from ground.streaks.end_search import CoarseEnds, coarse_ends
from ground.streaks.fit_record import TrailResult, point_record, trail_record
from ground.streaks.flashes import flashes
from ground.streaks.intruders import MOST_MASKED, at_median_brightness, intruder_mask, outshining
from ground.streaks.light_curve import LightCurve, light_curve
from ground.streaks.model_choice import choose_model, straight_unless_evident, width_estimate
from ground.streaks.no_trail import NoTrailError, Reason
from ground.streaks.point_source import fit_point
from ground.streaks.trail_frame import TrailFrame, cut_ends
from ground.streaks.trail_model import DENSITY, END0, END1, Q1, Q2, SAGITTA, SLOPE, V_MID, profiles
from ground.streaks.trail_pixels import TrailPixels, usable_pixels
from ground.streaks.wiggle import local_offsets
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.products import StreakFit, StreakPixels
from sboc_e2e.icd.signals import Detection

CHANGE_POINT_SNR2: Final = 7.3
"""Ends are change points below S^2 = 7.3 L / width: there the Cramer-Rao bound meets 4.39 L / S^2."""

LEAST_POINT_SNR: Final = 1.0
"""A point with less light than its error is not what the detector saw."""

SHAPE_SNR: Final = 10.0
"""Fainter trails are taken as straight and uniform."""

POINT_WIDTHS: Final = 2.0
"""Trails shorter than this many PSF sigmas are points."""

OVERLAP_WIDTHS: Final = 9.0
"""Below this length in widths the PSFs of the two ends overlap."""

INTRUDER_ROUNDS: Final = 3
"""Fit and mask follow each other until the mask stays; a budget of work. Chosen, not measured."""
WIGGLE_ROUNDS: Final = 3
"""Offsets and fit follow each other; a budget of work. Chosen, not measured."""
SERIES_ROUNDS: Final = 2
"""Brightness that changes, and ends, one after the other."""

MAX_SHIFT_PX: Final = 4.0
"""How far across the trail the on-board detection may be off."""

MAX_ITERATIONS: Final = 25
"""Fisher-scoring iterations of one model."""


def fit_trail(pixels: StreakPixels, detection: Detection) -> StreakFit:
    """The fitted trail. Raises `NoTrailError` where the pixels do not allow one."""
    width = effective_width_px(pixels.psf_sigma_px)
    if StreakFlag.POINT_LIKE in detection.flags or detection.length_px < POINT_WIDTHS * pixels.psf_sigma_px:
        return fit_untrailed(pixels, detection)
    frame = TrailFrame.of_chord(detection.row0, detection.col0, detection.row1, detection.col1)
    reach = MAX_SHIFT_PX + 6.0 * width + 1.0 + abs(detection.sagitta_px)
    usable = usable_pixels(pixels, frame, reach)
    half = 0.5 * detection.length_px
    flagged = cut_ends(detection, pixels.frame_shape)
    line, crosses = _line_among_stars(usable, detection, half, flagged, width)
    found = _with_ends(line, flagged, pixels.frame_shape)
    for _ in range(INTRUDER_ROUNDS):
        mask, share = intruder_mask(found[0], width, found[0].blur_px)
        if not mask.any():
            break
        crosses |= share > 0.0
        kept = replace(found[0], pixels=found[0].pixels.take(~mask))
        found = _with_ends(kept, found[1].edges, pixels.frame_shape)
    line, coarse = found
    if coarse.length_px < OVERLAP_WIDTHS * width and not any(coarse.edges):
        return _short_trail(pixels, detection, line, crosses)
    try:
        return _long_trail(pixels, detection, _refined(line, coarse), coarse.edges, crosses)
    except NoTrailError as error:
        if error.reason is not Reason.IRREGULAR:
            raise
    # a shape that fades to nothing leaves its end open, and grows beyond all bounds where another light lies there
    return _long_trail(pixels, detection, line, coarse.edges, crosses)


def _line_among_stars(
    usable: TrailPixels, detection: Detection, half_px: float, edges: tuple[bool, bool], width_px: float
) -> tuple[LineFit, bool]:
    """The line without the light of stars on it, and whether there are any. Raises `NoTrailError` where there is no line.

    A bright star would pull both the line and the ends to itself, so it must go before they are looked for.
    """

    def found(pixels: TrailPixels) -> LineFit:
        sagitta_px = detection.sagitta_px
        line = find_line(pixels, half_px, edges, width_px=width_px, sagitta_px=sagitta_px, max_shift_px=MAX_SHIFT_PX)
        if line is None:
            raise NoTrailError(Reason.NO_LINE)
        return line

    error_px = 0.1 * half_px + 2.0 * width_px
    first = found(usable)
    mask, share = intruder_mask(at_median_brightness(first), width_px, (error_px, error_px), 1.0)
    crosses = 0.0 < share <= MOST_MASKED
    if share > MOST_MASKED and (bright := outshining(usable, detection, width_px)).any():
        # too many sources to be told from the trail by a line that they pull: the brightest go first
        crosses = True
        usable = usable.take(~bright)
        first = found(usable)
        mask, _ = intruder_mask(at_median_brightness(first), width_px, (error_px, error_px), 1.0)
    return (found(usable.without(first.pixels.index[mask])), crosses) if mask.any() else (first, crosses)


def _with_ends(line: LineFit, edges: tuple[bool, bool], shape: tuple[int, int]) -> tuple[LineFit, CoarseEnds]:
    """Coarse ends along the line, then the line again with them."""
    coarse = _coarse(line, edges, shape)
    line = moved_to_middle(line, (coarse.end0, coarse.end1), coarse.edges)
    free = tuple(p for p in line.free if p not in (END0, END1))
    # hard edges: the PSF's own share of the spread is already in the model
    line = score(
        line.pixels, line.parameters, free,
        half_px=line.half_px, blur_px=(coarse.sigma0_px, coarse.sigma1_px), iterations=8,
    )  # fmt: skip
    if not line.regular:
        raise NoTrailError(Reason.IRREGULAR)
    return turned_along(straight_unless_evident(line, iterations=8)), coarse


def _template(line: LineFit) -> NDArray[np.float64]:
    """(n,) electrons per unit density of fully lit pixels on the fitted line, brightness included."""
    p = line.parameters
    return profiles(p, line.pixels.u, line.pixels.v, line.half_px, line.pixels.frame.angle_rad)


def _coarse(line: LineFit, edges: tuple[bool, bool], shape: tuple[int, int]) -> CoarseEnds:
    """`coarse_ends` on the pixels near the line. Raises `NoTrailError` where nothing is lit."""
    near = line.pixels.near(2.2 * line.width_px + abs(line.parameters[SAGITTA]))
    at = replace(line, pixels=near)
    half = line.half_px
    found = coarse_ends(
        near.u, _template(at), near.value_e, near.variance_e2,
        guess=(-half, half, float(line.parameters[DENSITY])), edges=edges,
        image_limits=line.pixels.frame.image_limits(shape),
    )  # fmt: skip
    if found is None:
        raise NoTrailError(Reason.NO_ENDS)
    return found


def _refined(line: LineFit, coarse: CoarseEnds) -> LineFit:
    """Curvature, brightness and width where the pixels ask for them, then the local centre line."""
    gaussian = line.snr**2 > CHANGE_POINT_SNR2 * coarse.length_px / line.width_px
    if gaussian:
        ends = tuple(e for e, at_edge in zip((END0, END1), coarse.edges, strict=True) if not at_edge)
        sharp = score(
            line.pixels, line.parameters, (*line.free, *ends),
            half_px=line.half_px, blur_px=(0.0, 0.0), iterations=MAX_ITERATIONS,
        )  # fmt: skip
        line = sharp if sharp.regular else line
    shape = line.snr > SHAPE_SNR
    line = choose_model(line, iterations=MAX_ITERATIONS, shape=shape)
    for _ in range(WIGGLE_ROUNDS if shape else 0):
        offsets = local_offsets(line, (-line.half_px, line.half_px))
        if offsets is None:
            break
        straightened = replace(line.pixels, v=line.pixels.v - np.interp(line.pixels.u, *offsets))
        straight = score(
            straightened, line.parameters, line.free,
            half_px=line.half_px, blur_px=line.blur_px, iterations=MAX_ITERATIONS,
        )  # fmt: skip
        if not straight.regular:
            break
        line = straight
    return line


def _long_trail(
    pixels: StreakPixels,
    detection: Detection,
    line: LineFit,
    edges: tuple[bool, bool],
    crosses: bool,
) -> StreakFit:
    """Posterior of the ends along the final line, and the record."""
    coarse = _coarse(line, edges, pixels.frame_shape)
    near = line.pixels.near(2.7 * line.width_px + abs(line.parameters[SAGITTA]))
    uniform = _template(replace(line, pixels=near))
    lit = _lit_between(line, coarse)
    for _ in range(SERIES_ROUNDS):
        series = _series(line, lit)
        template = uniform if series is None else uniform * series.at((2.0 * near.u - lit[0] - lit[1]) / (lit[1] - lit[0]))
        # the line's density has soft edges, the coarse one counts half-lit pixels as lit
        tables = end_tables(
            near.u, template, near.value_e, near.variance_e2,
            width_px=line.width_px, coarse=replace(coarse, density_e_px=float(line.parameters[DENSITY])),
        )  # fmt: skip
        ends = end_posterior(
            tables,
            brightness=(line.half_px, float(line.parameters[Q1]), float(line.parameters[Q2])),
            line_parameters=2 + (SAGITTA in line.free),
        )
        if series is None or ends.end1 - ends.end0 < POINT_WIDTHS * pixels.psf_sigma_px:
            break
        lit = (ends.end0, ends.end1)
    if series is not None:
        ends = replace(ends, covariance_px2=ends.covariance_px2 + end_variance_px2(series, line.width_px))
    if ends.end1 - ends.end0 < POINT_WIDTHS * pixels.psf_sigma_px:
        return fit_untrailed(pixels, detection)
    return _record(pixels, detection, line, ends, coarse.edges, crosses)


def _lit_between(line: LineFit, coarse: CoarseEnds) -> tuple[float, float]:
    """Ends between which the brightness is followed: those of the line's fit where it has them, else the coarse ones.

    Coarse ends count what the PSF spreads beyond them as lit, 0.8 widths at S/N 5,000. The outermost bins would look dim.
    """
    fitted0, fitted1 = (float(line.parameters[end]) if end in line.free else None for end in (END0, END1))
    lit = coarse.end0 if fitted0 is None else fitted0, coarse.end1 if fitted1 is None else fitted1
    return lit if lit[1] - lit[0] > POINT_WIDTHS * line.width_px else (coarse.end0, coarse.end1)


def _series(line: LineFit, ends: tuple[float, float]) -> LightSeries | None:
    """Brightness beyond the line's, where it changes more than the line's model can."""
    curve, smooth = _light_curve(line, ends)
    n = len(curve.density_e_px)
    if not curve.variable:
        return None
    place = ends[0] + (np.arange(n, dtype=np.float64) + 0.5) * ((ends[1] - ends[0]) / n)
    return light_series(curve, smooth(np.asarray(place, dtype=np.float64)))


def _light_curve(
    line: LineFit, ends: tuple[float, float]
) -> tuple[LightCurve, Callable[[NDArray[np.float64]], NDArray[np.float64]]]:
    """Brightness in bins between two ends, and the density that the line has at places (n,) along it."""

    def smooth(u: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(line.parameters[DENSITY] * np.maximum(brightness(u), 0.05))

    def brightness(u: NDArray[np.float64]) -> NDArray[np.float64]:
        x = u / line.half_px
        return np.asarray(1.0 + line.parameters[Q1] * x + line.parameters[Q2] * (x * x - 1.0 / 3.0))

    near = line.pixels.take(np.abs(line.pixels.v) < 3.0 * line.width_px + abs(line.parameters[SAGITTA]))
    template = _template(replace(line, pixels=near))
    curve = light_curve(
        near.u, template / np.maximum(brightness(near.u), 0.05), near.value_e, near.variance_e2,
        ends=ends, smooth_density_e_px=smooth(near.u), width_px=line.width_px, snr=line.snr,
    )  # fmt: skip
    return curve, smooth


def _short_trail(pixels: StreakPixels, detection: Detection, line: LineFit, crosses: bool) -> StreakFit:
    """A trail whose ends overlap: Fisher scoring for where the joint posterior lies, then that posterior."""
    free = (DENSITY, END0, END1, V_MID, SLOPE)
    line = score(line.pixels, line.parameters, free, half_px=line.half_px, blur_px=(0.0, 0.0), iterations=MAX_ITERATIONS)
    line = turned_along(line)
    index = np.array([DENSITY, END0, END1])
    center, covariance = line.parameters[index], line.covariance[np.ix_(index, index)]
    regular = line.regular and np.linalg.eigvalsh(covariance)[0] > 0.0
    if not regular or center[2] - center[1] < POINT_WIDTHS * pixels.psf_sigma_px:
        return fit_untrailed(pixels, detection)
    near = line.pixels.near(2.7 * line.width_px)
    reach = center[2] - center[1] + 6.0 * line.width_px
    near = near.take(np.abs(near.u - 0.5 * (center[1] + center[2])) < reach)
    ends = short_trail_posterior(
        near.u, _template(replace(line, pixels=near)), near.value_e, near.variance_e2,
        width_px=line.width_px, center=center, covariance=covariance, line_parameters=2,
    )  # fmt: skip
    if ends.end1 - ends.end0 < POINT_WIDTHS * pixels.psf_sigma_px:
        return fit_untrailed(pixels, detection)
    return _record(pixels, detection, line, ends, (False, False), crosses)


def _record(
    pixels: StreakPixels,
    detection: Detection,
    line: LineFit,
    ends: EndPosterior,
    edges: tuple[bool, bool],
    crosses: bool,
) -> StreakFit:
    """Final line with the ends' posterior, width, light curve and flags."""
    line = moved_to_middle(line, (ends.end0, ends.end1), edges)
    shift = 0.5 * (ends.end0 + ends.end1)
    blur = np.sqrt(np.maximum(np.diag(ends.covariance_px2), 0.0))
    free = tuple(p for p in line.free if p not in (END0, END1))
    line = score(
        line.pixels, line.parameters, free,
        half_px=line.half_px, blur_px=(float(blur[0]), float(blur[1])), iterations=MAX_ITERATIONS,
    )  # fmt: skip
    if not line.regular:
        raise NoTrailError(Reason.IRREGULAR)
    ln_width, ln_width_err = width_estimate(line, MAX_ITERATIONS)
    lit = (ends.end0 - shift, ends.end1 - shift)
    curve, _ = _light_curve(line, lit)
    everything = usable_pixels(pixels, line.pixels.frame, 5.0 * line.width_px + abs(float(line.parameters[SAGITTA])))
    seen = flashes(line, everything, lit) if crosses else []
    result = TrailResult(
        line=line,
        ends=ends,
        shift_px=shift,
        edges=edges,
        crosses=crosses,
        ln_width=ln_width,
        ln_width_err=ln_width_err,
        curve=replace(curve, variable=curve.variable or bool(seen)),
        flashes=seen,
    )  # fmt: skip
    gaussian = all(edges) or line.snr**2 > CHANGE_POINT_SNR2 * (ends.end1 - ends.end0) / line.width_px
    return trail_record(pixels, detection, result, gaussian_ends=gaussian)


def fit_untrailed(pixels: StreakPixels, detection: Detection) -> StreakFit:
    """The fit of a point-like detection. Raises `NoTrailError` where there is no source."""
    usable = np.isfinite(pixels.variance_e2) & np.isfinite(pixels.value_e) & (pixels.variance_e2 > 0.0)
    start = (0.5 * (detection.row0 + detection.row1), 0.5 * (detection.col0 + detection.col1))
    near = usable & (np.hypot(pixels.row - start[0], pixels.col - start[1]) < 30.0)
    row, col, value, variance = (
        np.asarray(a[near], dtype=np.float64) for a in (pixels.row, pixels.col, pixels.value_e, pixels.variance_e2)
    )
    width = effective_width_px(pixels.psf_sigma_px)
    point = fit_point(row, col, value, variance, start=start, width_px=width, free_width=False)
    if point is None or point.snr < LEAST_POINT_SNR:
        raise NoTrailError(Reason.NO_SOURCE)
    wide = fit_point(row, col, value, variance, start=(point.row, point.col), width_px=width, free_width=True)
    return point_record(pixels, detection, point, wide)
