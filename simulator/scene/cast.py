"""The objects of a run, in the order of the truth table: given ones first, then satellites, then the sampled population."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sgp4.api import SGP4_ERRORS

from sboc_e2e.icd.errors import UserError
from simulator.camera import Camera
from simulator.platform import earth
from simulator.platform.carrier import Carrier
from simulator.platform.observer import Observer
from simulator.randomness import Effect, generator
from simulator.scene import sources
from simulator.scene.aberration import aberrate
from simulator.scene.alternatives import seen_per_day
from simulator.scene.atmosphere import Atmosphere
from simulator.scene.encounters import (
    FLUX_BLOCK,
    Drawn,
    PopulationOptions,
    Window,
    draw_encounters,
    natural_flux,
    natural_numbers,
)
from simulator.scene.fleet import KINDS, make_fleet, passing_now, pixel_objects
from simulator.scene.light import LightOptions
from simulator.scene.objects import PixelPathObject, SkyObject
from simulator.scene.prediction import Watch, predict_crossings
from simulator.scene.satellites import SatelliteOptions, read_satellites, satellite_object, with_sizes

Array = NDArray[np.float64]

YEAR_S = 365.25 * earth.DAY_S


@dataclass(frozen=True, kw_only=True, eq=False)
class Cast:
    """All objects, the encounters behind the sampled ones, and satellites that SGP4 refused with its error codes."""

    objects: tuple[SkyObject | PixelPathObject, ...]
    drawn: Drawn
    refused: dict[str, int]
    duration_s: float
    window: Window
    """What the encounters were drawn for."""


def make_cast(
    given: sources.ObjectOptions,
    population: PopulationOptions,
    carrier: Carrier,
    camera: Camera,
    effects: LightOptions,
    sky_e_s: float,
    duration_s: float,
) -> Cast:
    """Make the objects. sky_e_s : sky in the middle of the field, electrons per pixel and second, for expected S/N."""
    objects: list[SkyObject | PixelPathObject] = []
    colour_factor = camera.instrument.colour_factor
    fleet = None
    orbits_end_s, satellites_end_s = np.full(len(given.orbit), np.inf), dict[tuple[str, int], float]()
    if given.walker or given.breakup:
        fleet = make_fleet(given, population, carrier.epoch_tai_ns, carrier.seed, colour_factor, duration_s)
        orbits_end_s = fleet.to_s[fleet.kind == KINDS.index("orbit")]
        ends = zip(fleet.satellites, fleet.to_s, strict=False)
        satellites_end_s = {(s.name, s.record.satnum): float(end_s) for s, end_s in ends if end_s < duration_s}
    orbits = zip(given.orbit, orbits_end_s.tolist(), strict=True)
    objects.extend(replace(sources.orbiting(o, carrier.epoch_tai_ns), to_s=end_s) for o, end_s in orbits if end_s > 0.0)
    objects.extend(sources.sky_path(o) for o in given.sky_path)
    objects.extend(sources.pixel_path(o) for o in given.pixel_path)
    for o in given.passing:
        when = carrier.tai_ns(o.when * duration_s)
        objects.append(sources.passing(o, *_met(o, carrier, camera, when), o.when * duration_s))
    for e in given.encounter:
        when = carrier.tai_ns(e.when * duration_s)
        place = camera.direction(e.field_row, e.field_col)
        objects.append(sources.encounter(e, *carrier.observer.state(when), carrier.attitude(when), place, e.when * duration_s))
    found, refused = _satellites(given.satellites, carrier, camera, duration_s, satellites_end_s)
    objects.extend(found)
    if fleet is not None:
        # about the boresight, as wide as a window off it needs
        half = 1.02 * (0.5 * max(camera.shape) + np.abs(camera.window_offset_px).max()) / camera.projection.focal_px
        near = passing_now(fleet, carrier, half, half, duration_s)
        drawn_kinds = [KINDS.index("walker"), KINDS.index("fragment")]
        objects.extend(pixel_objects(fleet, near[np.isin(fleet.kind[near], drawn_kinds)]))
    middle_s = 0.5 * duration_s
    window = encounter_window(carrier, camera, effects, sky_e_s, middle_s, duration_s)
    drawn = draw_encounters(population, window, carrier.seed)
    objects.extend(sources.population_objects(drawn, population, middle_s, carrier.seed))
    return Cast(objects=tuple(objects), drawn=drawn, refused=refused, duration_s=duration_s, window=window)


def lasting_objects(
    given: sources.ObjectOptions, carrier: Carrier, camera: Camera, duration_s: float
) -> tuple[sources.OrbitOptions, ...]:
    """Orbits of the objects that pass or are given by elements, under all forces and with epochs of their own."""
    start_utc = earth.utc_text(carrier.epoch_tai_ns)
    orbits = [replace(o, forces="all", epoch_utc=o.epoch_utc or start_utc) for o in given.orbit]
    for o in given.passing:
        when = carrier.tai_ns(o.when * duration_s)
        elements = sources.passing_elements(o, *_met(o, carrier, camera, when))
        orbits.append(sources.lasting(o, elements, earth.utc_text(when)))
    return tuple(orbits)


def _met(options: sources.PassingOptions, carrier: Carrier, camera: Camera, when: int) -> tuple[Array, Array]:
    """Place of the camera (3,) km and direction (3,) in which an object passes."""
    direction = carrier.attitude(when).T @ camera.direction(options.field_row, options.field_col)
    return carrier.observer.state(when)[0], np.asarray(direction)


def _satellites(
    options: SatelliteOptions, carrier: Carrier, camera: Camera, duration_s: float, end_s: Mapping[tuple[str, int], float]
) -> tuple[list[SkyObject], dict[str, int]]:
    """Catalogued satellites that cross the field during the run, each once; and the refused ones.

    end_s : when those break up that do, by name and number; one that did before the run is left out.
    UserError when one that was asked for by name is refused.
    """
    if not options.file:
        return [], {}
    listed = read_satellites(options.file, options.names)
    predicted = predict_crossings(
        with_sizes(listed, options.sizes_file) if options.sizes_file else listed,
        Watch(
            observer=carrier.observer,
            attitude=carrier.attitude,
            projection=camera.projection,
            shape=camera.shape,
            epoch_tai_ns=carrier.epoch_tai_ns,
            from_s=0.0,
            to_s=duration_s,
            farthest_km=options.farthest_km,
        ),
    )
    if options.names and predicted.refused:
        name, code = next(iter(predicted.refused.items()))
        raise UserError(f"satellite {name!r} of {options.file}: refused by SGP4 ({SGP4_ERRORS.get(code, code)})")
    once = {id(c.satellite): c.satellite for c in predicted.crossings}
    whole = [(s, end_s.get((s.name, s.record.satnum), np.inf)) for s in once.values()]
    epoch = carrier.epoch_tai_ns
    return [replace(satellite_object(s, options, epoch), to_s=end) for s, end in whole if end > 0.0], predicted.refused


def encounter_window(
    carrier: Carrier, camera: Camera, effects: LightOptions, sky_e_s: float, middle_s: float, duration_s: float
) -> Window:
    """Field and sensitivity of the camera during the run, for drawing encounters."""
    middle = carrier.tai_ns(middle_s)
    position, velocity = carrier.observer.state(middle)
    return Window(
        observer_km=position,
        velocity_km_s=velocity,
        attitude=carrier.attitude(middle),
        sun_km=earth.sun_position_km(middle),
        half_row=0.5 * camera.shape[0] / camera.projection.focal_px,
        half_col=0.5 * camera.shape[1] / camera.projection.focal_px,
        mid_row=camera.window_offset_px[0] / camera.projection.focal_px,
        mid_col=camera.window_offset_px[1] / camera.projection.focal_px,
        duration_s=duration_s,
        exposure_s=camera.exposure_s,
        flux_e_s=camera.zero_point_e_s,
        focal_px=camera.projection.focal_px,
        sigma_px=camera.axis_sigma_px,
        noise_variance_e2=float(camera.sensor.variance_e2(sky_e_s * camera.exposure_s, camera.exposure_s)),
        aperture_m=camera.blurring_aperture_m,
        effects=effects,
        colour_factor=camera.instrument.colour_factor,
    )


def summary(options: PopulationOptions, cast: Cast) -> dict[str, Any]:
    """Encounters of nature against those drawn, for each size class; JSON-able.

    natural_in_run : detectable objects of nature in the field at some time of the run, as the drawn ones' candidates have it (the
    sum of their weights). natural_expected : the same from an integral of its own, good to 3 %. entering_per_day : that enter it.
    density_boost : drawn over natural_expected, which is how much denser than nature the run's sky is.
    natural_at_any_range : the same as natural_expected, objects beyond `farthest` included. boost_at_any_range : drawn over it,
    which is how much denser the run's sky seems to who does not know where it ends.
    flux_km2_year : nature's cross-sectional area flux of all objects of the class at the camera.
    seen_per_day : entering ones of S/N 8 and more; models_low, models_high : what models leave, as factors on it.
    """
    drawn = cast.drawn
    numbers = [natural_numbers(options, c, cast.window) if c.count else (0.0, 0.0) for c in options.classes]
    seen = [seen_per_day(options, c, cast.window, k) for k, c in enumerate(options.classes)]
    streams = [generator(drawn.seed, Effect.POPULATION, block=FLUX_BLOCK + k) for k in range(len(options.classes))]
    flux = [natural_flux(options, c, cast.window, rng) for c, rng in zip(options.classes, streams, strict=True)]
    classes = [
        {
            "from_mm": size_class.from_mm,
            "to_mm": size_class.to_mm,
            "drawn": int(drawn.drawn_by_class[k]),
            "natural_in_run": float(drawn.natural_by_class[k]),
            "boost": _ratio(drawn.drawn_by_class[k], drawn.natural_by_class[k]),
            "natural_expected": numbers[k][0],
            "density_boost": _ratio(drawn.drawn_by_class[k], numbers[k][0]),
            "natural_at_any_range": numbers[k][1],
            "boost_at_any_range": _ratio(drawn.drawn_by_class[k], numbers[k][1]),
            "entering_per_day": float(drawn.per_day_by_class[k]),
            "flux_km2_year": flux[k] * YEAR_S,
            "seen_per_day": seen[k].per_day,
            "models_low": seen[k].low,
            "models_high": seen[k].high,
        }
        for k, size_class in enumerate(options.classes)
    ]
    return {
        "duration_s": cast.duration_s,
        "snr_min": options.snr_min,
        "slowest_deg_s": options.slowest_deg_s,
        "classes": classes,
        "natural_in_run": float(drawn.natural_by_class.sum()),
        "drawn": int(drawn.drawn_by_class.sum()),
        "boost": _ratio(drawn.drawn_by_class.sum(), drawn.natural_by_class.sum()),
        "satellites_refused_by_sgp4": cast.refused,
    }


def target_direction(
    name: str,
    given: sources.ObjectOptions,
    observer: Observer,
    epoch_tai_ns: int,
    effects: LightOptions,
    air_at: Callable[[Observer, int], Atmosphere | None],
) -> Callable[[int], Array]:
    """Apparent direction of the object that the pointing follows, as a function of TAI nanoseconds.

    UserError when no object has that name.
    """
    found: list[SkyObject] = [sources.orbiting(o, epoch_tai_ns) for o in given.orbit if o.name == name]
    found.extend(sources.sky_path(o) for o in given.sky_path if o.name == name)
    if not found and given.satellites.file:
        read = read_satellites(given.satellites.file, (name,))
        found.extend(satellite_object(s, given.satellites, epoch_tai_ns) for s in read)
    if not found:
        raise UserError(
            f"pointing.target: no object named {name!r}; allowed are names of objects.orbit, objects.sky_path, objects.satellites"
        )

    def direction(tai_ns: int) -> Array:
        position, velocity = observer.state(tai_ns)
        time_s = np.array([(tai_ns - epoch_tai_ns) * 1e-9])
        vector = found[0].seen(time_s, position[None], earth.sun_position_km(tai_ns), effects).vector_km
        distance_km = np.linalg.norm(vector, axis=1)
        apparent = aberrate(vector / distance_km, velocity if effects.orbital_aberration else np.zeros(3))
        air = air_at(observer, tai_ns)
        return np.asarray((apparent if air is None else air.refracted(apparent, distance_km))[0])

    return direction


def _ratio(shown: float, natural: float) -> float | None:
    return float(shown) / float(natural) if natural > 0.0 else None
