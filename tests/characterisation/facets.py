"""Light of bodies made of plane faces, in the sight of a site: truth for tests, which shares no code with ground."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SUN = np.array([1.0, 0.0, 0.0])


@dataclass(frozen=True, kw_only=True, eq=False)
class Body:
    """normal : (m, 3) of the faces in body axes. area_albedo : (m,) m2, diffuse; mirror : (m,) m2, of a lobe of `sharpness`.

    axis : (3,) of rotation, fixed to the stars and to the body; period_s : infinite at rest.
    """

    normal: Array
    area_albedo: Array
    mirror: Array
    sharpness: float
    axis: Array
    period_s: float


def turned(vectors: Array, axis: Array, angle: Array) -> Array:
    """Rodrigues' rotation of vectors (m, 3) through angles (n,): (n, m, 3)."""
    cosine, sine = np.cos(angle)[:, None, None], np.sin(angle)[:, None, None]
    along = (vectors @ axis)[:, None] * axis
    return vectors * cosine + np.cross(axis, vectors) * sine + along * (1.0 - cosine)


def magnitude(body: Body, t_s: Array, to_observer_km: Array, start_rad: float) -> Array:
    """Apparent V (n,) with the Sun along x. to_observer_km : (n, 3)."""
    range_km = np.linalg.norm(to_observer_km, axis=1)
    sight = to_observer_km / range_km[:, None]
    normal = turned(body.normal, body.axis, start_rad + 2.0 * np.pi * t_s / body.period_s)
    lit = np.clip(normal @ SUN, 0.0, None)
    seen = np.clip(np.einsum("nmk,nk->nm", normal, sight), 0.0, None)
    half = sight + SUN
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    lobe = np.clip(np.einsum("nmk,nk->nm", normal, half), 0.0, None) ** body.sharpness
    light = (lit * seen / np.pi) @ body.area_albedo + ((lit > 0) * (seen > 0) * lobe) @ body.mirror
    return np.asarray(-26.74 - 2.5 * np.log10(np.maximum(light, 1e-6) / (range_km * 1e3) ** 2))


def box(rng: np.random.Generator, period_s: float, *, mirror: float = 0.0) -> Body:
    """A box with unlike sides (albedo 0.1 to 0.6), turning about an oblique axis."""
    edges = rng.uniform(1.0, 3.0, 3)
    areas = np.repeat([edges[1] * edges[2], edges[2] * edges[0], edges[0] * edges[1]], 2)
    normal = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=float)
    axis = rng.normal(size=3)
    return Body(
        normal=normal,
        area_albedo=areas * rng.uniform(0.1, 0.6, 6),
        mirror=areas * mirror,
        sharpness=400.0,
        axis=axis / np.linalg.norm(axis),
        period_s=period_s,
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Sight:
    """A pass. t_s : (n,). to_observer_km : (n, 3). phase_rad, range_km : (n,)."""

    t_s: Array
    to_observer_km: Array
    phase_rad: Array
    range_km: Array


def sight(rng: np.random.Generator, *, span_s: float = 400.0, step_s: float = 2.0) -> Sight:
    """An object in the geostationary ring or a navigation orbit, seen from the turning Earth at a phase of 15 to 100 deg."""
    radius = rng.choice([42164.0, 26560.0])
    rate = np.sqrt(398600.4418 / radius**3)
    t_s = np.arange(0.0, span_s, step_s) + rng.uniform(0.0, 0.2)
    while True:
        angle, latitude, longitude = rng.uniform(0, 2 * np.pi), rng.uniform(-0.9, 0.9), rng.uniform(0, 2 * np.pi)
        tilt = rng.uniform(0.0, 1.0)
        u = angle + rate * t_s
        place = radius * np.column_stack([np.cos(u), np.sin(u) * np.cos(tilt), np.sin(u) * np.sin(tilt)])
        east = longitude + 7.292115e-5 * t_s
        site = 6378.0 * np.column_stack(
            [np.cos(latitude) * np.cos(east), np.cos(latitude) * np.sin(east), np.full(len(t_s), np.sin(latitude))]
        )
        to_observer = site - place
        range_km = np.linalg.norm(to_observer, axis=1)
        phase = np.arccos(np.clip(to_observer @ SUN / range_km, -1, 1))
        up = np.einsum("nk,nk->n", site, -to_observer) / 6378.0 / range_km
        if up.min() > 0.35 and np.radians(15) < phase.mean() < np.radians(100):
            return Sight(t_s=t_s, to_observer_km=to_observer, phase_rad=phase, range_km=range_km)


def noisy(rng: np.random.Generator, mag: Array, sigma: float, *, slow: float = 0.0) -> Array:
    """Magnitudes with white noise and a drift of the air's transparency (a random walk that ends `slow` mag away)."""
    return np.asarray(mag + rng.normal(0.0, sigma, len(mag)) + np.cumsum(rng.normal(0.0, slow / np.sqrt(len(mag)), len(mag))))
