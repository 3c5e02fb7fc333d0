"""Source-level astrometry and photometry: detected stars against where the catalogue has them, and real against simulated."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from sboc_e2e.validation.sources import Sources
from sboc_e2e.validation.subjects import KnownStars

SEARCH_PX: Final = 40.0
"""A WCS may be wrong by this much as a whole."""
NEAR_PX: Final = 3.0
"""After the common shift. Chosen, not measured: wider pairs strangers, narrower loses stars under a distorted WCS."""
VOTE_PX: Final = 2.0
"""Shifts within this distance are one. Chosen, not measured: about the FWHM of a star."""
MIN_VOTES: Final = 3
"""Fewer pairs with one shift may be chance; the WCS is then taken as it is."""
DEPTH: Final = 1.5
"""Catalogue stars that take part, brightest first, for each detected one: those far below the detection limit pair by chance."""


@dataclass(frozen=True, kw_only=True, eq=False)
class StarMatch:
    """Catalogue stars found in an image. star_id : (n,); row, col : (n,) measured minus expected, px, the common offset taken
    out; offset_row, offset_col : that offset, px; place_row, place_col : (n,) measured; magnitude : (n,) -2.5 log10(flux) - V."""

    star_id: NDArray[np.int64]
    row: NDArray[np.float64]
    col: NDArray[np.float64]
    offset_row: float
    offset_col: float
    place_row: NDArray[np.float64]
    place_col: NDArray[np.float64]
    magnitude: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.star_id)


def match_known(sources: Sources, known: KnownStars) -> StarMatch:
    """Pair catalogue stars with detected ones: the offset that most pairs share (a vote), then the nearest within `NEAR_PX`."""
    known = _brightest(known, int(DEPTH * len(sources)))
    place = np.stack([sources.row, sources.col], axis=1)
    expected = np.stack([known.row, known.col], axis=1)
    offset = _common_offset(place, expected)
    which, found = _nearest(place, expected + offset)
    for _ in range(2):
        if len(found):
            offset = np.median(place[found] - expected[which], axis=0)
            which, found = _nearest(place, expected + offset)
    apart = place[found] - expected[which] - offset
    with np.errstate(divide="ignore", invalid="ignore"):
        magnitude = -2.5 * np.log10(sources.flux[found]) - known.v_mag[which]
    return StarMatch(
        star_id=known.star_id[which],
        row=apart[:, 0],
        col=apart[:, 1],
        offset_row=float(offset[0]),
        offset_col=float(offset[1]),
        place_row=place[found, 0],
        place_col=place[found, 1],
        magnitude=magnitude,
    )


def _brightest(known: KnownStars, n: int) -> KnownStars:
    kept = np.sort(np.argsort(known.v_mag, kind="stable")[: max(n, MIN_VOTES)])
    return replace(known, **{name: getattr(known, name)[kept] for name in ("star_id", "row", "col", "v_mag")})


def _common_offset(place: NDArray[np.float64], expected: NDArray[np.float64]) -> NDArray[np.float64]:
    """The shift (row, col) within `SEARCH_PX` that brings most expected places to measured ones; the smaller one of equals; zero
    without `MIN_VOTES` pairs that share it."""
    if not len(place) or not len(expected):
        return np.zeros(2)
    pairs = cKDTree(place).query_ball_point(expected, SEARCH_PX)
    shifts = np.array([place[j] - expected[i] for i, near in enumerate(pairs) for j in near]).reshape(-1, 2)
    if not len(shifts):
        return np.zeros(2)
    votes = cKDTree(shifts).query_ball_point(shifts, VOTE_PX, return_length=True)
    best = np.lexsort((np.hypot(shifts[:, 0], shifts[:, 1]), -votes))[0]
    if votes[best] < MIN_VOTES:
        return np.zeros(2)
    return np.asarray(np.median(shifts[np.hypot(*(shifts - shifts[best]).T) <= VOTE_PX], axis=0))


def _nearest(place: NDArray[np.float64], expected: NDArray[np.float64]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Indices of expected and of measured stars that are each other's nearest within `NEAR_PX`."""
    nothing = np.zeros(0, dtype=np.intp)
    if not len(place) or not len(expected):
        return nothing, nothing
    distance, found = cKDTree(place).query(expected)
    _, back = cKDTree(expected).query(place[found])
    good = (distance <= NEAR_PX) & (back == np.arange(len(expected)))
    return np.flatnonzero(good), found[good]
