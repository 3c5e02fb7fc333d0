"""Surveys: which debris passes the field in hours and years, and how it shows in each frame, without a pixel.

The objects, orbits, pointing, light and densities are those of the pixel chain; only the image is missing. Time is divided into
blocks, each with random streams of its own, so that any worker makes any block with the same bytes. A block's passages are a
Poisson process: candidates as in `scene.encounters` stand for ``w`` objects of nature each, and each is kept ``floor(w + u)``
times, u uniform in [0, 1). Where no w exceeds 1, their number scatters as nature's does.
"""

from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd.errors import UserError
from simulator.as_built import with_drawn_errors
from simulator.camera import Camera
from simulator.mount import carrier_of
from simulator.optics.far_scatter import SHADING_DEG
from simulator.options import SimulatorOptions
from simulator.platform import earth
from simulator.platform.carrier import Carrier
from simulator.platform.kepler import elements_of, velocity_through
from simulator.platform.observer import OrbitingObserver, make_observer
from simulator.randomness import Effect, generator
from simulator.scene.backdrop import backdrop_of
from simulator.scene.cast import encounter_window
from simulator.scene.debris import SizeClass, draw_orbits, low_orbit_share
from simulator.scene.earth_light import earth_reach_rad
from simulator.scene.encounters import (
    NEAR_SHARE,
    Window,
    cell_density,
    expected_snr,
    in_field,
    number_density,
    reach_km,
)
from simulator.scene.fleet import Fleet, is_given, make_fleet
from simulator.scene.reflection import LightCurve, in_sight, lambert_flux, sunlit_fraction
from simulator.scene.stars import sky_catalogue
from simulator.scene.surface import Surfaces, draw_surfaces
from simulator.trail_noise import StarNoise, TrailEnergy

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

BLOCK_S: Final = 21_600.0
"""A block of time: a quarter of a day."""

STEP_S: Final = 60.0
"""Candidates of a block meet the camera at instants, one at random in each step: 4 deg of a low orbit."""

EVEN_SHARE: Final = 0.6
"""Of the candidates, how many have ranges even in volume, not in the logarithm."""

BEYOND_ONE: Final = 0.05
"""Share of nature's passages that may lie beyond weights of 1, where passages come in pairs."""

POOL: Final = 200_000  # pieces of a pool: `expected_passages` shows what they leave as the scatter between its rounds
POOL_BLOCKS: Final = 32
"""Sizes and orbits are drawn once for `POOL_BLOCKS` blocks, `POOL` of them for each class. Candidates take theirs from there."""

SIZE_CELLS: Final = 48  # of ln size in a class, each with its share of a pool; more of them change nothing but time. Chosen
EVEN_SIZES: Final = 0.1
"""Of a pool's pieces, how many have sizes even in the logarithm. Chosen: it bounds what a piece can stand for."""

CHUNK: Final = 200_000  # candidates at a time; bounds memory
PILOT: Final = 400_000  # candidates of the pilot for each class: more of them, fewer heavy weights missed. Chosen, not measured
PILOT_DAYS: Final = 365.0  # a year, so that it sees all seasons of the orbit
PILOT_BLOCK: Final = 4_000_000  # beyond any block of time: 2,700 years of four a day
POOL_GROUP: Final = 5_000_000
"""Random streams of the pilot and of pools, beside those of blocks."""
FRAMES_EACH: Final = 24
"""Most frames of its stay in which a passage is looked at. They are spread evenly; each then stands for several."""

LONGEST_STAY_S: Final = 1e5
"""Longest stay that is counted, for objects that stand still in the field."""

CURVE_SPREAD: Final = 1.0  # of the logarithm of the period about 2 s, as `scene.sources: light_curves` draws it (assumed)
SPIN_S: Final = 1.0  # step of the difference of attitudes; at 0.06 deg/s its sine is its angle to 2e-7


@dataclass(frozen=True, kw_only=True, eq=False)
class Flight:
    """A camera on its orbit. window : what it sees, but for place and attitude, which `instants` has."""

    options: SimulatorOptions
    camera: Camera
    carrier: Carrier
    window: Window
    seed: int
    fleet: Fleet | None
    """Objects with names; None where the scenario has none."""
    energy: TrailEnergy
    stars: StarNoise

    @classmethod
    def of(cls, options: SimulatorOptions, seed: int) -> "Flight":
        """The flight of a scenario. UserError for a ground site and for pointing that follows an object."""
        refuse_unwatched(options)
        options = with_drawn_errors(options, seed)
        epoch = earth.tai_ns_of_utc(options.epoch_utc)
        observer = make_observer(options.platform, epoch)
        shutter = options.shutter
        if options.sensor.type == "ccd":
            shutter = replace(shutter, line_time_us=0.0)
        camera = Camera(
            options.instrument, options.psf, options.vignetting, options.sensor, exposure_s=shutter.exposure_s, seed=seed
        )
        carrier = carrier_of(options, shutter, observer, camera, seed)
        window = encounter_window(carrier, camera, options.light, 0.0, 0.0, BLOCK_S)
        fleet = None
        if is_given(options.objects):
            colour_factor = camera.instrument.colour_factor
            fleet = make_fleet(options.objects, options.population, epoch, seed, colour_factor)
        return cls(
            options=options, camera=camera, carrier=carrier, window=window, seed=seed, fleet=fleet,
            energy=TrailEnergy(camera=camera), stars=StarNoise(camera, options.stars, sky_catalogue(options.stars)),
        )  # fmt: skip


def refuse_unwatched(options: SimulatorOptions) -> None:
    """UserError for a ground site and for pointing that follows an object."""
    if options.platform.kind == "site":
        raise UserError("platform.kind: a survey needs a camera in orbit: sun_synchronous or kepler, not site")
    if options.pointing.law == "object":
        raise UserError("pointing.law: a survey follows no object; allowed are anti_sun, inertial, sidereal, nadir, schedule")


@dataclass(frozen=True, kw_only=True, eq=False)
class Instants:
    """The camera at m times. spin_rad_s (m, 3) : turn of the camera frame, in its own axes.

    noise_e2 (m,) : variance of a pixel in the middle of the field, one exposure. star_share (m,) : of S^2 that the noise of
    stars leaves. span_s : time for which all of them stand; watched (m,) : the Earth is not in the field.
    """

    time_s: Array
    position_km: Array
    velocity_km_s: Array
    attitude: Array
    spin_rad_s: Array
    sun_km: Array
    sky_e: Array
    noise_e2: Array
    star_share: Array
    watched: NDArray[np.bool_]
    span_s: float
    epoch_tai_ns: int

    @property
    def watched_s(self) -> float:
        """Time in which the Earth is not in the field."""
        return self.span_s * float(self.watched.mean())


def instants_of(flight: Flight, time_s: Array, span_s: float) -> Instants:
    """The camera at times after the epoch (m,)."""
    carrier, camera = flight.carrier, flight.camera
    tai_ns = [carrier.tai_ns(float(t)) for t in time_s]
    observer = carrier.observer
    if not isinstance(observer, OrbitingObserver):
        raise TypeError("a flight has an observer in orbit")
    position, velocity = observer.motion.states(np.asarray(time_s))
    attitude = np.array([carrier.attitude(t) for t in tai_ns])
    later = np.array([carrier.attitude(t + round(SPIN_S * 1e9)) for t in tai_ns])
    turn = np.einsum("nij,nkj->nik", later, attitude)
    spin = (
        -0.5
        / SPIN_S
        * np.stack([turn[:, 2, 1] - turn[:, 1, 2], turn[:, 0, 2] - turn[:, 2, 0], turn[:, 1, 0] - turn[:, 0, 1]], axis=1)
    )
    sun = np.array([earth.sun_position_km(t) for t in tai_ns])
    boresight = attitude[:, 2]
    sky_flux = np.array(
        [_sky_flux(flight, *values) for values in zip(tai_ns, sun, position, boresight, strict=True)], dtype=np.float64
    )
    sky_e = sky_flux * camera.surface_rate_e_s * camera.exposure_s
    sky_e = sky_e + camera.instrument.stray_light_e_px_s * camera.exposure_s
    dark = float(camera.sensor.variance_e2(0.0, camera.exposure_s))
    per_e = float(camera.sensor.variance_e2(1.0, camera.exposure_s)) - dark
    distance = np.linalg.norm(position, axis=1)
    from_nadir = np.arccos(np.clip(-np.sum(boresight * position, axis=1) / distance, -1.0, 1.0))
    watched = from_nadir >= np.arcsin(earth.EARTH_RADIUS_KM / distance) + camera.radius_rad
    noise_e2 = dark + per_e * sky_e
    return Instants(
        time_s=np.asarray(time_s), position_km=position, velocity_km_s=velocity, attitude=attitude, spin_rad_s=spin, sun_km=sun,
        sky_e=sky_e, noise_e2=noise_e2, star_share=flight.stars.share(boresight, noise_e2), watched=watched,
        span_s=span_s, epoch_tai_ns=carrier.epoch_tai_ns,
    )  # fmt: skip


def _sky_flux(flight: Flight, tai_ns: int, sun_km: Array, place_km: Array, boresight: Array) -> float:
    """Flux of a square arcsecond in the middle of the field as in the pixel chain: sky, and scattered light of Moon and Earth.

    Where the baffle shades all of the Earth, what its vanes leak is left out: 0.1 % of the darkest sky.
    """
    nadir = -place_km / np.linalg.norm(place_km)
    shaded = np.radians(flight.camera.instrument.scatter.baffle_deg + SHADING_DEG)
    dark = float(boresight @ nadir) < np.cos(min(earth_reach_rad(place_km) + shaded, np.pi))
    options = replace(flight.options.sky, planets=False, earth=flight.options.sky.earth and not dark)
    backdrop = backdrop_of(options, tai_ns, sun_km, place_km, None, None)
    return float(backdrop.surface_flux(boresight[None], flight.camera)[0])


def block_instants(flight: Flight, block: int) -> Instants:
    """Instants of a block, one at a random time of each step."""
    n = round(BLOCK_S / STEP_S)
    rng = generator(flight.seed, Effect.SURVEY, block)
    return instants_of(flight, block * BLOCK_S + (np.arange(n) + rng.random(n)) * STEP_S, BLOCK_S)


@dataclass(frozen=True, kw_only=True, eq=False)
class Passages:
    """n objects that pass the field, each at an instant (n,) in it: positions and velocities (n, 3), GCRS.

    natural (n,) : passages of nature that each stands for. enter_s, leave_s : of the field, from the instant on.
    """

    instant: Indices
    size_m: Array
    surfaces: Surfaces
    position_km: Array
    velocity_km_s: Array
    range_km: Array
    rate_deg_s: Array
    enter_s: Array
    leave_s: Array
    snr: Array
    natural: Array

    def taken(self, which: Indices) -> "Passages":
        """Some of them."""
        return Passages(
            **{name: getattr(self, name)[which] for name in self.__dataclass_fields__ if name != "surfaces"},
            surfaces=self.surfaces.taken(which),
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Pool:
    """Pieces of a class: diameters and orbits. population (n,) : pieces of nature that each stands for, times the number of

    pieces.
    """

    size_m: Array
    population: Array
    a_km: Array
    e: Array
    i_rad: Array


def pool_of(flight: Flight, size_class: SizeClass, rng: np.random.Generator) -> Pool:
    """Pieces of a class: sizes as `_size_cells` has them, orbits of the population."""
    options = flight.options.population
    edges, share = _size_cells(flight, size_class)
    width = edges[1] - edges[0]
    cell = np.searchsorted(np.cumsum(share[:-1]), rng.random(POOL), side="right")
    size_m = np.exp(edges[cell] + width * rng.random(POOL))
    low = low_orbit_share(size_m, options.low_orbit_share_small, options.low_orbit_share_large)
    a_km, e, i_rad = draw_orbits(rng, size_m, spread=options.spread_by_breakup)
    return Pool(size_m=size_m, population=number_density(size_m) * low * width / share[cell], a_km=a_km, e=e, i_rad=i_rad)


def _size_cells(flight: Flight, size_class: SizeClass) -> tuple[Array, Array]:
    """Edges of cells of ln size (m), and the share of a pool's pieces of each: about as many as can be seen.

    That is their number times the volume within which they can have `snr_min`. All sizes then stand for about as many
    passages, and fewer candidates do. `EVEN_SIZES` of a pool are even in ln size, whatever can be seen.
    """
    options = flight.options.population
    edges = np.linspace(np.log(size_class.from_mm * 1e-3), np.log(size_class.to_mm * 1e-3), SIZE_CELLS + 1)
    size_m = np.exp(0.5 * (edges[1:] + edges[:-1]))
    one = np.ones(SIZE_CELLS)
    reach = _reach_km(flight, flight.window, size_m, Surfaces(albedo=options.albedo * one, specular=0.0 * one, colour=one))
    seen = number_density(size_m) * np.clip(reach, options.nearest_km, options.farthest_km) ** 3
    return edges, EVEN_SIZES / SIZE_CELLS + (1.0 - EVEN_SIZES) * seen / seen.sum()


def candidates(flight: Flight, at: Instants, pool: Pool, n: int, rng: np.random.Generator) -> Passages:
    """Those of n candidates of a pool that may be seen, `natural` for the time that the instants stand for."""
    options, window = flight.options.population, flight.window
    piece = rng.integers(len(pool.size_m), size=n)
    size_m = pool.size_m[piece]
    surfaces = draw_surfaces(rng.spawn(1)[0], n, options.albedo, options.surface, window.colour_factor)
    darkest = replace(window, noise_variance_e2=float(at.noise_e2.min()), attitude=at.attitude[0], sun_km=at.sun_km[0])
    reach = _reach_km(flight, darkest, size_m, surfaces)
    far = np.clip(reach, options.nearest_km * 1.001, options.farthest_km)
    near = np.maximum(options.nearest_km, far / NEAR_SHARE)
    span = np.log(far / near)
    shell = (far**3 - near**3) / 3.0
    even = rng.random(n) < EVEN_SHARE
    place = rng.random(n)
    range_km = np.empty(n)
    range_km[even] = np.cbrt(near[even] ** 3 + 3.0 * place[even] * shell[even])
    range_km[~even] = near[~even] * np.exp(place[~even] * span[~even])
    per_km = (1.0 - EVEN_SHARE) / (range_km * span) + EVEN_SHARE * range_km**2 / shell
    u, v = rng.uniform(-window.half_col, window.half_col, n), rng.uniform(-window.half_row, window.half_row, n)
    slant = np.sqrt(1.0 + u * u + v * v)
    camera = np.stack([u, v, np.ones(n)], axis=1) * (range_km / slant)[:, None]
    instant = rng.integers(len(at.time_s), size=n)
    position = at.position_km[instant] + np.einsum("ni,nij->nj", camera, at.attitude[instant])
    a_km, e, i_rad = pool.a_km[piece], pool.e[piece], pool.i_rad[piece]
    signs = rng.random((2, n)) < 0.5
    with np.errstate(invalid="ignore"):
        density = cell_density(position, a_km, e, i_rad)
    kept = np.flatnonzero((density > 0.0) & (reach > options.nearest_km) & at.watched[instant])
    instant, camera, position, range_km = instant[kept], camera[kept], position[kept], range_km[kept]
    size_m, surfaces = size_m[kept], surfaces.taken(kept)
    velocity = velocity_through(position, a_km[kept], e[kept], i_rad[kept], signs[0, kept], signs[1, kept], just_missing=True)
    there = np.flatnonzero(np.isfinite(velocity).all(axis=1))
    solid_angle = 4.0 * window.half_row * window.half_col / slant[kept] ** 3
    natural = pool.population[piece[kept]] * density[kept] * solid_angle * range_km**2 / per_km[kept] * at.span_s / n
    return make_passages(
        flight, at, instant[there], size_m[there], surfaces.taken(there), position[there], velocity[there], natural[there]
    )


def _reach_km(flight: Flight, window: Window, size_m: Array, surfaces: Surfaces) -> Array:
    """Range within which a piece can have `snr_min` in a window: at zero phase, in focus, as slow as counts."""
    options = flight.options.population
    still, slow = (
        expected_snr(np.ones(1), np.radians([rate]), np.array([window.exposure_s]), np.array([1e9]), window)[0]
        for rate in (0.0, options.slowest_deg_s)
    )
    return np.asarray(reach_km(size_m, surfaces, options.snr_min, window) * np.sqrt(slow / still))


def make_passages(
    flight: Flight,
    at: Instants,
    instant: Indices,
    size_m: Array,
    surfaces: Surfaces,
    position_km: Array,
    velocity_km_s: Array,
    in_sight_now: Array | float = 1.0,
) -> Passages:
    """Passages of objects in the field at their instants; in_sight_now (n,) : times their stay, of nature's passages."""
    window = flight.window
    line = position_km - at.position_km[instant]
    relative = velocity_km_s - at.velocity_km_s[instant]
    attitude = at.attitude[instant]
    camera = np.einsum("nij,nj->ni", attitude, line)
    rate = np.einsum("nij,nj->ni", attitude, relative) + np.cross(at.spin_rad_s[instant], camera)
    range_km = np.linalg.norm(line, axis=1)
    across = relative - np.sum(relative * line, axis=1, keepdims=True) * line / range_km[:, None] ** 2
    rate_rad_s = np.linalg.norm(across, axis=1) / range_km
    enter, leave = in_field(camera, rate, window.half_row, window.half_col)
    enter, leave = np.maximum(enter, -LONGEST_STAY_S), np.minimum(leave, LONGEST_STAY_S)
    stay = np.maximum(leave - enter, 0.0)
    flux = light_of(flight, at, instant, size_m, surfaces, position_km)
    at_noise = replace(window, noise_variance_e2=at.noise_e2[instant])  # type: ignore[arg-type]  # one for each passage
    snr = expected_snr(flux * window.flux_e_s, rate_rad_s, stay, range_km, at_noise)
    seen = (stay > 0.0) & (np.degrees(rate_rad_s) >= flight.options.population.slowest_deg_s)
    return Passages(
        instant=instant,
        size_m=size_m,
        surfaces=surfaces,
        position_km=position_km,
        velocity_km_s=velocity_km_s,
        range_km=range_km,
        rate_deg_s=np.degrees(rate_rad_s),
        enter_s=enter,
        leave_s=leave,
        snr=np.where(seen, snr, 0.0),
        natural=np.where(seen, in_sight_now / np.maximum(stay, 1e-9), 0.0),
    )  # fmt: skip - one line for what, one for where, one for how


def light_of(flight: Flight, at: Instants, instant: Indices, size_m: Array, surfaces: Surfaces, position_km: Array) -> Array:
    """Mean light (n,) of objects at positions, in units of a V = 0 star with the Sun's colour."""
    effects, observer, sun = flight.options.light, at.position_km[instant], at.sun_km[instant]
    flux = surfaces.albedo * surfaces.colour * size_m**2
    flux = flux * lambert_flux(
        1.0, 1.0, position_km, observer, sun, phase_function=effects.phase_function, specular=surfaces.specular
    )
    if effects.earth_shadow:
        flux = flux * sunlit_fraction(position_km, sun)
    return np.asarray(flux * in_sight(position_km, observer))


def pilot_instants(flight: Flight) -> Instants:
    """Instants of a year, at which the pilots of all classes look."""
    rng = generator(flight.seed, Effect.SURVEY, PILOT_BLOCK)
    return instants_of(flight, np.sort(rng.random(240)) * PILOT_DAYS * earth.DAY_S, BLOCK_S)


def candidate_number(flight: Flight, at: Instants, number: int) -> int:
    """How many candidates of a class a block needs, so that few stand for more than one passage; from a pilot at instants."""
    options = flight.options.population
    size_class = options.classes[number]
    if size_class.count == 0:
        return 0
    rng = generator(flight.seed, Effect.SURVEY, PILOT_BLOCK, number + 1)
    drawn = candidates(flight, at, pool_of(flight, size_class, rng), PILOT, rng)
    weight = np.sort(drawn.natural[drawn.snr >= options.snr_min])[::-1] * PILOT
    if not weight.size:
        return 1000
    # with n candidates those above n stand for more than one; what is above is sum(w - n)
    above = np.cumsum(weight) - np.arange(1, len(weight) + 1) * weight
    allowed = np.searchsorted(above, BEYOND_ONE * weight.sum(), side="right")
    return int(np.clip(weight[min(allowed, len(weight) - 1)], 1000, 20_000_000))


class Pools:
    """The pools of the blocks that a worker makes; the last of each class is kept."""

    def __init__(self) -> None:
        self._kept: dict[int, tuple[int, Pool]] = {}

    def of(self, flight: Flight, size_class: SizeClass, number: int, block: int) -> Pool:
        """The pool of a class for a block: the same for all blocks of a group."""
        group = block // POOL_BLOCKS
        kept = self._kept.get(number)
        if kept is None or kept[0] != group:
            rng = generator(flight.seed, Effect.SURVEY, POOL_GROUP + group, number + 1)
            kept = group, pool_of(flight, size_class, rng)
            self._kept[number] = kept
        return kept[1]


def draw_block(flight: Flight, block: int, numbers: list[int], pools: Pools) -> tuple[Instants, Passages]:
    """Passages of nature in a block that reach `population.snr_min`, one row for each (`natural` 1)."""
    options = flight.options.population
    at = block_instants(flight, block)
    parts = []
    for k, (size_class, n) in enumerate(zip(options.classes, numbers, strict=True)):
        if n == 0:
            continue
        rng = generator(flight.seed, Effect.SURVEY, block, k + 1)
        pool = pools.of(flight, size_class, k, block)
        for first in range(0, n, CHUNK):
            some = candidates(flight, at, pool, min(CHUNK, n - first), rng)
            # each call's `natural` is of its own number of candidates: all calls together make n
            weight = some.natural * min(CHUNK, n - first) / n
            copies = np.floor(np.where(some.snr >= options.snr_min, weight, 0.0) + rng.random(len(weight))).astype(np.int64)
            parts.append(some.taken(np.repeat(np.arange(len(copies)), copies)))
    return at, joined(parts) if parts else none_of(flight, at)


def joined(parts: list[Passages]) -> Passages:
    """Passages one after the other."""
    names = [name for name in Passages.__dataclass_fields__ if name != "surfaces"]
    columns: dict[str, Any] = {name: np.concatenate([getattr(p, name) for p in parts]) for name in names}
    surfaces = {name: np.concatenate([getattr(p.surfaces, name) for p in parts]) for name in ("albedo", "specular", "colour")}
    return Passages(**columns, surfaces=Surfaces(**surfaces))


def none_of(flight: Flight, at: Instants) -> Passages:
    """No passages."""
    no, where = np.zeros(0), np.zeros((0, 3))
    surfaces = Surfaces(albedo=no, specular=no, colour=no)
    return make_passages(flight, at, np.zeros(0, np.int64), no, surfaces, where, where)


EXPECTED_ROUNDS: Final = 6  # with pools of their own; their scatter is the error of their mean. Time grows with them
EXPECTED_BLOCK: Final = 8_000_000  # first random stream of the rounds, beside those of the pilot, the pools and the flux


def expected_passages(
    flight: Flight, size_edges_m: Array, altitude_edges_km: Array, inclination_edges_deg: Array, span_s: float
) -> Array:
    """Passages (rounds, sizes, altitudes, inclinations) expected in a time from the epoch on, without Poisson's scatter.

    Each round has pools of its own: its scatter is what the pieces of a pool leave.
    """
    edges = [np.array(size_edges_m), np.array(altitude_edges_km), np.array(inclination_edges_deg)]
    sizes = [(c.from_mm, c.to_mm) for c in flight.options.population.classes if c.count]
    out = np.zeros([EXPECTED_ROUNDS, *(len(e) - 1 for e in edges)])
    for k in range(len(size_edges_m) - 1):
        low, high = 1e3 * float(size_edges_m[k]), 1e3 * float(size_edges_m[k + 1])
        # a survey has no objects between and beyond its classes
        parts = [(max(low, a), min(high, b)) for a, b in sizes if max(low, a) < min(high, b) * (1.0 - 1e-9)]
        for part, (a, b) in enumerate(parts):
            for turn in range(EXPECTED_ROUNDS):
                rng = generator(flight.seed, Effect.SURVEY, EXPECTED_BLOCK + turn, 10 * k + part)
                at = instants_of(flight, np.sort(rng.random(360)) * span_s, span_s)
                pool = pool_of(flight, SizeClass(from_mm=a, to_mm=b, count=1), rng)
                found = candidates(flight, at, pool, CHUNK, rng)
                weight = np.where(found.snr >= flight.options.population.snr_min, found.natural, 0.0)
                _, _, i_deg = orbits_of(found)
                altitude = np.linalg.norm(found.position_km, axis=1) - earth.EARTH_RADIUS_KM
                inside = np.clip(altitude, edges[1][0], edges[1][-1] * (1.0 - 1e-9))
                table, _ = np.histogramdd(np.stack([found.size_m, inside, i_deg], axis=1), bins=edges, weights=weight)
                out[turn] += table
    return out


FLUX_PIECES: Final = 40_000  # of a pool of 200,000, for each shell: time against scatter. Chosen, not measured
FLUX_BLOCK: Final = 7_000_000  # random streams of the flux, beside those of the pools and the rounds


def model_flux(flight: Flight, size_edges_m: Array, altitude_edges_km: Array, inclination_edges_deg: Array) -> Array:
    """Objects per km^2 and year (sizes, altitudes, inclinations) of the scenario's population: density times relative speed.

    On a circular orbit of the camera's inclination at heights even within each shell, all directions together; inclinations
    are those of the objects.
    """
    observer = flight.carrier.observer
    if not isinstance(observer, OrbitingObserver):
        raise TypeError("a flight has an observer in orbit")
    place, speed = observer.motion.states(np.linspace(0.0, 5_900.0, 240))
    up = place / np.linalg.norm(place, axis=1, keepdims=True)
    ahead = np.cross(np.cross(place, speed), place)
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    out = np.zeros((len(size_edges_m) - 1, len(altitude_edges_km) - 1, len(inclination_edges_deg) - 1))
    for k in range(len(size_edges_m) - 1):
        rng = generator(flight.seed, Effect.SURVEY, FLUX_BLOCK, k + 1)
        size_class = SizeClass(from_mm=1e3 * float(size_edges_m[k]), to_mm=1e3 * float(size_edges_m[k + 1]), count=1)
        pool = pool_of(flight, size_class, rng)
        n = FLUX_PIECES
        a_km, e, i_rad, population = pool.a_km[:n], pool.e[:n], pool.i_rad[:n], pool.population[:n]
        band = np.searchsorted(inclination_edges_deg, np.degrees(i_rad), side="right") - 1
        for j in range(len(altitude_edges_km) - 1):
            top = min(float(altitude_edges_km[j + 1]), HIGHEST_SHELL_KM)
            low = max(float(altitude_edges_km[j]), LOWEST_SHELL_KM)
            r = earth.EARTH_RADIUS_KM + rng.uniform(low, top, n)
            at = rng.integers(len(up), size=n)
            here = up[at] * r[:, None]
            with np.errstate(invalid="ignore"):
                density = np.nan_to_num(cell_density(here, a_km, e, i_rad))
            signs = rng.random((2, n)) < 0.5
            theirs = velocity_through(here, a_km, e, i_rad, signs[0], signs[1], just_missing=True)
            ours = ahead[at] * np.sqrt(earth.MU_KM3_S2 / r)[:, None]
            relative = np.nan_to_num(np.linalg.norm(theirs - ours, axis=1))
            flux = population * density * relative / n * 365.25 * earth.DAY_S
            out[k, j] = np.bincount(np.clip(band, 0, out.shape[2] - 1), weights=flux, minlength=out.shape[2])
    return out


HIGHEST_SHELL_KM: Final = 2000.0  # the usual upper border of low orbits
LOWEST_SHELL_KM: Final = 300.0
"""The lowest and the highest shell are open; their flux is taken from here and to here."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Looks:
    """Frames in which passages leave light (k,): whose, S/N, length, V of the mean light of the trail, how much of a frame's

    noise, and how many frames of the stay this one stands for. open_s : of the exposure after the epoch. cut : by the field's
    edge. frames (n,) : of each passage's stay.
    """

    passage: Indices
    snr: Array
    length_px: Array
    mag: Array
    noise_e: Array
    stands_for: Array
    open_s: Array
    cut: NDArray[np.bool_]
    frames: Indices


def looks_of(
    flight: Flight,
    at: Instants,
    p: Passages,
    rng: np.random.Generator,
    only: tuple[int | Indices, int | Indices] | None = None,
    *,
    turns: bool = True,
) -> Looks:
    """How passages show in the frames of their stay, or in those from one to another; rng : for how they turn, if they do."""
    window, camera, period = flight.window, flight.camera, 1.0 / flight.options.frame_rate_hz
    exposure, base = camera.exposure_s, at.time_s[p.instant]
    line = p.position_km - at.position_km[p.instant]
    relative = p.velocity_km_s - at.velocity_km_s[p.instant]
    attitude = at.attitude[p.instant]
    place = np.einsum("nij,nj->ni", attitude, line)
    moves = np.einsum("nij,nj->ni", attitude, relative) + np.cross(at.spin_rad_s[p.instant], place)
    shift = 1e-6 * flight.carrier.shutter.line_time_us * 0.5 * (camera.shape[0] - 1)
    first = np.ceil((base + p.enter_s - exposure - shift) / period).astype(np.int64)
    last = np.floor((base + p.leave_s - shift) / period).astype(np.int64)
    if only is not None:
        first, last = np.maximum(first, only[0]), np.minimum(last, only[1])
    frames = np.maximum(last - first + 1, 0)
    shown = np.minimum(frames, FRAMES_EACH)
    whose = np.repeat(np.arange(len(frames)), shown)
    within = np.arange(len(whose)) - np.repeat(np.cumsum(shown) - shown, shown)
    number = first[whose] + np.floor((within + 0.5) * frames[whose] / shown[whose]).astype(np.int64)
    open_s = number * period
    begin = np.maximum(open_s + shift - base[whose], p.enter_s[whose])
    end = np.minimum(open_s + shift + exposure - base[whose], p.leave_s[whose])
    lit = np.maximum(end - begin, 0.0)
    middle = 0.5 * (begin + end)
    there = place[whose] + moves[whose] * middle[:, None]
    distance = np.linalg.norm(there, axis=1)
    across = moves[whose] - np.sum(moves[whose] * there, axis=1, keepdims=True) * there / distance[:, None] ** 2
    rate = np.linalg.norm(across, axis=1) / distance
    row, col = camera.projection.to_pixels(there)
    flux = light_of(flight, at, p.instant, p.size_m, p.surfaces, p.position_km)[whose] * (p.range_km[whose] / distance) ** 2
    if turns:
        flux *= turning(flight, len(p.size_m), whose, base[whose] + begin, base[whose] + np.maximum(end, begin + 1e-6), rng)
    lit_share = np.nan_to_num(camera.illumination_at(row, col), nan=0.0)
    noise_e2 = at.noise_e2[p.instant][whose] - (1.0 - lit_share) * at.sky_e[p.instant][whose]
    length_px = rate * lit * window.focal_px
    share = flight.energy.of(length_px, row, col, camera.defocus_px(distance)) * at.star_share[p.instant][whose]
    snr = flux * lit_share * window.flux_e_s * lit * np.sqrt(share / noise_e2)
    with np.errstate(divide="ignore"):
        mag = -2.5 * np.log10(flux)
    return Looks(
        passage=whose, snr=np.where(lit > 0.0, snr, 0.0), length_px=length_px, mag=mag,
        noise_e=np.sqrt(noise_e2), stands_for=frames[whose] / shown[whose], open_s=open_s, cut=lit < exposure * (1.0 - 1e-9),
        frames=frames,
    )  # fmt: skip


def turning(flight: Flight, n: int, whose: Indices, begin_s: Array, end_s: Array, rng: np.random.Generator) -> Array:
    """Light (k,) over the mean of pieces (n,) that turn, between pairs of times: as `scene.sources: light_curves` draws them."""
    options = flight.options.population
    surface = options.surface
    tumbles = rng.random(n) < options.tumbling_share
    period, amplitude = rng.lognormal(np.log(2.0), CURVE_SPREAD, n), rng.uniform(0.1, 0.7, n)
    phase, faces, flashes = rng.uniform(0.0, 2.0 * np.pi, n), rng.random((n, 3)), rng.random(n) < surface.glint_share
    peak = surface.glint_factor * np.exp(0.7 * rng.standard_normal(n))
    faceted = faces[:, 0] < surface.facet_share
    out = np.ones(len(whose))
    turns = np.flatnonzero(tumbles[whose])
    if not turns.size:
        return out
    mine = whose[turns]
    columns: dict[str, Any] = {
        "period_s": period[mine],
        "amplitude": amplitude[mine],
        "phase_rad": phase[mine],
        "facets": np.where(faceted, 0.5 + 0.5 * faces[:, 1], 0.0)[mine],
        "facet_phase_rad": 2.0 * np.pi * faces[mine, 2],
        "glint_factor": np.where(flashes, peak, 0.0)[mine],
        "glint_width_s": (period * surface.glint_turn_deg / 360.0)[mine],
    }
    out[turns] = LightCurve(**columns).mean_factor(begin_s[turns], end_s[turns])
    return out


def orbits_of(p: Passages) -> tuple[Array, Array, Array]:
    """Semi-major axis (km), eccentricity and inclination (deg) of passages (n,)."""
    found = elements_of(p.position_km, p.velocity_km_s)
    return found.a_km, found.e, np.degrees(found.i_rad)
