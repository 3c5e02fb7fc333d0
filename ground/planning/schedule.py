"""A schedule: visits in their order, and what each is for."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ground.planning.windows import Windows


@dataclass(frozen=True, kw_only=True)
class Visit:
    """The camera rests on a field.

    boresight : unit vector, GCRS axes. targets : numbers of those in the field. gain : nats, of all of them.
    """

    start_tai_ns: int
    end_tai_ns: int
    boresight: tuple[float, float, float]
    targets: tuple[int, ...]
    gain: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Schedule:
    """Visits by time; gain_nats : (m,) of each target; forbidden : share of cases that each constraint forbids.

    windows : when each target can be seen, brightness aside; None for a fence.
    """

    visits: tuple[Visit, ...]
    gain_nats: NDArray[np.float64]
    forbidden: dict[str, float]
    n_slots: int
    notes: tuple[str, ...]
    windows: Windows | None = None

    @property
    def worth(self) -> float:
        """Sum of the gains, nats."""
        return float(sum(visit.gain for visit in self.visits))
