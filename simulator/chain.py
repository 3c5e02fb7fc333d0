"""The simulator, read aloud. This is the only module that knows the order of effects:

    platform    where the camera is and looks at each instant; what clock, GPS and star tracker say of it
    scene       which stars, sky and objects shine there: aberration, light time, shadow, phase
    projection  gnomonic with distortion, in one coordinate module
    brightness  magnitudes and colours to electrons, zodiacal and stray light
    atmosphere  (ground sites) refraction, extinction, seeing and image motion, scintillation, clouds, sky glow
    motion      pointing, jitter and relative motion; each row at its own epoch
    exposure    stars and trails through PSF, defocus and vignetting into mean photo-electrons
    radiation   particle tracks as charge
    sensor      shot noise, dark current, fixed pattern, reset and read noise, full well, conversion, binning
    telemetry   header with time tags, attitude and orbit, each with its error; truth beside it

Any frame can be made alone, by any process, with the same bytes.
"""

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sboc_e2e import truth
from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.icd.errors import UserError
from sboc_e2e.icd.frame import Calibration, Frame, NominalCamera
from simulator.as_built import with_drawn_errors
from simulator.camera import Camera
from simulator.header import frame_header
from simulator.options import SimulatorOptions
from simulator.platform import earth
from simulator.platform.carrier import Carrier
from simulator.platform.jitter import make_jitter
from simulator.platform.line_of_sight import LineOfSight
from simulator.platform.observer import OrbitingObserver, SiteObserver, make_observer
from simulator.platform.pointing import commanded_attitude
from simulator.platform.shutter import ShutterOptions
from simulator.radiation.arrival import field_lines
from simulator.radiation.field import ParticleField
from simulator.randomness import Effect, generator
from simulator.scene.atmosphere import Atmosphere, clouds_of
from simulator.scene.cast import make_cast, summary, target_direction
from simulator.scene.crossing import RowShutter, exposed_intervals
from simulator.scene.objects import PixelPathObject
from simulator.scene.sky import SKY_GRID, diffuse_flux, fill_diffuse
from simulator.scene.star_image import expose_stars, place_stars
from simulator.scene.stars import StarSky
from simulator.scene.trail_image import Path, add_trail, pixel_path_of, sky_path_of
from simulator.scene.turbulence import Unsteadiness
from simulator.sensor.smear import add_smear
from simulator.truth_rows import cosmic_rows, frame_row, star_rows

Array = NDArray[np.float64]

STAR_MARGIN_PX = 40.0
"""Stars this far outside the frame are drawn for the light of their wings."""


def carrier_of(
    options: SimulatorOptions,
    shutter: ShutterOptions,
    observer: OrbitingObserver | SiteObserver,
    camera: Camera,
    seed: int,
    target: Callable[[int], Array] | None = None,
) -> Carrier:
    """The platform that carries a camera. target : direction that the law `object` follows."""
    epoch = earth.tai_ns_of_utc(options.epoch_utc)
    return Carrier(
        epoch_tai_ns=epoch,
        seed=seed,
        frame_rate_hz=options.frame_rate_hz,
        observer=observer,
        attitude=commanded_attitude(options.pointing, observer, epoch, target),
        jitter=make_jitter(options.jitter, seed),
        shutter=shutter,
        clock=options.clock,
        telemetry=options.telemetry,
        rows=camera.shape[0],
        row_step=camera.binning.rows,
    )


class Simulator:
    """A simulated camera in its world, at the epoch of its options.

    UserError for options that contradict each other or the laws of nature.
    """

    def __init__(self, options: SimulatorOptions, *, seed: int, catalogue: StarCatalogue) -> None:
        options = with_drawn_errors(options, seed)
        shutter = options.shutter
        window = options.sensor.window
        shutter.refuse_overlap(window.rows or options.instrument.rows - window.row0, options.frame_rate_hz)
        if options.sensor.type == "ccd":  # all rows are exposed at once; the line time is that of the store's read-out
            shutter = replace(shutter, line_time_us=0.0)
        self.options = options
        self.seed = seed
        self.n_frames = options.frames
        self._epoch = epoch = earth.tai_ns_of_utc(options.epoch_utc)
        duration_s = options.frames / options.frame_rate_hz
        earth.refuse_outside_data(epoch + round(duration_s * 1e9))
        self._camera = Camera(
            options.instrument, options.psf, options.vignetting, options.sensor, exposure_s=shutter.exposure_s, seed=seed
        )
        self._clouds = clouds_of(options.atmosphere, seed)
        observer = make_observer(options.platform, epoch)
        target = None
        if options.pointing.law == "object":
            target = target_direction(options.pointing.target, options.objects, observer, epoch, options.light, self._air)
        self._carrier = carrier_of(options, shutter, observer, self._camera, seed, target)
        self._check_field(duration_s)
        self._particles = ParticleField(
            options.radiation,
            rows=options.instrument.rows,
            cols=options.instrument.cols,
            pitch_um=options.instrument.pixel_um,
            seed=seed,
            epoch_jyear=earth.jyear(epoch),
        )
        self._stars = StarSky(options.stars, options.instrument, catalogue, seed=seed, epoch_jyear=earth.jyear(epoch))
        middle = self._carrier.attitude(epoch + round(0.5e9 * duration_s))[2]
        sky_e_s = float(self._sky_rate_e_s(middle[None], self._air(observer, epoch))[0])
        self._cast = make_cast(
            options.objects, options.population, self._carrier, self._camera, options.light, sky_e_s, duration_s
        )

    # ------------------------------------------------------------- one frame

    def frame(self, index: int) -> tuple[Frame, truth.FrameTruth]:
        """Frame number `index` and its truth."""
        if not 0 <= index < self.n_frames:
            raise UserError(f"frame {index}: allowed are 0 to {self.n_frames - 1}")
        sight = self._carrier.sight(index)
        image_e, sky_e, entropy_bits, stars, streaks = self._expose(sight, index)
        middle = self._carrier.timing(index, delivered=True).middle_tai_ns
        fixed = self._carrier.earth_fixed(middle)
        lines = field_lines(*fixed) if fixed else None
        hits = self._particles.hits(index, self._camera.exposure_s, self._carrier.geodetic(middle), lines)
        self._camera.sensor.overflow(image_e)
        pixels = self._camera.sensor.digitise(image_e, index, self._camera.exposure_s, hits)
        cosmics = cosmic_rows(self._camera, hits, index)
        frame = frame_row(self._camera.at(sight.reference_s), self._carrier, sight, self._air_of(sight), sky_e, index)
        frame["entropy_bits"], frame["n_cosmics"] = entropy_bits, len(cosmics)
        made = truth.FrameTruth(frame=frame, stars=stars, streaks=streaks, cosmics=cosmics)
        return Frame(header=frame_header(self._camera, self._carrier, sight, index), pixels=pixels), made

    def mean_electrons(self, index: int) -> NDArray[np.float32]:
        """Noise-free photo-electrons of a frame, on the detector's read-out window."""
        return self._expose(self._carrier.sight(index), index)[0]

    def _expose(
        self, sight: LineOfSight, index: int
    ) -> tuple[NDArray[np.float32], float, float, NDArray[np.void], NDArray[np.void]]:
        """Sky, stars and objects as mean electrons; mean sky, entropy without objects, truth of stars and streaks."""
        shutter = self._shutter(index)
        image_e = self._diffuse(sight, index)
        sky_e = float(image_e[::16].mean(dtype=np.float64))
        stars = self._add_stars(image_e, sight, shutter, index)
        entropy_bits = self._camera.sensor.entropy_bits(image_e[::16], self._camera.exposure_s)
        streaks = [truth.empty("streaks")]
        for object_id, path in self._paths(sight, index, range(len(self._cast.objects))):
            trail = add_trail(image_e, path, sight, shutter, self._camera.at(sight.reference_s), epoch_tai_ns=self._epoch)
            trail["frame"], trail["object_id"] = index, object_id
            streaks.append(trail)
        sensor = self.options.sensor
        if sensor.type == "ccd" and sensor.ccd.row_transfer_us > 0.0:
            add_smear(image_e, sensor.ccd.row_transfer_us * 1e-6, self._camera.exposure_s)
        return image_e, sky_e, entropy_bits, stars, np.concatenate(streaks)

    def _shutter(self, index: int) -> RowShutter:
        """When the rows of the window are open."""
        timing = self._carrier.timing(index, delivered=False)
        return RowShutter(
            open_s=(timing.t_start_tai_ns - self._epoch) * 1e-9,
            line_s=timing.line_time_ns * 1e-9,
            exposure_s=self._camera.exposure_s,
            rows=self._camera.shape[0],
            cols=self._camera.shape[1],
        )

    def _air(self, observer: object, tai_ns: int) -> Atmosphere | None:
        """The atmosphere above a site; None in orbit."""
        if not isinstance(observer, SiteObserver):
            return None
        return Atmosphere(
            options=self.options.atmosphere,
            up=observer.up(tai_ns),
            height_m=observer.site.height_m,
            clouds=self._clouds,
            time_s=(tai_ns - self._epoch) * 1e-9,
        )

    def _air_of(self, sight: LineOfSight) -> Atmosphere | None:
        """The atmosphere in the middle of a frame."""
        return self._air(self._carrier.observer, self._carrier.tai_ns(sight.reference_s))

    def _check_field(self, duration_s: float) -> None:
        """Refuse the Earth and the horizon in the field at 17 times of the run; set the seeing of a site to its mean."""
        seeing_px = []
        for time_s in np.linspace(0.0, duration_s, 17):
            tai_ns = self._carrier.tai_ns(float(time_s))
            air, boresight = self._air(self._carrier.observer, tai_ns), self._carrier.attitude(tai_ns)[2]
            if air is None:
                self._carrier.refuse_earth(tai_ns, self._camera.radius_rad)
            else:
                air.refuse_low(boresight)
                seeing_px.append(self._camera.projection.focal_px * air.seeing_sigma_rad(boresight))
        if seeing_px:
            self._camera.seeing_px = float(np.mean(seeing_px))
            self._camera.seeing_error = self.options.atmosphere.seeing_error

    # ------------------------------------------------------------- the scene

    def _sky_rate_e_s(self, directions: Array, air: Atmosphere | None) -> Array:
        """Diffuse light on axis in directions (n, 3): electrons per detector pixel and second."""
        flux = diffuse_flux(self.options.sky, directions, earth.sun_position_km(self._epoch))
        if air is not None:
            flux = flux * air.transmission(directions) + air.glow_flux(directions)
        return np.asarray(flux * self._camera.surface_rate_e_s)

    def _diffuse(self, sight: LineOfSight, index: int) -> NDArray[np.float32]:
        """An image of sky and stray light."""
        camera, shape = self._camera.at(sight.reference_s), self._camera.shape
        row, col = np.meshgrid(*(np.linspace(0.0, n - 1.0, SKY_GRID) for n in shape), indexing="ij")
        directions = camera.projection.to_vectors(row.ravel(), col.ravel()) @ sight.reference
        rate_e_s = self._sky_rate_e_s(directions, self._air_of(sight)).reshape(SKY_GRID, SKY_GRID)
        image_e = np.empty(shape, dtype=np.float32)
        stray_e = camera.instrument.stray_light_e_px_s * camera.exposure_s
        grid_e = (rate_e_s * camera.exposure_s).astype(np.float32)
        fill_diffuse(image_e, *camera.illumination, grid_e, stray_e, camera.instrument.stray_gradient)
        return image_e

    def _add_stars(self, image_e: NDArray[np.float32], sight: LineOfSight, shutter: RowShutter, index: int) -> NDArray[np.void]:
        """Add the stars to the image; their truth."""
        if not self.options.stars.enabled:
            return truth.empty("stars")
        camera, air = self._camera.at(sight.reference_s), self._air_of(sight)
        velocity = np.zeros(3)
        if self.options.light.annual_aberration:
            velocity = velocity + earth.earth_velocity_km_s(self._carrier.tai_ns(sight.reference_s))
        if self.options.light.orbital_aberration:
            velocity = velocity + sight.middle_velocity_km_s
        swing_rad = float(np.ptp(sight.turn_rad, axis=0).max())
        margin_rad = 1.5 * STAR_MARGIN_PX / camera.projection.focal_px
        radius_deg = float(np.degrees(camera.radius_rad + swing_rad + margin_rad))
        field = self._stars.around(camera.direction(0.0, 0.0) @ sight.reference, radius_deg)
        places = place_stars(field, sight, velocity, camera.projection, shutter, STAR_MARGIN_PX, air)
        row, col = places.row.mean(axis=0), places.col.mean(axis=0)
        sigma_px = np.sqrt(camera.sigma_at(row, col) ** 2 + places.spread_px2)
        flux_e = field.flux_e_s[places.index] * shutter.exposure_s * places.exposed * camera.illumination_at(row, col)
        if air is not None:
            flux_e *= air.transmission(field.direction[places.index])
            aperture_m = camera.instrument.aperture_m
            flux_e *= air.flicker(len(flux_e), sight.reference[2], aperture_m, shutter.exposure_s, self.seed, index)
        expose_stars(image_e, places, flux_e, sigma_px, camera)
        return star_rows(self._camera, field, places, flux_e, sigma_px, float(image_e[::64, ::64].mean()), index)

    def _paths(self, sight: LineOfSight, index: int, wanted: Iterable[int]) -> list[tuple[int, Path]]:
        """Paths of those wanted objects that come near the field in a frame."""
        sun_km = earth.sun_position_km(self._carrier.tai_ns(sight.reference_s))
        first_open_s = index / self.options.frame_rate_hz
        to_middle_s = 0.5e-9 * self._carrier.timing(index, delivered=False).line_time_ns * (self._camera.shape[0] - 1)
        air, light, camera = self._air_of(sight), self.options.light, self._camera.at(sight.reference_s)
        paths = []
        for object_id in wanted:
            thing = self._cast.objects[object_id]
            path: Path | None
            unsteady = self._turbulence(air, sight, index, object_id)
            if isinstance(thing, PixelPathObject):
                start_s = (first_open_s if thing.restart else 0.0) + (to_middle_s if thing.from_middle_row else 0.0)
                path = pixel_path_of(thing, sight, camera, start_s, light, unsteady)
            else:
                path = sky_path_of(thing, sight, camera, sun_km, light, air, unsteady)
            if path is not None:
                paths.append((object_id, path))
        return paths

    def _turbulence(self, air: Atmosphere | None, sight: LineOfSight, index: int, object_id: int) -> Unsteadiness | None:
        """Scintillation and image motion of one object while the rows of one frame are open."""
        if air is None:
            return None
        rng = generator(self.seed, Effect.TURBULENCE, index, object_id)
        span = float(sight.node_s[0]), float(sight.node_s[-1])
        return air.unsteadiness(sight.reference[2], self._camera.instrument.aperture_m, *span, rng)

    # -------------------------------------------------------------- the run

    def camera(self) -> NominalCamera:
        """The camera as ground and on-board software believe it to be."""
        return self._camera.nominal()

    def calibration(self) -> Calibration:
        """What on-board and ground software may know: nominal camera, and maps reduced from noisy calibration frames."""
        return self._camera.calibration()

    def objects(self) -> NDArray[np.void]:
        """Truth of all objects, with the range at which each is first seen."""
        out = truth.empty("objects", len(self._cast.objects))
        for k, thing in enumerate(self._cast.objects):
            out[k]["object_id"], out[k]["range_km"] = k, np.nan
            for name in ("name", "kind", "size_m", "albedo", "a_km", "e", "i_deg", "weight"):
                out[k][name] = getattr(thing.identity, name)
        waiting = set(range(len(out)))
        for index in range(self.n_frames):
            if not waiting:
                break
            sight, shutter = self._carrier.sight(index), self._shutter(index)
            first_s, last_s = float(sight.node_s[0]), float(sight.node_s[-1])
            for k, path in self._paths(sight, index, sorted(waiting)):
                lit = exposed_intervals(path.place, shutter, 0.5, first_s, last_s)
                if lit:
                    distance_km = path.range_km(np.array([0.5 * (lit[0].start_s + lit[0].end_s)]))[0]
                    out[k]["range_km"] = distance_km if np.isfinite(distance_km) else np.nan
                    waiting.discard(k)
        return out

    def population_summary(self) -> dict[str, Any]:
        """Encounters of nature against those drawn, for each size class; JSON-able."""
        return summary(self.options.population, self._cast)
