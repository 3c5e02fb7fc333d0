"""Arcs of stars about the pole of the sky, in pictures of a fixed camera with a wide lens: neither round nor parallel.

Each star moves about one axis. A lens without distortion shows its motion at (x, y), in focal lengths from the middle, as

    (wy (1 + x^2) - wx x y - wz y,  -wx (1 + y^2) + wy x y + wz x)

for an axis (wx, wy, wz) (Longuet-Higgins & Prazdny 1980, Proc. R. Soc. Lond. B 208, 385, for a camera that turns). Two lines fix
the axis, up to the focal length, which is tried. Lines of objects run anywhere. The meteors of a shower run apart from a place.
Where that is far away they are nearly parallel, as arcs far from the pole are. So lines must run about an axis better than they
point at any place.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ground.vetting.radiants import Lines, spread_deg
from ground.vetting.repeated import PUBLISHED
from sboc_e2e.icd.products import StreakFit

FOCAL_SIDES: Final = (0.3, 0.5, 0.8, 1.3, 2.5, 100.0)
"""Focal lengths that are tried, in longer sides of the frame: fields of 118 deg to almost none. Chosen."""
AWAY_DEG: Final = 4.0
"""Angle between a line and the motion of the stars at its middle, at most, beside what its ends may err by. Chosen: arcs
of a lens without distortion are 0.4 to 1.4 deg off in the median, those of lenses that bend them 2.5."""
ENDS_PX: Final = 1.5
"""By how much an end of a short line may lie aside."""
VOTING: Final = 60
"""Longest lines that are combined in pairs: a budget of work."""
FEWEST: Final = 6
"""Least number of circles about the axis with lines on them. Chosen: 5 of 18,000 frames with 6 to 12 random lines have so many
and the share below, and 5 of 18,000 showers."""
LEAST_SHARE: Final = 0.7
"""Least share of the published lines that run about the axis. Eight of nine pictures of star trails have 0.79 to 1. Chosen in
view of them."""
BESIDE_ROUND: Final = 12
"""Least number of circles where leaves or lamps passed for round stars, or stars are round and the lines are objects."""
AROUND_DEG: Final = 45.0
"""Least spread of the directions of these lines. Objects of a formation are nearly parallel, as geostationary ones in a frame
that follows the stars; none runs around the pole. Chosen."""
APART_PX: Final = 4.0
"""Circles this far apart are two: lines that follow each other, as satellites of a train do, count once."""
LONGER: Final = 2.0
"""A line that is longer than this many stars' arcs, by nine tenths of those in the frame, is no star's."""


@dataclass(frozen=True, kw_only=True)
class _Arcs:
    """Lines of a frame: places of their middles (n, 2: row, col), from the frame's middle, and vectors (n, 2), px."""

    middle: NDArray[np.float64]
    vector: NDArray[np.float64]

    @classmethod
    def of(cls, fits: Sequence[StreakFit], shape: tuple[int, int]) -> "_Arcs":
        """Of the fits of a frame of (rows, cols) px."""
        ends = np.array([(fit.row0, fit.col0, fit.row1, fit.col1) for fit in fits], dtype=np.float64).reshape(-1, 4)
        middle = 0.5 * (ends[:, :2] + ends[:, 2:]) - 0.5 * (np.array(shape) - 1.0)
        return cls(middle=middle, vector=ends[:, 2:] - ends[:, :2])

    def chosen(self, which: NDArray[np.intp] | NDArray[np.bool_]) -> "_Arcs":
        """Some of them."""
        return _Arcs(middle=self.middle[which], vector=self.vector[which])

    @property
    def length(self) -> NDArray[np.float64]:
        """Lengths (n,), px."""
        return np.maximum(np.hypot(*self.vector.T), 1e-9)

    @property
    def way(self) -> NDArray[np.float64]:
        """Directions (n, 2)."""
        return self.vector / self.length[:, None]

    @property
    def may_be_off_deg(self) -> NDArray[np.float64]:
        """Angle (n,) by which each may differ from the stars' motion."""
        return np.minimum(AWAY_DEG + np.degrees(ENDS_PX / self.length), 89.0)

    @property
    def longest(self) -> NDArray[np.intp]:
        """Those that are combined in pairs."""
        return np.argsort(-self.length, kind="stable")[:VOTING]

    def flows(self, focal_px: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Motions along columns and rows that each component of the axis gives, (n, 3) each, in focal lengths."""
        y, x = self.middle.T / focal_px
        return np.column_stack([-x * y, 1.0 + x * x, -y]), np.column_stack([-(1.0 + y * y), x * y, x])

    def across(self, focal_px: float) -> NDArray[np.float64]:
        """What each component of the axis moves a star aside of each line by, (n, 3), in focal lengths."""
        by_col, by_row = self.flows(focal_px)
        row, col = self.way.T
        return row[:, None] * by_col - col[:, None] * by_row

    def misfit(self, away_deg: NDArray[np.float64]) -> NDArray[np.float64]:
        """Sums over lines of squared angles (..., n) in what they may be off, each 1 at most."""
        return np.asarray(np.minimum((away_deg / self.may_be_off_deg) ** 2, 1.0).sum(axis=-1))


@dataclass(frozen=True, kw_only=True)
class _Turn:
    """A turn of the sky. axis (3,) : unit vector along columns, rows and the line of sight."""

    axis: NDArray[np.float64]
    focal_px: float

    def arc_px(self, lines: _Arcs) -> NDArray[np.float64]:
        """Length (n,) of a star's arc at each line's middle, for a turn by one radian."""
        by_col, by_row = lines.flows(self.focal_px)
        return np.maximum(self.focal_px * np.hypot(by_col @ self.axis, by_row @ self.axis), 1e-9)

    def away_deg(self, lines: _Arcs) -> NDArray[np.float64]:
        """Angle (n,) between each line and the motion of a star at its middle."""
        aside = self.focal_px * np.abs(lines.across(self.focal_px) @ self.axis) / self.arc_px(lines)
        return np.asarray(np.degrees(np.arcsin(np.minimum(aside, 1.0))))

    def holds(self, lines: _Arcs) -> NDArray[np.bool_]:
        """Which lines (n,) run as the stars do there."""
        return np.asarray(self.away_deg(lines) <= lines.may_be_off_deg)

    def circles(self, lines: _Arcs) -> int:
        """Number of circles about the axis that lines lie on."""
        y, x = lines.middle.T / self.focal_px
        sight = np.column_stack([x, y, np.ones_like(x)])
        cosine = sight @ self.axis / np.linalg.norm(sight, axis=1)
        count, last = 0, -np.inf
        for each in np.sort(self.focal_px * np.arccos(np.clip(cosine, -1.0, 1.0))).tolist():
            if each - last > APART_PX:
                count, last = count + 1, each
        return count


def of_turning_stars(
    fits: Sequence[StreakFit], probability: NDArray[np.float64], shape: tuple[int, int], *, round_stars: bool
) -> NDArray[np.bool_]:
    """(n,) which fits of a frame are arcs of stars; none where its published lines share no turn.

    probability : (n,) of the fits. shape : rows, columns of the frame. round_stars : whether it seems to have round stars.
    """
    none = np.zeros(len(fits), np.bool_)
    known = np.array([fit.length_px > 0.0 for fit in fits], dtype=np.bool_)
    published = _Arcs.of([fit for fit, p, ok in zip(fits, probability, known, strict=True) if ok and p >= PUBLISHED], shape)
    if len(published.middle) < FEWEST:
        return none
    turn = _best_turn(published, max(shape))
    stars = published.chosen(turn.holds(published))
    if len(stars.middle) < LEAST_SHARE * len(published.middle) or turn.circles(stars) < (BESIDE_ROUND if round_stars else FEWEST):
        return none
    if round_stars and spread_deg(stars.way) < AROUND_DEG:
        return none
    if published.misfit(turn.away_deg(published)) >= _misfit_of_a_shower(published):
        return none
    lines = _Arcs.of(fits, shape)
    turn_rad = float(np.quantile(stars.length / turn.arc_px(stars), 0.9))
    return known & turn.holds(lines) & (lines.length <= LONGER * turn_rad * turn.arc_px(lines) + ENDS_PX)


def _best_turn(lines: _Arcs, side_px: int) -> _Turn:
    """The turn about an axis that the lines fit best."""
    first, second = (lines.longest[k] for k in np.triu_indices(len(lines.longest), 1))
    turns, misfits = [], []
    for focal_px in (share * side_px for share in FOCAL_SIDES):
        across, (by_col, by_row) = lines.across(focal_px), lines.flows(focal_px)
        axes = np.cross(across[first], across[second])
        axes /= np.maximum(np.linalg.norm(axes, axis=1), 1e-30)[:, None]
        arc = np.maximum(np.hypot(axes @ by_col.T, axes @ by_row.T), 1e-12)
        misfit = lines.misfit(np.degrees(np.arcsin(np.minimum(np.abs(axes @ across.T) / arc, 1.0))))
        turns.append(_Turn(axis=axes[int(np.argmin(misfit))], focal_px=focal_px))
        misfits.append(float(misfit.min()))
    return turns[int(np.argmin(misfits))]


def _misfit_of_a_shower(lines: _Arcs) -> float:
    """That of the place which the lines point at best."""
    places = Lines.in_plane(lines.middle[lines.longest], lines.way[lines.longest]).crossings
    return float(lines.misfit(Lines.in_plane(lines.middle, lines.way).away_deg(places)).min())
