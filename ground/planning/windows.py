"""When each target can be seen: the instants at which constraints begin and end to forbid it, to half a second."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ground.orbit.catalogue_match import KnownObjects
from ground.planning.constraints import visibility_of
from ground.planning.options import ConstraintOptions
from ground.planning.sky import Orbit, Site, sky_of
from ground.planning.targets import states_at

_RESOLUTION_NS: Final = 500_000_000
"""Bisection ends here: both ends of a window are right to half a second. Chosen, not measured."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Windows:
    """k windows by target, then time. target : (k,) numbers; start_tai_ns, end_tai_ns : (k,)."""

    target: NDArray[np.int64]
    start_tai_ns: NDArray[np.int64]
    end_tai_ns: NDArray[np.int64]


def windows_of(
    known: KnownObjects,
    station: Site | Orbit,
    options: ConstraintOptions,
    t_tai_ns: NDArray[np.int64],
    allowed: NDArray[np.bool_],
) -> Windows:
    """Windows within the instants t_tai_ns (n,), where `allowed` (m, n) is True; brightness is not considered.

    A window that lies between two instants is not found, nor is a gap.
    """
    padded = np.pad(allowed, ((0, 0), (1, 1)))
    target, place = np.nonzero(padded[:, 1:] != padded[:, :-1])  # place k: between instants k - 1 and k
    before = t_tai_ns[np.maximum(place - 1, 0)].copy()
    after = t_tai_ns[np.minimum(place, len(t_tai_ns) - 1)].copy()
    opens = padded[target, place + 1]
    while len(before) and (after - before).max() > _RESOLUTION_NS:
        middle = before + (after - before) // 2
        ahead = _allowed_at(known, station, options, target, middle) == opens
        after = np.where(ahead, middle, after)
        before = np.where(ahead, before, middle)
    return Windows(target=target[opens], start_tai_ns=after[opens], end_tai_ns=before[~opens])


def _allowed_at(
    known: KnownObjects, station: Site | Orbit, options: ConstraintOptions, target: NDArray[np.int64], t_tai_ns: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """What constraints say of targets (k,), each at its own time."""
    position, velocity = states_at(known, target, t_tai_ns)
    order = np.argsort(t_tai_ns, kind="stable")
    sky = sky_of(station, t_tai_ns[order])
    out = np.empty(len(target), dtype=np.bool_)
    out[order] = visibility_of(position[None, order], velocity[None, order], sky, options).allowed[0]
    return out
