"""Ends of trails that fade: whether the light stops with a step or runs out below the noise, and how far it was seen.

A fit of one brightness puts the end of a fading trail where the light falls below half of what it was, and calls that exact.
Vignetting, a phase that changes and a shadow end trails in this way. What is seen then is a lower limit: the object may go
on, too faint, to the border. So the light is followed in blocks along the line, each with the level of the sky beside it, for
at a vignetted border the frame's own level is wrong. The best fall that never rises (isotonic regression: Barlow et al. 1972)
is compared with the best step. Where the fall is worth `LEAST_EVIDENCE` more, the end is where the fall is last seen, and its
interval reaches the border.
"""

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.special import ndtr

from ground.streaks.arc import Arc
from ground.streaks.centre_line import effective_width_px
from ground.streaks.light_blocks import BLOCK_WIDTHS, LIT_WIDTHS, Array, Blocks, blocks_of, light_beside, sums_before, weights_of
from ground.streaks.light_end import LightEnd, light_end
from ground.streaks.trail_pixels import TrailPixels, usable_pixels
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.products import StreakFit, StreakPixels

ABOVE_SIGMAS: Final = 3.0
"""A block beyond an end that stands so far above the best fall holds another source: the fall is pulled up by it already."""

STAR_ROUNDS: Final = 4
"""Blocks that stars cover beyond an end, and their neighbours."""

WINDOW_SNR: Final = 15.0
"""S/N of the light before the end in which a step is looked for. A straight fall to nothing of this S/N is worth 12 in log
likelihood more than the best step; a brightness that changes by 30 % over it and then stops, 1."""

OTHER_LIGHT: Final = 0.07
"""Light of a block beyond an end that is none of the trail's, as a share of the trail's mean light (one sigma, beside the
noise): unlisted stars, roofs, its own wings. From S/N 300 on a hundredth of a trail's light is far above the noise. Two meteors
were followed 25 and 220 px beyond their ends, over stars and a dome of 1 to 9 % of their light. Chosen in view of them."""

LEAST_SNR: Final = 10.0
"""Fainter trails do not tell a step from a fall."""

LEAST_EVIDENCE: Final = 5.0
"""Gain in log likelihood from which a fall is believed. Noise on a step gives the fall, which is free to follow it, 1 to 2."""

RUNS_ON_WIDTHS: Final = (1.0, 2.0, 4.0)
"""Lengths in widths of the blocks in which light is followed that may be the trail's: short ones, as regions end six widths
beyond an end, and long ones for faint light."""
RUNS_ON_SIGMAS: Final = 3.0
"""Light of a block beyond an end, without `OTHER_LIGHT`, from which it may be the trail's."""
BLURRED_SHARE: Final = 0.02
"""Light that a real lens throws beyond a step, as a share of the light before it (one sigma): most of what a Gaussian misplaces,
`ground.vetting.likelihood.PSF_SHAPE_ERROR`."""

DOUBT: Final = 3.0
"""Gain from which the end stays but its interval reaches to the border. Of 60 ends of uniform drawn trails of S/N 15 to 300, 4
had as much and 1 had `LEAST_EVIDENCE`; with one end in five fading, a fall is then as likely as a step."""

BEYOND_SNR: Final = 4.0
"""S/N of light beyond an end, its brightest block left out as that of a star, from which the end is none."""

FALL_SNR: Final = 3.0
"""The same of light beyond an end that is known to fall, with its brightest block."""

SEEN_DROP: Final = 0.5
"""Light is seen as far as cutting it off there costs less than this in log likelihood: one sigma."""

AT_BORDER_WIDTHS: Final = 6.0
"""A fall that is seen to within so many widths of the border runs over it."""

MASK_WIDTHS: Final = 3.0
"""An end is one of the mask if no pixel can be used so many widths beyond it."""

STEP_WIDTHS: Final = 0.1
"""Step of the places where a stop is tried: an error of half of it changes the light of a block by 1.3 %."""

BLUR_WIDTHS: Final = 8.0
"""So many widths from a stop the light is whole or none to 1e-15."""

AGREE_BLOCKS: Final = 1.5
"""Blocks within which a fall and a fit agree on an end. The fall is then the finer measure. Chosen in view of one drawn trail."""

LEAST_BLOCKS: Final = 6
"""Fewer blocks from the middle outwards leave no window before the end. Chosen, not measured."""


@dataclass(frozen=True, kw_only=True)
class Fade:
    """An end as followed outwards: where its light was last seen (px from the middle), and how far inwards it may have ended."""

    seen_px: float
    inwards_px: float


def with_fading_ends(fit: StreakFit, pixels: StreakPixels) -> StreakFit:
    """The fit, its ends moved to where the light is last seen and their intervals widened to the border where a trail fades.

    Ends that step, ends that lie on the border already and fits without a line come back as they are.
    """
    if fit.flags & (StreakFlag.FIT_FAILED | StreakFlag.POINT_LIKE) or not fit.snr > LEAST_SNR:
        return fit
    arc = Arc.of(fit)
    width = effective_width_px(fit.width_px)
    all_near = usable_pixels(pixels, arc.chord, math.inf)
    straight = replace(all_near, v=all_near.v - arc.height_px(all_near.u))
    for end, flag in enumerate((StreakFlag.EDGE0, StreakFlag.EDGE1)):
        if flag not in fit.flags:
            outwards = replace(straight, u=straight.u if end else -straight.u)
            fit = _with_end_followed(fit, end, outwards, arc, width, arc.border_px(end, pixels.frame_shape))
    return fit


def _with_end_followed(fit: StreakFit, end: int, outwards: TrailPixels, arc: Arc, width_px: float, border_px: float) -> StreakFit:
    """The fit with one end followed outwards. arc : the fit's line before any end was moved."""
    half_px = arc.half_px
    blocks = blocks_of(outwards, width_px, border_px)
    other = OTHER_LIGHT * max(fit.flux_e, 0.0) / max(fit.length_px, 1.0)
    beyond = np.where(blocks.place > half_px, other, 0.0)
    blocks = replace(blocks, sigma=np.hypot(blocks.sigma, beyond))
    fade = _fade(blocks, half_px, width_px, border_px)
    seen_px = half_px if fade is None else fade.seen_px
    if seen_px > half_px:  # where it went outwards, the lines beside it have a say
        blocks = _without_light_beside(blocks, outwards, half_px, width_px, border_px)
        fade = _fade(blocks, half_px, width_px, border_px)
    light = light_end(outwards, half_px, width_px, border_px)
    place_px = _place_of(light, fade, half_px, blocks.length_px)
    own = fit.end_interval_px[end].copy()
    if fade is not None or place_px < half_px:
        # a fall reaches to the border; where light is lost before the fit's end without one, that end may be right
        inwards_px = 0.0 if fade is None else fade.inwards_px
        reach_px = half_px + own[1] if fade is None else border_px + width_px
        moved = _with_end(fit, end, (-inwards_px, reach_px - place_px), place_px, border_px, arc, width_px)
        lit = _with_light_of(moved, blocks, half_px, place_px, width_px)
        fit = _with_curve(lit, end, blocks, half_px, fit.length_px)
    elif seen_px > half_px:  # the trail's light or that of stars: the end stays, and may lie there
        fit = _reaching_to(fit, end, seen_px - half_px)
    elif _ends_at_a_mask(outwards, half_px, width_px, border_px):
        fit = _reaching_to(fit, end, border_px - half_px)
    else:
        longer = (blocks_of(outwards, width_px, border_px, n) for n in RUNS_ON_WIDTHS)
        runs_on_px = max(_runs_on_to(each, half_px, width_px, border_px) for each in longer)
        if runs_on_px > half_px + own[1]:
            fit = _reaching_to(fit, end, runs_on_px - half_px)
    return _with_light_interval(fit, end, light, place_px, own)


def _place_of(light: LightEnd, fade: Fade | None, half_px: float, block_px: float) -> float:
    """Where the trail ends, px from the middle: at the nearer of the light's end and the place where a fall is last seen."""
    if fade is None:
        return min(light.place_px, half_px)
    if light.place_px == half_px and abs(fade.seen_px - half_px) <= AGREE_BLOCKS * block_px:
        return fade.seen_px
    return min(light.place_px, max(fade.seen_px, half_px))


def _with_light_interval(fit: StreakFit, end: int, light: LightEnd, place_px: float, own_px: Array) -> StreakFit:
    """The fit with the interval of its light's end, which is on the border with the end. own_px : (2,) of one brightness."""
    intervals = fit.light_interval_px.copy() if len(fit.light_interval_px) else fit.end_interval_px.copy()
    on_border = (StreakFlag.EDGE0, StreakFlag.EDGE1)[end] in fit.flags
    lost = np.array([min(light.bright_px - place_px, own_px[0]), max(light.faint_px - place_px, own_px[1])])
    intervals[end] = 0.0 if on_border else lost
    return replace(fit, light_interval_px=intervals)


def _with_light_of(fit: StreakFit, blocks: Blocks, half_px: float, place_px: float, width_px: float) -> StreakFit:
    """The fit with the light between its old end and a later one."""
    more = (blocks.place > half_px + width_px) & (blocks.place < place_px) & np.isfinite(blocks.sigma)
    return replace(
        fit,
        flux_e=fit.flux_e + float(blocks.density[more].sum()) * blocks.length_px,
        flux_err_e=math.hypot(fit.flux_err_e, math.sqrt(float(np.sum(blocks.sigma[more] ** 2))) * blocks.length_px),
    )


def _without_light_beside(blocks: Blocks, outwards: TrailPixels, end_px: float, width_px: float, border_px: float) -> Blocks:
    """The blocks, those beyond an end without the light that blocks on lines beside the trail have in the mean.

    Its scatter, without their noise, is added to the errors. Where too little of such lines is seen the blocks stay as they are.
    """
    light, noise = light_beside(outwards, end_px, width_px, border_px)
    if not light.size:
        return blocks
    mean, scatter = max(float(light.mean()), 0.0), math.sqrt(max(float(light.var() - noise.mean()), 0.0))
    beyond = blocks.place > end_px
    return replace(
        blocks,
        density=blocks.density - np.where(beyond, mean, 0.0),
        sigma=np.hypot(blocks.sigma, np.where(beyond, scatter, 0.0)),
    )


def _reaching_to(fit: StreakFit, end: int, beyond_px: float) -> StreakFit:
    """The fit with an end that stays and an interval that reaches so far beyond it."""
    interval = fit.end_interval_px.copy()
    interval[end, 1] = beyond_px
    return replace(fit, end_interval_px=interval, flags=fit.flags | StreakFlag.ENDS_NOT_GAUSSIAN)


def _runs_on_to(blocks: Blocks, end_px: float, width_px: float, border_px: float) -> float:
    """How far light goes on beyond an end without a gap, px from the middle: the end itself where it stops.

    A hundredth of a bright trail's light is seen far beyond where half of it is lost. It may be that of other sources, so that
    the end does not move, but the trail may go on as far as that.
    """
    first = math.ceil(end_px / blocks.length_px)
    inside = first - math.ceil(BLOCK_WIDTHS * width_px / blocks.length_px)
    if not 0 <= inside < first < blocks.density.size:
        return end_px
    before = float(np.median(blocks.density[inside:first]))
    near = blocks.place[first:] - 0.5 * blocks.length_px - end_px
    # the light of a step that the profile's width blurs; see `_best_step`
    blurred = width_px / blocks.length_px * (_ramp(-near / width_px) - _ramp(-(near + blocks.length_px) / width_px))
    sigma = np.hypot(blocks.sigma[first:], BLURRED_SHARE * before)
    lit = blocks.density[first:] - before * blurred > RUNS_ON_SIGMAS * sigma
    number = int(np.argmin(lit)) if not lit.all() else lit.size
    return min(float(first + number) * blocks.length_px, border_px) if number else end_px


def _ends_at_a_mask(outwards: TrailPixels, end_px: float, width_px: float, border_px: float) -> bool:
    """Whether the last pixels that can be used lie at an end, and not at the border: the light may go on below the mask.

    Regions reach `onboard.downlink.roi.LEAST_END_MARGIN_SIGMA` widths beyond an end, twice as far as is asked here.
    """
    lit = outwards.u[np.abs(outwards.v) < LIT_WIDTHS * width_px]
    last = float(lit.max(initial=0.0))
    return border_px - last > LIT_WIDTHS * width_px and last < end_px + MASK_WIDTHS * width_px


def _gains(density: Array, sigma: Array, model: Array) -> Array:
    """(n,) log likelihood of each block with a model over that without light."""
    return np.asarray(0.5 * weights_of(sigma) * (density**2 - (density - model) ** 2))


def _falling(density: Array, sigma: Array) -> Array:
    """The best light (n,) that never rises outwards and is never negative."""
    from scipy.optimize import isotonic_regression  # takes a quarter of a second, which frames without trails do not need

    weights = np.maximum(weights_of(sigma), 1e-30)
    return np.maximum(isotonic_regression(density, weights=weights, increasing=False).x, 0.0)


def _best_step(blocks: Blocks, sigma: Array, width_px: float, first: int) -> float:
    """Log likelihood of the best constant light that stops, from a block on; the profile's width blurs the stop.

    The share of a block that is lit is the mean of a normal distribution function over it: 1 or 0 but for those near the stop.
    """
    weight, length = weights_of(sigma[first:]), blocks.length_px
    light, n = weight * blocks.density[first:], weight.size
    stops = STEP_WIDTHS * width_px * np.arange(1, 1 + round(n * length / (STEP_WIDTHS * width_px)))
    block, reach = (stops // length).astype(np.int64), math.ceil(BLUR_WIDTHS * width_px / length)
    wholly = np.clip(block - reach, 0, n)
    total, square = (sums_before(each)[wholly] for each in (light, weight))
    for near in (block + away for away in range(-reach, reach + 1)):
        inside = (near >= 0) & (near < n)
        u = (stops - near * length) / width_px
        lit = np.where(inside, width_px / length * (_ramp(u) - _ramp(u - length / width_px)), 0.0)
        at = np.where(inside, near, 0)
        total, square = total + lit * light[at], square + lit**2 * weight[at]
    gains = 0.5 * np.maximum(total, 0.0) ** 2 / np.maximum(square, 1e-300)
    return float(gains.max(initial=0.0))


def _ramp(x: Array) -> Array:
    """Integral of the normal distribution function from minus infinity to x."""
    return np.asarray(x * ndtr(x) + np.exp(-0.5 * x**2) / math.sqrt(2.0 * math.pi))


def _fade(blocks: Blocks, end_px: float, width_px: float, border_px: float) -> Fade | None:
    """How the light before and beyond an end fades; None where it steps, or too little is seen."""
    density, sigma = blocks.density, blocks.sigma
    if density.size < LEAST_BLOCKS:
        return None
    fall = _falling(density, sigma)
    for _ in range(STAR_ROUNDS):  # light that stands above any fall beyond the end is a star's, even if it covers two blocks
        above = (blocks.place > end_px) & (density - fall > ABOVE_SIGMAS * sigma)
        if not above.any():
            break
        sigma = np.where(above, math.inf, sigma)
        fall = _falling(density, sigma)
    seen = _last_seen(_gains(density, sigma, fall))
    inwards = np.cumsum((weights_of(sigma) * np.maximum(density, 0.0) ** 2)[seen::-1])
    # both ends of the window move by whole blocks: at least two are needed to tell a step from a fall
    start = max(min(seen - int(np.searchsorted(inwards, WINDOW_SNR**2)), seen - 2), 0)
    window = slice(start, None)
    evidence = float(_gains(density[window], sigma[window], _falling(density[window], sigma[window])).sum())
    evidence -= _best_step(blocks, sigma, width_px, start)
    seen_px = (seen + 1) * blocks.length_px
    beyond = (blocks.place > end_px + width_px) & (blocks.place < seen_px) & np.isfinite(sigma)
    falls = evidence >= LEAST_EVIDENCE
    runs_on = _snr(density[beyond], sigma[beyond]) > FALL_SNR if falls else False
    runs_on |= _snr_without_brightest(density[beyond], sigma[beyond]) > BEYOND_SNR
    if not runs_on:  # noise beyond the end is no reason to move it outwards
        if not evidence > DOUBT:
            return None
        seen_px, inwards_px = (min(seen_px, end_px), blocks.length_px) if falls else (end_px, 0.0)
        return Fade(seen_px=seen_px, inwards_px=inwards_px)
    # what runs on without a visible fall may be stars in a row: then the fitted end is the right one
    doubtful = 0.0 if falls else max(seen_px - end_px, 0.0)
    return Fade(seen_px=min(seen_px, border_px), inwards_px=blocks.length_px + doubtful)


def _snr(density: Array, sigma: Array) -> float:
    """S/N of the light of some blocks together."""
    weight = sigma**-2
    return float(weight @ density) / math.sqrt(float(weight.sum())) if density.size else 0.0


def _snr_without_brightest(density: Array, sigma: Array) -> float:
    """S/N of the light of some blocks but the brightest."""
    if density.size < 2:
        return 0.0
    rest = np.arange(density.size) != int(np.argmax(density / sigma))
    return _snr(density[rest], sigma[rest])


def _last_seen(gains: Array) -> int:
    """The block as far as which light is seen."""
    total = np.cumsum(gains)
    return int(np.flatnonzero(total >= total.max() - SEEN_DROP)[0])


def _with_end(
    fit: StreakFit, end: int, interval_px: tuple[float, float], seen_px: float, border_px: float, arc: Arc, width_px: float
) -> StreakFit:
    """The fit with one end where its light was last seen, or on the border where it is seen to there.

    interval_px : of the object's end about `seen_px`.
    """
    over = border_px - seen_px < AT_BORDER_WIDTHS * width_px
    place = border_px if over else seen_px
    along = np.array([fit.row1 - fit.row0, fit.col1 - fit.col0]) / max(fit.length_px, 1e-6)
    across = np.array([-along[1], along[0]])
    interval = fit.end_interval_px.copy()
    low, high = interval_px
    interval[end] = (0.0, 0.0) if over else (min(low, interval[end, 0]), high)
    spread = 0.5 * float(interval[end, 1] - interval[end, 0])
    block = slice(2 * end, 2 * end + 2)
    kept = float(across @ fit.covariance_px2[block, block] @ across)
    covariance = fit.covariance_px2.copy()
    covariance[block] = covariance[:, block] = 0.0
    covariance[block, block] = kept * np.outer(across, across) + spread**2 * np.outer(along, along)
    flags = fit.flags | StreakFlag.ENDS_NOT_GAUSSIAN
    if over:
        flags |= StreakFlag.EDGE1 if end else StreakFlag.EDGE0
    row, col = (float(x) for x in arc.chord.to_pixel(place if end else -place, arc.height_px(place)))
    moved = replace(
        fit,
        **({"row1": row, "col1": col} if end else {"row0": row, "col0": col}),  # type: ignore[arg-type]
        covariance_px2=covariance,
        end_interval_px=interval,
        flags=flags,
    )
    longer = moved.length_px / max(fit.length_px, 1e-6)
    return replace(moved, sagitta_px=fit.sagitta_px * longer**2, sagitta_err_px=fit.sagitta_err_px * longer**2)


def _with_curve(fit: StreakFit, end: int, blocks: Blocks, half_px: float, length_px: float) -> StreakFit:
    """The fit with as many more or fewer bins of its light curve as it is longer or shorter at one end than `length_px`."""
    number = fit.light_curve_e_px.size
    if not number:
        return fit
    bin_px = length_px / number
    more = round((fit.length_px - length_px) / bin_px)
    if more < 0:
        kept = slice(0, number + more) if end else slice(-more, None)
        return replace(fit, light_curve_e_px=fit.light_curve_e_px[kept], light_curve_err_e_px=fit.light_curve_err_e_px[kept])
    known = np.isfinite(blocks.sigma)
    place = half_px + (np.arange(more) + 0.5) * bin_px
    added = [np.interp(place, blocks.place[known], each[known]).astype(np.float32) for each in (blocks.density, blocks.sigma)]
    curves = (fit.light_curve_e_px, fit.light_curve_err_e_px)
    joined = [np.append(old, new) if end else np.append(new[::-1], old) for old, new in zip(curves, added, strict=True)]
    return replace(fit, light_curve_e_px=joined[0], light_curve_err_e_px=joined[1])
