"""Stars that other frames took out and a track's own frame did not: the light that is left there is not the track's.

A star of S/N 3 to 4.5 is taken out of some frames and missed in others, as noise has it. Where it was missed it may bear out a
track, and the other frames show nothing at its place. Each of the three false tracks of 16 frames with 25,000 stars (seed 56000)
lay on such stars.
"""

import math
from collections.abc import Sequence
from typing import Final

import numba as nb
import numpy as np
from numpy.typing import NDArray

from onboard.image import registration

ACROSS_SIGMAS: Final = 3.0
"""A star is on a trail within so many PSF widths of its line: its smoothed image reaches as far as 2.1 of its own widths."""

AGREE_PX: Final = 2.0
"""Two frames mean the same star within this: at S/N 3 a place errs by 0.4 px, and blends by more. Chosen, not measured."""

TIMES: Final = 2  # frames that took it out: noise passes for a star at one place in 10^5. Chosen, not measured


def by_row(stars: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """A list of stars (n, 2) row, col by growing row, so that a track's rows are found in it without reading all of it."""
    return stars[np.argsort(stars[:, 0], kind="stable")]


def left_in(
    line: NDArray[np.float64],
    own: int,
    removed: Sequence[NDArray[np.uint16]],
    transforms: NDArray[np.float64],
    psf_sigma_px: float,
) -> NDArray[np.float64]:
    """Places (m, 2) row, col of the stars on a segment of frame `own` that other frames took out and this one did not.

    line (2, 2) : its ends, row and col. removed : of each frame, (n, 2) row, col, as `by_row` has them.
    transforms (frames, 2, 3) : of row, col of the centre frame into each.
    """
    centre = registration.apply(registration.inverse(transforms[own]), line)
    ends = centre @ transforms[:, :, :2].transpose(0, 2, 1) + transforms[:, None, :, 2]
    places, frames = [np.zeros((0, 2))], [np.zeros(0, np.intp)]
    for k, stars in enumerate(removed):
        near = _beside(stars, ends[k], ACROSS_SIGMAS * psf_sigma_px, AGREE_PX)
        if len(near):
            there = registration.apply(registration.inverse(transforms[k]), near)
            places.append(registration.apply(transforms[own], there))
            frames.append(np.full(len(near), k))
    place, frame = np.concatenate(places), np.concatenate(frames)
    alike = np.hypot(*(place[:, None] - place).T) < AGREE_PX
    elsewhere = np.array([len(set(frame[same].tolist()) - {own}) for same in alike], np.intp)
    known_here = (alike & (frame == own)).any(axis=1)
    return place[(frame != own) & (elsewhere >= min(TIMES, len(removed) - 1)) & ~known_here]


@nb.njit(cache=True)
def _beside(stars: NDArray[np.uint16], ends: NDArray[np.float64], across_px: float, beyond_px: float) -> NDArray[np.float64]:
    """Which stars (n, 2), by growing row, lie on a segment (2, 2), or so near to it."""
    margin = across_px + beyond_px
    low, high = ends[:, 0].min() - margin, ends[:, 0].max() + margin
    first = np.searchsorted(stars[:, 0], low)
    way_row, way_col = ends[1, 0] - ends[0, 0], ends[1, 1] - ends[0, 1]
    length = max(math.hypot(way_row, way_col), 1e-6)
    near, n = np.empty((len(stars) - first, 2)), 0
    for k in range(first, len(stars)):
        if stars[k, 0] > high:
            break
        row, col = stars[k, 0] - ends[0, 0], stars[k, 1] - ends[0, 1]
        along = (row * way_row + col * way_col) / length
        across = abs(row * way_col - col * way_row) / length
        if -beyond_px < along < length + beyond_px and across < across_px:
            near[n, 0], near[n, 1] = stars[k, 0], stars[k, 1]
            n += 1
    return near[:n].copy()
