"""Columns of a selection of stars."""

from dataclasses import dataclass, fields
from enum import IntFlag

import numpy as np
from numpy.typing import NDArray


class CatalogueFlag(IntFlag):
    """State of a catalogue entry (uint8)."""

    NO_PROPER_MOTION = 1 << 0
    """No proper motion is known; the position is that of the observation (about 1991.5 in Tycho-2)."""
    ONE_BAND = 1 << 1
    """Measured in one band only; the colour is assumed."""
    SUPPLEMENT = 1 << 2
    """From Tycho-2 supplement 1 (Hipparcos or Tycho-1 entry)."""
    DOUBLE = 1 << 3
    """Photocentre of a pair, or member of a resolved pair treated as double."""
    SYNTHETIC = 1 << 4
    """Not a real star: drawn from counts."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Stars:
    """Stars at one epoch; columns of equal length n.

    ra_deg, dec_deg : float64, ICRS at `epoch_jyear`, proper motion applied. pm_ra_mas_yr (times cos dec), pm_dec_mas_yr :
    float32 at that epoch, 0 where unknown. v_mag, b_v : float32, Johnson. sigma_mas : float32, quoted error of each
    coordinate at that epoch. flags : uint8 of `CatalogueFlag`. source_id : int64, the catalogue's own identifier
    (Tycho-2: TYC1 << 17 | TYC2 << 3 | TYC3). hip : int32 Hipparcos number, 0 for none.
    """

    epoch_jyear: float
    ra_deg: NDArray[np.float64]
    dec_deg: NDArray[np.float64]
    pm_ra_mas_yr: NDArray[np.float32]
    pm_dec_mas_yr: NDArray[np.float32]
    v_mag: NDArray[np.float32]
    b_v: NDArray[np.float32]
    sigma_mas: NDArray[np.float32]
    flags: NDArray[np.uint8]
    source_id: NDArray[np.int64]
    hip: NDArray[np.int32]

    def __len__(self) -> int:
        return len(self.ra_deg)

    def take(self, index: NDArray[np.intp] | NDArray[np.bool_]) -> "Stars":
        """The stars of an index or mask, in its order."""
        columns = {f.name: getattr(self, f.name)[index] for f in fields(self) if f.name != "epoch_jyear"}
        return Stars(epoch_jyear=self.epoch_jyear, **columns)
