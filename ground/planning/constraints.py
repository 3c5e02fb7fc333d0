"""Which target may be looked at when, and what forbids it where it may not."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ground.planning.options import ConstraintOptions
from ground.planning.sky import EARTH_RADIUS_KM, Sky

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

SUN_RADIUS_KM: Final = 695700.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Visibility:
    """Targets (m) at instants (n).

    direction : (m, n, 3) unit vectors from the station. range_km, phase_rad : (m, n). rate_rad_s : (m, n) against the stars.
    allowed : (m, n). forbidden : name of each constraint, and the share of all cases that it alone or with others forbids.
    """

    direction: Array
    range_km: Array
    phase_rad: Array
    rate_rad_s: Array
    allowed: Flags
    forbidden: dict[str, float]


def visibility_of(position_km: Array, velocity_km_s: Array, sky: Sky, options: ConstraintOptions) -> Visibility:
    """Geometry and constraints of targets at (m, n, 3) km, km/s. Targets without a position are never allowed."""
    line = position_km - sky.station_km
    range_km = np.linalg.norm(line, axis=-1)
    direction = line / range_km[..., None]
    motion = velocity_km_s - sky.station_km_s
    radial = np.sum(motion * direction, axis=-1)
    rate = np.linalg.norm(motion - radial[..., None] * direction, axis=-1) / range_km
    to_sun = sky.sun_km - position_km
    towards_sun = np.sum(-direction * to_sun, axis=-1) / np.linalg.norm(to_sun, axis=-1)
    free = {
        "no position": np.isfinite(range_km),
        "Earth's shadow": sunlit(position_km, sky.sun_km),
        "Moon": separation(direction, sky.moon_km - sky.station_km) >= np.radians(options.moon_deg),
        "too fast": rate <= np.radians(options.max_rate_deg_s),
    }
    if sky.up is None:
        free["Sun"] = separation(direction, sky.sun_km - sky.station_km) >= np.radians(options.sun_deg)
        free["Earth's limb"] = above_limb(direction, sky.station_km) >= np.radians(options.limb_deg)
    else:
        free["elevation"] = np.sum(direction * sky.up, axis=-1) >= np.sin(np.radians(options.elevation_deg))
        dark = sun_elevation_rad(sky, sky.up) <= np.radians(options.darkness_deg)
        free["daylight"] = np.broadcast_to(dark, range_km.shape)
        free["weather"] = np.broadcast_to(np.True_ if sky.clear is None else sky.clear, range_km.shape)
    allowed = np.logical_and.reduce(list(free.values()))
    return Visibility(
        direction=direction,
        range_km=range_km,
        phase_rad=np.arccos(np.clip(towards_sun, -1.0, 1.0)),
        rate_rad_s=rate,
        allowed=allowed,
        forbidden={name: float(1.0 - np.mean(good)) for name, good in free.items()},
    )


def separation(direction: Array, body: Array) -> Array:
    """Angles (rad) of unit vectors (..., n, 3) from bodies (n, 3)."""
    cosine = np.sum(direction * body, axis=-1) / np.linalg.norm(body, axis=-1)
    return np.asarray(np.arccos(np.clip(cosine, -1.0, 1.0)))


def sun_elevation_rad(sky: Sky, up: Array) -> Array:
    """Geometric elevation (n,) of the Sun's centre above the horizon of zeniths (n, 3)."""
    line = sky.sun_km - sky.station_km
    return np.asarray(np.arcsin(np.sum(line * up, axis=-1) / np.linalg.norm(line, axis=-1)))


def above_limb(direction: Array, station_km: Array) -> Array:
    """Angles (rad) of directions (..., n, 3) above the limb of a spherical Earth; negative in front of it."""
    distance = np.linalg.norm(station_km, axis=-1)
    from_nadir = separation(direction, -station_km)
    return np.asarray(from_nadir - np.arcsin(EARTH_RADIUS_KM / distance))


def sunlit(position_km: Array, sun_km: Array) -> Flags:
    """Whether objects (..., n, 3) are outside the Earth's penumbra (Montenbruck & Gill, Satellite Orbits, section 3.4.2)."""
    to_sun = sun_km - position_km
    sun_distance, radius = np.linalg.norm(to_sun, axis=-1), np.linalg.norm(position_km, axis=-1)
    with np.errstate(invalid="ignore"):
        sun_disc, earth_disc = np.arcsin(SUN_RADIUS_KM / sun_distance), np.arcsin(np.minimum(EARTH_RADIUS_KM / radius, 1.0))
        apart = np.arccos(np.clip(-np.sum(position_km * to_sun, axis=-1) / (radius * sun_distance), -1.0, 1.0))
        return np.asarray(apart >= sun_disc + earth_disc)
