"""Result of radiation in one exposure: charge in pixels, and a table of tracks for the truth."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, kw_only=True, eq=False)
class HitList:
    """Charge of particle tracks, sparse; a pixel may appear more than once.

    row, col : (n,) int32, detector pixels, all inside the detector. charge_e : (n,) float32.
    tracks : structured array with columns row0, col0, row1, col1 (entry and exit of the sensitive layer, px, may lie outside
        the detector) and charge_e (electrons left inside it); one row for each track that left any.
    """

    row: NDArray[np.int32]
    col: NDArray[np.int32]
    charge_e: NDArray[np.float32]
    tracks: NDArray[np.void]


TRACK_DTYPE = np.dtype([(name, "f4") for name in ("row0", "col0", "row1", "col1", "charge_e")])


def no_hits() -> HitList:
    """The empty list."""
    return HitList(
        row=np.zeros(0, dtype=np.int32),
        col=np.zeros(0, dtype=np.int32),
        charge_e=np.zeros(0, dtype=np.float32),
        tracks=np.zeros(0, dtype=TRACK_DTYPE),
    )
