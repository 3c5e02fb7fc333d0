"""Transform from an earlier frame to this one: a similarity found from the two star lists alone."""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from onboard.image.nearest import nearest, number_within
from sboc_e2e.icd.flags import StarFlag
from sboc_e2e.icd.signals import StarList

IDENTITY: Final = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""Transform of a frame into itself."""

BRIGHTEST: Final = 60
"""Stars of each list that vote for the shift."""

MATCHED: Final = 1500
"""Brightest stars of the earlier list that are matched for the fit, with twice as many of the other list."""


LEAST: Final = 5
"""Stars that must agree."""

FIXED: Final = 2
"""Of these, stars that a similarity brings together whatever they are."""

CHANCE: Final = 0.01
"""Two fields that have nothing to do with each other are taken for one no more often than this. Chosen, not measured."""


def _similarity(source: NDArray[np.float64], target: NDArray[np.float64]) -> NDArray[np.float64]:
    """Least-squares 2 x 3 map [[a, -b, tr], [b, a, tc]] of points (n, 2) onto points (n, 2)."""
    mean_s, mean_t = source.mean(axis=0), target.mean(axis=0)
    s, t = source - mean_s, target - mean_t
    power = float(np.sum(s * s))
    a = float(np.sum(s * t)) / power if power > 0.0 else 1.0
    b = float(np.sum(s[:, 0] * t[:, 1] - s[:, 1] * t[:, 0])) / power if power > 0.0 else 0.0
    rotation = np.array([[a, -b], [b, a]])
    return np.column_stack([rotation, mean_t - rotation @ mean_s])


def apply(transform: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Map points (n, 2) of (row, col) by a (2, 3) transform."""
    return np.asarray(points @ transform[:, :2].T + transform[:, 2])


def inverse(transform: NDArray[np.float64]) -> NDArray[np.float64]:
    """The (2, 3) transform that undoes another."""
    back = np.linalg.inv(transform[:, :2])
    return np.column_stack([back, -back @ transform[:, 2]])


def _places(stars: StarList, *, single: bool = False) -> NDArray[np.float64]:
    """Places (n, 2) of a list's stars, brightest first, without what is sharper than one: hot pixels stay where stars move.

    single : without blends either. Every long trail is listed as a row of them, and trails of one motion move alike.
    """
    blurred = (stars.flags & int(StarFlag.COSMIC_LIKE | (StarFlag.BLENDED if single else StarFlag(0)))) == 0
    return np.column_stack([stars.row[blurred], stars.col[blurred]])


def _shift(old: NDArray[np.float64], new: NDArray[np.float64], reach_px: float) -> tuple[NDArray[np.float64], int]:
    """The shift (2,) that most pairs of places (n, 2), (m, 2) have, and how many have it."""
    shifts = (new[None, :BRIGHTEST] - old[:BRIGHTEST, None]).reshape(-1, 2)
    shifts = shifts[np.abs(shifts).max(axis=1) <= reach_px]
    if len(shifts) == 0:
        return np.zeros(2), 0
    winner = shifts[int(np.argmax(number_within(shifts, 2.0)))]
    same = shifts[np.hypot(*(shifts - winner).T) <= 2.0]
    return same.mean(axis=0), len(same)


def register(earlier: StarList, now: StarList, *, reach_px: float) -> NDArray[np.float64] | None:
    """The (2, 3) transform that takes (row, col) of `earlier` to `now`, or None when fewer than 5 stars agree, or no more than
    in fields that have nothing to do with each other.

    Shifts between the brightest stars vote within 2 px (up to reach_px), those that are no blends first; the winner is refined by
    matching bright stars within 3, then 1.5 px and fitting a similarity. Rotation
    between frames must move no star by more than ~3 px for the vote.
    """
    old, new = _places(earlier), _places(now)
    if len(old) < LEAST or len(new) < LEAST:
        return None
    shift, votes = _shift(_places(earlier, single=True), _places(now, single=True), reach_px)
    if votes < LEAST:
        shift, votes = _shift(old, new, reach_px)
    if votes == 0:
        return None
    transform = np.column_stack([np.eye(2), shift])
    points, target = old[:MATCHED], new[: 2 * MATCHED]
    for radius in (3.0, 1.5, 1.0):
        distance, index = nearest(apply(transform, points), target, radius)
        matched = np.isfinite(distance)
        if np.count_nonzero(matched) < LEAST:
            return None
        transform = _similarity(points[matched], target[index[matched]])
    expected = len(points) * len(target) * math.pi * radius**2 / max(float(np.prod(np.ptp(target, axis=0))), 1.0)
    places = (2.0 * reach_px / radius) ** 2
    ln_fields = ln_chance(int(np.count_nonzero(matched)) - FIXED, expected) + math.log(places)
    return transform if ln_fields < math.log(CHANCE) else None


def ln_chance(found: int, expected: float) -> float:
    """Upper bound of ln P(n >= found) of Poisson's law (Chernoff): found - expected - found ln(found / expected)."""
    return found - expected - found * math.log(found / expected) if found > expected > 0.0 else 0.0
