"""The simulator, read aloud. This is the only module that knows the order of effects:

    platform    where the camera is and looks at each instant; what clock, GPS and star tracker say of it
    scene       which stars, sky and objects shine there: aberration, light time, shadow, phase
    projection  gnomonic with distortion, in one coordinate module
    brightness  magnitudes and colours to electrons, zodiacal and stray light
    atmosphere  (ground sites) refraction, extinction, seeing, scintillation, clouds, sky glow
    motion      pointing, jitter and relative motion; each row at its own epoch
    exposure    stars and trails through PSF, defocus and vignetting into mean photo-electrons
    radiation   particle tracks as charge
    sensor      shot noise, dark current, fixed pattern, reset and read noise, full well, conversion, binning
    telemetry   header with time tags, attitude and orbit, each with its error; truth beside it

Any frame can be made alone, by any process, with the same bytes.
"""

from collections.abc import Callable, Iterable, Iterator
from typing import Any

import erfa
import numpy as np
from numpy.typing import NDArray
from sgp4.api import SGP4_ERRORS

from sboc_e2e import truth
from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.icd.errors import UserError
from sboc_e2e.icd.frame import Calibration, Frame, FrameHeader, NominalCamera
from simulator.exposure import render_stars
from simulator.optics.instrument import SUN_B_V, band_factor
from simulator.optics.psf import sigma_at
from simulator.optics.vignetting import relative_illumination
from simulator.options import SimulatorOptions
from simulator.platform import earth
from simulator.platform.jitter import make_jitter
from simulator.platform.line_of_sight import LineOfSight, line_of_sight
from simulator.platform.observer import SiteObserver, make_observer
from simulator.platform.pointing import commanded_attitude
from simulator.platform.rotation import quaternion_of
from simulator.platform.shutter import FrameTiming, frame_timing
from simulator.platform.telemetry import attitude_estimate, observer_state
from simulator.radiation.field import ParticleField
from simulator.scene import sources
from simulator.scene.aberration import aberrate
from simulator.scene.atmosphere import Atmosphere
from simulator.scene.crossing import RowShutter, exposed_intervals
from simulator.scene.encounters import Window, draw_encounters
from simulator.scene.objects import PixelPathObject, SkyObject
from simulator.scene.prediction import predict_crossings
from simulator.scene.satellites import SatelliteOptions, read_satellites, satellite_object
from simulator.scene.sky import SKY_GRID, fill_diffuse, surface_brightness_flux, unresolved_s10, zodiacal_s10
from simulator.scene.star_image import place_stars
from simulator.scene.stars import StarField, StarSky, angles_deg
from simulator.scene.trail_image import FocalPlane, Path, add_trail, pixel_path_of, sky_path_of
from simulator.sensor import Sensor

Array = NDArray[np.float64]

STAR_TRUTH_SNR = 5.0
"""Stars above this matched-filter S/N are in the truth table; the fainter ones are in the image only."""


class Simulator:
    """A simulated camera in its world, at the epoch of its options."""

    def __init__(self, options: SimulatorOptions, *, seed: int, catalogue: StarCatalogue) -> None:
        if options.shutter.exposure_s * options.frame_rate_hz > 1.0 + 1e-9:
            raise UserError(
                f"shutter.exposure: {options.shutter.exposure_s:g} s does not fit {options.frame_rate_hz:g} frames/s; "
                f"allowed is up to {1.0 / options.frame_rate_hz:g} s"
            )
        self.options = options
        self.seed = seed
        self.n_frames = options.frames
        self._epoch = earth.tai_ns_of_utc(options.epoch_utc)
        self._set_up_camera()
        self._set_up_platform()
        self._sky = StarSky(options.stars, options.instrument, catalogue, seed=seed, epoch_jyear=earth.jyear(self._epoch))
        self._objects = self._make_objects()

    # ---------------------------------------------------------------- set-up

    def _set_up_camera(self) -> None:
        """Geometry of the read-out window, sensor, illumination."""
        options, camera = self.options, self.options.instrument
        self._sensor = Sensor(options.sensor, rows=camera.rows, cols=camera.cols, seed=self.seed)
        window, self._binning = options.sensor.window, options.sensor.binning
        self._shape = self._sensor.window_shape
        whole = camera.true_projection()
        self._projection = whole.delivered(bin_rows=1, bin_cols=1, window_row0=window.row0, window_col0=window.col0)
        self._corner_px = 0.5 * float(np.hypot(camera.rows, camera.cols))
        self._psf_scale = 1.0 + camera.as_built.psf_width
        rows, cols = np.arange(self._shape[0])[:, None], np.arange(self._shape[1])[None, :]
        self._illumination = np.empty(self._shape, dtype=np.float32)
        for first in range(0, self._shape[0], 256):
            block = slice(first, first + 256)
            self._illumination[block] = self._illumination_at(rows[block], cols)
        self._scratch_e = np.zeros(self._shape, dtype=np.float32)
        self._particles = ParticleField(
            options.radiation,
            rows=camera.rows,
            cols=camera.cols,
            pitch_um=camera.pixel_um,
            seed=self.seed,
            epoch_jyear=earth.jyear(self._epoch),
        )

    def _set_up_platform(self) -> None:
        options = self.options
        self._observer = make_observer(options.platform, self._epoch)
        self._jitter = make_jitter(options.jitter, self.seed)
        target = self._target_direction() if options.pointing.law == "object" else None
        self._attitude = commanded_attitude(options.pointing, self._observer, self._epoch, target)
        for tai_ns in (self._epoch, self._epoch + round(options.frames / options.frame_rate_hz * 1e9)):
            self._refuse_earth(tai_ns)
        air = self._air(self._epoch)
        self._seeing_px = 0.0 if air is None else self._projection.focal_px * air.seeing_sigma_rad(self._attitude(self._epoch)[2])

    def _target_direction(self) -> Callable[[int], Array]:
        """Apparent direction of the object that the pointing follows, by its name."""
        name, given = self.options.pointing.target, self.options.objects
        found: list[SkyObject] = [sources.orbiting(o) for o in given.orbit if o.name == name]
        found.extend(sources.sky_path(o) for o in given.sky_path if o.name == name)
        if not found and given.satellites.file:
            read = read_satellites(given.satellites.file, (name,))
            found.extend(satellite_object(s, given.satellites, self._epoch) for s in read)
        if not found:
            raise UserError(
                f"pointing.target: no object named {name!r}; allowed are objects.orbit, objects.sky_path, objects.satellites"
            )

        def direction(tai_ns: int) -> Array:
            position, velocity = self._observer.state(tai_ns)
            time_s = np.array([(tai_ns - self._epoch) * 1e-9])
            vector = found[0].seen(time_s, position[None], earth.sun_position_km(tai_ns)).vector_km
            apparent = aberrate(vector / np.linalg.norm(vector), velocity)
            air = self._air(tai_ns)
            return (apparent if air is None else air.refracted(apparent, np.linalg.norm(vector, axis=1)))[0]

        return direction

    def _air(self, tai_ns: int) -> Atmosphere | None:
        """The atmosphere above a site; None in orbit."""
        if not isinstance(self._observer, SiteObserver):
            return None
        return Atmosphere(options=self.options.atmosphere, up=self._observer.up(tai_ns), height_m=self._observer.site.height_m)

    def _refuse_earth(self, tai_ns: int) -> None:
        """UserError when the Earth, or the horizon of a site, reaches into the field."""
        boresight, air = self._attitude(tai_ns)[2], self._air(tai_ns)
        if air is not None:
            air.refuse_low(boresight)
            return
        position = self._observer.state(tai_ns)[0]
        radius = float(np.linalg.norm(position))
        limb_deg = float(np.degrees(np.arcsin(earth.EARTH_RADIUS_KM / radius)))
        from_nadir_deg = float(np.degrees(np.arccos(np.clip(-boresight @ position / radius, -1.0, 1.0))))
        needed_deg = limb_deg + float(np.degrees(np.arctan(self._corner_px / self._projection.focal_px)))
        if from_nadir_deg < needed_deg:
            raise UserError(
                f"pointing: the Earth stands in the field, {from_nadir_deg:.1f} deg from nadir; allowed is above {needed_deg:.1f}"
            )

    def _make_objects(self) -> list[SkyObject | PixelPathObject]:
        """All objects of the run in the order of the truth table: given ones first, then the population."""
        given, found = self.options.objects, []
        found.extend(sources.orbiting(o) for o in given.orbit)
        found.extend(sources.sky_path(o) for o in given.sky_path)
        found.extend(sources.pixel_path(o) for o in given.pixel_path)
        duration_s = self.options.frames / self.options.frame_rate_hz
        for o in given.passing:
            found.append(self._passing(o, o.when * duration_s))
        for e in given.encounter:
            when = self._epoch + round(e.when * duration_s * 1e9)
            found.append(
                sources.encounter(
                    e,
                    *self._observer.state(when),
                    self._attitude(when),
                    self._field_direction(e.field_row, e.field_col),
                    e.when * duration_s,
                )
            )
        found.extend(self._satellites(given.satellites, duration_s))
        middle_s = 0.5 * duration_s
        self._drawn = draw_encounters(self.options.population, self._encounter_window(middle_s, duration_s), self.seed)
        population = self.options.population
        found.extend(sources.population_objects(self._drawn, population.albedo, middle_s, population.tumbling_share, self.seed))
        return found

    def _field_direction(self, field_row: float, field_col: float) -> Array:
        """Direction in the camera frame of a place of the field, -1 to 1 along each axis."""
        row = 0.5 * (self._shape[0] - 1) * (1.0 + field_row)
        col = 0.5 * (self._shape[1] - 1) * (1.0 + field_col)
        return np.asarray(self._projection.to_vectors(np.array([row]), np.array([col]))[0])

    def _passing(self, options: sources.PassingOptions, time_s: float) -> SkyObject:
        """An object that passes a place of the field at a time after the epoch."""
        when = self._epoch + round(time_s * 1e9)
        camera = self._field_direction(options.field_row, options.field_col)
        return sources.passing(options, self._observer.state(when)[0], self._attitude(when).T @ camera, time_s)

    def _satellites(self, options: SatelliteOptions, duration_s: float) -> list[SkyObject]:
        """Catalogued satellites that cross the field during the run, each once."""
        self._refused: dict[str, int] = {}
        if not options.file:
            return []
        predicted = predict_crossings(
            read_satellites(options.file, options.names),
            self._observer,
            self._attitude,
            self._projection,
            self._shape,
            self._epoch,
            0.0,
            duration_s,
            options.farthest_km,
        )
        self._refused = predicted.refused
        if options.names and self._refused:
            name, code = next(iter(self._refused.items()))
            raise UserError(f"satellite {name!r} of {options.file}: refused by SGP4 ({SGP4_ERRORS.get(code, code)})")
        once = {id(c.satellite): c.satellite for c in predicted.crossings}
        return [satellite_object(s, options, self._epoch) for s in once.values()]

    def _encounter_window(self, middle_s: float, duration_s: float) -> Window:
        """What the camera sees during the run, for drawing encounters."""
        middle = self._epoch + round(middle_s * 1e9)
        position, velocity = self._observer.state(middle)
        camera, shutter = self.options.instrument, self.options.shutter
        sky_e = self._sky_rate_e_s(self._attitude(middle)[2][None])[0] * shutter.exposure_s
        return Window(
            observer_km=position,
            velocity_km_s=velocity,
            attitude=self._attitude(middle),
            sun_km=earth.sun_position_km(middle),
            half_row=0.5 * self._shape[0] / self._projection.focal_px,
            half_col=0.5 * self._shape[1] / self._projection.focal_px,
            duration_s=duration_s,
            exposure_s=shutter.exposure_s,
            flux_e_s=camera.true_zero_point_e_s,
            focal_px=self._projection.focal_px,
            sigma_px=self.options.psf.sigma_px * self._psf_scale,
            noise_variance_e2=float(self._sensor.variance_e2(float(sky_e), shutter.exposure_s)),
            aperture_m=camera.aperture_m,
        )

    # ------------------------------------------------------------ the camera

    def _illumination_at(self, row: Array, col: Array) -> Array:
        """Relative illumination at positions of the read-out window."""
        return relative_illumination(
            self.options.vignetting,
            row,
            col,
            center_row=self._projection.center_row,
            center_col=self._projection.center_col,
            corner_radius_px=self._corner_px,
            focal_px=self._projection.focal_px,
        )

    def _sigma_at(self, row: Array, col: Array) -> Array:
        """PSF sigma of the built camera at positions of the read-out window."""
        nominal = sigma_at(
            self.options.psf,
            row,
            col,
            center_row=self._projection.center_row,
            center_col=self._projection.center_col,
            corner_radius_px=self._corner_px,
        )
        return np.asarray(np.hypot(nominal * self._psf_scale, self._seeing_px))

    def _sky_rate_e_s(self, directions: Array) -> Array:
        """Diffuse light on axis in directions (n, 3): electrons per detector pixel and second."""
        sky = self.options.sky
        sun = earth.sun_position_km(self._epoch)
        s10 = sky.zodiacal * zodiacal_s10(directions, sun / np.linalg.norm(sun)) + sky.unresolved * unresolved_s10(directions)
        return np.asarray(surface_brightness_flux(s10) * self._flux_to_rate_e_s())

    def _flux_to_rate_e_s(self) -> float:
        """Electrons per detector pixel and second of a surface brightness of one V = 0 star per square arcsecond."""
        pixel_arcsec2 = (np.degrees(1.0 / self._projection.focal_px) * 3600.0) ** 2
        return float(self.options.instrument.true_zero_point_e_s * pixel_arcsec2)

    def _plane(self) -> FocalPlane:
        camera, exposure_s = self.options.instrument, self.options.shutter.exposure_s
        delivered, pedestal = self._sensor.delivered, self.options.sensor.converter.pedestal_adu
        return FocalPlane(
            shape=self._shape,
            bin_rows=self._binning.rows,
            bin_cols=self._binning.cols,
            zero_point_e_s=camera.true_zero_point_e_s,
            sigma_px=self._sigma_at,
            illumination=self._illumination_at,
            variance_e2=lambda image_e, row0, col0: self._sensor.variance_e2(image_e, exposure_s, row0=row0, col0=col0),
            saturation_e=(delivered.saturation_adu - pedestal) * self.options.sensor.converter.gain_e_adu,
            focal_px=self._projection.focal_px,
            aperture_m=camera.aperture_m,
            obstruction=camera.obstruction,
        )

    def camera(self) -> NominalCamera:
        """The camera as ground and on-board software believe it to be, in delivered pixels."""
        nominal = self.options.instrument
        window, binning = self.options.sensor.window, self._binning
        geometry = nominal.nominal_projection().delivered(
            bin_rows=binning.rows, bin_cols=binning.cols, window_row0=window.row0, window_col0=window.col0
        )
        delivered = self._sensor.delivered
        colours = np.linspace(0.2, 1.2, 11)
        factor = band_factor(colours, nominal.band_short_nm, nominal.band_long_nm)
        return NominalCamera(
            name=nominal.name,
            rows=delivered.rows,
            cols=delivered.cols,
            focal_px=geometry.focal_px,
            center_row=geometry.center_row,
            center_col=geometry.center_col,
            k1=geometry.k1,
            k2=geometry.k2,
            p1=geometry.p1,
            p2=geometry.p2,
            psf_sigma_px=self.options.psf.sigma_px / binning.cols,
            gain_e_adu=delivered.gain_e_adu,
            read_noise_e=delivered.read_noise_e,
            saturation_adu=delivered.saturation_adu,
            full_well_e=delivered.full_well_e,
            zero_point_e_s=nominal.zero_point_e_s,
            colour_term=float(np.polyfit(colours - SUN_B_V, -2.5 * np.log10(factor), 1)[0]),
            aperture_m=nominal.aperture_m,
            obstruction=nominal.obstruction,
        )

    def calibration(self) -> Calibration:
        """Nominal camera, and dark, flat and defects reduced from noisy calibration frames."""
        maps = self._sensor.calibration_maps(self.options.shutter.exposure_s, self._illumination)
        calibration = self.options.sensor.calibration
        return Calibration(
            camera=self.camera(),
            dark_adu=maps.dark_adu,
            flat=maps.flat,
            defects=maps.defects,
            provenance=f"simulated calibration: {calibration.dark_frames} dark and {calibration.flat_frames} flat frames",
        )

    # ------------------------------------------------------------- one frame

    def frame(self, index: int) -> tuple[Frame, truth.FrameTruth]:
        """Frame number `index` and its truth."""
        if not 0 <= index < self.n_frames:
            raise UserError(f"frame {index}: allowed are 0 to {self.n_frames - 1}")
        delivered_timing, timing = self._timing(index)
        exposure_s = self.options.shutter.exposure_s
        shutter, sight = self._shutter(timing), self._sight(timing)
        image_e, sky_e = self._diffuse(sight, exposure_s, index)
        stars = self._add_stars(image_e, sight, shutter, index)
        entropy = self._sensor.entropy_bits(image_e[::16], exposure_s)
        streaks = self._add_objects(image_e, sight, shutter, index)
        hits = self._particles.hits(index, exposure_s, self._geodetic(timing.middle_tai_ns))
        pixels = self._sensor.digitise(image_e, index, exposure_s, hits)
        header = self._header(delivered_timing, sight, index)
        cosmics = truth.empty("cosmics", len(hits.tracks))
        cosmics["frame"] = index
        for name in hits.tracks.dtype.names or ():
            cosmics[name] = hits.tracks[name]
        self._to_delivered(cosmics, "row0", "col0")
        self._to_delivered(cosmics, "row1", "col1")
        summary = self._frame_truth(delivered_timing, sight, index, sky_e)
        summary["entropy_bits"], summary["n_cosmics"] = entropy, len(cosmics)
        made = truth.FrameTruth(frame=summary, stars=stars, streaks=streaks, cosmics=cosmics)
        return Frame(header=header, pixels=pixels), made

    def _timing(self, index: int) -> tuple[FrameTiming, FrameTiming]:
        """Times of the delivered rows, and of the detector rows of the window."""
        options = self.options
        common = {"seed": self.seed, "epoch_tai_ns": self._epoch, "frame": index, "frame_rate_hz": options.frame_rate_hz}
        delivered = frame_timing(
            options.shutter, options.clock, rows=self._shape[0] // self._binning.rows, row_step=self._binning.rows, **common
        )
        detector = frame_timing(options.shutter, options.clock, rows=self._shape[0], row_step=1, **common)
        return delivered, detector

    def _shutter(self, timing: FrameTiming) -> RowShutter:
        """When the rows of the window are open."""
        return RowShutter(
            open_s=(timing.t_start_tai_ns - self._epoch) * 1e-9,
            line_s=timing.line_time_ns * 1e-9,
            exposure_s=self.options.shutter.exposure_s,
            rows=self._shape[0],
            cols=self._shape[1],
        )

    def _sight(self, timing: FrameTiming) -> LineOfSight:
        """How the camera moves during a frame."""
        return line_of_sight(timing, self._epoch, self._observer, self._attitude, self._jitter)

    def _paths(self, sight: LineOfSight, index: int, wanted: Iterable[int]) -> Iterator[tuple[int, Path]]:
        """Paths of the wanted objects through a frame."""
        sun_km = earth.sun_position_km(self._epoch + round(sight.reference_s * 1e9))
        first_open_s = index / self.options.frame_rate_hz
        air = self._air_of(sight)
        for object_id in wanted:
            thing = self._objects[object_id]
            if isinstance(thing, PixelPathObject):
                zero_s = first_open_s if thing.restart else 0.0
                yield object_id, pixel_path_of(thing, sight, self._projection, self._binning.rows, self._binning.cols, zero_s)
            else:
                yield (
                    object_id,
                    sky_path_of(thing, sight, self._projection, sun_km, air, self._dimming(air, sight, index, object_id)),
                )

    def _air_of(self, sight: LineOfSight) -> Atmosphere | None:
        """The atmosphere in the middle of a frame."""
        return self._air(self._epoch + round(sight.reference_s * 1e9))

    def _dimming(self, air: Atmosphere | None, sight: LineOfSight, index: int, object_id: int) -> float:
        """What extinction, clouds and scintillation leave of an object's flux in one frame."""
        if air is None:
            return 1.0
        boresight = sight.reference[2]
        flicker = air.flicker(
            1, boresight, self.options.instrument.aperture_m, self.options.shutter.exposure_s, self.seed, index, 1 + object_id
        )
        return float(flicker[0] * air.transmission(boresight[None], self.seed, index)[0])

    def _diffuse(self, sight: LineOfSight, exposure_s: float, index: int) -> tuple[NDArray[np.float32], float]:
        """An image of sky and stray light, and the mean sky per detector pixel."""
        nodes_row = np.linspace(0.0, self._shape[0] - 1.0, SKY_GRID)
        nodes_col = np.linspace(0.0, self._shape[1] - 1.0, SKY_GRID)
        row, col = np.meshgrid(nodes_row, nodes_col, indexing="ij")
        directions = self._projection.to_vectors(row.ravel(), col.ravel()) @ sight.reference
        rate_e_s = self._sky_rate_e_s(directions)
        air = self._air_of(sight)
        if air is not None:
            rate_e_s = rate_e_s * air.transmission(directions, self.seed, index)
            rate_e_s = rate_e_s + air.glow_flux(directions) * self._flux_to_rate_e_s()
        grid_e = (rate_e_s * exposure_s).reshape(SKY_GRID, SKY_GRID).astype(np.float32)
        image_e = np.empty(self._shape, dtype=np.float32)
        camera = self.options.instrument
        fill_diffuse(image_e, self._illumination, grid_e, camera.stray_light_e_px_s * exposure_s, camera.stray_gradient)
        return image_e, float(image_e[::16].mean(dtype=np.float64))

    def _add_stars(self, image_e: NDArray[np.float32], sight: LineOfSight, shutter: RowShutter, index: int) -> NDArray[np.void]:
        """Add the stars to the image; the truth of those above `STAR_TRUTH_SNR`."""
        if not self.options.stars.enabled:
            return truth.empty("stars")
        middle = self._epoch + round(sight.reference_s * 1e9)
        velocity = earth.earth_velocity_km_s(middle) + sight.velocity_km_s[len(sight.velocity_km_s) // 2]
        corners = self._projection.to_vectors(
            np.array([0.0, 0.0, shutter.rows, shutter.rows]), np.array([0.0, shutter.cols, 0.0, shutter.cols])
        )
        centre = self._projection.to_vectors(np.array([0.5 * shutter.rows]), np.array([0.5 * shutter.cols]))[0]
        radius_deg = float(np.degrees(np.arccos(np.clip((corners @ centre).min(), -1.0, 1.0)))) + 0.1
        swing_deg = float(np.degrees(np.ptp(sight.turn_rad, axis=0).max()))
        field: StarField = self._sky.around(centre @ sight.reference, radius_deg + swing_deg)
        air = self._air_of(sight)
        places = place_stars(field, sight, velocity, self._projection, shutter, 40.0, air)
        row, col = places.row.mean(axis=0), places.col.mean(axis=0)
        sigma = np.sqrt(self._sigma_at(row, col) ** 2 + places.spread_px2)
        flux_e = field.flux_e_s[places.index] * shutter.exposure_s * self._illumination_at(row, col)
        if air is not None:
            flux_e *= air.transmission(field.direction[places.index], self.seed, index)
            aperture_m = self.options.instrument.aperture_m
            flux_e *= air.flicker(len(flux_e), sight.reference[2], aperture_m, shutter.exposure_s, self.seed, index)
        substeps = len(places.row)
        for k in range(substeps):
            render_stars(image_e, places.row[k], places.col[k], flux_e / substeps, sigma)
        noise_e = np.sqrt(float(self._sensor.variance_e2(float(image_e[::64, ::64].mean()), shutter.exposure_s)))
        length = np.hypot(np.ptp(places.row, axis=0), np.ptp(places.col, axis=0))
        width = 2.0 * np.sqrt(np.pi) * sigma
        known = flux_e > STAR_TRUTH_SNR * noise_e * np.sqrt(width * (width + length))
        known &= (row > -0.5) & (row < shutter.rows - 0.5) & (col > -0.5) & (col < shutter.cols - 0.5)
        out = truth.empty("stars", int(known.sum()))
        out["frame"] = index
        out["star_id"] = field.star_id[places.index[known]]
        out["row"], out["col"], out["flux_e"] = row[known], col[known], flux_e[known]
        out["v_mag"], out["b_v"] = field.v_mag[places.index[known]], field.b_v[places.index[known]]
        self._to_delivered(out, "row", "col")
        return out

    def _add_objects(self, image_e: NDArray[np.float32], sight: LineOfSight, shutter: RowShutter, index: int) -> NDArray[np.void]:
        """Add all movers; their truth."""
        plane = self._plane()
        rows = [truth.empty("streaks")]
        for object_id, path in self._paths(sight, index, range(len(self._objects))):
            rows.append(
                add_trail(
                    image_e,
                    self._scratch_e,
                    path,
                    sight,
                    shutter,
                    plane,
                    frame=index,
                    object_id=object_id,
                    epoch_tai_ns=self._epoch,
                )  # fmt: skip - what is drawn on what, then which
            )
        return np.concatenate(rows)

    def _geodetic(self, tai_ns: int) -> tuple[float, float, float] | None:
        """Geodetic latitude and longitude (deg) and altitude (km) of an orbiting camera."""
        if self.options.platform.kind == "site":
            return None
        fixed = earth.itrs_from_gcrs(tai_ns) @ self._observer.state(tai_ns)[0]
        longitude, latitude, height_m = erfa.gc2gd(1, fixed * 1e3)
        return float(np.degrees(latitude)), float(np.degrees(longitude)), float(height_m) * 1e-3

    # ------------------------------------------------- what is said about it

    def _header(self, timing: FrameTiming, sight: LineOfSight, index: int) -> FrameHeader:
        """Telemetry that travels with the pixels."""
        delivered, options = self._sensor.delivered, self.options
        position, velocity = (v[0] for v in sight.observer_at(np.array([sight.reference_s])))
        clock_error = timing.clock_tai_ns - timing.t_start_tai_ns
        return FrameHeader(
            frame=index,
            t_start_tai_ns=timing.clock_tai_ns,
            exposure_ns=timing.exposure_ns,
            line_time_ns=timing.line_time_ns,
            rows=delivered.rows,
            cols=delivered.cols,
            bin_rows=self._binning.rows,
            bin_cols=self._binning.cols,
            window_row0=options.sensor.window.row0,
            window_col0=options.sensor.window.col0,
            gain_e_adu=delivered.gain_e_adu,
            read_noise_e=delivered.read_noise_e,
            saturation_adu=delivered.saturation_adu,
            attitude=attitude_estimate(options.telemetry, sight.reference, sight.rate_rad_s(), seed=self.seed, frame=index),
            observer=observer_state(
                options.telemetry, timing.middle_tai_ns + clock_error, position, velocity, seed=self.seed, frame=index
            ),
            temperature_k=options.sensor.temperature_k,
        )

    def _frame_truth(self, timing: FrameTiming, sight: LineOfSight, index: int, sky_e: float) -> NDArray[np.void]:
        """One row of the truth of frames."""
        out = truth.empty("frames", 1)
        exposure_s = self.options.shutter.exposure_s
        position, velocity = (v[0] for v in sight.observer_at(np.array([sight.reference_s])))
        delivered = self._sensor.delivered
        row, col = np.meshgrid(np.linspace(0, delivered.rows - 1.0, 9), np.linspace(0, delivered.cols - 1.0, 9), indexing="ij")
        row, col = row.ravel(), col.ravel()
        bins = self._binning
        vectors = self._projection.to_vectors(bins.rows * row + 0.5 * (bins.rows - 1), bins.cols * col + 0.5 * (bins.cols - 1))
        epoch_s = (timing.t_start_tai_ns - self._epoch) * 1e-9 + timing.line_time_ns * 1e-9 * row + 0.5 * exposure_s
        air = self._air_of(sight)
        seen = sight.to_gcrs(epoch_s, vectors)
        ra, dec = angles_deg(seen if air is None else air.unrefracted(seen))
        values = {
            "frame": index,
            "t_start_true_tai_ns": timing.t_start_tai_ns,
            "t_start_clock_tai_ns": timing.clock_tai_ns,
            "exposure_ns": timing.exposure_ns,
            "line_time_ns": timing.line_time_ns,
            "q_true": quaternion_of(sight.reference),
            "position_m": position * 1e3,
            "velocity_m_s": velocity * 1e3,
            "grid_row": row,
            "grid_col": col,
            "grid_ra_app_deg": ra,
            "grid_dec_app_deg": dec,
            "sky_e_px": sky_e * bins.rows * bins.cols,
            "noise_e": np.sqrt(float(self._sensor.variance_e2(sky_e, exposure_s)) * bins.rows * bins.cols),
            "zero_point_mag": 2.5 * np.log10(self.options.instrument.true_zero_point_e_s),
        }
        for name, value in values.items():
            out[name] = value
        return out

    def _to_delivered(self, table: NDArray[np.void], row: str, col: str) -> None:
        """Window pixels to delivered pixels, in place."""
        table[row] = (table[row] - 0.5 * (self._binning.rows - 1)) / self._binning.rows
        table[col] = (table[col] - 0.5 * (self._binning.cols - 1)) / self._binning.cols

    # -------------------------------------------------------------- the run

    def objects(self) -> NDArray[np.void]:
        """Truth of all objects, with the range at which each is first seen."""
        out = truth.empty("objects", len(self._objects))
        for k, thing in enumerate(self._objects):
            who = thing.identity
            out[k]["object_id"] = k
            for name in ("name", "kind", "size_m", "albedo", "a_km", "e", "i_deg", "weight"):
                out[k][name] = getattr(who, name)
            out[k]["range_km"] = np.nan
        waiting = set(range(len(self._objects)))
        for index in range(self.n_frames):
            if not waiting:
                break
            _, timing = self._timing(index)
            sight = self._sight(timing)
            for k, path in self._paths(sight, index, sorted(waiting)):
                lit = exposed_intervals(path.place, self._shutter(timing), 0.5, float(sight.node_s[0]), float(sight.node_s[-1]))
                if lit:
                    out[k]["range_km"] = path.range_km(np.array([0.5 * (lit[0].start_s + lit[0].end_s)]))[0]
                    waiting.discard(k)
        return out

    def population_summary(self) -> dict[str, Any]:
        """Encounters of nature against those drawn, for each size class; JSON-able."""
        options, drawn = self.options.population, self._drawn
        duration_s = self.options.frames / self.options.frame_rate_hz
        classes = []
        for k, size_class in enumerate(options.classes):
            natural, shown = float(drawn.natural_by_class[k]), int(drawn.drawn_by_class[k])
            classes.append(
                {
                    "from_mm": size_class.from_mm,
                    "to_mm": size_class.to_mm,
                    "drawn": shown,
                    "natural_in_run": natural,
                    "boost": shown / natural if natural > 0.0 else None,
                    "entering_per_day": float(drawn.per_day_by_class[k]),
                }
            )
        total, shown = float(drawn.natural_by_class.sum()), int(drawn.drawn_by_class.sum())
        return {
            "duration_s": duration_s,
            "snr_min": options.snr_min,
            "classes": classes,
            "natural_in_run": total,
            "drawn": shown,
            "boost": shown / total if total > 0.0 else None,
            "satellites_refused_by_sgp4": self._refused,
        }
