"""Chains of trailed stars: two or three trails end to end, or side by side, that a fit took for one line.

Where the stars of a frame share a motion, each leaves a trail of the same length and direction. Chance puts some of them nearly
on one line, a few degrees off that direction. They are no rows of points, for they have no gaps, and are longer than one star.
How many there are follows from the lines that are single stars; a trail of an object has any direction and length.
"""

from collections.abc import Sequence
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from ground.vetting.star_rows import LN_LENGTHS, REAL_PER_FRAME
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.products import StreakFit

APART_PX: Final = 1.5
"""A trail is a star's when its vector is as near as this to the stars' motion, plus `APART_SHARE` of its length: as on
board (`onboard.stars.star_motion`)."""
APART_SHARE: Final = 0.1
"""Share of a star trail's length by which its vector may err, beside `APART_PX`."""

OFF_PX: Final = 1.8
"""Scale of the sine of the angle between a chain and the stars times the length of a star, px: how far aside the next star of a
chain lies. Their number falls exponentially with it. Of 131 lines of a frame with trails of 27 px 80 lie within 2 deg, 109
within 4 and 121 within 8."""
FURTHER: Final = 1.0
"""Scale of the length of a chain beyond that of one star, over that. The same frame."""
SHORTER: Final = 0.1
"""Scale of the length by which a faint star falls short of the others, over that. The same frame: two in 131 by a fifth."""
LN_SNR: Final = 0.7
"""One sigma of ln S/N within which stars are as bright as those of a chain: half to twice, as for look-alikes."""


class Motion(Protocol):
    """Motion of the stars of a frame during its exposure, of open sign."""

    def at(self, row: NDArray[np.float64], col: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Vectors (n,), (n,) in px, rows and columns, of stars at places (n,)."""


def star_vectors(stars: Motion, fits: Sequence[StreakFit]) -> NDArray[np.float64]:
    """Vectors (n, 2: row, col) in px of a star at the middle of each fit; the sign of all is open."""
    ends = np.array([(fit.row0, fit.row1, fit.col0, fit.col1) for fit in fits], dtype=np.float64).reshape(-1, 4)
    return np.column_stack(stars.at(ends[:, :2].mean(axis=1), ends[:, 2:].mean(axis=1)))


def move_as(stars: Motion, fits: Sequence[StreakFit]) -> NDArray[np.bool_]:
    """(n,) which trails are as long as that of a star at their place, and run the same way; a border may cut some shorter."""
    wanted = star_vectors(stars, fits)
    vector = np.array([(fit.row1 - fit.row0, fit.col1 - fit.col0) for fit in fits], dtype=np.float64).reshape(-1, 2)
    vector *= np.where((vector * wanted).sum(axis=1) >= 0.0, 1.0, -1.0)[:, None]
    length = np.hypot(*wanted.T)
    cut = np.array([bool(fit.flags & (StreakFlag.EDGE0 | StreakFlag.EDGE1)) for fit in fits], dtype=np.bool_)
    share = np.minimum([fit.length_px for fit in fits], length) / np.maximum(length, 1e-9)
    wanted *= np.where(cut, share, 1.0)[:, None]
    return np.asarray(np.hypot(*(vector - wanted).T) < APART_PX + APART_SHARE * length)


def against_chains(stars: Motion, fits: Sequence[StreakFit]) -> NDArray[np.float64]:
    """(n,) odds of a chain of star trails against a trail of an object, for the fits of a frame whose stars share a motion.

    Chains are taken to be as many as the single stars that are as bright, each piece of the line for itself.
    """
    wanted, single = star_vectors(stars, fits), move_as(stars, fits)
    length = np.hypot(*wanted.T)
    fitted = np.array([(fit.row1 - fit.row0, fit.col1 - fit.col0) for fit in fits], dtype=np.float64).reshape(-1, 2)
    across = wanted[:, 0] * fitted[:, 1] - wanted[:, 1] * fitted[:, 0]
    sine = np.abs(across) / np.maximum(length * np.hypot(*fitted.T), 1e-9)
    over = np.array([fit.length_px for fit in fits]) / np.maximum(length, 1e-9)
    ln_snr = np.log(np.maximum([fit.snr for fit in fits], 1e-3))
    fainter = np.maximum((ln_snr - 0.5 * np.log(np.maximum(over, 1.0)))[:, None] - ln_snr[None, :], 0.0) / LN_SNR
    number = (np.exp(-0.5 * fainter**2) * single).sum(axis=1)
    scale = np.minimum(OFF_PX / np.maximum(length, 1e-9), 1.0)
    direction = np.pi / (2.0 * scale) * np.exp(-sine / scale)
    lengths = LN_LENGTHS * over * np.exp(-np.where(over < 1.0, (1.0 - over) / SHORTER, (over - 1.0) / FURTHER)) / FURTHER
    return np.asarray(number / REAL_PER_FRAME * direction * lengths, dtype=np.float64)
