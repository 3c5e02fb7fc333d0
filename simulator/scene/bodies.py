"""Moon and planets: how bright they are, and which stand near a direction.

Planets: V of Mallama & Hilton 2018, Astronomy and Computing 25, 10, for the phases that are seen from the Earth, without rotation
(Mars 0.06 mag) and season. Moon: V of Krisciunas & Schaefer 1991, PASP 103, 1033, eq. 9, with the opposition surge of its text.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from simulator.platform import ephemeris
from simulator.platform.earth import AU_KM, sun_position_km

Array = NDArray[np.float64]

MOON_RADIUS_KM: Final = 1737.4  # mean radius (Archinal et al. 2018)
MOON_B_V: Final = 0.92  # Allen's Astrophysical Quantities, as below
_MOON_DISTANCE_KM: Final = 384400.0  # mean distance, for which eq. 9 holds
SURGE_DEG: Final = 7.0  # nearer to full Moon than this it is brighter than eq. 9 ...
SURGE: Final = 0.35  # ... by a factor of 1.35 - 0.05 phase (Krisciunas & Schaefer 1991)
_SATURN_POLE: Final = np.array([0.08547883, 0.07323576, 0.99364475])
"""North pole of Saturn and its rings, ICRS (40.589 deg, 83.537 deg; Archinal et al. 2018)."""
_URANUS_POLE: Final = np.array([-0.21199958, -0.94155916, -0.26176809])
"""North pole of Uranus, ICRS (257.311 deg, -15.175 deg; Archinal et al. 2018)."""
_RADIUS_KM: Final = dict(zip(ephemeris.PLANETS, (2439.4, 6051.8, 3396.2, 71492.0, 60268.0, 25559.0, 24764.0), strict=True))
_B_V: Final = dict(zip(ephemeris.PLANETS, (0.97, 0.82, 1.43, 0.83, 1.04, 0.56, 0.41), strict=True))
"""B-V: Mallama et al. 2017, Icarus 282, 19; Venus, Saturn, Moon: Allen's Astrophysical Quantities, 4th ed., table 12.7."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Body:
    """A body of the solar system. direction : (3,) from the observer, not aberrated. flux_v0 : in units of a V = 0 star.

    to_sun : (3,) unit direction from the body to the Sun.
    """

    name: str
    direction: Array
    flux_v0: float
    b_v: float
    radius_rad: float
    to_sun: Array


def moon_magnitude(phase_deg: float, distance_km: float, sun_au: float) -> float:
    """V of the Moon. phase_deg : angle between Sun and observer as the Moon sees them, 0 at full Moon."""
    surge = 1.0 + SURGE * max(0.0, 1.0 - phase_deg / SURGE_DEG)
    at_mean = -12.73 + 0.026 * phase_deg + 4e-9 * phase_deg**4 - 2.5 * np.log10(surge)
    return float(at_mean + 5.0 * np.log10(distance_km / _MOON_DISTANCE_KM * sun_au))


def planet_magnitude(
    name: str, sun_au: float, observer_au: float, phase_deg: float, sun_latitude_deg: float = 0.0, latitude_deg: float = 0.0
) -> float:
    """V of a planet at distances from Sun and observer.

    sun_latitude_deg, latitude_deg : of the Sun and of the observer above the planet's equator (Saturn's rings, Uranus).
    """
    a, distance = phase_deg, 5.0 * np.log10(sun_au * observer_au)
    tilt_deg = np.sqrt(max(sun_latitude_deg * latitude_deg, 0.0))
    ring = np.sin(np.radians(tilt_deg))
    mean_latitude = 0.5 * (abs(sun_latitude_deg) + abs(latitude_deg))
    powers: tuple[float, ...]
    if name == "Mercury":
        # Constant term to sixth power of the phase angle.
        powers = (-0.613, 6.3280e-2, -1.6336e-3, 3.3644e-5, -3.4265e-7, 1.6893e-9, -3.0334e-12)
    elif name == "Venus":
        crescent = a > 163.7
        powers = (236.05828, -2.81914, 8.39034e-3) if crescent else (-4.384, -1.044e-3, 3.687e-4, -2.814e-6, 8.938e-9)
    elif name == "Mars":
        powers = (-1.601, 0.02267, -1.302e-4) if a <= 50.0 else (-0.367, -0.02573, 3.445e-4)
    elif name == "Jupiter":
        powers = (-9.395, -3.7e-4, 6.16e-4)
    elif name == "Saturn":
        powers = (-8.914 - ring * (1.825 + 0.378 * np.exp(-2.25 * a)), 0.026)
    elif name == "Uranus":
        powers = (-7.110 - 8.4e-4 * mean_latitude, 6.587e-3, 1.045e-4)
    else:
        powers = (-7.00, 7.944e-3, 9.617e-5)
    return float(distance + np.polynomial.polynomial.polyval(a, powers))


def moon(tai_ns: int, observer_km: Array) -> Body:
    """The Moon from a geocentric place (3,)."""
    geocentric = ephemeris.moon_position_km(tai_ns)
    seen, to_sun = geocentric - observer_km, sun_position_km(tai_ns) - geocentric
    distance, sun = float(np.linalg.norm(seen)), float(np.linalg.norm(to_sun))
    phase_deg = _angle_deg(-seen, to_sun)
    return Body(
        name="Moon",
        direction=seen / distance,
        flux_v0=10.0 ** (-0.4 * moon_magnitude(phase_deg, distance, sun / AU_KM)),
        b_v=MOON_B_V,
        radius_rad=float(np.arcsin(MOON_RADIUS_KM / distance)),
        to_sun=to_sun / sun,
    )


def planets(tai_ns: int) -> list[Body]:
    """All planets from the Earth's centre; an observer near the Earth sees the nearest one 30 arcsec aside at most."""
    return [_planet(name, tai_ns) for name in ephemeris.PLANETS]


def _planet(name: str, tai_ns: int) -> Body:
    geocentric, heliocentric = ephemeris.planet_position_km(name, tai_ns)
    distance, sun = float(np.linalg.norm(geocentric)), float(np.linalg.norm(heliocentric))
    pole = {"Saturn": _SATURN_POLE, "Uranus": _URANUS_POLE}.get(name, np.array([0.0, 0.0, 1.0]))
    latitudes = [float(np.degrees(np.arcsin(-v @ pole / np.linalg.norm(v)))) for v in (heliocentric, geocentric)]
    magnitude = planet_magnitude(
        name, sun / AU_KM, distance / AU_KM, _angle_deg(geocentric, heliocentric), latitudes[0], latitudes[1]
    )
    return Body(
        name=name,
        direction=geocentric / distance,
        flux_v0=10.0 ** (-0.4 * magnitude),
        b_v=_B_V[name],
        radius_rad=_RADIUS_KM[name] / distance,
        to_sun=-heliocentric / sun,
    )


def _angle_deg(one: Array, other: Array) -> float:
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(one, other)), one @ other)))


def disc_points(body: Body, step_rad: float) -> tuple[Array, Array]:
    """Directions (n, 3) over a body's lit disc, about `step_rad` apart, and the share of its light of each, (n,).

    Lommel and Seeliger's law, ``mu0 / (mu0 + mu)``: a full Moon is evenly bright.
    """
    n = max(int(np.pi * (body.radius_rad / step_rad) ** 2), 1)
    k = np.arange(n) + 0.5
    radius, turn = np.sqrt(k / n), np.pi * (1.0 + np.sqrt(5.0)) * k
    if n == 1:
        radius = np.zeros(1)
    east = np.cross([0.0, 0.0, 1.0], body.direction)
    east /= np.linalg.norm(east)
    north = np.cross(body.direction, east)
    across = (radius * np.cos(turn))[:, None] * east + (radius * np.sin(turn))[:, None] * north
    seen = body.direction + np.sin(body.radius_rad) * across
    share = brightness(body, across)
    if share.sum() <= 0.0:
        share = np.ones(n)
    return seen / np.linalg.norm(seen, axis=-1, keepdims=True), share / share.sum()


def brightness(body: Body, across: Array) -> Array:
    """Relative brightness at places (..., 3) of the disc, at right angles to the line of sight, in radii; 0 beyond the disc."""
    outward = np.sqrt(np.clip(1.0 - np.sum(across * across, axis=-1), 0.0, 1.0))
    normal = across - outward[..., None] * body.direction
    lit = np.maximum(normal @ body.to_sun, 0.0)
    return np.asarray(np.where(outward > 0.0, lit / np.maximum(lit + outward, 1e-12), 0.0))
