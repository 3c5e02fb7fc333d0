"""The motion that the lines of a frame share where its stars are lines: equal trails all over it.

The star list knows the stars' motion where it finds them as trails. Trails beyond its reach, or too dense for it, are left to the
detector, and in a dense field two or three of them run together there. The fits part them again, so that the motion is looked for
among detections and among fits (`ground.vetting.look_alikes`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ground.vetting.star_trails import APART_PX, APART_SHARE, Motion
from onboard.stars.star_motion import LEAST_COMMON, common_motion
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.products import StreakFit
from sboc_e2e.icd.signals import Detection, StarMotion

FEWEST_STARS: Final = 8
"""Lanes of lines that share a motion from which on they are stars: a formation of objects has fewer. Chosen, not measured."""

EQUAL: Final = 0.4
"""Where no star is round, fewer lanes do if their lines are as equal as this: the root mean square of their differences from the
motion, over what they may err. Lines that agree by chance have 0.7. Sixteen drawn fields of trailed stars have 0.16 to 0.44, a
frame of a telescope that follows satellites 0.03, six meteors of one radiant 0.6."""

LINES_A_TERM: Final = 3
"""Star lines for each term of the polynomial that their vectors are fitted with: wide lenses stretch and turn trails towards the
corners. In a picture of a wide lens 60 of 135 lines agree with a rigid motion, and those at the corners are 13 % longer."""
ROUNDS: Final = 6
"""Rounds of the fit and the choice of lines that agree with it, by which they have settled. Chosen."""

NOT_WHOLE: Final = StreakFlag.POINT_LIKE | StreakFlag.EDGE0 | StreakFlag.EDGE1 | StreakFlag.FIT_FAILED
"""Points, lines that a border cuts, and fits that say nothing."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LensMotion:
    """Motion of the stars as a wide lens shows it: a polynomial of the place.

    coefficients : (3 or 6, 2) of the terms 1, y, x, y^2, yx, x^2 for rows and columns, px; y, x from the middle of the frame over
    half its longer side.
    """

    coefficients: NDArray[np.float64]
    shape: tuple[int, ...]

    def at(self, row: NDArray[np.float64], col: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Vectors (n,), (n,) of stars at places (n,)."""
        drow, dcol = (_terms(row, col, self.shape)[:, : len(self.coefficients)] @ self.coefficients).T
        return drow, dcol

    @classmethod
    def of(cls, motion: StarMotion, places: NDArray[np.float64], vectors: NDArray[np.float64], shape: tuple[int, ...]) -> Motion:
        """Fitted to the lines (n, 2 each) that agree with a motion, and to those that agree with the fit; the motion itself
        where these are few.
        """
        terms = _terms(places[:, 0], places[:, 1], shape)
        best: Motion = motion
        for _ in range(ROUNDS):
            share, sign = _share_apart(vectors, np.stack(best.at(places[:, 0], places[:, 1]), axis=1))
            agree = share < 1.0
            n_terms = next((n for n in (6, 3) if np.count_nonzero(agree) >= LINES_A_TERM * n), 0)
            if not n_terms:
                return best
            fitted, *_ = np.linalg.lstsq(terms[agree, :n_terms], (sign[:, None] * vectors)[agree], rcond=None)
            best = cls(coefficients=np.asarray(fitted, dtype=np.float64), shape=shape)
        return best


def _terms(row: NDArray[np.float64], col: NDArray[np.float64], shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Terms (n, 6) of the polynomials."""
    y, x = ((2.0 * place - (side - 1)) / max(shape) for place, side in zip((row, col), shape, strict=True))
    return np.column_stack((np.ones_like(y), y, x, y * y, y * x, x * x))


def _share_apart(vectors: NDArray[np.float64], wanted: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Differences (n,) of lines from the motion there over what they may err, and the signs (n,) with which they are nearer."""
    sign = np.where((vectors * wanted).sum(axis=1) >= 0.0, 1.0, -1.0)
    return np.hypot(*(sign[:, None] * vectors - wanted).T) / _may_err(wanted), sign


def stars_as_lines(
    found: Sequence[Detection] | Sequence[StreakFit], round_stars: bool = True, *, shape: tuple[int, ...]
) -> Motion | None:
    """The motion that the stars share where they are lines, detections or fits; None where the lines share none.

    Lines that share a motion and follow each other are a train of satellites, and one lane. Stars lie all over the frame.
    round_stars : whether the frame has stars that are points. Where it has none, the stars must be among the lines, and
        `LEAST_COMMON` lanes do if they are `EQUAL`. Objects of a formation leave equal lines beside stars that are round.
    """
    lines = sorted((line for line in found if not line.flags & NOT_WHOLE), key=lambda line: -line.snr)
    ends = np.array([(line.row0, line.col0, line.row1, line.col1) for line in lines]).reshape(-1, 4)
    places, vectors = 0.5 * (ends[:, :2] + ends[:, 2:]), ends[:, 2:] - ends[:, :2]
    motion = common_motion(places, vectors, (0.5 * (shape[0] - 1), 0.5 * (shape[1] - 1)))
    if motion is None:
        return None
    wanted = np.stack(motion.at(places[:, 0], places[:, 1]), axis=1)
    share, _ = _share_apart(vectors, wanted)
    agree = share < 1.0
    lanes = lanes_of(places[agree], wanted[agree])
    equal = not round_stars and lanes >= LEAST_COMMON and float(np.mean(share[agree] ** 2)) <= EQUAL**2
    return LensMotion.of(motion, places, vectors, shape) if equal or lanes >= FEWEST_STARS else None


def lanes_of(places: NDArray[np.float64], vectors: NDArray[np.float64]) -> int:
    """Number of lanes of trails (n, 2: row, col) about their middles: those that follow each other along their way share one."""
    length, wide = np.hypot(*vectors.T), _may_err(vectors)
    lanes: list[int] = []
    # a line that is no longer than its own lane is wide tells no way
    for k in np.flatnonzero(length > 2.0 * wide).tolist():
        d_row, d_col = (places[k] - places[lanes]).T
        aside = np.abs(d_row * vectors[lanes, 1] - d_col * vectors[lanes, 0]) / length[lanes]
        if (aside > wide[lanes]).all():
            lanes.append(k)
    return len(lanes)


def _may_err(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """By how much a line may differ from these vectors (n, 2) of stars, px."""
    return np.asarray(APART_PX + APART_SHARE * np.hypot(*vectors.T), dtype=np.float64)
