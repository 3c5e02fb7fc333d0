"""Two-body motion: elements, states, and the orbit that passes through a given point. Vectorised over objects or times.

Elements are in GCRS axes; km, s, rad. Vallado, Fundamentals of Astrodynamics (4th ed.), algorithms 2, 9 and 10.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from simulator.platform.earth import MU_KM3_S2

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Elements:
    """Osculating elements at an epoch; scalars or arrays of equal shape."""

    a_km: Array
    e: Array
    i_rad: Array
    node_rad: Array
    argp_rad: Array
    mean_anomaly_rad: Array


def elements_deg(
    a_km: float, e: float, inclination_deg: float, node_deg: float, perigee_deg: float, mean_anomaly_deg: float
) -> Elements:
    """Elements of one orbit from degrees."""
    return Elements(
        a_km=np.asarray(a_km, dtype=np.float64),
        e=np.asarray(e, dtype=np.float64),
        i_rad=np.asarray(np.radians(inclination_deg)),
        node_rad=np.asarray(np.radians(node_deg)),
        argp_rad=np.asarray(np.radians(perigee_deg)),
        mean_anomaly_rad=np.asarray(np.radians(mean_anomaly_deg)),
    )


class OrbitNumbers(Protocol):
    """Options that give an orbit by its osculating elements."""

    @property
    def semi_major_axis_km(self) -> float: ...  # noqa: D102 - named for what it is
    @property
    def eccentricity(self) -> float: ...  # noqa: D102
    @property
    def inclination_deg(self) -> float: ...  # noqa: D102
    @property
    def node_deg(self) -> float: ...  # noqa: D102
    @property
    def perigee_deg(self) -> float: ...  # noqa: D102
    @property
    def mean_anomaly_deg(self) -> float: ...  # noqa: D102


def elements_in(options: OrbitNumbers) -> Elements:
    """Elements of the orbit that some options give."""
    o = options
    return elements_deg(o.semi_major_axis_km, o.eccentricity, o.inclination_deg, o.node_deg, o.perigee_deg, o.mean_anomaly_deg)


def eccentric_anomaly(mean_anomaly_rad: Array, e: Array) -> Array:
    """Root of Kepler's equation by Newton's method from Danby's starting value; converges for e < 0.99 in 6 steps."""
    mean = np.mod(np.asarray(mean_anomaly_rad) + np.pi, 2 * np.pi) - np.pi
    ecc = mean + 0.85 * e * np.sign(np.sin(mean))
    for _ in range(9):
        ecc = ecc - (ecc - e * np.sin(ecc) - mean) / (1.0 - e * np.cos(ecc))
    return ecc


def state_of(elements: Elements, dt_s: Array | float = 0.0) -> tuple[Array, Array]:
    """Positions (..., 3) km and velocities (..., 3) km/s a time after the epoch of the elements."""
    a, e = np.asarray(elements.a_km), np.asarray(elements.e)
    motion = np.sqrt(MU_KM3_S2 / a**3)
    ecc = eccentric_anomaly(elements.mean_anomaly_rad + motion * dt_s, e)
    cos_e, sin_e, root = np.cos(ecc), np.sin(ecc), np.sqrt(1.0 - e * e)
    radius = a * (1.0 - e * cos_e)
    x, y = a * (cos_e - e), a * root * sin_e
    speed = motion * a * a / radius
    vx, vy = -speed * sin_e, speed * root * cos_e
    p_axis, q_axis = perifocal_axes(elements)
    position = x[..., None] * p_axis + y[..., None] * q_axis
    velocity = vx[..., None] * p_axis + vy[..., None] * q_axis
    return position, velocity


def perifocal_axes(elements: Elements) -> tuple[Array, Array]:
    """Unit vectors towards perigee and 90 deg ahead of it, each (..., 3)."""
    cn, sn = np.cos(elements.node_rad), np.sin(elements.node_rad)
    cw, sw = np.cos(elements.argp_rad), np.sin(elements.argp_rad)
    ci, si = np.cos(elements.i_rad), np.sin(elements.i_rad)
    p_axis = np.stack(np.broadcast_arrays(cn * cw - sn * sw * ci, sn * cw + cn * sw * ci, sw * si), axis=-1)
    q_axis = np.stack(np.broadcast_arrays(-cn * sw - sn * cw * ci, -sn * sw + cn * cw * ci, cw * si), axis=-1)
    return p_axis, q_axis


def elements_of(position_km: Array, velocity_km_s: Array) -> Elements:
    """Osculating elements of states (..., 3); circular or equatorial orbits give some valid set of angles."""
    r = np.asarray(position_km, dtype=np.float64)
    v = np.asarray(velocity_km_s, dtype=np.float64)
    a, e, ecc, inclination, h = _shape_of(r, v)
    h_norm = np.linalg.norm(h, axis=-1)
    node = np.arctan2(h[..., 0], -h[..., 1])
    node = np.where(np.hypot(h[..., 0], h[..., 1]) < 1e-12 * h_norm, 0.0, node)
    bounded = np.clip(e, 0.0, 1.0 - 1e-12)
    true = np.arctan2(np.sqrt(1.0 - bounded * bounded) * np.sin(ecc), np.cos(ecc) - bounded)
    cn, sn = np.cos(node), np.sin(node)
    along = r[..., 0] * cn + r[..., 1] * sn
    across = np.sum(r * np.cross(h / h_norm[..., None], np.stack([cn, sn, np.zeros_like(cn)], axis=-1)), axis=-1)
    latitude_argument = np.arctan2(across, along)
    return Elements(
        a_km=a, e=e, i_rad=inclination, node_rad=node, argp_rad=latitude_argument - true, mean_anomaly_rad=ecc - e * np.sin(ecc)
    )


def size_shape_inclination(position_km: Array, velocity_km_s: Array) -> tuple[Array, Array, Array]:
    """Semi-major axis (km), eccentricity and inclination (rad) of states (..., 3): a third of the work of `elements_of`."""
    a, e, _, inclination, _ = _shape_of(position_km, velocity_km_s)
    return a, e, inclination


def _shape_of(r: Array, v: Array) -> tuple[Array, Array, Array, Array, Array]:
    """Semi-major axis, eccentricity, eccentric anomaly, inclination, and angular momentum (..., 3), of states (..., 3)."""
    radius = np.linalg.norm(r, axis=-1)
    speed2 = np.sum(v * v, axis=-1)
    a = 1.0 / (2.0 / radius - speed2 / MU_KM3_S2)
    h = np.cross(r, v)
    inclination = np.arctan2(np.hypot(h[..., 0], h[..., 1]), h[..., 2])
    e_cos = 1.0 - radius / a
    e_sin = np.sum(r * v, axis=-1) / np.sqrt(MU_KM3_S2 * np.abs(a))
    return a, np.hypot(e_cos, e_sin), np.arctan2(e_sin, e_cos), inclination, h


def velocity_through(
    position_km: Array,
    a_km: Array,
    e: Array,
    i_rad: Array,
    ascending: NDArray[np.bool_],
    outbound: NDArray[np.bool_],
    *,
    just_missing: bool = False,
) -> Array:
    """Velocities (n, 3) of the orbits of given size, shape and inclination that pass through points (n, 3).

    `ascending` and `outbound` (bool) choose among the four of them. NaN where none passes: outside [perigee, apogee],
    or beyond the inclination in latitude; `just_missing`: the velocity at the apsis or the highest latitude there.
    """
    radius = np.linalg.norm(position_km, axis=-1)
    up = position_km / radius[..., None]
    sin_lat = up[..., 2]
    cos_lat = np.sqrt(np.clip(1.0 - sin_lat * sin_lat, 1e-300, None))
    east = np.stack([-up[..., 1], up[..., 0], np.zeros_like(radius)], axis=-1) / cos_lat[..., None]
    north = np.cross(up, east)
    speed2 = MU_KM3_S2 * (2.0 / radius - 1.0 / a_km)
    horizontal = np.sqrt(MU_KM3_S2 * a_km * (1.0 - e * e)) / radius
    sin_azimuth = np.cos(i_rad) / cos_lat
    vertical2 = speed2 - horizontal * horizontal
    if just_missing:
        vertical2, sin_azimuth = np.maximum(vertical2, 0.0), np.clip(sin_azimuth, -1.0, 1.0)
    with np.errstate(invalid="ignore"):
        vertical = np.sqrt(vertical2) * np.where(outbound, 1.0, -1.0)
        cos_azimuth = np.sqrt(1.0 - sin_azimuth * sin_azimuth) * np.where(ascending, 1.0, -1.0)
    return vertical[..., None] * up + (horizontal * sin_azimuth)[..., None] * east + (horizontal * cos_azimuth)[..., None] * north
