"""Centre line of a trail by Fisher scoring: first found coarse to fine, then refined with the ends as known so far."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ground.streaks.no_trail import NoTrailError, Reason
from ground.streaks.trail_model import (
    DENSITY,
    END0,
    END1,
    LN_WIDTH,
    N_PARAMETERS,
    PIXEL_VARIANCE_PX2,
    Q1,
    Q2,
    SAGITTA,
    SLOPE,
    V_MID,
    Scale,
    accumulate,
    fisher_scoring,
    mean_all,
    quartic_px4,
)
from ground.streaks.trail_pixels import TrailPixels

BEYOND_PX: Final = 1e7
"""Coordinate of an end beyond the frame's edge."""

SEARCH_STAGES: Final = ((2.5, 3), (1.6, 3), (1.0, 5))
"""Widening of the PSF and iterations of each stage of the search for the line."""

CURVED_WIDTHS: Final = 40.0
"""Shorter trails (in widths) are straight."""

SEARCH_PIXELS: Final = 2000
"""A budget of work: the search only starts the fit, which uses all pixels. Chosen, not measured."""
SEARCH_BLOCK_PX: Final = 0.5
"""The line is searched in at most about this many values: pixels, or of longer trails means over blocks this wide."""


def effective_width_px(psf_sigma_px: float) -> float:
    """Gaussian width of the PSF integrated over a pixel."""
    return math.sqrt(psf_sigma_px**2 + PIXEL_VARIANCE_PX2)


@dataclass(frozen=True, kw_only=True, eq=False)
class LineFit:
    """Parameters of `trail_model` with covariance (9, 9), in the axes of `pixels.frame`.

    half_px : half of the reference length that x = u / half_px refers to. blur_px : extra width of both ends.
    """

    pixels: TrailPixels
    parameters: NDArray[np.float64]
    covariance: NDArray[np.float64]
    half_px: float
    blur_px: tuple[float, float]
    free: tuple[int, ...]
    chi2: float
    snr: float
    n_pixels: int

    @property
    def regular(self) -> bool:
        """Whether the iteration ended at something that can be a trail: finite, bright, not inside out or out of scale."""
        p = self.parameters
        if not (np.isfinite(p).all() and np.isfinite(self.covariance).all() and p[DENSITY] > 0.0):
            return False
        # brightness must not turn negative along the trail, nor an end run away from where it was looked for
        shape = abs(p[Q1]) + abs(p[Q2]) < 3.0 and abs(p[LN_WIDTH]) < 4.0
        stray0 = abs(p[END0] + self.half_px) if END0 in self.free else 0.0
        stray1 = abs(p[END1] - self.half_px) if END1 in self.free else 0.0
        return bool(shape and max(stray0, stray1) < 0.9 * self.half_px + 3.0)

    @property
    def scale(self) -> Scale:
        """What the kernels of `trail_model` take for this line, without the fourth cumulant."""
        return self.half_px, *self.blur_px, 0.0

    @property
    def across_px(self) -> NDArray[np.float64]:
        """(n,) how far the pixels lie from the centre line, bend included, across the axes."""
        p, x = self.parameters, self.pixels.u / self.half_px
        return np.asarray(self.pixels.v - p[V_MID] - p[SLOPE] * x - p[SAGITTA] * (1.0 / 3.0 - x * x))

    @property
    def width_px(self) -> float:
        """Width across the trail, pixel included."""
        return math.exp(self.parameters[LN_WIDTH])


def uniform_trail(density_e_px: float, half_px: float, edges: tuple[bool, bool], width_px: float) -> NDArray[np.float64]:
    """Parameter vector of a straight, uniform trail between -half and +half (an end at the frame's edge is beyond it)."""
    parameters = np.zeros(N_PARAMETERS)
    parameters[DENSITY] = density_e_px
    parameters[END0] = -BEYOND_PX if edges[0] else -half_px
    parameters[END1] = BEYOND_PX if edges[1] else half_px
    parameters[LN_WIDTH] = math.log(width_px)
    return parameters


def _limits(width_px: float) -> NDArray[np.float64]:
    """Largest change of each parameter in one iteration: lengths of the PSF's size; the density is linear, so free."""
    limits = np.full(N_PARAMETERS, 0.7 * width_px)
    limits[DENSITY] = np.inf
    limits[LN_WIDTH] = 0.3
    limits[[Q1, Q2]] = 0.5
    return limits


def score(
    pixels: TrailPixels,
    parameters: NDArray[np.float64],
    free: Sequence[int],
    *,
    half_px: float,
    blur_px: tuple[float, float],
    iterations: int,
    quartic: bool = True,
) -> LineFit:
    """Fisher scoring of the free parameters."""
    mask = np.zeros(N_PARAMETERS, dtype=np.bool_)
    mask[list(free)] = True
    quartic_term = quartic_px4(pixels.frame.angle_rad) if quartic else 0.0
    found, covariance, chi2, snr2, used, _ = fisher_scoring(
        parameters, mask, _limits(math.exp(parameters[LN_WIDTH])),
        pixels.u, pixels.v, pixels.value_e, pixels.variance_e2, (half_px, *blur_px, quartic_term), iterations,
    )  # fmt: skip
    return LineFit(
        pixels=pixels,
        parameters=found,
        covariance=covariance,
        half_px=half_px,
        blur_px=blur_px,
        free=tuple(free),
        chi2=chi2,
        snr=math.sqrt(snr2),
        n_pixels=used,
    )


def turned_along(line: LineFit) -> LineFit:
    """The same line in axes along it: offset and slope become zero."""
    parameters = line.parameters.copy()
    frame = line.pixels.frame.turned(0.0, parameters[V_MID], parameters[SLOPE] / line.half_px)
    parameters[V_MID] = parameters[SLOPE] = 0.0
    return LineFit(
        pixels=line.pixels.in_frame(frame),
        parameters=parameters,
        covariance=line.covariance,
        half_px=line.half_px,
        blur_px=line.blur_px,
        free=line.free,
        chi2=line.chi2,
        snr=line.snr,
        n_pixels=line.n_pixels,
    )


def curvature_statistic(line: LineFit) -> float:
    """Rao's score statistic of a free sagitta, at the best straight line (1 by chance).

    Raises `NoTrailError` where the pixels do not determine the straight line.
    """
    index = np.array([*line.free, SAGITTA], dtype=np.int64)
    gradient, fisher = np.empty(index.size), np.empty((index.size, index.size))
    p = line.pixels
    accumulate(line.parameters, p.u, p.v, p.value_e, p.variance_e2, line.scale, index, gradient, fisher)
    try:
        row = np.linalg.solve(fisher[:-1, :-1], fisher[:-1, -1])
    except np.linalg.LinAlgError as error:
        raise NoTrailError(Reason.SINGULAR) from error
    information = float(fisher[-1, -1] - row @ fisher[:-1, -1])
    if not information > 0.0:
        raise NoTrailError(Reason.SINGULAR)
    return float((gradient[-1] - row @ gradient[:-1]) ** 2) / information


def minus_two_ln_likelihood(line: LineFit) -> float:
    """Of all the line's pixels, but for a constant; its noise is Gaussian with the object's own Poisson noise."""
    p = line.pixels
    mean = mean_all(line.parameters, p.u, p.v, line.scale)
    variance = p.variance_e2 + np.maximum(mean, 0.0)
    return float(np.sum((p.value_e - mean) ** 2 / variance + np.log(variance)))


def _searched(pixels: TrailPixels, parameters: NDArray[np.float64], half_px: float, width_px: float) -> LineFit:
    """Coarse to fine with widened PSFs; bent where the start is."""
    free = (DENSITY, V_MID, SLOPE) + ((SAGITTA,) if parameters[SAGITTA] != 0.0 else ())
    for widening, iterations in SEARCH_STAGES:
        parameters[LN_WIDTH] = math.log(widening * width_px)
        line = score(pixels, parameters, free, half_px=half_px, blur_px=(0.0, 0.0), iterations=iterations, quartic=False)
        parameters = line.parameters
    return line


def find_line(
    pixels: TrailPixels,
    half_px: float,
    edges: tuple[bool, bool],
    *,
    width_px: float,
    sagitta_px: float,
    max_shift_px: float,
) -> LineFit | None:
    """The line near that of the detection, with given ends; None if it diverges or has no light."""
    near = pixels.near(max_shift_px + 3.0 * width_px + abs(sagitta_px))
    if near.u.size < 8:
        return None
    if near.u.size > SEARCH_PIXELS:
        blocks_across = 2.0 * (max_shift_px + 3.0 * width_px + abs(sagitta_px)) / SEARCH_BLOCK_PX
        near = near.in_blocks(float(near.u[-1] - near.u[0]) * blocks_across / SEARCH_PIXELS, SEARCH_BLOCK_PX)
    line = _searched(near, uniform_trail(0.0, half_px, edges, width_px), half_px, width_px)
    if sagitta_px != 0.0:
        parameters = uniform_trail(0.0, half_px, edges, width_px)
        parameters[SAGITTA], parameters[V_MID] = sagitta_px, sagitta_px * 2.0 / 3.0  # the arc meets the chord at both ends
        bent = _searched(near, parameters, half_px, width_px)
        gain = minus_two_ln_likelihood(line) - minus_two_ln_likelihood(bent)
        if bent.regular and (not line.regular or gain > math.log(near.u.size) + 3.0):
            line = bent
    parameters = line.parameters
    if not line.regular or abs(parameters[V_MID]) + abs(parameters[SLOPE]) > 3.0 * max_shift_px:
        return None
    long_enough = 2.0 * half_px > CURVED_WIDTHS * width_px
    if SAGITTA not in line.free and long_enough and curvature_statistic(line) > math.log(near.u.size) + 3.0:
        parameters = parameters.copy()
        line = score(near, parameters, (*line.free, SAGITTA), half_px=half_px, blur_px=(0.0, 0.0), iterations=8, quartic=False)
        parameters = line.parameters
        if not line.regular:
            return None
    turned = turned_along(line)
    return LineFit(
        pixels=pixels.in_frame(turned.pixels.frame).near(5.0 * width_px + 0.7 + abs(parameters[SAGITTA])),
        parameters=turned.parameters,
        covariance=turned.covariance,
        half_px=half_px,
        blur_px=(0.0, 0.0),
        free=turned.free,
        chi2=turned.chi2,
        snr=turned.snr,
        n_pixels=turned.n_pixels,
    )


def moved_to_middle(line: LineFit, ends: tuple[float, float], edges: tuple[bool, bool]) -> LineFit:
    """The line with its origin midway between `ends` (u of the present axes) and x = +-1 at them."""
    middle, half = 0.5 * (ends[0] + ends[1]), max(0.5 * (ends[1] - ends[0]), 0.5)
    p = line.parameters.copy()
    scale, shift = half / line.half_px, middle / line.half_px
    sagitta, q1, q2 = p[SAGITTA], p[Q1], p[Q2]
    centre = p[V_MID] + p[SLOPE] * shift + sagitta * (1.0 / 3.0 - shift * shift)
    slope = (p[SLOPE] - 2.0 * sagitta * shift) * scale
    p[SAGITTA] = sagitta * scale**2
    p[V_MID] = centre - p[SAGITTA] / 3.0
    p[SLOPE] = slope
    mean = 1.0 + q1 * shift + q2 * (shift**2 - 1.0 / 3.0) + q2 * scale**2 / 3.0
    p[DENSITY] *= max(mean, 0.05)
    p[Q1] = (q1 + 2.0 * q2 * shift) * scale / max(mean, 0.05)
    p[Q2] = q2 * scale**2 / max(mean, 0.05)
    p[END0] = -BEYOND_PX if edges[0] else -half
    p[END1] = BEYOND_PX if edges[1] else half
    frame = line.pixels.frame.turned(middle, 0.0, 0.0)
    return LineFit(
        pixels=line.pixels.in_frame(frame),
        parameters=p,
        covariance=line.covariance,
        half_px=half,
        blur_px=line.blur_px,
        free=line.free,
        chi2=line.chi2,
        snr=line.snr,
        n_pixels=line.n_pixels,
    )
