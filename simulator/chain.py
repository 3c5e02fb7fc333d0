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

from collections.abc import Iterable
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
from simulator.mount import carrier_of
from simulator.options import SimulatorOptions
from simulator.platform import earth
from simulator.platform.line_of_sight import LineOfSight
from simulator.platform.observer import SiteObserver, make_observer
from simulator.radiation.arrival import field_lines
from simulator.radiation.field import ParticleField
from simulator.radiation.hits import HitList
from simulator.scene.aberration import observer_velocity_km_s
from simulator.scene.atmosphere import Atmosphere, clouds_of, seeing_sigma_rad
from simulator.scene.backdrop import Backdrop, add_moon, backdrop_of, diffuse_image
from simulator.scene.cast import lasting_objects, make_cast, summary, target_direction
from simulator.scene.cirrus import make_cirrus
from simulator.scene.crossing import RowShutter, row_shutter
from simulator.scene.movers import first_seen_km, paths_of
from simulator.scene.point_sources import PointSources
from simulator.scene.sources import OrbitOptions
from simulator.scene.trail_image import Path, add_trail
from simulator.sensor.lag import LagBetweenFrames
from simulator.sensor.smear import add_smear
from simulator.starlight import STAR_MARGIN_PX, Points, add_stars
from simulator.truth_rows import cosmic_rows, frame_row, object_rows

Array = NDArray[np.float64]


class Simulator:
    """A simulated camera in its world. UserError for options that contradict each other or the laws of nature."""

    def __init__(self, options: SimulatorOptions, *, seed: int, catalogue: StarCatalogue) -> None:
        options = with_drawn_errors(options, seed)
        options.refuse_bad_timing()
        shutter = options.shutter
        if options.sensor.type == "ccd":  # all rows are exposed at once; the line time is that of the store's read-out
            shutter = replace(shutter, line_time_us=0.0)
        self.options = options
        self.seed = seed
        self.n_frames = options.frames
        self._epoch = epoch = earth.tai_ns_of_utc(options.epoch_utc)
        self._duration_s = duration_s = options.frames / options.frame_rate_hz
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
        self._points = PointSources(
            options.stars, options.sky, options.instrument, catalogue, seed=seed, epoch_jyear=earth.jyear(epoch)
        )
        self._cirrus = make_cirrus(options.sky.structure, seed)
        self._lag = LagBetweenFrames(options.sensor)
        middle = self._carrier.attitude(epoch + round(0.5e9 * duration_s))[2]
        sky_e_s = float(self._backdrop(epoch).surface_flux(middle[None], self._camera)[0] * self._camera.surface_rate_e_s)
        self._cast = make_cast(
            options.objects, options.population, self._carrier, self._camera, options.light, sky_e_s, duration_s
        )

    def lasting_objects(self) -> tuple[OrbitOptions, ...]:
        """Objects that pass or are given by elements, as orbits under all forces that runs of other days can meet."""
        return lasting_objects(self.options.objects, self._carrier, self._camera, self._duration_s)

    def frame(self, index: int) -> tuple[Frame, truth.FrameTruth]:
        """Frame number `index` and its truth."""
        if not 0 <= index < self.n_frames:
            raise UserError(f"frame {index}: allowed are 0 to {self.n_frames - 1}")
        sight = self._carrier.sight(index)
        image_e, sky_e, entropy_bits, stars, streaks = self._expose(sight, index)
        hits = self._hits(index)
        self._camera.sensor.overflow(image_e)
        self._lag.show(image_e, hits, index, self._light_and_hits)
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
        shutter, camera = self._shutter(index), self._camera.at(sight.reference_s)
        backdrop = self._backdrop(self._carrier.tai_ns(sight.reference_s))
        image_e = diffuse_image(backdrop, sight, camera)
        sky_e = float(image_e[::16].mean(dtype=np.float64))
        velocity = observer_velocity_km_s(self.options.light, self._carrier.tai_ns(sight.reference_s), sight.middle_velocity_km_s)
        add_moon(image_e, backdrop, sight, camera, velocity)
        stars = self._add_stars(image_e, sight, shutter, backdrop, velocity, index)
        entropy_bits = self._camera.sensor.entropy_bits(image_e, self._camera.exposure_s, every=16)
        streaks = [truth.empty("streaks")]
        for object_id, path in self._paths(sight, index, range(len(self._cast.objects))):
            trail = add_trail(image_e, path, sight, shutter, camera, epoch_tai_ns=self._epoch)
            trail["frame"], trail["object_id"] = index, object_id
            streaks.append(trail)
        sensor = self.options.sensor
        if sensor.type == "ccd" and sensor.ccd.row_transfer_us > 0.0:
            add_smear(image_e, sensor.ccd.row_transfer_us * 1e-6, self._camera.exposure_s)
        return image_e, sky_e, entropy_bits, stars, np.concatenate(streaks)

    def _hits(self, index: int) -> HitList:
        """Particles through the detector in a frame."""
        middle = self._carrier.timing(index, delivered=True).middle_tai_ns
        fixed = self._carrier.earth_fixed(middle)
        lines = field_lines(*fixed) if fixed else None
        return self._particles.hits(index, self._camera.exposure_s, self._carrier.geodetic(middle), lines)

    def _light_and_hits(self, index: int) -> tuple[NDArray[np.float32], HitList]:
        """Charge of a frame that is exposed only for what it leaves behind."""
        image_e = self.mean_electrons(index)
        self._camera.sensor.overflow(image_e)
        return image_e, self._hits(index)

    def _shutter(self, index: int) -> RowShutter:
        """When the rows of the window are open."""
        timing = self._carrier.timing(index, delivered=False)
        return row_shutter(timing, self._epoch, self._camera.exposure_s, self._camera.shape)

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
        """Refuse the horizon of a site in the field at 17 times of the run; set the seeing of a site to its mean."""
        times = [self._carrier.tai_ns(float(t)) for t in np.linspace(0.0, duration_s, 17)]
        airs = [(self._air(self._carrier.observer, t), self._carrier.attitude(t)[2]) for t in times]
        sigma_rad = [seeing_sigma_rad(air, boresight) for air, boresight in airs if air is not None]
        if sigma_rad:
            self._camera.seeing_px = float(np.mean(self._camera.projection.focal_px * np.array(sigma_rad)))
            self._camera.seeing_error = self.options.atmosphere.seeing_error

    def _backdrop(self, tai_ns: int) -> Backdrop:
        """Sky, Moon, planets and Earth at an instant; the zodiacal light is that of the epoch."""
        observer = self._carrier.observer
        place = observer.state(tai_ns)[0]
        return backdrop_of(
            self.options.sky, tai_ns, earth.sun_position_km(self._epoch), place, self._air(observer, tai_ns), self._cirrus
        )

    def _add_stars(
        self,
        image_e: NDArray[np.float32],
        sight: LineOfSight,
        shutter: RowShutter,
        backdrop: Backdrop,
        velocity_km_s: Array,
        index: int,
    ) -> NDArray[np.void]:
        """Add stars, asteroids and planets to the image; their truth."""
        if not self.options.stars.enabled:
            return truth.empty("stars")
        camera = self._camera.at(sight.reference_s)
        swing_rad = float(np.ptp(sight.turn_rad, axis=0).max())
        radius_rad = camera.radius_rad + swing_rad + 1.5 * STAR_MARGIN_PX / camera.projection.focal_px
        centre = camera.direction(0.0, 0.0) @ sight.reference
        points = Points(
            listed=self._points.listed(centre, radius_rad, self._carrier.tai_ns(sight.reference_s), backdrop.observer_km),
            nebulae=self._points.nebulae(centre, radius_rad),
            planets=backdrop.planets_near(centre, radius_rad),
        )
        return add_stars(image_e, points, backdrop, sight, velocity_km_s, shutter, camera, (self.seed, index))

    def _paths(self, sight: LineOfSight, index: int, wanted: Iterable[int]) -> list[tuple[int, Path]]:
        """Paths of those wanted objects that come near the field in a frame."""
        first_open_s = index / self.options.frame_rate_hz
        middle_s = 0.5e-9 * self._carrier.timing(index, delivered=False).line_time_ns * (self._camera.shape[0] - 1)
        sun_km = earth.sun_position_km(self._carrier.tai_ns(sight.reference_s))
        camera, air = self._camera.at(sight.reference_s), self._air_of(sight)
        things = [(k, self._cast.objects[k]) for k in wanted]
        return paths_of(things, sight, camera, sun_km, self.options.light, air, (first_open_s, middle_s), (self.seed, index))

    def camera(self) -> NominalCamera:
        """The camera as ground and on-board software believe it to be."""
        return self._camera.nominal()

    def calibration(self) -> Calibration:
        """What on-board and ground software may know: nominal camera, and maps reduced from noisy calibration frames."""
        return self._camera.calibration()

    def objects(self) -> NDArray[np.void]:
        """Truth of all objects, with the range at which each is first seen."""

        def seen(index: int, waiting: list[int]) -> dict[int, float]:
            sight = self._carrier.sight(index)
            return first_seen_km(self._paths(sight, index, waiting), self._shutter(index), sight)

        return object_rows(self._cast.objects, self.n_frames, seen)

    def population_summary(self) -> dict[str, Any]:
        """Encounters of nature against those drawn, for each size class; JSON-able."""
        return summary(self.options.population, self._cast)
