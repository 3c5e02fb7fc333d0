"""Micro-vibration, drift and bias of the pointing as a time series: any epoch, in any order, gives the same attitude.

The series of each axis is a sum of harmonics whose powers integrate a given spectrum over logarithmic bands and whose
phases are drawn once (spectral representation, Shinozuka & Deodatis 1991, Appl. Mech. Rev. 44, 191); one seed for the
platform, so that all frames and detectors feel the same motion.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd.errors import UserError
from simulator.platform.earth_orientation import ARCSEC_RAD
from simulator.randomness import Effect, generator

Array = NDArray[np.float64]

HARMONICS = 72
"""Sines that stand for the spectrum, 20 a decade from 0.02 to 100 Hz: time against repetition. Chosen, not measured."""


@dataclass(frozen=True, kw_only=True)
class VibrationLine:
    """A narrow line of the spectrum, such as a reaction wheel's."""

    frequency_hz: float = field(default=30.0, metadata={"doc": "centre", "min": 1e-3, "max": 5000.0})
    rms_arcsec: float = field(default=0.05, metadata={"doc": "rms of each axis", "min": 0.0, "max": 3600.0})


@dataclass(frozen=True, kw_only=True)
class JitterOptions:
    """Spectrum of the attitude error: white below a corner frequency, then a power law, and lines."""

    cross_rms_arcsec: float = field(
        default=0.3, metadata={"doc": "rms of each axis across the boresight", "min": 0.0, "max": 3600.0}
    )
    roll_rms_arcsec: float = field(default=1.5, metadata={"doc": "rms about the boresight", "min": 0.0, "max": 36000.0})
    lowest_hz: float = field(default=0.02, metadata={"doc": "lowest frequency of the spectrum", "min": 1e-5, "max": 100.0})
    corner_hz: float = field(default=0.3, metadata={"doc": "the spectrum falls above this", "min": 1e-5, "max": 1000.0})
    highest_hz: float = field(default=100.0, metadata={"doc": "highest frequency of the spectrum", "min": 1e-4, "max": 5000.0})
    slope: float = field(default=2.0, metadata={"doc": "power falls as frequency to minus this", "min": 0.0, "max": 8.0})
    lines: tuple[VibrationLine, ...] = field(
        default=(VibrationLine(frequency_hz=33.0, rms_arcsec=0.03),), metadata={"doc": "wheel and cooler lines"}
    )
    drift_x_arcsec_s: float = field(
        default=0.2, metadata={"doc": "constant rate about the camera's X", "min": -36000.0, "max": 36000.0}
    )
    drift_y_arcsec_s: float = field(
        default=-0.1, metadata={"doc": "constant rate about the camera's Y", "min": -36000.0, "max": 36000.0}
    )
    drift_roll_arcsec_s: float = field(
        default=0.0, metadata={"doc": "constant rate about the boresight", "min": -36000.0, "max": 36000.0}
    )
    bias_x_arcsec: float = field(default=8.0, metadata={"doc": "constant offset about X", "min": -36000.0, "max": 36000.0})
    bias_y_arcsec: float = field(default=-5.0, metadata={"doc": "constant offset about Y", "min": -36000.0, "max": 36000.0})
    bias_roll_arcsec: float = field(
        default=20.0, metadata={"doc": "constant offset about the boresight", "min": -36000.0, "max": 36000.0}
    )

    def __post_init__(self) -> None:
        if not self.lowest_hz < self.highest_hz:
            raise UserError(f"jitter.lowest: {self.lowest_hz} Hz must be below jitter.highest, {self.highest_hz} Hz")


@dataclass(frozen=True, kw_only=True, eq=False)
class Jitter:
    """Harmonics of the three axes: frequency (k,), amplitude and phase (k, 3); bias and rate (3,). Radians, seconds."""

    omega_rad_s: Array
    amplitude_rad: Array
    phase_rad: Array
    bias_rad: Array
    rate_rad_s: Array

    def rotation_vector(self, time_s: Array) -> Array:
        """Rotation vectors (n, 3) of the camera, in the camera frame, at times after the epoch of the run."""
        time_s = np.asarray(time_s, dtype=np.float64)
        angle = time_s[:, None] * self.omega_rad_s
        # sin(angle + phase) expanded, so that one sine and cosine serve the three axes
        swing = np.sin(angle) @ (self.amplitude_rad * np.cos(self.phase_rad))
        swing += np.cos(angle) @ (self.amplitude_rad * np.sin(self.phase_rad))
        return np.asarray(self.bias_rad + time_s[:, None] * self.rate_rad_s + swing)


def make_jitter(options: JitterOptions, seed: int) -> Jitter:
    """Draw the phases and frequencies of a platform's jitter."""
    rng = generator(seed, Effect.JITTER)
    edges = np.geomspace(options.lowest_hz, options.highest_hz, HARMONICS + 1)
    frequency = edges[:-1] * (edges[1:] / edges[:-1]) ** rng.random(HARMONICS)
    power = np.diff(edges) / (1.0 + (frequency / options.corner_hz) ** options.slope)
    rms = np.array([options.cross_rms_arcsec, options.cross_rms_arcsec, options.roll_rms_arcsec])
    amplitude = np.sqrt(2.0 * power / power.sum())[:, None] * rms
    for line in options.lines:
        frequency = np.append(frequency, line.frequency_hz)
        amplitude = np.vstack([amplitude, np.full((1, 3), np.sqrt(2.0) * line.rms_arcsec)])
    return Jitter(
        omega_rad_s=2 * np.pi * frequency,
        amplitude_rad=amplitude * ARCSEC_RAD,
        phase_rad=rng.uniform(0.0, 2 * np.pi, amplitude.shape),
        bias_rad=np.array([options.bias_x_arcsec, options.bias_y_arcsec, options.bias_roll_arcsec]) * ARCSEC_RAD,
        rate_rad_s=np.array([options.drift_x_arcsec_s, options.drift_y_arcsec_s, options.drift_roll_arcsec_s]) * ARCSEC_RAD,
    )
