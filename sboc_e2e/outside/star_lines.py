"""The motion that the lines of a frame share where its stars are lines: equal trails all over it.

The star list knows the stars' motion where it finds them as trails. Trails beyond its reach, or too dense for it, are left to the
detector, and in a dense field two or three of them run together there. The fits part them again, so that the motion is looked for
among detections and among fits (`ground.vetting.look_alikes`).
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ground.vetting.star_trails import APART_PX, APART_SHARE
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

NOT_WHOLE: Final = StreakFlag.POINT_LIKE | StreakFlag.EDGE0 | StreakFlag.EDGE1 | StreakFlag.FIT_FAILED
"""Points, lines that a border cuts, and fits that say nothing."""


def stars_as_lines(
    found: Sequence[Detection] | Sequence[StreakFit], round_stars: bool = True, *, shape: tuple[int, ...]
) -> StarMotion | None:
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
    apart = np.minimum(np.hypot(*(vectors - wanted).T), np.hypot(*(vectors + wanted).T))
    share = apart / _may_err(wanted)
    agree = share < 1.0
    lanes = lanes_of(places[agree], wanted[agree])
    equal = not round_stars and lanes >= LEAST_COMMON and float(np.mean(share[agree] ** 2)) <= EQUAL**2
    return motion if equal or lanes >= FEWEST_STARS else None


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
