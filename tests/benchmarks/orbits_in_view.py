"""Objects on drawn orbits that cross a line of sight: what boxes of velocities by name are held against.

Orbits are made from elements: one of a size, shape and inclination that leads through a place (Vallado 2013, chapter 2).
Rates are differences of places in the image a second apart. The on-board code reckons with headings and rates instead.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from onboard.track.boxes import OrbitKind
from sboc_e2e.icd.frame import AttitudeEstimate, FrameHeader, ObserverState

Array = NDArray[np.float64]

GM_M3_S2: Final = 3.986004418e14
"""Of the Earth, IERS Conventions 2010."""
OBSERVER_M: Final = 7078e3
"""Radius of the observer's circular orbit: 700 km above the equator."""
OBSERVER_M_S: Final = math.sqrt(GM_M3_S2 / OBSERVER_M)
"""Its speed."""
OBSERVER_INCLINATION_DEG: Final = 98.2
"""Sun-synchronous at that height."""

RANGES: Final = {
    "geo": ((42.164e6, 42.164e6), (0.0, 0.0), (0.0, 15.0), (42.164e6, 42.164e6)),
    "meo": ((25.5e6, 29.6e6), (0.0, 0.0), (54.0, 65.0), (25.5e6, 29.6e6)),
    "molniya": ((26.56e6, 26.56e6), (0.69, 0.74), (62.0, 65.0), (38.0e6, 45.0e6)),
}
"""Semi-major axis (m), eccentricity, inclination (deg), radius (m), stated here and not taken from on board. GEO: IADC 2007.
MEO: GLONASS (25.5 Mm, 64.8 deg) to Galileo (29.6 Mm, 56 deg). Molniya about its apogee."""
DRAWN: Final = {
    name: OrbitKind(semi_major_axis_m=axis, eccentricity=eccentricity, inclination_deg=inclination, radius_m=radius)
    for name, (axis, eccentricity, inclination, radius) in RANGES.items()
}
"""Kinds of orbits that objects are drawn from."""


@dataclass(frozen=True, kw_only=True)
class Observer:
    """Place (m) and velocity (m/s), GCRS, of a camera, and its axes (3, 3): rows of columns, rows and line of sight."""

    place_m: Array
    velocity_m_s: Array
    axes: Array

    @classmethod
    def towards_the_night(cls, rng: np.random.Generator) -> "Observer":
        """Anywhere on a dawn-dusk orbit, looking within 25 deg of the pole of the orbit that is away from the Sun."""
        turn = Rotation.from_euler("ZXZ", [rng.uniform(0, 360), OBSERVER_INCLINATION_DEG, rng.uniform(0, 360)], degrees=True)
        tilt = Rotation.from_rotvec(math.radians(25.0) * math.sqrt(rng.uniform()) * _unit_in_plane(rng))
        return cls(
            place_m=turn.apply([OBSERVER_M, 0.0, 0.0]),
            velocity_m_s=turn.apply([0.0, OBSERVER_M_S, 0.0]),
            axes=_level_axes(turn.apply(tilt.apply([0.0, 0.0, rng.choice([-1.0, 1.0])]))),
        )

    @classmethod
    def looking_at(cls, sight: Array, place_m: Array, velocity_m_s: Array) -> "Observer":
        """With a given line of sight, columns level."""
        return cls(place_m=place_m, velocity_m_s=velocity_m_s, axes=_level_axes(sight))

    def header(self, side_px: int) -> FrameHeader:
        """Of a square frame taken here."""
        return FrameHeader(
            frame=0, t_start_tai_ns=10**18, exposure_ns=200_000_000, line_time_ns=0, rows=side_px, cols=side_px,
            attitude=AttitudeEstimate(
                quaternion=Rotation.from_matrix(self.axes).as_quat(), rate_rad_s=np.zeros(3), covariance_rad2=1e-10 * np.eye(3)
            ),
            observer=ObserverState(
                tai_ns=10**18, position_m=self.place_m, velocity_m_s=self.velocity_m_s, sigma_position_m=10.0,
                sigma_velocity_m_s=0.1,
            ),
        )  # fmt: skip

    def pixel(self, place_m: Array, velocity_m_s: Array, seconds: float, focal_px: float) -> Array:
        """Row and column, from the middle of the frame, of an object after some time of straight motion."""
        seen = self.axes @ (place_m - self.place_m + seconds * (velocity_m_s - self.velocity_m_s))
        return focal_px * seen[[1, 0]] / seen[2]

    def rate_px_s(self, place_m: Array, velocity_m_s: Array, focal_px: float) -> Array:
        """Rates down the rows and along the columns of an object among the stars."""
        before, after = (self.pixel(place_m, velocity_m_s, s, focal_px) for s in (-0.5, 0.5))
        return after - before

    def object_in_view(
        self, kind: OrbitKind, half_px: float, focal_px: float, rng: np.random.Generator
    ) -> tuple[Array, Array] | None:
        """Place and velocity of an object of a kind somewhere in the field; None where no such orbit leads through there."""
        at = rng.uniform(-half_px, half_px, 2) / focal_px
        sight = self.axes.T @ np.array([at[1], at[0], 1.0])
        sight /= np.linalg.norm(sight)
        radius_m = rng.uniform(*kind.radius_m)
        along = float(self.place_m @ sight)
        place = self.place_m + sight * (-along + math.sqrt(along**2 + radius_m**2 - OBSERVER_M**2))
        # circular orbits have the radius for a size
        eccentricity = rng.uniform(*kind.eccentricity)
        a = radius_m if eccentricity == 0.0 else rng.uniform(*kind.semi_major_axis_m)
        velocity = velocity_through(place, a, eccentricity, math.radians(rng.uniform(*kind.inclination_deg)), rng)
        return None if velocity is None else (place, velocity)


def velocity_through(place_m: Array, a: float, e: float, inclination: float, rng: np.random.Generator) -> Array | None:
    """Velocity on one of the orbits of these elements (m, 1, rad) that lead through a place; None where none does."""
    radius = float(np.linalg.norm(place_m))
    latitude, longitude = math.asin(place_m[2] / radius), math.atan2(place_m[1], place_m[0])
    p = a * (1.0 - e**2)
    cosine = (p / radius - 1.0) / e if e > 0.0 else 1.0
    if abs(math.sin(latitude)) > math.sin(inclination) or abs(cosine) > 1.0:
        return None
    anomaly = rng.choice([-1.0, 1.0]) * math.acos(cosine)
    from_node = math.asin(math.sin(latitude) / max(math.sin(inclination), 1e-12))
    from_node = math.pi - from_node if rng.uniform() < 0.5 else from_node
    node = longitude - math.atan2(math.cos(inclination) * math.sin(from_node), math.cos(from_node))
    turn = Rotation.from_euler("ZXZ", [node, inclination, from_node - anomaly])
    found = turn.apply(radius * np.array([math.cos(anomaly), math.sin(anomaly), 0.0]))
    assert np.allclose(found, place_m, atol=1.0), "the orbit must lead through its place"
    return np.asarray(turn.apply(math.sqrt(GM_M3_S2 / p) * np.array([-math.sin(anomaly), e + math.cos(anomaly), 0.0])))


def _level_axes(sight: Array) -> Array:
    """Columns level, rows across, and a line of sight: unit vectors (3, 3)."""
    level = np.cross([0.0, 0.0, 1.0], sight)
    level /= np.linalg.norm(level)
    return np.stack([level, np.cross(sight, level), sight])


def _unit_in_plane(rng: np.random.Generator) -> Array:
    """A random direction across the pole."""
    angle = rng.uniform(0.0, 2.0 * math.pi)
    return np.array([math.cos(angle), math.sin(angle), 0.0])
