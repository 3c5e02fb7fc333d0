"""Telemetry of the platform: attitude from the star tracker, position and velocity from GPS, with their errors."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd.frame import AttitudeEstimate, ObserverState
from simulator.platform.earth_orientation import ARCSEC_RAD
from simulator.platform.rotation import quaternion_of, small_rotation
from simulator.randomness import Effect, generator

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class TelemetryOptions:
    """Errors of the telemetered attitude and orbit; the stated sigmas are true ones."""

    attitude: bool = field(default=True, metadata={"doc": "the header carries an attitude"})
    attitude_cross_arcsec: float = field(
        default=3.0, metadata={"doc": "noise of each frame across the boresight", "min": 0.0, "max": 36000.0}
    )
    attitude_roll_arcsec: float = field(
        default=15.0, metadata={"doc": "noise of each frame about the boresight", "min": 0.0, "max": 36000.0}
    )
    misalignment_arcsec: float = field(
        default=10.0,
        metadata={"doc": "constant misalignment of camera and star tracker, rms of each axis", "min": 0.0, "max": 36000.0},
    )
    rate_noise_arcsec_s: float = field(default=0.5, metadata={"doc": "noise of the telemetered rates", "min": 0.0, "max": 3600.0})
    orbit: bool = field(default=True, metadata={"doc": "the header carries the observer's state"})
    position_m: float = field(default=10.0, metadata={"doc": "GPS position error, rms of each axis", "min": 0.0, "max": 1e7})
    velocity_m_s: float = field(default=0.05, metadata={"doc": "GPS velocity error, rms of each axis", "min": 0.0, "max": 1e4})
    steady: float = field(
        default=0.7,
        metadata={"doc": "share of the GPS error's variance that stays constant over the run", "min": 0.0, "max": 1.0},
    )


def attitude_estimate(
    options: TelemetryOptions, attitude: Array, rate_rad_s: Array, *, seed: int, frame: int
) -> AttitudeEstimate | None:
    """Telemetered attitude of a frame from the true one (3, 3) and the true rate (3,) in the camera frame."""
    if not options.attitude:
        return None
    rng = generator(seed, Effect.ATTITUDE_ERROR, frame)
    noise = np.array([options.attitude_cross_arcsec, options.attitude_cross_arcsec, options.attitude_roll_arcsec]) * ARCSEC_RAD
    fixed = options.misalignment_arcsec * ARCSEC_RAD
    error = noise * rng.standard_normal(3) + fixed * generator(seed, Effect.ATTITUDE_ERROR, 0, 1).standard_normal(3)
    return AttitudeEstimate(
        quaternion=quaternion_of(small_rotation(error) @ attitude),
        rate_rad_s=rate_rad_s + options.rate_noise_arcsec_s * ARCSEC_RAD * rng.standard_normal(3),
        covariance_rad2=np.diag(np.maximum(noise**2 + fixed**2, (0.01 * ARCSEC_RAD) ** 2)),
    )


def observer_state(
    options: TelemetryOptions, tai_ns: int, position_km: Array, velocity_km_s: Array, *, seed: int, frame: int
) -> ObserverState | None:
    """Telemetered state of the observer; part of the error is the same in all frames, as for real GPS orbits."""
    if not options.orbit:
        return None
    steady = generator(seed, Effect.OBSERVER_ERROR, 0, 1).standard_normal(6)
    fresh = generator(seed, Effect.OBSERVER_ERROR, frame).standard_normal(6)
    error = np.sqrt(options.steady) * steady + np.sqrt(1.0 - options.steady) * fresh
    return ObserverState(
        tai_ns=tai_ns,
        position_m=position_km * 1e3 + options.position_m * error[:3],
        velocity_m_s=velocity_km_s * 1e3 + options.velocity_m_s * error[3:],
        sigma_position_m=options.position_m,
        sigma_velocity_m_s=options.velocity_m_s,
    )
