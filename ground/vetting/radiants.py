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
"""Such a line is as wide as a published one that points there, within this factor: edges of clouds and shores are wider than
meteors. Chosen."""
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
    known = np.array([fit.length_px > 0.0 for fit in fits], dtype=np.bool_)
    likeliest = [k for k in np.argsort(-probability, kind="stable").tolist() if known[k] and probability[k] >= UNLIKELY]
    published = _of_one_line_each(fits, [k for k in likeliest if probability[k] >= PUBLISHED][:MOST])
    odds = np.ones(len(fits))
    if len(published) < FEWEST_PUBLISHED:
        return odds
    by_published = _Shower([fits[k] for k in published], len(published), shape, trials=1)
    if not round_stars and by_published.largest >= FEWEST_STARS:
        return odds
    gaining = np.flatnonzero(known & (probability >= LEAST_PROBABILITY)).tolist()
    for k in gaining:
        odds[k] = by_published.odds_of(fits[k])
    if round_stars:
        width = np.array([effective_width_px(fit.width_px) for fit in fits])
        usual = float(np.median(width[published]))
        alike = (width <= ALIKE * usual) & (width >= usual / ALIKE)
        telling = _of_one_line_each(fits, [k for k in likeliest if alike[k]][:MOST])
        by_all = _Shower([fits[k] for k in telling], sum(k in published for k in telling), shape, trials=2)
        for k in gaining:
            if alike[k]:
                odds[k] = max(odds[k], by_all.odds_of(fits[k]))
    return odds


def _of_one_line_each(fits: Sequence[StreakFit], likeliest: Sequence[int]) -> list[int]:
    """Those of some fits that lie on no line of one before: pieces of a trail point at each place of it."""
    kept: list[int] = []
    for k in likeliest:
        if not any(_on_one_line(fits[k], fits[j]) for j in kept):
            kept.append(k)
    return kept


def _on_one_line(one: StreakFit, other: StreakFit) -> bool:
    """Whether two fits are one, lie on one trail, or point at each other."""
    if one is other or on_one_trail(one, other):
        return True
    lines = Lines.in_plane(*_middles_and_ways([one, other]))
    there = np.column_stack((_middles_and_ways([other, one])[0], np.ones(2)))
    return bool((np.diagonal(lines.away_deg(there)) <= AWAY_DEG).all())


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


class _Shower:
    """What lines of a frame tell of a radiant, through each of the lenses.

    fits : the lines, the published ones first. trials : places where one was looked for, before those of several lenses.
    """

    def __init__(self, fits: Sequence[StreakFit], published: int, shape: tuple[int, int], *, trials: int) -> None:
        self._fits, self._published, self._shape = fits, published, shape
        self._lenses: list[tuple[float | None, int]] = [(None, trials)]
        self._lenses += [(share * max(shape), len(FISHEYES) * trials) for share in FISHEYES]
        self._lines = [self._seen(fits, focal_px) for focal_px, _ in self._lenses]
        self._found: dict[tuple[int, ...], list[tuple[NDArray[np.float64], float] | None]] = {}

    @property
    def largest(self) -> int:
        """Most lines that point at one place, without distortion."""
        return int((self._lines[0].agree <= AWAY_DEG).sum(axis=1).max())

    def odds_of(self, fit: StreakFit) -> float:
        """Odds of a trail that it adds for a line, which may be one of its own."""
        others = tuple(place for place, other in enumerate(self._fits) if not _on_one_line(fit, other))
        if others not in self._found:
            self._found[others] = [
                lines.radiant(others, self._published, trials)
                for lines, (_, trials) in zip(self._lines, self._lenses, strict=True)
            ]
        odds = 1.0
        for (focal_px, _), found in zip(self._lenses, self._found[others], strict=True):
            if found is not None and found[1] > odds:
                away = self._seen([fit], focal_px).away_deg(found[0][None, :])[0, 0]
                odds = found[1] if away <= AWAY_DEG else odds
        return odds

    def _seen(self, fits: Sequence[StreakFit], focal_px: float | None) -> Lines:
        """Fits that have a length, through a lens whose axis is the middle of the frame."""
        middle, way = _middles_and_ways(fits)
        middle = middle - 0.5 * (np.array(self._shape) - 1.0)
        return Lines.in_plane(middle, way) if focal_px is None else Lines.of_fisheye(middle, way, focal_px)


def spread_deg(way: NDArray[np.float64]) -> float:
    """Least angle that holds all directions (n, 2), either sense of each alike."""
    angle = np.sort(np.degrees(np.arctan2(way[:, 0], way[:, 1])) % 180.0)
    return 180.0 - float(np.max(np.diff(angle, append=angle[0] + 180.0)))
