"""Trails of runs whose pictures nobody needs: the pixel chain's encounters, paths and trails on its sky and stars, without noise.

Each seed draws the objects that a run of the pixel chain with this seed shows; camera, orbit, pointing and stars are those of
one flight. What the truth then says of trails (S/N, length, magnitude) costs a hundredth of a run.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from sboc_e2e import truth
from sboc_e2e.catalogue import StarCatalogue
from simulator.chain import Simulator
from simulator.platform import earth
from simulator.scene.backdrop import backdrop_of
from simulator.scene.cast import make_cast
from simulator.scene.cirrus import make_cirrus
from simulator.scene.crossing import row_shutter
from simulator.scene.movers import paths_of
from simulator.scene.objects import PixelPathObject, SkyObject
from simulator.scene.sources import ObjectOptions
from simulator.scene.trail_image import add_trail
from simulator.survey import Flight

NOBODY = ObjectOptions(passing=())
"""In place of the objects that a scenario places by name: only the sampled population flies."""


@dataclass(frozen=True, kw_only=True, eq=False)
class BareTrails:
    """trails (k,) : rows of the truth of streaks, `object_id` a place in size_m (m,) and run (m,) : of the objects of all runs.

    noise_e (k,) : of a pixel in each trail's frame, as the truth of frames has it.
    """

    trails: NDArray[np.void]
    noise_e: NDArray[np.float64]
    size_m: NDArray[np.float64]
    run: NDArray[np.int64]


def bare_trails(flight: Flight, catalogue: StarCatalogue, seeds: Sequence[int]) -> BareTrails:
    """Trails of the runs of some seeds."""
    options, carrier = flight.options, flight.carrier
    casts = [_drawn(flight, seed) for seed in seeds]
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
    )


def _drawn(flight: Flight, seed: int) -> tuple[SkyObject | PixelPathObject, ...]:
    """The sampled objects of the run with a seed."""
    options, carrier, camera = flight.options, flight.carrier, flight.camera
    duration_s = options.frames / options.frame_rate_hz
    cirrus, sun_km = make_cirrus(options.sky.structure, flight.seed), earth.sun_position_km(carrier.epoch_tai_ns)
    here = carrier.observer.state(carrier.epoch_tai_ns)[0]
    backdrop = backdrop_of(options.sky, carrier.epoch_tai_ns, sun_km, here, None, cirrus)
    middle = carrier.attitude(carrier.epoch_tai_ns + round(0.5e9 * duration_s))[2]
    sky_e_s = float(backdrop.surface_flux(middle[None], camera)[0] * camera.surface_rate_e_s)
    return make_cast(NOBODY, options.population, replace(carrier, seed=seed), camera, options.light, sky_e_s, duration_s).objects
