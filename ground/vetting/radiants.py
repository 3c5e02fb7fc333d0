"""Lines that point at one place: the meteors of a shower, whose parallel ways run apart from a radiant in perspective.

Two lines always cross. A third one meets their crossing by chance within an angle of few degrees in one of thirty draws. So three
lines and more that point at one place tell a shower, and each other line that does so has the odds of that chance in its favour.
Lines of noise, clouds and horizons point anywhere. Parallel lines say nothing here: stars that trail, rain, wires and trunks are
parallel too. In a wide field trailed stars are not, and there are many of them.

A lens without distortion shows great circles of the sky straight, and the place may lie anywhere in the plane of the picture. A
fisheye bends them, so that lines of a shower do not cross in one place of the plane, but in one of the sky. Its image is r = f
theta (equidistant projection) for several focal lengths f.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
import scipy  # scipy.special is loaded where it is used
from numpy.typing import NDArray

from ground.streaks.centre_line import effective_width_px
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
FEWEST_PUBLISHED: Final = 2
"""Least number of published ones among them. Chosen: unlikely lines are roofs and clouds more often than meteors."""
UNLIKELY: Final = 0.02
"""Probability from which on lines tell a radiant beside published ones. Chosen: short meteors of one picture had 0.03 to 0.2."""
ALIKE: Final = 3.0
"""Such a line is as wide as the median published one, within this factor: edges of clouds and shores are wider than meteors.
Chosen."""
FISHEYES: Final = (0.3, 0.45, 0.7)
"""Focal lengths of fisheyes that are tried, in longer sides of the frame: 191, 127 and 82 deg along it. Chosen."""
MOST: Final = 24
"""Lines of a frame that are looked at, the likeliest first: a budget of work."""
LEAST_SPREAD_DEG: Final = 2.0 * AWAY_DEG
"""Least angle over which the directions of these lines are spread: nearer ones are parallel within what they may err."""
FEWEST_STARS: Final = 8
"""Where no star is round, so many lines that point at one place may be the stars: as many as share a motion there
(`sboc_e2e.outside.star_lines`). Two pictures of trailed stars with 9 and 13 had 14 false lines more without this."""


def for_radiant(
    fits: Sequence[StreakFit], probability: NDArray[np.float64], shape: tuple[int, int], *, round_stars: bool
) -> NDArray[np.float64]:
    """Odds (n,) of a trail that a radiant adds, given the probabilities (n,) of the fits of a frame; 1 where it says nothing.

    shape : rows, columns of the frame. round_stars : whether it has stars that are points; where not, unlikely lines tell
    nothing. No line speaks for itself, nor a line beside it on the same trail.
    """
    may_gain = np.array([fit.length_px > 0.0 for fit in fits], dtype=np.bool_) & (probability >= LEAST_PROBABILITY)
    order = np.argsort(-probability, kind="stable")
    order = order[may_gain[order]]
    odds = np.ones(len(fits))
    published = int((probability[order] >= PUBLISHED).sum())
    if published >= FEWEST_PUBLISHED:
        likely = int((probability[order] >= UNLIKELY).sum())
        odds[order] = _Sky([fits[k] for k in order], shape).odds(published, likely, round_stars=round_stars)
    return odds


def _middles_and_ways(fits: Sequence[StreakFit]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Middles and directions (n, 2) of fits that have a length, rows and columns."""
    ends = np.array([(fit.row0, fit.col0, fit.row1, fit.col1) for fit in fits])
    along = ends[:, 2:] - ends[:, :2]
    return 0.5 * (ends[:, :2] + ends[:, 2:]), along / np.hypot(*along.T)[:, None]


@dataclass(frozen=True, kw_only=True)
class Lines:
    """Lines of a frame, as a lens shows the sky.

    straight : (n, 3) normal of each line's great circle. onward : (n, 3) along it at its middle. Without a focal length both are
    those of projective geometry. way : (n, 2) directions in the frame, rows and columns.
    """

    straight: NDArray[np.float64]
    onward: NDArray[np.float64]
    way: NDArray[np.float64]

    @classmethod
    def in_plane(cls, middle: NDArray[np.float64], way: NDArray[np.float64]) -> "Lines":
        """As a lens without distortion shows them. middle, way : (n, 2) px; directions of length 1."""
        across = np.column_stack((way[:, 1], -way[:, 0]))
        return cls(
            straight=np.column_stack((across, -(across * middle).sum(axis=1))),
            onward=np.column_stack((way, -(way * middle).sum(axis=1))),
            way=way,
        )

    @classmethod
    def of_fisheye(cls, middle: NDArray[np.float64], way: NDArray[np.float64], focal_px: float) -> "Lines":
        """As an equidistant fisheye shows them. middle : (n, 2) px from its axis."""
        radius = np.maximum(np.hypot(*middle.T), 1e-9)
        outward, theta = middle / radius[:, None], radius / focal_px
        around = np.column_stack((-outward[:, 1], outward[:, 0]))
        sine, cosine = np.sin(theta)[:, None], np.cos(theta)[:, None]
        per_theta = (way * outward).sum(axis=1)[:, None] / focal_px
        per_turn = (way * around).sum(axis=1)[:, None] * sine / radius[:, None]
        onward = np.hstack((per_theta * cosine * outward + per_turn * around, -per_theta * sine))
        onward /= np.maximum(np.linalg.norm(onward, axis=1), 1e-30)[:, None]
        return cls(straight=np.cross(np.hstack((sine * outward, cosine)), onward), onward=onward, way=way)

    def chosen(self, which: Sequence[int]) -> "Lines":
        """Some of them."""
        return Lines(straight=self.straight[which], onward=self.onward[which], way=self.way[which])

    @cached_property
    def pairs(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """First and second line of each pair."""
        return np.triu_indices(len(self.way), 1)

    @cached_property
    def crossings(self) -> NDArray[np.float64]:
        """Where each pair of lines crosses (pairs, 3): in the plane row, column and what both are to be divided by."""
        first, second = self.pairs
        return np.cross(self.straight[first], self.straight[second])

    @cached_property
    def agree(self) -> NDArray[np.float64]:
        """Angles (pairs, n) of the lines from the directions to the crossings."""
        return self.away_deg(self.crossings)

    def away_deg(self, places: NDArray[np.float64]) -> NDArray[np.float64]:
        """Angles (places, n) between the lines and the directions from their middles to places (places, 3), as `crossings`."""
        return np.asarray(np.degrees(np.arctan2(np.abs(places @ self.straight.T), np.abs(places @ self.onward.T))))

    def radiant(self, chosen: Sequence[int], published: int, trials: int) -> tuple[NDArray[np.float64], float] | None:
        """The place (3,) that most of the chosen lines point at, and the odds of a trail for another line that does so too.

        None where it is no radiant. How many such places chance gives, in so many trials, against one that is real, says how far
        it is believed. published : the first lines that are. At least `FEWEST_PUBLISHED` of them must point there.
        """
        n = len(chosen)
        if n < FEWEST:
            return None
        pairs = np.flatnonzero(np.isin(self.pairs, chosen).all(axis=0))
        away = self.agree[np.ix_(pairs, np.asarray(chosen))]
        meets = away <= AWAY_DEG
        sure = meets[:, np.asarray(chosen) < published].sum(axis=1) >= FEWEST_PUBLISHED
        meeting = np.where(sure, meets.sum(axis=1), 0)
        best = int(np.lexsort((np.where(meets, away**2, 0.0).sum(axis=1), -meeting))[0])
        most = int(meeting[best])
        if most < FEWEST or spread_deg(self.way[np.asarray(chosen)[meets[best]]]) < LEAST_SPREAD_DEG:
            return None
        by_chance = trials * math.comb(n, 2) * float(scipy.special.bdtrc(most - 3, n - 2, BY_CHANCE)) / math.comb(most, 2)
        believed = 1.0 / (1.0 + by_chance)
        return self.crossings[pairs[best]], max(1.0 - believed + believed * most / n / BY_CHANCE, 1.0)


class _Sky:
    """Lines of a frame, the likeliest first, through each of the lenses."""

    def __init__(self, fits: Sequence[StreakFit], shape: tuple[int, int]) -> None:
        middle, way = _middles_and_ways(fits)
        from_axis = middle - 0.5 * (np.array(shape) - 1.0)
        self._fits = fits
        self._plane = Lines.in_plane(middle, way)
        self._lenses = [(self._plane, 1)]
        self._lenses += [(Lines.of_fisheye(from_axis, way, share * max(shape)), len(FISHEYES)) for share in FISHEYES]
        away = self._plane.away_deg(np.column_stack((middle, np.ones(len(fits)))))
        self._facing = (away <= AWAY_DEG) & (away.T <= AWAY_DEG)

    def odds(self, published: int, likely: int, *, round_stars: bool) -> NDArray[np.float64]:
        """Odds (n,) of a trail, see `for_radiant`. published, likely : how many of the lines are, the first ones."""
        telling = self._of_one_line_each(range(min(published, MOST)))
        if len(telling) < FEWEST_PUBLISHED:
            return np.ones(len(self._fits))
        if not round_stars:
            most = (self._plane.chosen(telling).agree <= AWAY_DEG).sum(axis=1).max()
            return np.ones(len(self._fits)) if most >= FEWEST_STARS else self._by(telling, len(telling), trials=1)
        width = np.array([effective_width_px(fit.width_px) for fit in self._fits])
        usual = float(np.median(width[telling]))
        alike = (width <= ALIKE * usual) & (width >= usual / ALIKE)
        all_telling = self._of_one_line_each(np.flatnonzero(alike[:likely])[:MOST].tolist())
        by_all = self._by(all_telling, sum(k in telling for k in all_telling), trials=2)
        return np.maximum(self._by(telling, len(telling), trials=1), np.where(alike, by_all, 1.0))

    def _by(self, telling: Sequence[int], published: int, *, trials: int) -> NDArray[np.float64]:
        """Odds (n,) that some lines add to each line, those on its own line left out.

        published : how many of them are, the first ones. trials : how often a radiant was looked for, before several lenses.
        """
        lenses = [(lines, lines.chosen(telling), trials * more) for lines, more in self._lenses]
        found: dict[tuple[int, ...], NDArray[np.float64]] = {}
        odds = np.ones(len(self._fits))
        for k in range(len(odds)):
            others = tuple(place for place, j in enumerate(telling) if not self._on_one_line(k, j))
            if others not in found:
                found[others] = np.ones(len(odds))
                for lines, own, each in lenses:
                    radiant = own.radiant(others, published, each)
                    if radiant is not None:
                        points = lines.away_deg(radiant[0][None, :])[0] <= AWAY_DEG
                        found[others] = np.maximum(found[others], np.where(points, radiant[1], 1.0))
            odds[k] = found[others][k]
        return odds

    def _of_one_line_each(self, likeliest: Sequence[int]) -> list[int]:
        """Those of some lines that lie on none of those before: pieces of a trail point at each place of it."""
        kept: list[int] = []
        for k in likeliest:
            if not any(self._on_one_line(k, j) for j in kept):
                kept.append(k)
        return kept

    def _on_one_line(self, k: int, j: int) -> bool:
        """Whether two lines point at each other, as one does at itself, or lie on one trail."""
        return bool(self._facing[k, j]) or on_one_trail(self._fits[k], self._fits[j])


def spread_deg(way: NDArray[np.float64]) -> float:
    """Least angle that holds all directions (n, 2), either sense of each alike."""
    angle = np.sort(np.degrees(np.arctan2(way[:, 0], way[:, 1])) % 180.0)
    return 180.0 - float(np.max(np.diff(angle, append=angle[0] + 180.0)))
