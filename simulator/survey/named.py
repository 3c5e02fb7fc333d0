"""Passages of objects with names through the field: the counterpart of drawn passages in `simulator.survey.passages`.

Time is cut into legs of 10 s. In each leg an object moves straight relative to the camera. The accelerations of two objects
near each other differ by less than 0.1 m/s^2, a metre in 5 s; for the farthest it is 0.1 km. States come from the middle of every
minute by a series of third order, good to a metre. Legs that follow one another are one passage.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from simulator.platform import earth
from simulator.scene.encounters import in_field
from simulator.scene.fleet import Fleet
from simulator.scene.prediction import may_cross
from simulator.survey.flight import BLOCK_S, Flight, Instants, instants_of
from simulator.survey.looks import Looks, looks_of
from simulator.survey.passages import Passages, make_passages

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

LEG_S: Final = 10.0  # step of an object's path; it moves straight within: half a leg bends it by 0.1 km at most (g t^2 / 2)
MINUTE_S: Final = 60.0  # step of the first look; `series` to its ends errs by 0.3 m to the fourth order and by 5 m for J2
LEGS_EACH: Final = round(MINUTE_S / LEG_S)
CHUNK: Final = 1500
"""Objects whose states are held at a time."""

APART_S: Final = 25.0
"""Legs of an object that lie farther apart belong to two passages."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FleetBlock:
    """Passages of a block (n,), their looks, and the object that each is of.

    too_slow : passages left out because they are slower than what the response was measured with.
    """

    at: Instants
    passages: Passages
    looks: Looks
    object: Indices
    too_slow: int


def fleet_block(flight: Flight, fleet: Fleet, block: int, farthest_km: float) -> FleetBlock:
    """What of a fleet passes the field in a block."""
    start = block * BLOCK_S
    middles = np.asarray(start + MINUTE_S * (np.arange(round(BLOCK_S / MINUTE_S)) + 0.5), dtype=np.float64)
    legs_s = np.asarray(start + LEG_S * (np.arange(round(BLOCK_S / LEG_S)) + 0.5), dtype=np.float64)
    at = instants_of(flight, legs_s, BLOCK_S)
    coarse = instants_of(flight, middles, BLOCK_S)
    rows, minutes, states = _near_the_field(flight, fleet, coarse)
    legs = np.repeat(np.arange(len(rows)), LEGS_EACH)
    instant = minutes[legs] * LEGS_EACH + np.tile(np.arange(LEGS_EACH), len(rows))
    position, velocity = series(states[legs], at.time_s[instant] - middles[minutes[legs]])
    who, exposure = rows[legs], flight.camera.exposure_s
    there = at.watched[instant] & (at.time_s[instant] >= fleet.from_s[who]) & (at.time_s[instant] < fleet.to_s[who])
    camera, moves = at.in_camera(instant, position, velocity)
    enter, leave = in_field(camera, moves, flight.window)
    half = 0.5 * LEG_S + exposure
    there &= (np.maximum(enter, -half) < np.minimum(leave, half)) & (np.linalg.norm(camera, axis=1) < farthest_km)
    # the pyramid's mirror image behind the camera
    there &= camera[:, 2] + moves[:, 2] * np.clip(0.5 * (enter + leave), -half, half) > 0.0
    kept = np.flatnonzero(there)
    kept = kept[np.lexsort((instant[kept], who[kept]))]
    who, instant = who[kept], instant[kept]
    p = make_passages(flight, at, instant, fleet.size_m[who], fleet.surfaces.taken(who), position[kept], velocity[kept])
    fast = p.rate_deg_s >= flight.options.population.slowest_deg_s
    number, slow = _numbered(who, at.time_s[instant], fast)
    which = np.flatnonzero(fast)
    p, who, instant = p.taken(which), who[which], instant[which]
    number = number[which]
    looks = looks_of(flight, at, p, np.random.default_rng(0), only=_own_frames(flight, at, instant), turns=False)
    _, first, merged = np.unique(number, return_index=True, return_inverse=True)
    count = np.bincount(merged, minlength=len(first))
    middle = first + count // 2
    frames = np.bincount(merged, weights=looks.frames, minlength=len(first)).astype(np.int64)
    return FleetBlock(
        at=at,
        passages=p.taken(middle),
        looks=replace(looks, passage=merged[looks.passage], frames=frames),
        object=who[middle],
        too_slow=slow,
    )


def series(states: Array, dt_s: Array) -> tuple[Array, Array]:
    """Positions and velocities (n, 3) a time (n,) after states (n, 6): two-body motion to the third order."""
    r, v, t = states[:, :3], states[:, 3:], dt_s[:, None]
    radius2 = np.sum(r * r, axis=1, keepdims=True)
    pull = earth.MU_KM3_S2 / radius2**1.5
    jerk = -pull * (v - 3.0 * np.sum(r * v, axis=1, keepdims=True) / radius2 * r)
    return r + t * v - 0.5 * t**2 * pull * r + t**3 / 6.0 * jerk, v - t * pull * r + 0.5 * t**2 * jerk


def _near_the_field(flight: Flight, fleet: Fleet, coarse: Instants) -> tuple[Indices, Indices, Array]:
    """Objects (k,) that may be in the field in a minute (k,), and their states (k, 6) in the middle of it."""
    rows, minutes, states = [], [], []
    window = flight.window
    turn = np.linalg.norm(coarse.spin_rad_s, axis=1) * 0.5 * MINUTE_S
    first, last = coarse.time_s[0] - MINUTE_S, coarse.time_s[-1] + MINUTE_S
    present = np.flatnonzero((fleet.from_s < last) & (fleet.to_s > first))
    for begin in range(0, len(present), CHUNK):
        some = present[begin : begin + CHUNK]
        position, velocity = fleet.states(some, coarse.time_s)
        for k in np.flatnonzero(coarse.watched):
            camera = (position[:, k] - coarse.position_km[k]) @ coarse.attitude[k].T
            rate = (velocity[:, k] - coarse.velocity_km_s[k]) @ coarse.attitude[k].T
            half_row, half_col = 1.02 * (window.half_row + abs(window.mid_row)), 1.02 * (window.half_col + abs(window.mid_col))
            crosses = may_cross(camera, rate, 0.5 * MINUTE_S + 1.0, half_row, half_col, float(turn[k]))
            near = np.flatnonzero(crosses & np.isfinite(camera).all(axis=1))
            rows.append(some[near])
            minutes.append(np.full(len(near), k))
            states.append(np.concatenate([position[near, k], velocity[near, k]], axis=1))
    if not rows:
        return np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 6))
    return np.concatenate(rows), np.concatenate(minutes), np.concatenate(states)


def _numbered(who: Indices, time_s: Array, fast: NDArray[np.bool_]) -> tuple[Indices, int]:
    """Number of the passage of each leg, sorted by object and time; and how many passages have no leg that is fast enough."""
    new = np.ones(len(who), dtype=bool)
    new[1:] = (np.diff(who) != 0) | (np.diff(time_s) > APART_S)
    number = np.cumsum(new) - 1
    return number, int(number[-1] + 1 - len(np.unique(number[fast]))) if len(number) else 0


def _own_frames(flight: Flight, at: Instants, instant: Indices) -> tuple[Indices, Indices]:
    """First and last frame whose middle row opens within each leg: no frame belongs to two."""
    period = 1.0 / flight.options.frame_rate_hz
    begin = at.time_s[instant] - 0.5 * LEG_S
    first = np.ceil(begin / period - 1e-9).astype(np.int64)
    beyond = np.ceil((begin + LEG_S) / period - 1e-9).astype(np.int64)
    return first, beyond - 1
