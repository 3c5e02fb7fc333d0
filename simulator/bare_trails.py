"""The pixel chain's objects and trails, for runs whose pictures nobody needs; and the same objects as passages of a survey.

Each seed draws the objects that a run of the pixel chain with this seed shows; camera, orbit, pointing and stars are those of
one flight. What the truth then says of trails (S/N, length, magnitude) costs a tenth of a run.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sboc_e2e import truth
from sboc_e2e.catalogue import StarCatalogue
from simulator.chain import Simulator
from simulator.platform import earth
from simulator.platform.kepler import state_of
from simulator.randomness import Effect, generator
from simulator.scene.backdrop import backdrop_of
from simulator.scene.cast import Cast, encounter_window, make_cast
from simulator.scene.cirrus import make_cirrus
from simulator.scene.crossing import row_shutter
from simulator.scene.encounters import TRUTH_EVEN_SHARE, Window, draw_candidates
from simulator.scene.movers import paths_of
from simulator.scene.sources import ObjectOptions
from simulator.scene.surface import Surfaces
from simulator.scene.trail_image import add_trail
from simulator.survey.flight import Flight, Instants, instants_of
from simulator.survey.passages import Passages, make_passages

Array = NDArray[np.float64]

SURFACE: Final = ("albedo", "specular", "colour")
MANY: Final = 400_000  # candidates of each class in `encounters_of`: a run's 60,000 weigh as some 100 equal ones
NOBODY: Final = ObjectOptions(passing=())
"""In place of the objects that a scenario places by name: only the sampled population flies."""


@dataclass(frozen=True, kw_only=True, eq=False)
class BareTrails:
    """trails (k,) : rows of the truth of streaks, `object_id` a place in size_m (m,) and run (m,) : of the objects of all runs.

    noise_e (k,) : of a pixel in each trail's frame, as the truth of frames has it. place_km, speed_km_s (m, 3) : at time_s (m,)
    after the epoch. surface (3, m) : albedo, specular share and colour.
    """

    trails: NDArray[np.void]
    noise_e: Array
    size_m: Array
    run: NDArray[np.int64]
    time_s: Array
    place_km: Array
    speed_km_s: Array
    surface: Array

    def as_passages(self, flight: Flight) -> tuple[Instants, Passages]:
        """The same objects as a survey has them."""
        return met(flight, self.time_s, self.size_m, Surfaces(**dict(zip(SURFACE, self.surface, strict=True))),
                   self.place_km, self.speed_km_s)  # fmt: skip


def bare_trails(flight: Flight, catalogue: StarCatalogue, seeds: Sequence[int]) -> BareTrails:
    """Trails of the runs of some seeds."""
    options, carrier = flight.options, flight.carrier
    made = [_cast(flight, seed) for seed in seeds]
    casts, drawn = [cast.objects for cast in made], [cast.drawn for cast in made]
    states = [state_of(one.elements) for one in drawn]
    number = np.cumsum([0, *(len(cast) for cast in casts)])
    empty = replace(options, objects=NOBODY, population=replace(options.population, classes=()))
    sky = Simulator(empty, seed=flight.seed, catalogue=catalogue)
    rows, noise = [truth.empty("streaks")], [np.zeros(0)]
    for index in range(options.frames):
        sight = carrier.sight(index)
        camera = flight.camera.at(sight.reference_s)
        sun_km = earth.sun_position_km(carrier.tai_ns(sight.reference_s))
        shutter = row_shutter(carrier.timing(index, delivered=False), carrier.epoch_tai_ns, camera.exposure_s, camera.shape)
        sky_e = sky.mean_electrons(index)
        noise_e = float(np.sqrt(camera.sensor.variance_e2(float(np.median(sky_e[::16])), camera.exposure_s)))
        for first, things in zip(number, casts, strict=False):
            image_e = sky_e.copy()
            # objects in orbit keep the time of the run, and no air is above them: neither start nor stream is used
            for k, path in paths_of(enumerate(things), sight, camera, sun_km, options.light, None, (0.0, 0.0), (0, index)):
                trail = add_trail(image_e, path, sight, shutter, camera, epoch_tai_ns=carrier.epoch_tai_ns)
                trail["frame"], trail["object_id"] = index, first + k
                rows.append(trail)
                noise.append(np.full(len(trail), noise_e))
    return BareTrails(
        trails=np.concatenate(rows),
        noise_e=np.concatenate(noise),
        size_m=np.array([thing.identity.size_m for thing in chain(*casts)]),
        run=np.repeat(np.arange(len(casts)), np.diff(number)),
        time_s=np.concatenate([one.time_s for one in drawn]) + 0.5 * options.frames / options.frame_rate_hz,
        place_km=np.concatenate([place for place, _ in states]),
        speed_km_s=np.concatenate([speed for _, speed in states]),
        surface=np.concatenate([[getattr(one.surfaces, name) for name in SURFACE] for one in drawn], axis=1),
    )


def met(
    flight: Flight, time_s: Array, size_m: Array, surfaces: Surfaces, place_km: Array, speed_km_s: Array
) -> tuple[Instants, Passages]:
    """Objects in the field, each at its own time (n,) after the epoch, as passages of a survey."""
    at = instants_of(flight, time_s, flight.options.frames / flight.options.frame_rate_hz)
    return at, make_passages(flight, at, np.arange(len(time_s)), size_m, surfaces, place_km, speed_km_s)


def encounters_of(flight: Flight, seed: int, each: int) -> tuple[Instants, Passages]:
    """`each` times as many objects as a run shows, drawn as the pixel chain draws them, out of more candidates than a run has.

    A run takes its few without repetition; so many are taken with it. More candidates, most of them far as most of nature's
    objects are, scatter less and mean the same (docs/survey.md).
    """
    options, window = flight.options.population, _window(flight)
    many = replace(options, candidates=MANY)
    parts = []
    for k, size_class in enumerate(options.classes):
        rng = generator(seed, Effect.POPULATION, block=k)
        found = draw_candidates(many, size_class, window, rng, even_share=TRUTH_EVEN_SHARE)
        share = np.where((found.snr >= options.snr_min) & (found.rate_deg_s >= options.slowest_deg_s), found.natural, 0.0)
        rng = generator(seed, Effect.SURVEY, k)
        pick = rng.choice(len(share), size=size_class.count * each, p=share / share.sum())
        when = found.time_s[pick] + 0.5 * window.duration_s
        parts.append((when, found.size_m[pick], found.surfaces.taken(pick), found.position_km[pick], found.velocity_km_s[pick]))
    surfaces = [part[2] for part in parts]
    together = Surfaces(**{name: np.concatenate([getattr(one, name) for one in surfaces]) for name in SURFACE})
    when, size_m, place_km, speed_km_s = (np.concatenate([part[n] for part in parts]) for n in (0, 1, 3, 4))
    return met(flight, when, size_m, together, place_km, speed_km_s)


def _sky_e_s(flight: Flight) -> float:
    """Sky in the middle of the field at the epoch, as the pixel chain takes it for expected S/N."""
    options, carrier = flight.options, flight.carrier
    cirrus, sun_km = make_cirrus(options.sky.structure, flight.seed), earth.sun_position_km(carrier.epoch_tai_ns)
    here = carrier.observer.state(carrier.epoch_tai_ns)[0]
    backdrop = backdrop_of(options.sky, carrier.epoch_tai_ns, sun_km, here, None, cirrus)
    middle = carrier.attitude(carrier.epoch_tai_ns + round(0.5e9 * options.frames / options.frame_rate_hz))[2]
    return float(backdrop.surface_flux(middle[None], flight.camera)[0] * flight.camera.surface_rate_e_s)


def _window(flight: Flight) -> Window:
    """What the pixel chain draws encounters for."""
    duration_s = flight.options.frames / flight.options.frame_rate_hz
    return encounter_window(flight.carrier, flight.camera, flight.options.light, _sky_e_s(flight), 0.5 * duration_s, duration_s)


def _cast(flight: Flight, seed: int) -> Cast:
    """The sampled objects of the run with a seed."""
    options = flight.options
    carrier, duration_s = replace(flight.carrier, seed=seed), options.frames / options.frame_rate_hz
    return make_cast(NOBODY, options.population, carrier, flight.camera, options.light, _sky_e_s(flight), duration_s)
