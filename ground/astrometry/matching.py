"""Pairing the star list with projected catalogue stars when the attitude is known to a few hundred arcsec.

First a vote: every list star votes for the offsets of all catalogue stars near it, once for each trial roll. True pairs agree on
one offset, and false pairs scatter. Then mutual nearest neighbours are paired, within a radius that shrinks while the attitude
is refined.
"""

from dataclasses import dataclass

import numpy as np
import scipy  # scipy.spatial is loaded where it is used: frames without a solution need none
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.intp]


@dataclass(frozen=True, kw_only=True)
class Vote:
    """Offset (list minus catalogue, px) and roll (rad, row axis from col axis, about the centre) with most votes.

    votes : pairs within one bin of it. chance : expected number of chance pairs in a bin of that size.
    """

    d_row_px: float
    d_col_px: float
    roll_rad: float
    votes: int
    chance: float

    @property
    def significant(self) -> bool:
        """Whether the votes exceed chance by six Poisson sigmas and are at least five pairs."""
        return self.votes >= max(5.0, self.chance + 6.0 * np.sqrt(self.chance + 1.0))


def vote_offset(
    listed: Array, catalogue: Array, *, center: Array, reach_px: float, bin_px: float, roll_limit_rad: float, half_size_px: float
) -> Vote:
    """The most popular offset between two point sets (n, 2) and (m, 2) of (row, col).

    reach_px : largest offset looked for. roll_limit_rad : largest roll looked for. half_size_px : distance of the farthest
    stars from `center` (2,): sets the step of the trial rolls, which moves them by one bin.
    """
    nothing = Vote(d_row_px=0.0, d_col_px=0.0, roll_rad=0.0, votes=0, chance=0.0)
    if len(listed) == 0 or len(catalogue) == 0:
        return nothing
    first, second = _pairs_within(listed, catalogue, reach_px + roll_limit_rad * half_size_px)
    if len(first) == 0:
        return nothing
    arm = listed[first] - center
    offset = arm - (catalogue[second] - center)
    n_steps = int(np.ceil(roll_limit_rad * half_size_px / bin_px))
    n_bins = 2 * int(np.ceil(reach_px / bin_px)) + 1
    best = (-1, 0, 0, 0.0)
    for step in range(-n_steps, n_steps + 1):
        roll = step * bin_px / half_size_px
        # undo the trial roll of the list: (row, col) turned by -roll about the centre
        turned = offset - roll * np.stack((arm[:, 1], -arm[:, 0]), axis=1)
        cell = np.rint(turned / bin_px).astype(np.int64) + n_bins // 2
        inside = ((cell >= 0) & (cell < n_bins)).all(axis=1)
        count = np.bincount(cell[inside, 0] * n_bins + cell[inside, 1], minlength=n_bins * n_bins).reshape(n_bins, n_bins)
        smooth = np.zeros_like(count)
        padded = np.pad(count, 1)
        for i in range(3):
            for j in range(3):
                smooth += padded[i : i + n_bins, j : j + n_bins]
        peak = int(np.argmax(smooth))
        if smooth.flat[peak] > best[0]:
            best = (int(smooth.flat[peak]), peak // n_bins, peak % n_bins, roll)
    votes, i, j, roll = best
    turned = offset - roll * np.stack((arm[:, 1], -arm[:, 0]), axis=1)
    near = np.abs(turned - bin_px * (np.array([i, j]) - n_bins // 2)).max(axis=1) <= 1.5 * bin_px
    d_row, d_col = np.median(turned[near], axis=0) if near.any() else (0.0, 0.0)
    density = len(catalogue) / max((np.ptp(catalogue, axis=0) + 1.0).prod(), 1.0)
    return Vote(
        d_row_px=float(d_row), d_col_px=float(d_col), roll_rad=roll, votes=votes, chance=len(listed) * density * 9.0 * bin_px**2
    )


def mutual_pairs(listed: Array, catalogue: Array, radius_px: float) -> tuple[Index, Index]:
    """Indices of list and catalogue points that are each other's nearest within `radius_px`."""
    if len(listed) == 0 or len(catalogue) == 0:
        none = np.zeros(0, dtype=np.intp)
        return none, none
    distance, nearest = scipy.spatial.cKDTree(catalogue).query(listed, distance_upper_bound=radius_px)
    _, back = scipy.spatial.cKDTree(listed).query(catalogue)
    found = np.flatnonzero(np.isfinite(distance))
    mutual = found[back[nearest[found]] == found]
    return mutual, np.asarray(nearest[mutual], dtype=np.intp)


def _pairs_within(listed: Array, catalogue: Array, radius_px: float) -> tuple[Index, Index]:
    """All pairs of points closer than `radius_px`."""
    lists = scipy.spatial.cKDTree(listed).query_ball_point(catalogue, radius_px)
    second = np.repeat(np.arange(len(catalogue)), [len(found) for found in lists])
    first = np.fromiter((i for found in lists for i in found), dtype=np.intp, count=len(second))
    return first, second
