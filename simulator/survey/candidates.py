"""Candidates for passages, drawn from pools of pieces, and how many passages of nature each of them stands for."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from simulator.platform.kepler import velocity_through
from simulator.scene.debris import SizeClass, draw_orbits, low_orbit_share
from simulator.scene.encounters import NEAR_SHARE, Window, cell_density, expected_snr, number_density, reach_km
from simulator.scene.surface import Surfaces, draw_surfaces
from simulator.survey.flight import Flight, Instants
from simulator.survey.passages import Passages, make_passages

Array = NDArray[np.float64]

EVEN_SHARE: Final = 0.6
"""Of the candidates, how many have ranges even in volume, not in the logarithm."""

POOL: Final = 200_000  # pieces of a pool: `expected_passages` shows what they leave as the scatter between its rounds
SIZE_CELLS: Final = 48  # of ln size in a class, each with its share of a pool; more of them change nothing but time. Chosen
EVEN_SIZES: Final = 0.1
"""Of a pool's pieces, how many have sizes even in the logarithm. Chosen: it bounds what a piece can stand for."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Pool:
    """Pieces of a class: diameters and orbits.

    population (n,) : pieces of nature that each stands for, times the number of pieces.
    """

    size_m: Array
    population: Array
    a_km: Array
    e: Array
    i_rad: Array


def pool_of(flight: Flight, size_class: SizeClass, rng: np.random.Generator) -> Pool:
    """Pieces of a class: sizes as `_size_cells` has them, orbits of the population."""
    options = flight.options.population
    edges, share = _size_cells(flight, size_class)
    width = edges[1] - edges[0]
    cell = np.searchsorted(np.cumsum(share[:-1]), rng.random(POOL), side="right")
    size_m = np.exp(edges[cell] + width * rng.random(POOL))
    low = low_orbit_share(size_m, options.low_orbit_share_small, options.low_orbit_share_large)
    a_km, e, i_rad = draw_orbits(rng, size_m, spread=options.spread_by_breakup)
    return Pool(size_m=size_m, population=number_density(size_m) * low * width / share[cell], a_km=a_km, e=e, i_rad=i_rad)


def _size_cells(flight: Flight, size_class: SizeClass) -> tuple[Array, Array]:
    """Edges of cells of ln size (m), and the share of a pool's pieces of each: about as many as can be seen.

    That is their number times the volume within which they can have `snr_min`. All sizes then stand for about as many
    passages, and fewer candidates do. `EVEN_SIZES` of a pool are even in ln size, whatever can be seen.
    """
    options = flight.options.population
    edges = np.linspace(np.log(size_class.from_mm * 1e-3), np.log(size_class.to_mm * 1e-3), SIZE_CELLS + 1)
    size_m = np.exp(0.5 * (edges[1:] + edges[:-1]))
    one = np.ones(SIZE_CELLS)
    reach = farthest_km(flight, flight.window, size_m, Surfaces(albedo=options.albedo * one, specular=0.0 * one, colour=one))
    seen = number_density(size_m) * np.clip(reach, options.nearest_km, options.farthest_km) ** 3
    return edges, EVEN_SIZES / SIZE_CELLS + (1.0 - EVEN_SIZES) * seen / seen.sum()


def candidates(flight: Flight, at: Instants, pool: Pool, n: int, rng: np.random.Generator) -> Passages:
    """Those of n candidates of a pool that may be seen, `natural` for the time that the instants stand for."""
    options, window = flight.options.population, flight.window
    piece = rng.integers(len(pool.size_m), size=n)
    size_m = pool.size_m[piece]
    surfaces = draw_surfaces(rng.spawn(1)[0], n, options.albedo, options.surface, window.colour_factor)
    darkest = replace(window, noise_variance_e2=float(at.noise_e2.min()), attitude=at.attitude[0], sun_km=at.sun_km[0])
    reach = farthest_km(flight, darkest, size_m, surfaces, at.fastest_turn_rad_s(flight.camera.radius_rad))
    far = np.clip(reach, options.nearest_km * 1.001, options.farthest_km)
    near = np.maximum(options.nearest_km, far / NEAR_SHARE)
    span = np.log(far / near)
    shell = (far**3 - near**3) / 3.0
    even = rng.random(n) < EVEN_SHARE
    place = rng.random(n)
    range_km = np.empty(n)
    range_km[even] = np.cbrt(near[even] ** 3 + 3.0 * place[even] * shell[even])
    range_km[~even] = near[~even] * np.exp(place[~even] * span[~even])
    per_km = (1.0 - EVEN_SHARE) / (range_km * span) + EVEN_SHARE * range_km**2 / shell
    u, v = rng.uniform(-window.half_col, window.half_col, n), rng.uniform(-window.half_row, window.half_row, n)
    u, v = u + window.mid_col, v + window.mid_row
    slant = np.sqrt(1.0 + u * u + v * v)
    camera = np.stack([u, v, np.ones(n)], axis=1) * (range_km / slant)[:, None]
    instant = rng.integers(len(at.time_s), size=n)
    position = at.position_km[instant] + np.einsum("ni,nij->nj", camera, at.attitude[instant])
    a_km, e, i_rad = pool.a_km[piece], pool.e[piece], pool.i_rad[piece]
    signs = rng.random((2, n)) < 0.5
    with np.errstate(invalid="ignore"):
        density = cell_density(position, a_km, e, i_rad)
    kept = np.flatnonzero((density > 0.0) & (reach > options.nearest_km) & at.watched[instant])
    instant, camera, position, range_km = instant[kept], camera[kept], position[kept], range_km[kept]
    size_m, surfaces = size_m[kept], surfaces.taken(kept)
    velocity = velocity_through(position, a_km[kept], e[kept], i_rad[kept], signs[0, kept], signs[1, kept], just_missing=True)
    there = np.flatnonzero(np.isfinite(velocity).all(axis=1))
    solid_angle = 4.0 * window.half_row * window.half_col / slant[kept] ** 3
    natural = pool.population[piece[kept]] * density[kept] * solid_angle * range_km**2 / per_km[kept] * at.span_s / n
    return make_passages(
        flight, at, instant[there], size_m[there], surfaces.taken(there), position[there], velocity[there], natural[there]
    )


def farthest_km(flight: Flight, window: Window, size_m: Array, surfaces: Surfaces, turn_rad_s: float = 0.0) -> Array:
    """Range within which a piece can have `snr_min` in a window: at zero phase, in focus, as slow as counts.

    turn_rad_s : of the camera. It can follow a piece, whose trail is then shorter by so much than its motion against the stars.
    """
    options = flight.options.population
    slowest = max(float(np.radians(options.slowest_deg_s)) - turn_rad_s, 0.0)
    still, slow = (
        expected_snr(np.ones(1), np.array([rate]), np.array([window.exposure_s]), np.array([1e9]), window)[0]
        for rate in (0.0, slowest)
    )
    return np.asarray(reach_km(size_m, surfaces, options.snr_min, window) * np.sqrt(slow / still))
