"""Options of the simulator: each step's own dataclass, gathered. The defaults are the run `sso_antisun`."""

from dataclasses import dataclass, field, replace
from typing import Final

from sboc_e2e.icd.errors import UserError
from simulator.optics.instrument import AsBuiltOptions, InstrumentOptions
from simulator.optics.psf import PsfOptions
from simulator.optics.vignetting import VignettingOptions
from simulator.platform.jitter import JitterOptions
from simulator.platform.observer import PlatformOptions
from simulator.platform.pointing import PointingOptions
from simulator.platform.shutter import ClockOptions, ShutterOptions
from simulator.platform.telemetry import TelemetryOptions
from simulator.radiation.options import RadiationOptions
from simulator.scene.atmosphere import AtmosphereOptions
from simulator.scene.encounters import PopulationOptions
from simulator.scene.light import LightOptions
from simulator.scene.sky import SkyOptions
from simulator.scene.sources import ObjectOptions
from simulator.scene.stars import StarOptions
from simulator.sensor.options import SensorOptions

MOST_ROLL_DEG: Final = 175.0
"""Farthest roll from mid-exposure. Rotation vectors wrap at 180 deg; the rest is for orbit and jitter."""


@dataclass(frozen=True, kw_only=True)
class SimulatorOptions:
    """All options of the simulated world; one nested table for each step."""

    epoch_utc: str = field(default="2027-01-29T00:00:00", metadata={"doc": "opening of the first row of frame 0, UTC"})
    frames: int = field(default=24, metadata={"doc": "number of frames", "min": 1, "max": 1000000})
    frame_rate_hz: float = field(default=4.0, metadata={"doc": "frames per second", "min": 1e-4, "max": 1000.0})
    instrument: InstrumentOptions = field(
        default_factory=InstrumentOptions, metadata={"doc": "aperture, focal plane, throughput"}
    )
    psf: PsfOptions = field(default_factory=PsfOptions, metadata={"doc": "point-spread function"})
    vignetting: VignettingOptions = field(default_factory=VignettingOptions, metadata={"doc": "illumination of the field"})
    sensor: SensorOptions = field(default_factory=SensorOptions, metadata={"doc": "detector"})
    shutter: ShutterOptions = field(default_factory=ShutterOptions, metadata={"doc": "exposure and shutter"})
    clock: ClockOptions = field(default_factory=ClockOptions, metadata={"doc": "errors of the time tags"})
    platform: PlatformOptions = field(default_factory=PlatformOptions, metadata={"doc": "orbit or site"})
    pointing: PointingOptions = field(default_factory=PointingOptions, metadata={"doc": "pointing law"})
    jitter: JitterOptions = field(default_factory=JitterOptions, metadata={"doc": "micro-vibration, drift and bias"})
    telemetry: TelemetryOptions = field(
        default_factory=TelemetryOptions, metadata={"doc": "errors of telemetered attitude and orbit"}
    )
    stars: StarOptions = field(default_factory=StarOptions, metadata={"doc": "stars"})
    sky: SkyOptions = field(default_factory=SkyOptions, metadata={"doc": "diffuse background"})
    light: LightOptions = field(default_factory=LightOptions, metadata={"doc": "the light's way to the camera"})
    atmosphere: AtmosphereOptions = field(default_factory=AtmosphereOptions, metadata={"doc": "air above a ground site"})
    population: PopulationOptions = field(default_factory=PopulationOptions, metadata={"doc": "sampled debris"})
    objects: ObjectOptions = field(default_factory=ObjectOptions, metadata={"doc": "objects given one by one"})
    radiation: RadiationOptions = field(default_factory=RadiationOptions, metadata={"doc": "particles"})

    def refuse_bad_timing(self) -> None:
        """UserError when exposure or read-out last longer than a frame, and when the camera rolls too far within one."""
        rows = self.sensor.window.rows or self.instrument.rows - self.sensor.window.row0
        self.shutter.refuse_overlap(rows, self.frame_rate_hz)
        readout_s = 0.0 if self.sensor.type == "ccd" else 1e-6 * self.shutter.line_time_us * rows
        allowed_deg_s = MOST_ROLL_DEG / (0.5 * (self.shutter.exposure_s + readout_s))
        if abs(self.pointing.roll_rate_deg_s) > allowed_deg_s:
            raise UserError(
                f"pointing.roll_rate: {self.pointing.roll_rate_deg_s:g} deg/s turns the camera by more than {MOST_ROLL_DEG:g} "
                f"deg on one side of the middle of a frame; allowed is up to {allowed_deg_s:.4g} deg/s"
            )


def smoke_options(base: SimulatorOptions | None = None) -> SimulatorOptions:
    """The small set-up `smoke_wide`: the field of the base on 512 x 512 larger pixels, six frames.

    The aperture is 4 cm, so that stars are as far apart in pixels as in the large frame.
    """
    base = base or SimulatorOptions()
    scale = base.instrument.rows / 512
    instrument = replace(
        base.instrument,
        name="smoke_wide",
        aperture_m=0.04,
        rows=512,
        cols=512,
        pixel_um=base.instrument.pixel_um * scale,
        as_built=AsBuiltOptions(center_row_px=0.6, center_col_px=-0.4),
    )
    shutter = replace(base.shutter, line_time_us=base.shutter.line_time_us * scale)
    return replace(base, frames=6, instrument=instrument, shutter=shutter)
