"""Numerical propagation: states at many epochs, and what each does when the start or a force parameter changes."""

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Any, Final

import erfa
import numpy as np
from numpy.typing import NDArray

from ground.determination.forces import LEAK_RATES, LEAKS, ForceModel, propagator, step_of
from ground.determination.perigee import perigee_radii_km, perigees_of
from ground.orbit.dynamics import EARTH_RADIUS_KM
from sboc_e2e.icd import tai
from sboc_e2e.icd.errors import UserError

Array = NDArray[np.float64]

_LONGEST_DAYS: Final = 400.0  # a year and a month: a limit of work, and drag and manoeuvres leave no orbit to say more
_ABSOLUTE: Final = 1e-7
"""Error allowed in a step, m and m/s; the relative bound is the larger one for places. Chosen, not measured."""
_RELATIVE: Final = 1e-11  # 0.4 mm of a geostationary radius in a step (satkit's default: 1e-8). Chosen, not measured
_LEAK_PIECE_NS: Final = 300 * tai.NS_PER_S
"""A leak that changes is constant over such pieces h. After a time T the place is off by rate T h^2 / 12: 0.13 m at 3e-10 m/s^3
after 16 hours."""
_TABLES: Final = 16
"""Tables of Sun, Moon and the Earth's rotation kept at a time, 0.15 MB for each day that they cover."""
_LONGEST_TABLE_DAYS: Final = 40.0
"""Longer spans are rare, and each makes a table of its own, which is not kept."""
_GAUSS_2: Final = 3.0**-0.5
"""Nodes of Gauss's rule of two, as a share of half the piece from its middle."""
_SHORTEST_PIECE_NS: Final = 3600 * tai.NS_PER_S
"""Tables begin and end at multiples of an hour or more. Chosen: half an hour at each end costs a tenth of a millisecond."""
_NEAR_SURFACE_KM: Final = 50.0
"""Perigees of two bodies that lie higher above the surface are not looked for on the orbit itself. The Earth's oblateness moves
those of low orbits by 10 km within a revolution."""
_PASSAGE_STEPS: Final = 4
"""Steps from the passage of perigee that two bodies have to that of the orbit itself. Each divides the error by a hundred."""
_ONE_PASSAGE_S: Final = 60.0
"""Passages that states of one orbit have within such a time are looked at once; no revolution is as short as 80 of them."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Arc:
    """States (n, 6) km, km/s at epochs (n,) TAI ns. partials : (n, 6, 6 + k), of the start's six numbers and k parameters.

    Where partials were not asked for they are empty, (n, 6, 0).
    """

    t_tai_ns: NDArray[np.int64]
    states: Array
    partials: Array


def instant(t_tai_ns: int) -> Any:
    """An epoch as the propagator has it, to a microsecond."""
    satkit = propagator()
    days, rest_ns = divmod(int(t_tai_ns), tai.NS_PER_DAY)
    midnight = satkit.time.from_mjd(float(days + tai.EPOCH_JD - erfa.DJM0), satkit.timescale.TAI)
    return midnight + satkit.duration(seconds=rest_ns * 1e-9)


def itrs_to_gcrs(t_tai_ns: NDArray[np.int64]) -> Array:
    """Matrices (n, 3, 3) that turn Earth-fixed axes (ITRS) to GCRS, IAU 2006/2000A with Earth orientation of IERS Bulletin A."""
    satkit = propagator()
    turns = [satkit.frametransform.qitrf2gcrf(instant(int(t))) for t in t_tai_ns]
    return np.array([np.column_stack([q * axis for axis in np.eye(3)]) for q in turns]).reshape(-1, 3, 3)


class Flight:
    """An orbit integrated once from its epoch to others before and after; asked for any epoch between, with partials.

    state : (6,) km, km/s at t0. parameters : of `PARAMETERS`; their partials are one-sided differences of whole integrations,
    half as many as `propagate` makes. UserError for an interval without end and for an orbit that meets the Earth: one that
    starts, ends or is asked for below its equatorial radius, or passes its first or its last perigee of the span there.
    """

    def __init__(
        self,
        state: Array,
        t0_tai_ns: int,
        first_tai_ns: int,
        last_tai_ns: int,
        forces: ForceModel,
        parameters: tuple[str, ...] = (),
    ) -> None:
        ends = [*([first_tai_ns] if first_tai_ns < t0_tai_ns else []), *([last_tai_ns] if last_tai_ns > t0_tai_ns else [])]
        if any(abs(end - t0_tai_ns) > _LONGEST_DAYS * tai.NS_PER_DAY for end in ends):
            raise UserError(f"propagation: over more than {_LONGEST_DAYS:.0f} days from the epoch of the state")
        self._t0_tai_ns = t0_tai_ns
        self._state = np.asarray(state, dtype=float)
        self._parameters = parameters
        changed = [forces.with_values((name,), (forces.value_of(name) + step_of(name),)) for name in parameters]
        self._runs = {
            end > t0_tai_ns: (
                _integrated(state, t0_tai_ns, end, forces, True),
                [_integrated(state, t0_tai_ns, end, other, False) for other in changed],
            )
            for end in ends
        }
        for end, (run, _) in zip(ends, self._runs.values(), strict=True):
            last = np.array([end], dtype=np.int64)
            _require_above(run, self._state, t0_tai_ns, last, _read(run, last, False)[0])

    def at(self, t_tai_ns: NDArray[np.int64]) -> Arc:
        """States and partials at epochs (n,) within the span. UserError for an epoch at which the orbit is within the Earth."""
        n, k = len(t_tai_ns), len(self._parameters)
        states = np.tile(self._state, (n, 1))
        partials = np.tile(np.eye(6, 6 + k), (n, 1, 1))
        for ahead, (run, others) in self._runs.items():
            chosen = t_tai_ns > self._t0_tai_ns if ahead else t_tai_ns < self._t0_tai_ns
            if not chosen.any():
                continue
            states[chosen], partials[chosen, :, :6] = _read(run, t_tai_ns[chosen], True)
            _require_radius(states[chosen])
            for column, (name, other) in enumerate(zip(self._parameters, others, strict=True), 6):
                moved, _ = _read(other, t_tai_ns[chosen], False)
                partials[chosen, :, column] = (moved - states[chosen]) / step_of(name)
        return Arc(t_tai_ns=t_tai_ns, states=states, partials=partials)

    def noise(self, t_tai_ns: NDArray[np.int64], push_km2_s3: float, piece_ns: int) -> Array:
        """Covariances (n, 6, 6) that white accelerations between the state's epoch and epochs (n,) within the span add there.

        push_km2_s3 : power density along each axis. With transition matrices Phi from the state's epoch and G the columns of
        velocity, Q(t) is the integral of Phi(t) Phi(s)^-1 G q G^T Phi(s)^-T Phi(t)^T over s (Tapley, Schutz & Born 2004, section
        4.9). It is summed by Gauss's rule of two nodes over pieces of at most piece_ns, which is exact for free motion.
        """
        out = np.zeros((len(t_tai_ns), 6, 6))
        for ahead in (True, False):
            chosen = t_tai_ns > self._t0_tai_ns if ahead else t_tai_ns < self._t0_tai_ns
            if not chosen.any():
                continue
            away_ns, place = np.unique(np.abs(t_tai_ns[chosen] - self._t0_tai_ns), return_inverse=True)
            edges, ends = _edges(away_ns, piece_ns)
            half, middle = 0.5 * np.diff(edges), 0.5 * (edges[1:] + edges[:-1])
            nodes = (middle + _GAUSS_2 * half * np.array([[-1.0], [1.0]])).round().astype(np.int64)
            at_nodes = self.at(self._t0_tai_ns + (nodes if ahead else -nodes).reshape(-1)).partials[:, :, :6]
            back = np.linalg.inv(at_nodes)[:, :, 3:]
            each = (back @ back.transpose(0, 2, 1)).reshape(2, -1, 6, 6).sum(axis=0)
            total = np.cumsum(push_km2_s3 * 1e-9 * half[:, None, None] * each, axis=0)[ends]
            there = self.at(t_tai_ns[chosen]).partials[:, :, :6]
            out[chosen] = there @ total[place] @ there.transpose(0, 2, 1)
        return out


def _edges(ends_ns: NDArray[np.int64], piece_ns: int) -> tuple[Array, NDArray[np.intp]]:
    """Edges of pieces from zero through each of some rising ends, and by place the piece that ends there."""
    spans = list(pairwise([0, *ends_ns.tolist()]))
    counts = [-(-(last - first) // piece_ns) for first, last in spans]
    inner = [np.linspace(first, last, n + 1)[1:] for (first, last), n in zip(spans, counts, strict=True)]
    return np.concatenate([[0.0], *inner]), np.cumsum(counts) - 1


def propagate(
    state: Array,
    t0_tai_ns: int,
    t_tai_ns: NDArray[np.int64],
    forces: ForceModel,
    *,
    parameters: tuple[str, ...] = (),
    partials: bool = False,
) -> Arc:
    """States of an orbit at epochs before or after that of `state` (6,) km, km/s.

    parameters : of `PARAMETERS`, whose partial derivatives are wanted too (central differences of whole propagations).
    UserError for an interval without end and for an orbit that meets the Earth: one that is below its equatorial radius at the
    start, at an epoch, at its first perigee or at its last one before an epoch. Perigees between these are not looked at.
    """
    t = np.asarray(t_tai_ns, dtype=np.int64)
    if len(t) and float(np.abs(t - t0_tai_ns).max()) > _LONGEST_DAYS * tai.NS_PER_DAY:
        raise UserError(f"propagation: over more than {_LONGEST_DAYS:.0f} days from the epoch of the state")
    states, transition = _both_ways(state, t0_tai_ns, t, forces, partials, True)
    if not partials:
        return Arc(t_tai_ns=t, states=states, partials=np.empty((len(t), 6, 0)))
    columns = [transition]
    for name in parameters:
        step, value = step_of(name), forces.value_of(name)
        high, _ = _both_ways(state, t0_tai_ns, t, forces.with_values((name,), (value + step,)), False, False)
        low, _ = _both_ways(state, t0_tai_ns, t, forces.with_values((name,), (value - step,)), False, False)
        columns.append(((high - low) / (2.0 * step))[:, :, None])
    return Arc(t_tai_ns=t, states=states, partials=np.concatenate(columns, axis=2))


def _both_ways(
    state: Array, t0_tai_ns: int, t_tai_ns: NDArray[np.int64], forces: ForceModel, partials: bool, is_checked: bool
) -> tuple[Array, Array]:
    """States (n, 6) and transition matrices (n, 6, 6): one run forward, one backward, as far as epochs ask.

    is_checked : whether an orbit that meets the Earth is an error.
    """
    states, transition = np.tile(state, (len(t_tai_ns), 1)), np.tile(np.eye(6), (len(t_tai_ns), 1, 1))
    for chosen in (t_tai_ns > t0_tai_ns, t_tai_ns < t0_tai_ns):
        if chosen.any():
            t = t_tai_ns[chosen]
            end = int(t[np.argmax(np.abs(t - t0_tai_ns))])
            run = _integrated(state, t0_tai_ns, end, forces, partials)
            states[chosen], transition[chosen] = _read(run, t, partials)
            if is_checked:
                _require_above(run, np.asarray(state, dtype=float), t0_tai_ns, t, states[chosen])
    return states, transition


def _require_radius(states: Array) -> None:
    """UserError where one of states (n, 6) is below the Earth's equatorial radius."""
    least_km = float(np.sqrt(np.einsum("ni,ni->n", states[:, :3], states[:, :3]).min(initial=np.inf)))
    if least_km < EARTH_RADIUS_KM:
        raise UserError(f"propagation failed: the orbit meets the Earth, {least_km:.0f} km from its centre")


def _require_above(run: Any, state: Array, t0_tai_ns: int, t_tai_ns: NDArray[np.int64], states: Array) -> None:
    """UserError where a run from a state (6,) to epochs (n,) on one side of t0, with states (n, 6) there, meets the Earth.

    The two-body perigees of all states say where a passage may be too low; there the run itself is asked.
    """
    every = np.vstack([state, states])
    _require_radius(every)
    low = perigee_radii_km(every) < EARTH_RADIUS_KM + _NEAR_SURFACE_KM
    if not low.any():
        return
    away_s = np.concatenate([[0.0], (t_tai_ns - t0_tai_ns) * 1e-9])
    end_s = float(away_s[np.argmax(np.abs(away_s))])
    _, since_s, period_s = perigees_of(every)
    ahead = 1.0 if end_s > 0.0 else -1.0
    # the next passage after the start, and the last one before each epoch, in the direction of the run
    gap_s = np.mod(ahead * since_s, period_s)
    gap_s[0] = np.mod(-ahead * since_s[0], period_s[0])
    room_s = np.abs(away_s)
    room_s[0] = abs(end_s)
    low &= gap_s <= room_s
    passages_s = np.where(np.arange(len(every)) == 0, gap_s, room_s - gap_s)[low]
    for at_s in np.unique(np.round(passages_s / _ONE_PASSAGE_S) * _ONE_PASSAGE_S):
        there, one_s = state, float(np.clip(ahead * at_s, min(0.0, end_s), max(0.0, end_s)))
        for _ in range(_PASSAGE_STEPS):
            t = np.array([t0_tai_ns + round(1e9 * one_s)], dtype=np.int64)
            there = _read(run, t, False)[0][0] if t[0] != t0_tai_ns else state
            one_s = float(np.clip(one_s - perigees_of(there[None])[1][0], min(0.0, end_s), max(0.0, end_s)))
        _require_radius(there[None])


def _integrated(state: Array, t0_tai_ns: int, end_tai_ns: int, forces: ForceModel, partials: bool) -> Any:
    """The propagator's own result, which holds its steps."""
    satkit = propagator()
    first, last = _table_span(min(t0_tai_ns, end_tai_ns), max(t0_tai_ns, end_tai_ns))
    settings = _settings_with_table(forces.gravity_degree, forces.tides, forces.relativity, first, last)
    empirical = satkit.ecomparams.reduced(
        d0=forces.sun, y0=forces.panel, b0=forces.third, bc=forces.third_cos, bs=forces.third_sin
    )
    properties = satkit.satproperties(
        craoverm=forces.radiation, cdaoverm=forces.drag, ecom=empirical, thrusts=_leaks(forces, t0_tai_ns, end_tai_ns)
    )
    try:
        return satkit.propagate(
            1e3 * np.asarray(state), instant(t0_tai_ns), instant(end_tai_ns),
            output_phi=partials, propsettings=settings, satproperties=properties,
        )  # fmt: skip
    except RuntimeError as error:
        reason = str(error).splitlines()[0]
        raise UserError(f"propagation failed: {reason}; an orbit about the Earth, above its surface, is expected") from error


def _table_span(first_tai_ns: int, last_tai_ns: int) -> tuple[int, int]:
    """Ends of the table for a span of time: many orbits of about the same span share one.

    They depend on the span alone, so that results do not depend on what was propagated before.
    """
    piece = _SHORTEST_PIECE_NS
    while 8 * piece < last_tai_ns - first_tai_ns:
        piece *= 2
    return first_tai_ns // piece * piece, -(-last_tai_ns // piece) * piece


@lru_cache(maxsize=_TABLES)
def _settings_with_table(gravity_degree: int, tides: bool, relativity: bool, first_tai_ns: int, last_tai_ns: int) -> Any:
    """The propagator's settings with Sun, Moon and the Earth's rotation in a table of minutes.

    Without one each propagation makes its own, which takes four fifths of its time in high orbits.
    """
    satkit = propagator()
    settings = satkit.propsettings(
        abs_error=_ABSOLUTE,
        rel_error=_RELATIVE,
        gravity_degree=gravity_degree,
        tide_model=satkit.tidemodel.solid_full if tides else satkit.tidemodel.none,
        use_relativistic_correction=relativity,
    )
    if last_tai_ns - first_tai_ns <= _LONGEST_TABLE_DAYS * tai.NS_PER_DAY:
        settings.precompute_terms(instant(first_tai_ns), instant(last_tai_ns))
    return settings


def _leaks(forces: ForceModel, t0_tai_ns: int, end_tai_ns: int) -> list[Any]:
    """The leak as constant accelerations, one after the other."""
    satkit = propagator()
    constant, rate = (np.array([forces.value_of(name) for name in names]) for names in (LEAKS, LEAK_RATES))
    if not (constant.any() or rate.any()):
        return []
    first, last = min(t0_tai_ns, end_tai_ns), max(t0_tai_ns, end_tai_ns)
    ends = [*range(first, last, _LEAK_PIECE_NS), last] if rate.any() else [first, last]
    return [
        satkit.thrust.constant(
            constant + rate * (0.5 * (one + two) - t0_tai_ns) * 1e-9, instant(one), instant(two), frame=satkit.frame.GCRF
        )
        for one, two in pairwise(ends)
    ]


def _read(run: Any, t_tai_ns: NDArray[np.int64], partials: bool) -> tuple[Array, Array]:
    """States (n, 6) and transition matrices (n, 6, 6) of a result at epochs; without partials unit matrices."""
    found = [run.interp(instant(int(t)), output_phi=partials) for t in t_tai_ns]
    states = 1e-3 * np.array([row[0] if partials else row for row in found])
    # positions and velocities change their unit alike: the matrix keeps its numbers
    transition = np.array([row[1] for row in found]) if partials else np.tile(np.eye(6), (len(t_tai_ns), 1, 1))
    if not np.isfinite(states).all():
        raise UserError("propagation failed: the orbit meets the Earth, or leaves what can be computed")
    return states, transition
