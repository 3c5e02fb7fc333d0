"""Local centre line: offsets of a trail from its straight or curved line where jitter moved the camera."""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solveh_banded

from ground.streaks.centre_line import LineFit
from ground.streaks.trail_model import END0, END1, line_scores

KNOT_SNR: Final = 8.0
"""S/N of the piece of trail between two knots: an offset good to 0.15 px."""

MOST_KNOTS: Final = 100
"""A budget of work: a spline of so many knots follows jitter at 50 cycles in the exposure."""
SHORTEST_PIECE_WIDTHS: Final = 8.0
"""Shorter pieces share much of their light through the PSF at both ends. Chosen, not measured."""


def local_offsets(line: LineFit, ends: tuple[float, float]) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Knots u and offsets v (px) of a piecewise-linear correction, or None where the line needs none (BIC).

    One Fisher-scoring step on hat functions: the information matrix of neighbouring knots is tridiagonal.
    """
    length = ends[1] - ends[0]
    pieces = int(min((line.snr / KNOT_SNR) ** 2, length / (SHORTEST_PIECE_WIDTHS * line.width_px), MOST_KNOTS))
    if pieces < 4:
        return None
    knots = np.linspace(ends[0], ends[1], pieces + 1)
    p = line.pixels
    inside = (p.u > line.parameters[END0]) & (p.u < line.parameters[END1]) & (np.abs(line.across_px) < 4.0 * line.width_px)
    lit = p.take(inside)
    slope, information = line_scores(line.parameters, lit.u, lit.v, lit.value_e, lit.variance_e2, line.half_px)
    place = np.clip((lit.u - ends[0]) * (pieces / length), 0.0, pieces - 1e-9)
    left = place.astype(np.int64)
    right_share = place - left
    n = pieces + 1
    gradient = np.bincount(left, slope * (1.0 - right_share), n) + np.bincount(left + 1, slope * right_share, n)
    diagonal = np.bincount(left, information * (1.0 - right_share) ** 2, n)
    diagonal += np.bincount(left + 1, information * right_share**2, n)
    beside = np.bincount(left + 1, information * right_share * (1.0 - right_share), n)
    if not np.all(diagonal > 0.0):
        return None
    offsets = solveh_banded(np.array([beside, diagonal * (1.0 + 1e-9)]), gradient)
    if float(gradient @ offsets) < n * math.log(max(line.n_pixels, 2)):
        return None
    return knots, np.clip(offsets, -2.0 * line.width_px, 2.0 * line.width_px)
