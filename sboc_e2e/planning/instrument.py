"""Camera and station of a scenario, as the planner takes them."""

from typing import Final

import numpy as np

from ground.planning.light import PlannedCamera
from ground.planning.sky import Orbit, Site
from simulator.optics.psf import FWHM_PER_SIGMA
from simulator.options import SimulatorOptions
from simulator.platform import earth
from simulator.platform.observer import OrbitingObserver, make_observer
from simulator.sensor.binning import noise_factor
from simulator.sensor.maps import median_pixel

PIXEL_VARIANCE_PX2: Final = 1.0 / 12.0
"""Of a pixel's width, which adds to that of the PSF: a square of side 1."""


def planned_camera(options: SimulatorOptions, sky_mag_arcsec2: float) -> PlannedCamera:
    """Nominal values of the scenario's camera under a sky of a V surface brightness; pixels as delivered.

    A ground site adds the seeing, extinction and mean clouds of its air.
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
    side_px = min(sensor.window.rows or instrument.rows, sensor.window.cols or instrument.cols)
    return PlannedCamera(
        zero_point_e_s=zero_point_e_s,
        exposure_s=options.shutter.exposure_s,
        period_s=1.0 / options.frame_rate_hz,
        noise_e=_noise_e(options, sky_mag_arcsec2, scale_arcsec / bins),
        sigma_px=float(np.sqrt(sigma_px**2 + PIXEL_VARIANCE_PX2)),
        scale_arcsec=scale_arcsec,
        half_field_rad=0.5 * side_px * instrument.pixel_um * 1e-3 / instrument.focal_length_mm,
        extinction_mag=extinction_mag,
        seeing_sigma_px=seeing_px,
    )


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
