"""Telemetry that travels with the pixels of a frame."""

from sboc_e2e.icd.frame import FrameHeader
from simulator.camera import Camera
from simulator.platform.carrier import Carrier
from simulator.platform.line_of_sight import LineOfSight


def frame_header(camera: Camera, carrier: Carrier, sight: LineOfSight, frame: int) -> FrameHeader:
    """Header of a frame: read-out, stated camera values, and attitude and orbit with the errors of their sensors."""
    timing, sensor = carrier.timing(frame, delivered=True), camera.sensor
    delivered, window = sensor.delivered, sensor.options.window
    return FrameHeader(
        frame=frame,
        t_start_tai_ns=timing.clock_tai_ns,
        exposure_ns=timing.exposure_ns,
        line_time_ns=timing.line_time_ns,
        rows=delivered.rows,
        cols=delivered.cols,
        bin_rows=camera.binning.rows,
        bin_cols=camera.binning.cols,
        window_row0=window.row0,
        window_col0=window.col0,
        gain_e_adu=delivered.gain_e_adu,
        read_noise_e=delivered.read_noise_e,
        saturation_adu=delivered.saturation_adu,
        attitude=carrier.attitude_estimate(sight, frame),
        observer=carrier.observer_state(sight, frame),
        temperature_k=sensor.options.temperature_k,
    )
