"""How much false lines of a frame say of a fit at a distance from them.

Trees, roofs and lights fill a part of a picture, and trails lie in the sky above them.
"""

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from sboc_e2e.icd.products import StreakFit

NEAR: Final = 0.15
"""Sigma of the distance within which a line tells of a fit, as a share of the side of a square of the frame's area. Chosen at
once for look-alikes, not in view of results."""
ANYWHERE: Final = 0.2
"""Share of a line that counts anywhere in the frame. Chosen likewise."""
LEAST_SEEN: Final = 0.3
"""Share of the distance's distribution that a frame holds at least: half of it at a border. Bounds what lies outside."""
POINTS: Final = 5
"""Places along a fit at which it is held against lines: a budget of work."""


def told_at_distance(fits: Sequence[StreakFit], place: NDArray[np.float64], shape: tuple[int, int]) -> NDArray[np.float64]:
    """Weights (n, k) of lines for fits (n). Over all places that a line may have in the frame their mean is about one.

    place : (k, 2) row and column of the middles of the lines. shape : rows, columns of the frame.
    """
    side = NEAR * math.sqrt(shape[0] * shape[1])
    ends = np.array([(fit.row0, fit.col0, fit.row1, fit.col1) for fit in fits]).reshape(-1, 4)
    near = np.zeros((len(fits), len(place)))
    for u in (np.arange(POINTS) + 0.5) / POINTS:
        at = ends[:, :2] + u * (ends[:, 2:] - ends[:, :2])
        kernel = np.ones((len(fits), len(place)))
        for axis, size in enumerate(shape):
            seen = ndtr((size - at[:, axis]) / side) - ndtr(-at[:, axis] / side)
            apart = (at[:, axis][:, None] - place[None, :, axis]) / side
            density = np.exp(-0.5 * apart**2) / (math.sqrt(2.0 * math.pi) * side)
            kernel *= size * density / np.maximum(seen, LEAST_SEEN)[:, None]
        near += kernel / POINTS
    return np.asarray(ANYWHERE + (1.0 - ANYWHERE) * near)
