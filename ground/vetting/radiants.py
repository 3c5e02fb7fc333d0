"""Lines that point at one place: the meteors of a shower, whose parallel ways run apart from a radiant in perspective.

Two lines always cross. A third one meets their crossing by chance within an angle of few degrees in one of thirty draws. So three
published lines and more that point at one place tell a shower, and each other line that does so has the odds of that chance in
its favour. Lines of noise, clouds and horizons point anywhere. Parallel lines say nothing here: stars that trail, rain, wires and
trunks are parallel too. In a wide field trailed stars are not, and there are many of them.
"""

import math
from collections.abc import Sequence
from functools import cached_property
from typing import Final

import numpy as np
import scipy  # scipy.special is loaded where it is used
from numpy.typing import NDArray

from ground.vetting.any_camera import LEAST_PROBABILITY
from ground.vetting.repeated import PUBLISHED, on_one_trail
from sboc_e2e.icd.products import StreakFit

AWAY_DEG: Final = 3.0
"""Angle between a line and the direction to its radiant, at most: fits of 30 px err by a degree, and lenses bend great circles.
Chosen, not measured."""
BY_CHANCE: Final = 2.0 * AWAY_DEG / 180.0
"""Share of lines of any direction that point at a given place."""
FEWEST: Final = 3
"""Least number of lines that tell a radiant: two always cross."""
MOST: Final = 24
"""Published lines of a frame that are looked at, the likeliest first: a budget of work."""
LEAST_SPREAD_DEG: Final = 2.0 * AWAY_DEG
"""Least angle over which the directions of these lines are spread: nearer ones are parallel within what they may err."""
FEWEST_STARS: Final = 8
"""Where no star is round, so many lines that point at one place may be the stars: as many as share a motion there
(`sboc_e2e.outside.star_lines`). Two pictures of trailed stars with 9 and 13 had 14 false lines more without this."""


def for_radiant(fits: Sequence[StreakFit], probability: NDArray[np.float64], *, round_stars: bool) -> NDArray[np.float64]:
    """Odds (n,) of a trail that a radiant adds, given the probabilities (n,) of the fits of a frame; 1 where it says nothing.

    round_stars : whether the frame has stars that are points. No line speaks for itself, nor a line beside it on the same trail.
    """
    known = np.array([fit.length_px > 0.0 for fit in fits], dtype=np.bool_)
    telling = [k for k in np.argsort(-probability, kind="stable").tolist() if probability[k] >= PUBLISHED and known[k]][:MOST]
    odds = np.ones(len(fits))
    if len(telling) < FEWEST:
        return odds
    lines = Lines.of([fits[k] for k in telling])
    if not round_stars and int((lines.agree <= AWAY_DEG).sum(axis=1).max()) >= FEWEST_STARS:
        return odds
    for k in np.flatnonzero(known & (probability >= LEAST_PROBABILITY)).tolist():
        others = [place for place, j in enumerate(telling) if j != k and not on_one_trail(fits[k], fits[j])]
        found = lines.radiant(others)
        if found is not None and Lines.of([fits[k]]).away_deg(found[0][None, :])[0, 0] <= AWAY_DEG:
            odds[k] = found[1]
    return odds


class Lines:
    """Lines of a frame: their middles and directions (n, 2), rows and columns."""

    def __init__(self, middle: NDArray[np.float64], way: NDArray[np.float64]) -> None:
        self.middle, self.way = middle, way
        self.first, self.second = np.triu_indices(len(middle), 1)

    @cached_property
    def crossings(self) -> NDArray[np.float64]:
        """Where each pair of lines crosses: row, column and what both are to be divided by, 0 for parallel ones."""
        across = np.column_stack((self.way[:, 1], -self.way[:, 0]))
        straight = np.column_stack((across, -(across * self.middle).sum(axis=1)))
        return np.cross(straight[self.first], straight[self.second])

    @cached_property
    def agree(self) -> NDArray[np.float64]:
        """Angles (pairs, n) of the lines from the directions to the crossings."""
        return self.away_deg(self.crossings)

    @classmethod
    def of(cls, fits: Sequence[StreakFit]) -> "Lines":
        """Of fits that have a length."""
        ends = np.array([(fit.row0, fit.col0, fit.row1, fit.col1) for fit in fits])
        along = ends[:, 2:] - ends[:, :2]
        return cls(0.5 * (ends[:, :2] + ends[:, 2:]), along / np.hypot(*along.T)[:, None])

    def away_deg(self, places: NDArray[np.float64]) -> NDArray[np.float64]:
        """Angles (places, n) between the lines and the directions from their middles to places (places, 3), as `crossings`."""
        to_row, to_col = (places[:, k, None] - places[:, 2, None] * self.middle[:, k] for k in (0, 1))
        across = np.abs(to_row * self.way[:, 1] - to_col * self.way[:, 0])
        return np.asarray(np.degrees(np.arctan2(across, np.abs(to_row * self.way[:, 0] + to_col * self.way[:, 1]))))

    def radiant(self, chosen: Sequence[int]) -> tuple[NDArray[np.float64], float] | None:
        """The place (3,) that most of the chosen lines point at, and the odds of a trail for another line that does so too.

        None where it is no radiant. How many such places chance gives, against one that is real, says how far it is believed.
        """
        n = len(chosen)
        if n < FEWEST:
            return None
        pairs = np.flatnonzero(np.isin(self.first, chosen) & np.isin(self.second, chosen))
        away = self.agree[np.ix_(pairs, np.asarray(chosen))]
        meets = away <= AWAY_DEG
        meeting = meets.sum(axis=1)
        best = int(np.lexsort((np.where(meets, away**2, 0.0).sum(axis=1), -meeting))[0])
        most = int(meeting[best])
        if most < FEWEST or spread_deg(self.way[np.asarray(chosen)[meets[best]]]) < LEAST_SPREAD_DEG:
            return None
        by_chance = math.comb(n, 2) * float(scipy.special.bdtrc(most - 3, n - 2, BY_CHANCE)) / math.comb(most, 2)
        believed = 1.0 / (1.0 + by_chance)
        return self.crossings[pairs[best]], max(1.0 - believed + believed * most / n / BY_CHANCE, 1.0)


def spread_deg(way: NDArray[np.float64]) -> float:
    """Least angle that holds all directions (n, 2), either sense of each alike."""
    angle = np.sort(np.degrees(np.arctan2(way[:, 0], way[:, 1])) % 180.0)
    return 180.0 - float(np.max(np.diff(angle, append=angle[0] + 180.0)))
