"""The platform of a run: its place, the attitude of the camera, the times of open rows, and their telemetry."""

from dataclasses import dataclass

import erfa
import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd.frame import AttitudeEstimate, ObserverState
from simulator.platform import earth
from simulator.platform.jitter import Jitter
from simulator.platform.line_of_sight import LineOfSight, line_of_sight
from simulator.platform.observer import OrbitingObserver, SiteObserver
from simulator.platform.pointing import Attitude
from simulator.platform.shutter import ClockOptions, FrameTiming, ShutterOptions, frame_timing
from simulator.platform.telemetry import TelemetryOptions, attitude_estimate, observer_state

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Carrier:
    """An observer with an attitude and a shutter. attitude : the commanded one; jitter comes on top.

    rows : detector rows of the read-out window; row_step : of them in a delivered row.
    """

    epoch_tai_ns: int
    seed: int
    frame_rate_hz: float
    observer: OrbitingObserver | SiteObserver
    attitude: Attitude
    jitter: Jitter
    shutter: ShutterOptions
    clock: ClockOptions
    telemetry: TelemetryOptions
    rows: int
    row_step: int

    def tai_ns(self, time_s: float) -> int:
        """TAI of a time after the epoch."""
        return self.epoch_tai_ns + round(time_s * 1e9)

    def timing(self, frame: int, *, delivered: bool) -> FrameTiming:
        """Times of a frame's delivered rows, or of the detector rows of its window."""
        step = self.row_step if delivered else 1
        return frame_timing(
            self.shutter,
            self.clock,
            seed=self.seed,
            epoch_tai_ns=self.epoch_tai_ns,
            frame=frame,
            frame_rate_hz=self.frame_rate_hz,
            rows=self.rows // step,
            row_step=step,
        )

    def sight(self, frame: int) -> LineOfSight:
        """How the camera moves during a frame."""
        timing = self.timing(frame, delivered=False)
        return line_of_sight(timing, self.epoch_tai_ns, self.observer, self.attitude, self.jitter)

    def geodetic(self, tai_ns: int) -> tuple[float, float, float] | None:
        """Geodetic latitude and longitude (deg) and altitude (km) in orbit; None on the ground."""
        if isinstance(self.observer, SiteObserver):
            return None
        fixed = earth.itrs_from_gcrs(tai_ns) @ self.observer.state(tai_ns)[0]
        longitude, latitude, height_m = erfa.gc2gd(1, fixed * 1e3)
        return float(np.degrees(latitude)), float(np.degrees(longitude)), float(height_m) * 1e-3

    def earth_fixed(self, tai_ns: int) -> tuple[Array, Array] | None:
        """Earth-fixed position (3,) km in orbit, and the matrix from these axes to the camera's; None on the ground."""
        if isinstance(self.observer, SiteObserver):
            return None
        fixed_from_gcrs = earth.itrs_from_gcrs(tai_ns)
        return fixed_from_gcrs @ self.observer.state(tai_ns)[0], self.attitude(tai_ns) @ fixed_from_gcrs.T

    def attitude_estimate(self, sight: LineOfSight, frame: int) -> AttitudeEstimate | None:
        """Attitude as telemetered."""
        return attitude_estimate(self.telemetry, sight.reference, sight.rate_rad_s(), seed=self.seed, frame=frame)

    def observer_state(self, sight: LineOfSight, frame: int) -> ObserverState | None:
        """Orbit as telemetered, its epoch read from the same clock as the frame's."""
        timing = self.timing(frame, delivered=True)
        position, velocity = (v[0] for v in sight.observer_at(np.array([sight.reference_s])))
        tagged = timing.middle_tai_ns + timing.clock_tai_ns - timing.t_start_tai_ns
        return observer_state(self.telemetry, tagged, position, velocity, seed=self.seed, frame=frame)
