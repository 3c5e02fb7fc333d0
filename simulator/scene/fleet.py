"""Objects that have names, as one: satellites of a catalogue, constellations, pieces of a break-up, orbits given one by one.

Catalogued ones follow SGP4; the others the mean elements of a J2 orbit, whose node, perigee and phase drift at their secular
rates (periodic terms, some 10 km, and drag are left out). Where a run of pixels shows one, its motion is integrated, and what
breaks up during the run leaves its pieces where the run shows it.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd.errors import UserError
from simulator.platform import earth
from simulator.platform.carrier import Carrier
from simulator.platform.kepler import Elements, elements_deg, elements_of, state_of
from simulator.randomness import Effect, generator
from simulator.scene.breakup import BreakupOptions, draw_pieces
from simulator.scene.encounters import PopulationOptions
from simulator.scene.objects import OrbitingObject
from simulator.scene.prediction import may_cross
from simulator.scene.satellites import Satellite, propagate, read_satellites, size_of, with_sizes
from simulator.scene.sources import ObjectOptions, OrbitOptions, kepler_object, orbiting, own_epoch_tai_ns
from simulator.scene.surface import Surfaces, draw_surfaces
from simulator.scene.walker import walker_elements

Array = NDArray[np.float64]
Rows = NDArray[np.int64]

KINDS: Final = ("satellite", "fragment", "walker", "orbit")
LOWEST_PERIGEE_KM: Final = 120.0
"""Pieces whose orbits dip below this come down in their first turn; they are left out."""

FOREVER_S: Final = 1e12  # 30,000 years: longer than any run
STEP_S: Final = 10.0  # of the look at who may be in the field; half of it bends a path by 0.25 km, which `may_cross` allows
VELOCITY_S: Final = 0.1  # to either side, over which positions give a velocity: good to 1e-8 km/s in any orbit
CHUNK: Final = 15_000  # objects whose states are held at a time; bounds memory only


@dataclass(frozen=True, kw_only=True, eq=False)
class Fleet:
    """n objects. kind (n,) : number in `KINDS`. from_s, to_s (n,) : when each is there, after the epoch.

    satellites : the catalogued ones, which come first; elements : mean ones of the others at `elements_s` (n - satellites,).
    """

    names: tuple[str, ...]
    kind: NDArray[np.int8]
    size_m: Array
    surfaces: Surfaces
    from_s: Array
    to_s: Array
    satellites: tuple[Satellite, ...]
    elements: Elements
    elements_s: Array
    epoch_tai_ns: int

    def __len__(self) -> int:
        return len(self.names)

    def states(self, rows: Rows, time_s: Array) -> tuple[Array, Array]:
        """Positions and velocities (r, m, 3), GCRS km and km/s, of some objects at times (m,); NaN where SGP4 refuses."""
        rows = np.asarray(rows)
        position = np.full((len(rows), len(time_s), 3), np.nan)
        velocity = position.copy()
        known = len(self.satellites)
        listed = np.flatnonzero(rows < known)
        if listed.size:
            place, speed, error = propagate([self.satellites[k] for k in rows[listed]], self.epoch_tai_ns, time_s)
            fine = error == 0
            position[listed], velocity[listed] = (
                np.where(fine[..., None], place, np.nan),
                np.where(fine[..., None], speed, np.nan),
            )
        drawn = np.flatnonzero(rows >= known)
        if drawn.size:
            which = rows[drawn] - known
            some = Elements(**{name: getattr(self.elements, name)[which, None] for name in self.elements.__dataclass_fields__})
            position[drawn], velocity[drawn] = state_of(drifted(some, time_s[None, :] - self.elements_s[which, None]))
        return position, velocity

    def orbits(self) -> tuple[Array, Array, Array]:
        """Semi-major axis (km), eccentricity and inclination (deg) of all."""
        records = [s.record for s in self.satellites]
        motion = np.array([r.no_kozai for r in records]) / 60.0
        a_km = np.concatenate([(earth.MU_KM3_S2 / motion**2) ** (1.0 / 3.0), self.elements.a_km])
        e = np.concatenate([[r.ecco for r in records], self.elements.e])
        i_deg = np.degrees(np.concatenate([[r.inclo for r in records], self.elements.i_rad]))
        return a_km, e, i_deg


def drifted(elements: Elements, dt_s: Array) -> Elements:
    """Mean elements a time later: secular rates of J2 (Vallado, 4th ed., eqs. 9-38 to 9-41); a and e stay."""
    a, e, i = elements.a_km, elements.e, elements.i_rad
    motion = np.sqrt(earth.MU_KM3_S2 / a**3)
    factor = 1.5 * earth.J2 * (earth.EARTH_RADIUS_KM / (a * (1.0 - e * e))) ** 2 * motion
    sine2 = np.sin(i) ** 2
    anomaly = motion + factor * np.sqrt(1.0 - e * e) * (1.0 - 1.5 * sine2)
    shape = np.broadcast_shapes(np.shape(a), np.shape(dt_s))
    return Elements(
        a_km=np.broadcast_to(a, shape),
        e=np.broadcast_to(e, shape),
        i_rad=np.broadcast_to(i, shape),
        node_rad=elements.node_rad - factor * np.cos(i) * dt_s,
        argp_rad=elements.argp_rad + factor * (2.0 - 2.5 * sine2) * dt_s,
        mean_anomaly_rad=np.mod(elements.mean_anomaly_rad + anomaly * dt_s, 2.0 * np.pi),
    )


def mean_of(osculating: Elements) -> Elements:
    """Elements with the mean semi-major axis, so that the phase drifts as it should; the others stay osculating ones.

    The energy, J2's potential included, does not change. Its mean over an orbit gives the mean axis (first order in J2).
    """
    a, e, i = osculating.a_km, osculating.e, osculating.i_rad
    position, _ = state_of(osculating)
    radius = np.linalg.norm(position, axis=-1)
    strength = earth.MU_KM3_S2 * earth.J2 * earth.EARTH_RADIUS_KM**2 / 2.0
    here = strength / radius**3 * (3.0 * (position[..., 2] / radius) ** 2 - 1.0)
    energy = -earth.MU_KM3_S2 / (2.0 * a) + here
    mean_potential = strength / (a**3 * (1.0 - e * e) ** 1.5) * (1.5 * np.sin(i) ** 2 - 1.0)
    return replace(osculating, a_km=-earth.MU_KM3_S2 / (2.0 * (energy - mean_potential)))


def is_given(options: ObjectOptions) -> bool:
    """Whether a scenario names objects of these kinds."""
    return bool(options.satellites.file or options.walker or options.breakup or options.orbit)


def make_fleet(
    options: ObjectOptions,
    population: PopulationOptions,
    epoch_tai_ns: int,
    seed: int,
    colour_factor: Callable[[Array], Array] | None,
    run_s: float = 0.0,
) -> Fleet:
    """The objects of a scenario. Pieces have the surfaces of the sampled population; the others are Lambert spheres.

    run_s : length of the run of pixels that they are for, 0 for a survey.
    UserError for a file that cannot be read, an orbit that enters the Earth or whose epoch is too far from the run, and for a
    break-up of an object that is not there, has broken up before, or is a piece that does not yet exist.
    """
    listed: list[Satellite] = []
    if options.satellites.file:
        listed = read_satellites(options.satellites.file, options.satellites.names)
        if options.satellites.sizes_file:
            listed = with_sizes(listed, options.satellites.sizes_file)
    names = [s.name for s in listed]
    size = [size_of(s, options.satellites) for s in listed]
    albedo = [options.satellites.albedo] * len(listed)
    kind = [KINDS.index("satellite")] * len(listed)
    parts: list[Elements] = []
    elements_s: list[float] = []
    for w in options.walker:
        names += [f"{w.name}-{k + 1}" for k in range(w.satellites)]
        size += [w.size_m] * w.satellites
        albedo += [w.albedo] * w.satellites
        kind += [KINDS.index("walker")] * w.satellites
        parts.append(walker_elements(w))
        elements_s += [0.0] * w.satellites
    for o in options.orbit:
        names.append(o.name)
        size.append(o.size_m)
        albedo.append(o.albedo)
        kind.append(KINDS.index("orbit"))
        one = elements_deg(o.semi_major_axis_km, o.eccentricity, o.inclination_deg, o.node_deg, o.perigee_deg, o.mean_anomaly_deg)
        parts.append(mean_of(_vector(one)))
        elements_s.append((own_epoch_tai_ns(o, epoch_tai_ns) - epoch_tai_ns) * 1e-9)
    whole = len(names)
    fleet = Fleet(
        names=tuple(names), kind=np.array(kind, dtype=np.int8), size_m=np.array(size, dtype=np.float64),
        surfaces=Surfaces(albedo=np.array(albedo, dtype=np.float64), specular=np.zeros(whole), colour=np.ones(whole)),
        from_s=np.full(whole, -FOREVER_S), to_s=np.full(whole, FOREVER_S), satellites=tuple(listed),
        elements=_joined(parts), elements_s=np.array(elements_s, dtype=np.float64), epoch_tai_ns=epoch_tai_ns,
    )  # fmt: skip
    given = dict(zip(np.flatnonzero(fleet.kind == KINDS.index("orbit")).tolist(), options.orbit, strict=True))
    broken: dict[int, int] = {}
    made_by: dict[int, int] = {}
    for k, b in enumerate(options.breakup):
        parent = _parent_of(fleet, b.object)
        _refuse_absent(fleet, b, k, parent, broken, made_by)
        before = len(fleet)
        fleet = broken_up(fleet, b, parent, population, generator(seed, Effect.BREAKUP, k), colour_factor, given, run_s)
        broken[parent] = k
        made_by |= dict.fromkeys(range(before, len(fleet)), k)
    return fleet


def _parent_of(fleet: Fleet, wanted: str) -> int:
    """Row of the object of a name or number. UserError where there is none."""
    parent = next((k for k, name in enumerate(fleet.names) if name == wanted), None)
    if parent is None:
        parent = next((k for k, s in enumerate(fleet.satellites) if str(s.record.satnum) == wanted), None)
    if parent is None:
        raise UserError(
            f"objects.breakup.object: no object {wanted!r}; allowed are names or numbers of objects.satellites, "
            f"objects.walker and objects.orbit"
        )
    return parent


def _refuse_absent(
    fleet: Fleet, options: BreakupOptions, number: int, parent: int, broken: Mapping[int, int], made_by: Mapping[int, int]
) -> None:
    """UserError for a break-up of what another break-up ends, or has not yet made.

    broken, made_by : numbers of the entries that end a row of the fleet, and that it comes from.
    """
    if parent in broken:
        raise UserError(
            f"objects.breakup[{number}].object: {options.object!r} breaks up in objects.breakup[{broken[parent]}] already; "
            f"allowed is one break-up of each object"
        )
    from_h = float(fleet.from_s[parent]) / 3600.0
    if parent in made_by and options.when_h <= from_h:
        raise UserError(
            f"objects.breakup[{number}].when: {options.when_h:g} h; {options.object!r} comes from "
            f"objects.breakup[{made_by[parent]}] at {from_h:g} h, allowed is later"
        )


def broken_up(
    fleet: Fleet,
    options: BreakupOptions,
    parent: int,
    population: PopulationOptions,
    rng: np.random.Generator,
    colour_factor: Callable[[Array], Array] | None,
    given: Mapping[int, OrbitOptions],
    run_s: float,
) -> Fleet:
    """The fleet in which an object breaks up: it is there before, its pieces afterwards.

    parent : its row. given : orbits by their rows. run_s : within this time from the epoch the object breaks where a run of
    pixels shows it, and its pieces keep osculating elements: exact at the break-up, up to a kilometre a minute off an integrated
    orbit afterwards.
    """
    when_s = 3600.0 * options.when_h
    in_run = 0.0 < when_s < run_s
    position, velocity = fleet.states(np.array([parent]), np.array([when_s]))
    if in_run and parent >= len(fleet.satellites):
        position[0, 0], velocity[0, 0] = _shown_state(fleet, parent, when_s, given)
    if not np.isfinite(position).all():
        raise UserError(f"objects.breakup {options.object!r}: SGP4 has no position for it at the time of the break-up")
    pieces = draw_pieces(options, rng)
    with np.errstate(invalid="ignore"):
        orbits = elements_of(np.broadcast_to(position[0, 0], pieces.kick_m_s.shape), velocity[0, 0] + 1e-3 * pieces.kick_m_s)
        stays = (
            (orbits.a_km > 0.0) & (orbits.e < 0.98) & (orbits.a_km * (1.0 - orbits.e) > earth.EARTH_RADIUS_KM + LOWEST_PERIGEE_KM)
        )
    kept = np.flatnonzero(stays)
    orbits = Elements(**{name: getattr(orbits, name)[kept] for name in orbits.__dataclass_fields__})
    orbits = orbits if in_run else mean_of(orbits)
    n = len(kept)
    surfaces = draw_surfaces(rng, n, population.albedo, population.surface, colour_factor)
    to_s = fleet.to_s.copy()
    to_s[parent] = min(to_s[parent], when_s)
    return replace(
        fleet,
        names=(*fleet.names, *(f"{options.object} piece {k + 1}" for k in range(n))),
        kind=np.concatenate([fleet.kind, np.full(n, KINDS.index("fragment"), np.int8)]),
        size_m=np.concatenate([fleet.size_m, pieces.diameter_m[kept]]),
        surfaces=Surfaces(
            **{s: np.concatenate([getattr(fleet.surfaces, s), getattr(surfaces, s)]) for s in ("albedo", "specular", "colour")}
        ),
        from_s=np.concatenate([fleet.from_s, np.full(n, when_s)]),
        to_s=np.concatenate([to_s, np.full(n, FOREVER_S)]),
        elements=_joined([fleet.elements, orbits]),
        elements_s=np.concatenate([fleet.elements_s, np.full(n, when_s)]),
    )


def _shown_state(fleet: Fleet, row: int, time_s: float, given: Mapping[int, OrbitOptions]) -> tuple[Array, Array]:
    """Position and velocity (3,) with which a run of pixels shows an object that is in no catalogue."""
    thing = orbiting(given[row], fleet.epoch_tai_ns) if row in given else pixel_objects(fleet, np.array([row]))[0]
    before, now, after = thing.positions_km(time_s + VELOCITY_S * np.array([-1.0, 0.0, 1.0]))
    return now, (after - before) / (2.0 * VELOCITY_S)


def _vector(one: Elements) -> Elements:
    return Elements(**{name: np.atleast_1d(getattr(one, name)) for name in one.__dataclass_fields__})


def _joined(parts: list[Elements]) -> Elements:
    """Elements one after the other."""
    return Elements(
        **{name: np.concatenate([np.zeros(0), *(getattr(p, name) for p in parts)]) for name in Elements.__dataclass_fields__}
    )


def passing_now(fleet: Fleet, carrier: Carrier, half_row: float, half_col: float, duration_s: float) -> Rows:
    """Objects that may be in the field during a run of pixels: a little more than those that are."""
    n = max(int(np.ceil(duration_s / STEP_S)), 1)
    half = 0.5 * duration_s / n
    found = np.zeros(len(fleet), dtype=bool)
    for t in half * (2.0 * np.arange(n) + 1.0):
        now = carrier.tai_ns(float(t))
        place, speed = carrier.observer.state(now)
        frame, later = carrier.attitude(now), carrier.attitude(now + round(half * 1e9))
        turn = float(np.arccos(np.clip(0.5 * (np.trace(later @ frame.T) - 1.0), -1.0, 1.0)))
        for begin in range(0, len(fleet), CHUNK):
            rows = np.arange(begin, min(begin + CHUNK, len(fleet)))
            position, velocity = fleet.states(rows, np.array([t]))
            camera, rate = (position[:, 0] - place) @ frame.T, (velocity[:, 0] - speed) @ frame.T
            near = may_cross(camera, rate, half, half_row, half_col, turn)
            there = (fleet.from_s[rows] < t + half) & (t - half < fleet.to_s[rows])
            found[rows] |= near & np.isfinite(position[:, 0]).all(axis=1) & there
    return np.flatnonzero(found)


def pixel_objects(fleet: Fleet, rows: Rows) -> list[OrbitingObject]:
    """Constellation members and pieces as objects of a run of pixels, on integrated orbits.

    They start at its epoch, or where they come into being later.
    """
    made = []
    for row in rows:
        start_s = max(float(fleet.from_s[row]), 0.0)
        position, velocity = fleet.states(np.array([row]), np.array([start_s]))
        one = kepler_object(
            fleet.names[row],
            KINDS[fleet.kind[row]],
            float(fleet.size_m[row]),
            float(fleet.surfaces.albedo[row]),
            elements_of(position[0, 0], velocity[0, 0]),
            start_s,
            specular=float(fleet.surfaces.specular[row]),
            colour=float(fleet.surfaces.colour[row]),
        )
        made.append(replace(one, from_s=float(fleet.from_s[row]), to_s=float(fleet.to_s[row])))
    return made
