"""A fence across the geostationary ring: fields along a meridian, one after another, again and again.

An object of the ring drifts through the meridian once a day. It cannot slip through if it stays in the field for longer than the
camera needs to return to it. The fence is fixed in space on the ring itself. The parallax of a camera in low orbit (10 deg to
both sides) therefore moves it in the same way as the passing objects.
"""

from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ground.orbit.dynamics import MU_KM3_S2
from ground.planning.constraints import Visibility, visibility_of
from ground.planning.contradiction import contradiction
from ground.planning.light import PlannedCamera
from ground.planning.options import PlanOptions
from ground.planning.schedule import Schedule, Visit
from ground.planning.sky import Orbit, Site, Sky, sky_of
from sboc_e2e.icd.errors import UserError

Array = NDArray[np.float64]

RING_KM: Final = 42164.2
"""Radius of the geostationary ring: the cube root of GM over the square of the Earth's spin, 42,164.17 km."""
RING_SPEED_KM_S: Final = float(np.sqrt(MU_KM3_S2 / RING_KM))
_TRIED_DEG: Final = np.concatenate([np.arange(0.0, 91.0, 2.0), -np.arange(2.0, 91.0, 2.0)])
"""Meridians tried, from that opposite to the Sun: the nearer, the better lit."""


@dataclass(frozen=True, kw_only=True)
class FenceOptions:
    """The strip that the fence closes."""

    latitude_deg: float = field(
        default=15.0, metadata={"doc": "the fence reaches so far north and south of the equator", "min": 0.0, "max": 60.0}
    )
    overlap: float = field(default=0.1, metadata={"doc": "share of a field that its neighbour repeats", "min": 0.0, "max": 0.9})


@dataclass(frozen=True, kw_only=True, eq=False)
class Fence:
    """A schedule that closes a meridian.

    cycle_s : from one visit of a field to the next. longest_gap_s : the same where constraints forbid visits, the longest of all
    fields. crossing_s : least time that an object of the ring spends in a field while a visit lasts. held : share of visits
    that no constraint forbids.
    """

    schedule: Schedule
    meridian_deg: float
    n_fields: int
    cycle_s: float
    longest_gap_s: float
    crossing_s: float
    held: float

    @property
    def leak_proof(self) -> bool:
        """Nothing slips through: the camera is always back in time."""
        return self.longest_gap_s <= self.crossing_s


def fence_of(station: Site | Orbit, camera: PlannedCamera, start_tai_ns: int, options: PlanOptions, strip: FenceOptions) -> Fence:
    """The best-lit meridian at which most visits are possible, and its visits. UserError where none is possible."""
    observing_s = options.exposures * camera.period_s
    nearest_km = RING_KM - (7500.0 if isinstance(station, Orbit) else 6378.0)
    side_km = np.sqrt(2.0) * camera.half_field_rad * nearest_km  # of the square inside the circle
    latitude_km = 2.0 * np.radians(strip.latitude_deg) * RING_KM
    n_fields = max(1, int(np.ceil((latitude_km - side_km) / (side_km * (1.0 - strip.overlap)))) + 1)
    latitude = np.radians(strip.latitude_deg) - 0.5 * side_km / RING_KM
    latitudes = (np.linspace(-latitude, latitude, n_fields) if n_fields > 1 else np.zeros(1))[_order(n_fields)]
    _refuse_hurry(latitudes, observing_s, options)
    slot_s: Array = np.arange(max(n_fields, int(options.days * 86400.0 / options.visit_s)), dtype=np.float64) * options.visit_s
    epochs = start_tai_ns + np.round((slot_s + options.visit_s - 0.5 * observing_s) * 1e9).astype(np.int64)
    sky = sky_of(station, epochs)
    meridian, seen = _best_meridian(sky, latitudes, options)
    allowed = seen.allowed[0]
    visits = tuple(
        Visit(
            start_tai_ns=int(epochs[k] - round(0.5e9 * observing_s)),
            end_tai_ns=int(epochs[k] + round(0.5e9 * observing_s)),
            boresight=(float(seen.direction[0, k, 0]), float(seen.direction[0, k, 1]), float(seen.direction[0, k, 2])),
            targets=(),
            gain=0.0,
        )
        for k in np.flatnonzero(allowed)
    )
    crossing_s = side_km / RING_SPEED_KM_S - observing_s
    cycle_s = n_fields * options.visit_s
    note = f"a field is visited every {cycle_s:.0f} s and crossed in {crossing_s:.0f} s"
    schedule = Schedule(visits=visits, gain_nats=np.zeros(0), forbidden=seen.forbidden, n_slots=len(slot_s), notes=(note,))
    return Fence(
        schedule=schedule,
        meridian_deg=float(np.degrees(meridian) % 360.0),
        n_fields=n_fields,
        cycle_s=float(cycle_s),
        longest_gap_s=_longest_gap_s(slot_s, allowed, n_fields),
        crossing_s=float(crossing_s),
        held=float(np.mean(allowed)),
    )


def _order(n_fields: int) -> NDArray[np.int64]:
    """Every second field on the way north, the others on the way back: all steps are short, all fields wait equally long."""
    return np.concatenate([np.arange(0, n_fields, 2), np.arange(1, n_fields, 2)[::-1]])


def _refuse_hurry(latitudes: Array, observing_s: float, options: PlanOptions) -> None:
    """UserError where the longest step, as seen from a low orbit, does not fit into a visit."""
    step_deg = float(np.degrees(np.abs(np.diff(latitudes, append=latitudes[:1])).max())) * RING_KM / (RING_KM - 7500.0)
    needed_s = step_deg / options.slew.rate_deg_s + options.slew.settling_s + observing_s
    if needed_s > options.visit_s:
        raise UserError(
            f"plan.visit: slew, settling and exposures of a fence take {needed_s:.0f} s, more than a visit of "
            f"{options.visit_s:g} s; allowed is more, or a faster slew"
        )


def _longest_gap_s(slot_s: Array, allowed: NDArray[np.bool_], n_fields: int) -> float:
    """Longest time in which some field is not visited, from the start to the end of the plan."""
    gaps = []
    for field_number in range(n_fields):
        mine = np.arange(len(slot_s)) % n_fields == field_number
        times = np.concatenate([[slot_s[0]], slot_s[mine & allowed], [slot_s[-1]]])
        gaps.append(float(np.diff(times).max()))
    return max(gaps)


def _best_meridian(sky: Sky, latitudes: Array, options: PlanOptions) -> tuple[float, Visibility]:
    """Right ascension (rad) at which most visits are possible, the best-lit of equals; its geometry.

    UserError where no visit is possible at any of them.
    """
    middle = sky.sun_km[len(sky.sun_km) // 2]
    opposite = float(np.arctan2(-middle[1], -middle[0]))
    latitude = latitudes[np.arange(len(sky.t_tai_ns)) % len(latitudes)]
    found: list[tuple[float, float, Visibility]] = []
    for offset in np.radians(_TRIED_DEG[np.argsort(np.abs(_TRIED_DEG), kind="stable")]):
        ra = opposite + float(offset)
        point = RING_KM * np.stack([np.cos(latitude) * np.cos(ra), np.cos(latitude) * np.sin(ra), np.sin(latitude)], axis=1)
        east = np.array([-np.sin(ra), np.cos(ra), 0.0]) * RING_SPEED_KM_S
        seen = visibility_of(point[None], np.broadcast_to(east, point.shape)[None], sky, options.constraints)
        found.append((float(np.mean(seen.allowed)), ra, seen))
        if found[-1][0] == 1.0:
            break
    held, ra, seen = max(found, key=lambda one: one[0])
    if held == 0.0:
        why = contradiction([each for _, _, each in found], None, options)
        raise UserError(f"fence: no meridian of the geostationary ring can be seen at any time: {why}")
    return ra, seen
