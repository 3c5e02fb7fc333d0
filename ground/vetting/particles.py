"""Lines that are sharper than the optics: tracks of particles, or light where the stars are wider than the optics.

Full, stretched and crowded stars, and those of pictures that were made smaller, are wider than a trail beside them. A particle's
track is sharper than any of them. Their lengths differ: of particles from all sides a share of d^2 / (d^2 + L^2) leaves a track
longer than L in a detector d thick, so that a frame with long tracks has many more short ones. Trails have any length. How many
of a frame's sharp lines are tracks follows from all of them.
"""

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ground.vetting.star_rows import REAL_PER_FRAME
from sboc_e2e.icd.products import StreakFit

THICKNESS_PX: Final = 17.0
"""Thickness of a detector: 250 um, pixels of 15 um. Thin ones, and those of video, have shorter tracks."""
SHORTEST_PX: Final = 15.0
"""Shorter lines are not counted: they are sharp for many reasons. Chosen, not measured."""
LEAST_SNR: Final = 20.0
"""Fainter lines are not counted: noise is sharper than the optics too. Chosen, not measured: its best maxima have 8."""
LONGEST_PX: Final = 1600.0
"""Lengths of trails up to it are alike in their logarithm."""
PER_FRAME: Final = 0.1
"""Expected tracks of a frame that shows none."""
SHARP: Final = -0.2
"""Ln of a width over that of the optics from which on a line is sharper than they are. Chosen, not measured."""
ITERATIONS: Final = 20
"""Numbers of tracks and of trails, and the odds of each line, in turn: a budget of work."""


def odds_of_particles(fits: Sequence[StreakFit], sharp: Sequence[bool]) -> NDArray[np.float64]:
    """Odds (n,) of the track of a particle against a trail for the sharp lines of a frame, as far as lengths tell.

    Infinite for lines that are too short or faint to tell, or not sharp.
    sharp : lines that are sharper than the optics.
    """
    length = np.array([fit.length_px for fit in fits], dtype=np.float64)
    bright = np.array([fit.snr >= LEAST_SNR for fit in fits], dtype=np.bool_)
    counts = np.asarray(sharp, dtype=np.bool_) & (length >= SHORTEST_PX) & bright
    of_tracks = 2.0 * length**2 * (THICKNESS_PX**2 + SHORTEST_PX**2) / (THICKNESS_PX**2 + length**2) ** 2
    ratio = of_tracks * math.log(LONGEST_PX / SHORTEST_PX)
    odds = np.zeros(len(fits))
    for _ in range(ITERATIONS):
        tracks = np.where(counts, odds / (1.0 + odds), 0.0)
        trails = np.where(counts, 1.0 - tracks, 0.0)
        per_frame = 0.5 * (REAL_PER_FRAME + trails.sum() - trails)
        odds = np.where(counts, (PER_FRAME + tracks.sum() - tracks) / per_frame * ratio, 0.0)
    return np.where(counts, odds, np.inf)
