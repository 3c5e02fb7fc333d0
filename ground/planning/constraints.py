"""Which target may be looked at when, and what forbids it where it may not."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ground.planning.options import ConstraintOptions
from ground.planning.sky import Sky
from ground.sky.apparent import EARTH_RADIUS_KM
from ground.sky.shadow import sunlit

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True, eq=False)
class Visibility:
    """Targets (m) at instants (n).

    direction : (m, n, 3) unit vectors from the station. range_km, phase_rad : (m, n). rate_rad_s : (m, n) against the stars.
    air_mass : (m, n), 0 in orbit.
    free : (m, n) by the name of each constraint, where it forbids nothing. best : by the same names, the angle (deg) or rate
    (deg/s) of the case that comes nearest to being allowed; only for constraints that an option sets.
    """

    direction: Array
    range_km: Array
    phase_rad: Array
    rate_rad_s: Array
    air_mass: Array
    free: dict[str, Flags]
    best: dict[str, float]

    @property
    def allowed(self) -> Flags:
        """Where no constraint forbids anything (m, n)."""
        return np.asarray(np.logical_and.reduce(list(self.free.values())))

    @property
    def forbidden(self) -> dict[str, float]:
        """Share of all cases that each constraint, alone or with others, forbids."""
        return {name: float(1.0 - np.mean(good)) for name, good in self.free.items()}


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
    moon_deg = np.degrees(separation(direction, sky.moon_km - sky.station_km))
    rate_deg_s = np.degrees(rate)
    free = {
        "no position": np.isfinite(range_km),
        "Earth's shadow": sunlit(position_km, sky.sun_km),
        "Moon": moon_deg >= options.moon_deg,
        "too fast": rate_deg_s <= options.max_rate_deg_s,
    }
    best = {"Moon": _most(moon_deg), "too fast": -_most(-rate_deg_s)}
    mass = np.zeros(range_km.shape)
    if sky.up is None:
        sun_deg = np.degrees(separation(direction, sky.sun_km - sky.station_km))
        limb_deg = np.degrees(above_limb(direction, sky.station_km))
        free |= {"Sun": sun_deg >= options.sun_deg, "Earth's limb": limb_deg >= options.limb_deg}
        best |= {"Sun": _most(sun_deg), "Earth's limb": _most(limb_deg)}
    else:
        elevation_deg = np.degrees(np.arcsin(np.clip(np.sum(direction * sky.up, axis=-1), -1.0, 1.0)))
        mass = air_mass(elevation_deg)
        darkness_deg = np.degrees(sun_elevation_rad(sky, sky.up))
        free["elevation"] = elevation_deg >= options.elevation_deg
        free["daylight"] = np.broadcast_to(darkness_deg <= options.darkness_deg, range_km.shape)
        free["weather"] = np.broadcast_to(np.True_ if sky.clear is None else sky.clear, range_km.shape)
        best |= {"elevation": _most(elevation_deg), "daylight": -_most(-darkness_deg)}
    return Visibility(
        direction=direction,
        range_km=range_km,
        phase_rad=np.arccos(np.clip(towards_sun, -1.0, 1.0)),
        rate_rad_s=rate,
        air_mass=mass,
        free=free,
        best=best,
    )


def _most(values: Array) -> float:
    """The largest finite value, minus infinity where there is none."""
    return float(np.max(values, where=np.isfinite(values), initial=-np.inf))


def air_mass(elevation_deg: Array) -> Array:
    """Air mass of elevations (...,), that of the horizon below it (Kasten & Young 1989, Appl. Opt. 28, 4735)."""
    h = np.maximum(elevation_deg, 0.0)
    return np.asarray(1.0 / (np.sin(np.radians(h)) + 0.50572 * (h + 6.07995) ** -1.6364))


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
