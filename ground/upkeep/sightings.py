"""What each known orbit says of a night's tracklets: one integration for each orbit, and a look at the tracklets near its way."""

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from itertools import chain, repeat
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ground.determination.forces import ForceModel
from ground.determination.measurements import Directions
from ground.determination.perigee import piece_ns
from ground.determination.propagation import Flight
from ground.store.forces import noise_of, push_of
from ground.store.store import StoredOrbit
from sboc_e2e.icd.errors import UserError

Array = NDArray[np.float64]

NODES_PER_ORBIT: Final = 24
"""Equal in time; at perigee, where it is fastest, the orbit turns by a 24th from one to the next.

Cubic Hermite polynomials between them err by (2 pi / 24)^4 / 384 = 1.2e-5 of the radius of a circle.
"""
LONGEST_NODE_S: Final = 3600.0
"""Bound for slow orbits: 24 nodes a day."""
NEAR_RAD: Final = 2e-3
"""Added to the sieve's radius of six sigma: for the polynomials and the directions' own errors."""
WIDEST_RAD: Final = 0.5
"""29 deg: an error as large as the range says nothing; nothing wider is searched."""
ORBITS_AT_ONCE: Final = 500
"""Orbits given to a process at once: large against the cost of sending, small against a catalogue. Chosen, not measured."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Sighting:
    """An orbit and a tracklet near its way, from the orbit's own epoch.

    state (6,), covariance (6, 6) : predicted at the tracklet's middle. numbers : (6 + k, 6 + k), how state and parameters there
    follow from those at the orbit's epoch; noise : (6 + k, 6 + k), what the forces left out adds. residual (m,), slope
    (m, 6 + k) : of the tracklet's whitened directions, by the orbit's numbers at its epoch.
    """

    object_id: int
    tracklet_id: int
    t_tai_ns: int
    state: Array
    covariance: Array
    numbers: Array
    noise: Array
    residual: Array
    slope: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class KnownOrbit:
    """An orbit with its forces and the covariance (6 + k, 6 + k) of state and estimated parameters."""

    orbit: StoredOrbit
    forces: ForceModel
    covariance: Array

    @property
    def parameters(self) -> tuple[str, ...]:
        """Estimated parameters in the order of the covariance."""
        return tuple(self.orbit.parameters)


@dataclass(frozen=True, kw_only=True, eq=False)
class Tracklets:
    """A night's tracklets in the order of their middles: numbers, directions; epochs (n,), observers (n, 3) km, lines (n, 3)."""

    numbers: tuple[int, ...]
    data: tuple[Directions, ...]

    @classmethod
    def of(cls, data: Mapping[int, Directions]) -> "Tracklets":
        """Of tracklets by number."""
        numbers = sorted(data, key=lambda k: (int(data[k].t_tai_ns[len(data[k].t_tai_ns) // 2]), k))
        return cls(numbers=tuple(numbers), data=tuple(data[k] for k in numbers))

    @property
    def middles(self) -> tuple[NDArray[np.int64], Array, Array]:
        """Epochs, observers and lines of the middle directions."""
        rows = [(d, len(d.t_tai_ns) // 2) for d in self.data]
        t = np.array([d.t_tai_ns[m] for d, m in rows], dtype=np.int64)
        return t, np.array([d.observer_km[m] for d, m in rows]), np.array([d.direction[m] for d, m in rows])


def sightings(data: Mapping[int, Directions], known: Sequence[KnownOrbit], pool: Executor | None = None) -> list[Sighting]:
    """All pairs of an orbit and a tracklet near its way, in the order of orbits and tracklets, with or without processes.

    An orbit that cannot be propagated to the night has none.
    """
    if not data or not known:
        return []
    night = Tracklets.of(data)
    if pool is None:
        return _of_some(night, known)
    parts = [known[k : k + ORBITS_AT_ONCE] for k in range(0, len(known), ORBITS_AT_ONCE)]
    return list(chain.from_iterable(pool.map(_of_some, repeat(night), parts)))


def _of_some(night: Tracklets, known: Sequence[KnownOrbit]) -> list[Sighting]:
    t, here, line = night.middles
    span = min(int(d.t_tai_ns[0]) for d in night.data), max(int(d.t_tai_ns[-1]) for d in night.data)
    out: list[Sighting] = []
    for one in known:
        try:
            flight = Flight(one.orbit.state, one.orbit.epoch_tai_ns, *span, one.forces, one.parameters)
            near = _near(one, flight, t, here, line)
            noises = noise_of(one.orbit, flight, t[near])
            out += [
                _sighting(one, flight, noise, night.numbers[k], int(t[k]), night.data[k])
                for k, noise in zip(near, noises, strict=True)
            ]
        except UserError:
            continue
    return out


def _near(one: KnownOrbit, flight: Flight, t: NDArray[np.int64], here: Array, line: Array) -> NDArray[np.intp]:
    """Places in the list of tracklets within six sigma of where the orbit is expected."""
    node_ns = min(piece_ns(one.orbit.state, NODES_PER_ORBIT), round(1e9 * LONGEST_NODE_S))
    nodes = np.unique(np.append(np.arange(t[0], t[-1], node_ns, dtype=np.int64), t[-1]))
    arc = flight.at(nodes)
    place_of = arc.partials[:, :3]
    # of accelerations that the forces leave out, a circular orbit moves along its way three times as far as in free motion
    pushed = 3.0 * push_of(one.orbit) * np.abs((nodes - one.orbit.epoch_tai_ns) * 1e-9) ** 3
    spread = np.sqrt(np.einsum("nij,nij->n", place_of @ one.covariance, place_of) + pushed)
    if len(nodes) == 1:
        place, sigma = np.tile(arc.states[0, :3], (len(t), 1)), np.full(len(t), spread[0])
    else:
        j = np.clip(np.searchsorted(nodes, t, side="right") - 1, 0, len(nodes) - 2)
        h = (nodes[j + 1] - nodes[j]) * 1e-9
        u = ((t - nodes[j]) * 1e-9 / h)[:, None]
        p0, p1 = arc.states[j, :3], arc.states[j + 1, :3]
        v0, v1 = arc.states[j, 3:] * h[:, None], arc.states[j + 1, 3:] * h[:, None]
        place = p0 + u * (v0 + u * (3.0 * (p1 - p0) - 2.0 * v0 - v1 + u * (2.0 * (p0 - p1) + v0 + v1)))
        sigma = np.maximum(spread[j], spread[j + 1])
    away = place - here
    rho = np.linalg.norm(away, axis=1)
    limit = np.minimum(6.0 * sigma / rho + NEAR_RAD, WIDEST_RAD)
    return np.flatnonzero(np.einsum("ni,ni->n", away, line) > np.cos(limit) * rho)


def _sighting(one: KnownOrbit, flight: Flight, added: Array, tracklet_id: int, middle_tai_ns: int, data: Directions) -> Sighting:
    """added : (6, 6) covariance of what the forces left out, at the tracklet's middle."""
    there = flight.at(np.append(data.t_tai_ns, middle_tai_ns))
    value, slope = data.residuals(there.states[:-1])
    size = there.partials.shape[2]
    numbers = np.eye(size)
    numbers[:6] = there.partials[-1]
    noise = np.zeros((size, size))
    noise[:6, :6] = added
    return Sighting(
        object_id=one.orbit.object_id,
        tracklet_id=tracklet_id,
        t_tai_ns=middle_tai_ns,
        state=there.states[-1],
        covariance=(numbers @ one.covariance @ numbers.T + noise)[:6, :6],
        numbers=numbers,
        noise=noise,
        residual=value.reshape(-1),
        slope=(slope @ there.partials[:-1]).reshape(-1, size),
    )
