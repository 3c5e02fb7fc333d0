"""Directions of trapped protons: across the field lines, and more of them from the west than from the east.

A proton of a shell near its mirror point moves across the field. One that comes from the west has the centre of its
gyration above the sensor, where there are more protons (Lenchek & Singer 1962, J. Geophys. Res. 67, 4073).
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from simulator.radiation.belts import GeodeticPosition, trapped
from simulator.radiation.energy_loss import PROTON_MEV
from simulator.radiation.environment import POLE_LAT_DEG, POLE_LON_DEG

Array = NDArray[np.float64]

_NODES: Final = 4096  # directions of the sphere's means: 65,536 of them change norm and crossings by less than 1e-6
_EQUATOR_TESLA: Final = 2.99e-5
"""Dipole field at the geomagnetic equator on the ground (IGRF-13, 2015, the epoch of the belts' map; 0.2 % less in 2020)."""
_GRADIENT_STEP_KM: Final = 40.0  # 20 km or 80 km change the scale height by 1 % and 6 % (700 km, 28 S 45 W, 50 MeV)
_POLE_RAD: Final = (math.radians(POLE_LAT_DEG), math.radians(POLE_LON_DEG))
POLE: Final = np.array(
    [math.cos(_POLE_RAD[0]) * math.cos(_POLE_RAD[1]), math.cos(_POLE_RAD[0]) * math.sin(_POLE_RAD[1]), math.sin(_POLE_RAD[0])]
)
"""Axis of the geomagnetic dipole in Earth-fixed axes, towards the north (IGRF-13, 2020)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FieldLines:
    """The magnetic field at the sensor, in its own axes (cols, rows, depth): unit vectors (3,) along it and up; its size."""

    field: Array
    up: Array
    tesla: float


def field_lines(fixed_km: Array, camera_from_fixed: Array) -> FieldLines:
    """Dipole field at an Earth-fixed place, seen in the camera's axes."""
    radius = float(np.linalg.norm(fixed_km))
    up = fixed_km / radius
    field = POLE - 3.0 * float(POLE @ up) * up
    size = float(np.linalg.norm(field))
    return FieldLines(
        field=camera_from_fixed @ (field / size), up=camera_from_fixed @ up, tesla=_EQUATOR_TESLA * size * (6371.2 / radius) ** 3
    )


def proton_scale_km(position: GeodeticPosition, epoch_jyear: float, drift_deg_yr: float, energy_mev: float) -> float:
    """Height over which the protons' flux grows e-fold; endless where it does not."""
    low, high = (
        trapped("proton", position._replace(altitude_km=position.altitude_km + step), epoch_jyear, drift_deg_yr).above(energy_mev)
        for step in (-_GRADIENT_STEP_KM, _GRADIENT_STEP_KM)
    )
    if low <= 0.0 or high <= low:
        return math.inf
    return max(2.0 * _GRADIENT_STEP_KM / math.log(high / low), 50.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class Arrival:
    """Relative flux by direction of motion, mean 1 over the sphere."""

    lines: FieldLines
    pitch_width_rad: float
    gyration_over_scale: float
    norm: float = 1.0

    def weight(self, direction: Array) -> Array:
        """Flux of particles moving along unit vectors (n, 3)."""
        across = np.arcsin(np.clip(direction @ self.lines.field, -1.0, 1.0))
        # The centre of gyration lies along v x B for a positive charge.
        lift = np.cross(direction, self.lines.field) @ self.lines.up
        exponent = -0.5 * (across / self.pitch_width_rad) ** 2 + self.gyration_over_scale * lift
        return np.asarray(np.exp(exponent) / self.norm)

    def through_plane(self) -> float:
        """Crossings of the sensor's plane relative to an isotropic flux."""
        sphere = _sphere()
        return float(2.0 * np.mean(self.weight(sphere) * np.abs(sphere[:, 2])))

    def draw(self, rng: np.random.Generator, n: int) -> Array:
        """Directions of motion (n, 3) of protons that cross the plane."""
        highest = 1.2 * float((self.weight(_sphere())).max())
        found = np.zeros((0, 3))
        while len(found) < n:
            m = 4 * (n - len(found)) + 64
            proposed = crossing_directions(rng, m)
            kept = rng.random(m) * highest < self.weight(proposed)
            found = np.concatenate([found, proposed[kept]])
        return found[:n]


def arrival(lines: FieldLines, pitch_width_deg: float, energy_mev: float, scale_km: float) -> Arrival:
    """The pattern of protons of an energy where their flux has a scale height."""
    momentum_mev = math.sqrt(energy_mev * (energy_mev + 2.0 * PROTON_MEV))
    gyration_km = momentum_mev * 1e6 / 299792458.0 / lines.tesla * 1e-3
    raw = Arrival(lines=lines, pitch_width_rad=math.radians(pitch_width_deg), gyration_over_scale=gyration_km / scale_km)
    norm = float(np.mean(raw.weight(_sphere())))
    return Arrival(lines=lines, pitch_width_rad=raw.pitch_width_rad, gyration_over_scale=raw.gyration_over_scale, norm=norm)


def crossing_directions(rng: np.random.Generator, n: int) -> Array:
    """Directions (n, 3) in which an isotropic flux crosses a plane from both sides: density 2 cos d cos."""
    cosine = np.sqrt(rng.random(n))
    azimuth = rng.random(n) * (2.0 * math.pi)
    sine = np.sqrt(1.0 - cosine**2)
    side = np.where(rng.random(n) < 0.5, 1.0, -1.0)
    return np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), side * cosine], axis=1)


def _sphere() -> Array:
    """Directions spread evenly over the sphere (Fibonacci's spiral)."""
    k = np.arange(_NODES) + 0.5
    z = 1.0 - 2.0 * k / _NODES
    angle = math.pi * (1.0 + math.sqrt(5.0)) * k
    rho = np.sqrt(1.0 - z * z)
    return np.stack([rho * np.cos(angle), rho * np.sin(angle), z], axis=1)
