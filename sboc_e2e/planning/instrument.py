"""Camera and station of a scenario, as the planner takes them."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ground.planning.light import PlannedCamera
from ground.planning.schedule import Schedule
from ground.planning.sky import Orbit, Site
from sboc_e2e.icd.errors import UserError
from simulator.optics.psf import FWHM_PER_SIGMA
from simulator.options import SimulatorOptions
from simulator.platform import earth
from simulator.platform.observer import OrbitingObserver, make_observer
from simulator.platform.rotation import matrix_of_boresight
from simulator.sensor.binning import noise_factor
from simulator.sensor.maps import median_pixel
from simulator.trail_noise import PIXEL_VARIANCE_PX2

Array = NDArray[np.float64]


def planned_camera(options: SimulatorOptions, sky_mag_arcsec2: float) -> PlannedCamera:
    """Nominal values of the scenario's camera under a sky of a V surface brightness; pixels as delivered.

    A ground site adds the seeing, extinction and mean clouds of its air. UserError for a read-out window off the detector.
    """
    instrument, sensor, air = options.instrument, options.sensor, options.atmosphere
    bins = float(np.sqrt(sensor.binning.rows * sensor.binning.cols))
    scale_arcsec = float(np.degrees(instrument.pixel_um * 1e-3 / instrument.focal_length_mm)) * 3600.0 * bins
    sigma_px, zero_point_e_s = options.psf.sigma_px / bins, instrument.zero_point_e_s
    seeing_px = extinction_mag = 0.0
    if options.platform.kind == "site":
        seeing_px = air.seeing_arcsec / FWHM_PER_SIGMA / scale_arcsec
        extinction_mag = air.extinction_mag
        zero_point_e_s *= air.cloud_transmission
    side_px = min(sensor.window.shape_in(instrument.rows, instrument.cols))
    middle = window_middle(options)
    return PlannedCamera(
        zero_point_e_s=zero_point_e_s,
        exposure_s=options.shutter.exposure_s,
        period_s=1.0 / options.frame_rate_hz,
        noise_e=_noise_e(options, sky_mag_arcsec2, scale_arcsec / bins),
        sigma_px=float(np.sqrt(sigma_px**2 + PIXEL_VARIANCE_PX2)),
        scale_arcsec=scale_arcsec,
        # a pixel off the axis spans cos^2 of its angle less along the radius
        half_field_rad=0.5 * side_px * instrument.pixel_um * 1e-3 / instrument.focal_length_mm * float(middle[2] ** 2),
        extinction_mag=extinction_mag,
        seeing_sigma_px=seeing_px,
    )


def window_middle(options: SimulatorOptions) -> Array:
    """Unit vector (3,), camera frame, of the middle of what is read out; +Z where no read-out window moves it."""
    instrument = options.instrument
    row, col = options.sensor.window.offset_px_in(instrument.rows, instrument.cols)
    per_px = instrument.pixel_um * 1e-3 / instrument.focal_length_mm
    vector = np.array([per_px * col, per_px * row, 1.0])
    return np.asarray(vector / np.linalg.norm(vector))


def optical_axes(schedule: Schedule, options: SimulatorOptions) -> Schedule:
    """The schedule with the directions of the optical axis, by which a run points, in place of those of the fields' middles.

    They are one where the middle of the detector is that of the read-out window. UserError for a field that the window cannot be
    laid on: a camera that keeps its roll to north does not reach the poles with columns off its axis, and a steady roll turns
    the window away.
    """
    middle, pointing = window_middle(options), options.pointing
    if middle[2] == 1.0:
        return schedule
    if pointing.roll_rate_deg_s != 0.0:
        raise UserError(
            f"pointing.roll_rate: {pointing.roll_rate_deg_s:g} deg/s turns a read-out window off the middle of the detector away "
            f"from its field; allowed for a plan is 0"
        )
    roll = np.radians(pointing.roll_deg)
    visits = tuple(replace(visit, boresight=_axis_of(np.array(visit.boresight), middle, roll)) for visit in schedule.visits)
    return replace(schedule, visits=visits)


def _axis_of(direction: Array, middle: Array, roll_rad: float) -> tuple[float, float, float]:
    """Optical axis of the camera that has a direction (3,) of the sky at a direction (3,) of its frame."""
    cosine, sine = np.cos(roll_rad), np.sin(roll_rad)
    # on the camera without roll, whose +Y points south
    south, ahead = sine * middle[0] + cosine * middle[1], middle[2]
    reach = np.hypot(south, ahead)
    dec = np.arctan2(south, ahead) + np.arcsin(np.clip(direction[2] / reach, -1.0, 1.0))
    if abs(direction[2]) > reach or abs(dec) > 0.5 * np.pi:
        raise UserError(
            f"sensor.window: its middle is {np.degrees(np.arccos(middle[2])):.2f} deg off the optical axis and cannot be laid on "
            f"declination {np.degrees(np.arcsin(direction[2])):.2f} deg at pointing.roll {np.degrees(roll_rad):g} deg; "
            f"allowed are another roll, or a window about the middle of the detector"
        )
    at_meridian = matrix_of_boresight(np.array([np.cos(dec), 0.0, np.sin(dec)]), roll_rad).T @ middle
    ra = np.arctan2(direction[1], direction[0]) - np.arctan2(at_meridian[1], at_meridian[0])
    return float(np.cos(dec) * np.cos(ra)), float(np.cos(dec) * np.sin(ra)), float(np.sin(dec))


def _noise_e(options: SimulatorOptions, sky_mag_arcsec2: float, detector_scale_arcsec: float) -> float:
    """Noise of a delivered pixel, in electrons of its whole block. detector_scale_arcsec : of a pixel of the detector."""
    instrument, sensor, exposure_s = options.instrument, options.sensor, options.shutter.exposure_s
    sky_e_s = instrument.zero_point_e_s * 10.0 ** (-0.4 * sky_mag_arcsec2) * detector_scale_arcsec**2
    dark_e_s, read_noise_e = median_pixel(sensor)
    charge_e2 = (sky_e_s + instrument.stray_light_e_px_s + dark_e_s) * exposure_s if sensor.shot_noise else 0.0
    read_e2 = read_noise_e**2 + sensor.readout.row_noise_e**2 + sensor.converter.gain_e_adu**2 / 12.0
    if sensor.on_chip_sum:
        return float(np.sqrt(sensor.binning.rows * sensor.binning.cols * charge_e2 + read_e2))
    return float(noise_factor(sensor.binning) * np.sqrt(charge_e2 + read_e2))


def station_of(options: SimulatorOptions, start_tai_ns: int) -> Site | Orbit:
    """The scenario's platform when a plan starts; its elements hold at the scenario's epoch."""
    observer = make_observer(options.platform, earth.tai_ns_of_utc(options.epoch_utc))
    if isinstance(observer, OrbitingObserver):
        return Orbit(state=np.concatenate(observer.state(start_tai_ns)), epoch_tai_ns=start_tai_ns)
    site = observer.site
    return Site(longitude_deg=site.longitude_deg, latitude_deg=site.latitude_deg, height_m=site.height_m)
