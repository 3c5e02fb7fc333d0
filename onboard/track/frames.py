"""The frames that the seeds of one of them are followed through, as the compiled steps take them."""

from typing import NamedTuple

import numba as nb
import numpy as np
from numpy.typing import NDArray


class Frames(NamedTuple):
    """Frames in their order of time, and what is asked of tracks through them.

    Their images go beside this, since each call counts references to all arrays of a tuple.

    transforms (n, 2, 3) : of (row, col) of the centre frame into each; half_transforms : the same of pixels of halved images.
    taus (n,) : start of each exposure after that of the centre frame, in exposures, on the rows where the object is. n_old : how
    many frames, the first ones, are kept at half resolution alone: they are looked at where a track reaches the oldest of the
    others. n_frames : frames from there on only fill up the tuples of images. centre : the frame of the seeds. threshold : joint
    S/N asked of a track of n frames, at index n.
    """

    transforms: NDArray[np.float64]
    half_transforms: NDArray[np.float64]
    taus: NDArray[np.float64]
    n_old: int
    n_frames: int
    centre: int
    psf_sigma_px: float
    threshold: NDArray[np.float64]


class Span(NamedTuple):
    """Frames that are looked at: low ... high, and the seed's own among them."""

    centre: int
    low: int
    high: int


@nb.njit(cache=True, inline="always")
def span_of(frames: Frames, away: int) -> Span:
    """The frames of full resolution that are at most so many away from the centre."""
    return Span(frames.centre, max(frames.n_old, frames.centre - away), min(frames.n_frames - 1, frames.centre + away))


def halved_transforms(transforms: NDArray[np.float64]) -> NDArray[np.float64]:
    """Transforms (n, 2, 3) of pixels as those of halved images, whose pixel centres lie at 2 k + 0.5."""
    out = transforms.copy()
    out[:, :, 2] = 0.5 * (transforms[:, :, 2] + 0.5 * (transforms[:, :, 0] + transforms[:, :, 1]) - 0.5)
    return out
