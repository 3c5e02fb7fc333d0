"""Where the camera of a survey is and what its sky is like, at any times, without a pixel."""

from dataclasses import dataclass, replace
from typing import Final

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
from simulator.platform.observer import OrbitingObserver, make_observer
from simulator.platform.rotation import rotation_vector_of
from simulator.randomness import Effect, generator
from simulator.scene.backdrop import backdrop_of
from simulator.scene.cast import encounter_window
from simulator.scene.earth_light import earth_reach_rad
from simulator.scene.encounters import Window
from simulator.scene.fleet import Fleet, is_given, make_fleet
from simulator.scene.stars import sky_catalogue
from simulator.trail_noise import StarNoise, TrailEnergy

Array = NDArray[np.float64]

BLOCK_S: Final = 21_600.0
"""A block of time: a quarter of a day."""

STEP_S: Final = 60.0
"""Candidates of a block meet the camera at instants, one at random in each step: 4 deg of a low orbit."""

SPIN_S: Final = 0.25
"""Step of the difference of attitudes: 90 deg at the fastest roll, 360 deg/s. A rotation vector wraps at 180 deg."""


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
        """The flight of a scenario. UserError for what `refuse_unwatched` names."""
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
    """UserError for a ground site, for pointing that follows an object, and for timing that the pixel chain refuses."""
    if options.platform.kind == "site":
        raise UserError("platform.kind: a survey needs a camera in orbit: sun_synchronous or kepler, not site")
    if options.pointing.law == "object":
        raise UserError("pointing.law: a survey follows no object; allowed are anti_sun, inertial, sidereal, nadir, schedule")
    options.refuse_bad_timing()


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

    def fastest_turn_rad_s(self, radius_rad: float) -> float:
        """Most by which the camera's turn moves a star within a radius about the boresight."""
        sideways = np.linalg.norm(self.spin_rad_s[:, :2], axis=1)
        return float(np.max(sideways + np.abs(self.spin_rad_s[:, 2]) * np.sin(radius_rad)))

    def in_camera(self, instant: NDArray[np.int64], position_km: Array, velocity_km_s: Array) -> tuple[Array, Array]:
        """Places and their rates (n, 3), km and km/s in the camera frame, of objects (n, 3), GCRS, at instants (n,)."""
        attitude = self.attitude[instant]
        place = np.einsum("nij,nj->ni", attitude, position_km - self.position_km[instant])
        moves = np.einsum("nij,nj->ni", attitude, velocity_km_s - self.velocity_km_s[instant])
        # seen from the frame that turns, what rests turns the other way
        return place, moves - np.cross(self.spin_rad_s[instant], place)


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
    spin = rotation_vector_of(np.einsum("nij,nkj->nik", later, attitude)) / SPIN_S
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
