"""A line through the pixels of all frames of a track: one likelihood, from a line through the frames' places as a start.

Places of S/N 3 to 5 are maxima of noise as often as of light, and a line through them is no better than they are. Here the line
is what is fitted: Fisher scoring on the sum of the frames' log likelihoods, each at the place where the line crosses its
frame. The light of a frame is free, but for a prior about that of all frames.

The likelihood of so faint frames is no parabola, and one star may make a maximum of its own. So what is published is the mean and
the covariance of the line over the whole likelihood about the most likely line, with a share of frames that a star has spoilt.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from ground.importance import Proposals, adapted
from ground.normal_equations import scaled_inverse
from ground.photometry.usual_light import BRIGHTNESS, usual_light
from ground.streaks.across import REACH_PX, AcrossPixels
from ground.streaks.across_likelihood import SPOILT, AcrossLikelihood

Array = NDArray[np.float64]

COUNTS: Final = 0.9
"""Objects brighter than F are as F to minus this: light goes as the size squared, and the number of objects larger than a size as
the size to -1.45 above 1 cm and to -2.10 below (docs/physics.md, "Population")."""
FOREIGN_SIGMAS: Final = 3.5
"""A right frame in 2,000 shows more light or is farther off the line. What does is lit by a star and does not count."""
ITERATIONS: Final = 8
"""Of Fisher scoring from a start within the PSF; frames are judged from the fourth on. A budget of work; chosen, not measured."""
FIRST_JUDGED: Final = 3  # the iteration, counted from 0, from which on frames are judged: the line has settled by then
BORDER_PX: Final = 0.1
"""Width over which the likelihood falls off where a line leaves the pixels. Chosen, not measured."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CrossedFrame:
    """A frame that the line crosses.

    offset_px : (2,) place and half of the tilt of the zero line; by_line : (2, k) their derivatives by the line's parameters.
    variance_px2 : (2,) of both from the frame's attitude and the camera's turning.
    """

    pixels: AcrossPixels
    offset_px: Array
    by_line: Array
    variance_px2: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class PixelLine:
    """Mean (k,) and covariance (k, k) of the line's parameters, and which frames the most likely line rests on."""

    parameters: Array
    covariance: Array
    counts: NDArray[np.bool_]


def line_of_pixels(frames: Sequence[CrossedFrame], start: Array, information: Array, right: Array) -> PixelLine | None:
    """The line; None where the pixels lead it away from its start or fewer than two frames show its light.

    information, right : (k, k) and (k,), normal equations of what is known of the line without these frames.
    """
    pixels = [frame.pixels.without_intruders(frame.offset_px + frame.by_line @ start) for frame in frames]
    line = start
    off_line = np.zeros(len(frames), dtype=np.bool_)
    counts, covariance, usual = ~off_line, information, math.nan
    for iteration in range(ITERATIONS):
        places = [frame.offset_px + frame.by_line @ line for frame in frames]
        light = np.array([each.density(place) for each, place in zip(pixels, places, strict=True)])
        usual = usual_light(light[~off_line])
        if not usual > 0.0:
            return None
        spread2 = (BRIGHTNESS * usual) ** 2
        counts = ~off_line & (light[:, 0] - usual < FOREIGN_SIGMAS * np.sqrt(light[:, 1] + spread2))
        if np.count_nonzero(counts) < 2:
            return None
        density = (light[:, 0] * spread2 + usual * light[:, 1]) / (spread2 + light[:, 1])
        total, slope = information.copy(), right - information @ line
        off = np.zeros(len(frames))
        for k, frame in enumerate(frames):
            gradient, fisher = pixels[k].evidence(places[k], float(density[k]), 1.0 / spread2)
            gradient, fisher = _in_doubt(gradient, fisher, frame.variance_px2)
            off[k] = _sigmas_off(gradient, fisher)
            if counts[k]:
                total += frame.by_line.T @ fisher @ frame.by_line
                slope += frame.by_line.T @ gradient
        covariance = scaled_inverse(total)
        line = line + covariance @ slope
        if iteration >= FIRST_JUDGED and len(frames) > FIRST_JUDGED:
            off_line = off > FOREIGN_SIGMAS
    moved = max(float(np.abs(frame.by_line @ (line - start))[0]) for frame in frames)
    if not (np.isfinite(line).all() and moved < REACH_PX and np.count_nonzero(counts) >= 2):
        return None
    within = _within_doubt(frames, pixels, usual, (line, covariance), information, right)
    return PixelLine(parameters=within[0], covariance=within[1], counts=counts)


def _within_doubt(
    frames: Sequence[CrossedFrame],
    pixels: Sequence[AcrossPixels],
    usual: float,
    start: tuple[Array, Array],
    information: Array,
    right: Array,
) -> tuple[Array, Array]:
    """Mean (k,) and covariance (k, k) of the line over the whole likelihood, spoilt frames included, and over the object's light.

    The most likely line is where noise adds most light. With this light given, a line beside it would be too unlikely.

    usual : light of the object on the most likely line, e-/px. start : that line and the inverse of its Fisher matrix.
    """
    tables = [AcrossLikelihood.of(each) for each in pixels]
    sure = [_sureness(frame, each, start[0], usual) for frame, each in zip(frames, pixels, strict=True)]
    spoilt = [math.log(SPOILT) + each.log_spoilt(usual) for each in tables]

    def log_density(points: Array) -> Array:
        lines, relative = points[:, :-1], points[:, -1]
        light = usual * np.exp(relative)
        total = -COUNTS * relative
        total += lines @ right - 0.5 * np.einsum("mi,ij,mj->m", lines, information, lines)
        for frame, table, share, floor in zip(frames, tables, sure, spoilt, strict=True):
            place = frame.offset_px + lines @ frame.by_line.T
            log = share * table.log(place, light, BRIGHTNESS * light)
            total += np.logaddexp(math.log1p(-SPOILT) + log, floor)
            total -= 0.5 * (np.maximum(np.abs(place[:, 0]) - REACH_PX, 0.0) / BORDER_PX) ** 2
        return np.asarray(total)

    line, covariance = start
    variance = [each.density(frame.offset_px + frame.by_line @ line)[1] for frame, each in zip(frames, pixels, strict=True)]
    relative = 1.0 / float(np.sum(1.0 / (np.array(variance) / usual**2 + BRIGHTNESS**2)))
    draws = adapted(Proposals.of(len(right) + 1), (np.append(line, 0.0), block_diag(covariance, relative)), log_density)
    return draws.mean[:-1], draws.covariance[:-1, :-1]


def _sureness(frame: CrossedFrame, pixels: AcrossPixels, line: Array, usual: float) -> float:
    """Share of a place's information that is left when the frame itself may be off: normal errors widen a parabola by it."""
    _, fisher = pixels.evidence(frame.offset_px + frame.by_line @ line, usual, 0.0)
    return 1.0 / (1.0 + float(fisher[0, 0] * frame.variance_px2[0]))


def _in_doubt(gradient: Array, fisher: Array, variance_px2: Array) -> tuple[Array, Array]:
    """Slope and information of the place when the frame itself may be off by normal errors of this variance."""
    keep = np.linalg.inv(np.eye(2) + fisher * variance_px2)
    known = keep @ fisher
    return keep @ gradient, 0.5 * (known + known.T)


def _sigmas_off(gradient: Array, fisher: Array) -> float:
    """Distance of a frame's own place from the line, in its errors."""
    determinant = float(fisher[0, 0] * fisher[1, 1] - fisher[0, 1] ** 2)
    if not determinant > 0.0:
        return 0.0
    step = np.linalg.solve(fisher, gradient)
    return abs(float(step[0])) * math.sqrt(float(fisher[0, 0]))
