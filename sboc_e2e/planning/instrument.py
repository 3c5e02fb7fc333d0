"""Camera and station of a scenario, as the planner takes them."""

import numpy as np

from ground.planning.light import PlannedCamera
from ground.planning.sky import Orbit, Site
from simulator.options import SimulatorOptions
from simulator.platform.observer import OrbitingObserver, make_observer


def planned_camera(options: SimulatorOptions, sky_mag_arcsec2: float) -> PlannedCamera:
    """Nominal values of the scenario's camera under a sky of a V surface brightness; pixels as delivered."""
    instrument, sensor = options.instrument, options.sensor
    bins = float(np.sqrt(sensor.binning.rows * sensor.binning.cols))
    scale_arcsec = float(np.degrees(instrument.pixel_um * 1e-3 / instrument.focal_length_mm)) * 3600.0 * bins
    exposure_s = options.shutter.exposure_s
    sky_e = instrument.zero_point_e_s * 10.0 ** (-0.4 * sky_mag_arcsec2) * scale_arcsec**2 * exposure_s
    noise_e = float(np.sqrt(sky_e + sensor.dark.median_e_s * exposure_s * bins**2 + (sensor.readout.read_noise_e * bins) ** 2))
    side_px = min(sensor.window.rows or instrument.rows, sensor.window.cols or instrument.cols)
    return PlannedCamera(
        zero_point_e_s=instrument.zero_point_e_s,
        exposure_s=exposure_s,
        period_s=1.0 / options.frame_rate_hz,
        noise_e=noise_e,
        sigma_px=options.psf.sigma_px / bins,
        scale_arcsec=scale_arcsec,
        half_field_rad=0.5 * side_px * instrument.pixel_um * 1e-3 / instrument.focal_length_mm,
    )


def station_of(options: SimulatorOptions, epoch_tai_ns: int) -> Site | Orbit:
    """The scenario's platform, its elements given at an epoch."""
    observer = make_observer(options.platform, epoch_tai_ns)
    if isinstance(observer, OrbitingObserver):
        return Orbit(state=np.concatenate(observer.state(epoch_tai_ns)), epoch_tai_ns=epoch_tai_ns)
    site = observer.site
    return Site(longitude_deg=site.longitude_deg, latitude_deg=site.latitude_deg, height_m=site.height_m)
