"""What is known of an orbit before it is seen: catalogued debris, breakup velocities, fat tails.

Densities are of (a, e, i) with uniform node, perigee and anomaly. In Delaunay variables phase space has unit Jacobian, so
``p(r, v) = p(a, e, i) / ((2 pi)^3 * mu^1.5 a^0.5 e sin(i) / 2)`` (Goldstein, Poole & Safko 2002, section 10.8): space
density, speeds and their correlations follow from the element density alone, and no root is trivial: the volume of phase
space vanishes at the observer.
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ground.orbit.dynamics import MU_KM3_S2

CATALOGUE_FILE = "leo_deb_hist_2023.npz"
_LOWEST_PERIGEE_KM = 6378.137 + 120.0
"""Below this an object decays within the revolution in which it would be seen."""
_LARGEST_A_KM = 60000.0


class PriorTable(NamedTuple):
    """Element density as cells: probability per (km, 1, rad) in `density` (na, ne, ni), and weights of the analytic parts.

    tail_share : log-uniform in a, uniform in e below the decay limit, isotropic in inclination. ring_share : the
    geostationary ring and what has left it.
    """

    a_edges_km: NDArray[np.float64]
    e_edges: NDArray[np.float64]
    i_edges_rad: NDArray[np.float64]
    density: NDArray[np.float64]
    tail_share: float
    ring_share: float


@lru_cache(maxsize=1)
def catalogue_counts() -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Counts (88, 7, 72) of catalogued LEO fragments and the edges in a (km), e and i (rad); provenance beside the file."""
    with np.load(str(files("ground.orbit") / CATALOGUE_FILE), allow_pickle=False) as stored:
        return (
            stored["H"].astype(np.float64),
            stored["alt_edges"] + 6378.137,
            stored["ecc_edges"].copy(),
            np.radians(stored["inc_edges"]),
        )


def draw_catalogue(n: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Elements (n, 3) a (km), e, i (rad) of catalogued fragments, uniform inside their cells, perigee above the ground."""
    counts, a_edges, e_edges, i_edges = catalogue_counts()
    cumulative = np.cumsum(counts.ravel())
    out = np.empty((n, 3))
    todo = np.arange(n)
    while len(todo):
        cell = np.unravel_index(np.searchsorted(cumulative, rng.random(len(todo)) * cumulative[-1], side="right"), counts.shape)
        for column, (index, edges) in enumerate(zip(cell, (a_edges, e_edges, i_edges), strict=True)):
            out[todo, column] = edges[index] + rng.random(len(todo)) * (edges[index + 1] - edges[index])
        todo = todo[out[todo, 0] * (1.0 - out[todo, 1]) < _LOWEST_PERIGEE_KM]
    return out


def state_of_elements(elements: NDArray[np.float64], angles_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    """States (n, 6) km, km/s of elements (n, 3) and angles (n, 3): node, argument of perigee, mean anomaly."""
    a, e, inclination = elements.T
    node, perigee, mean = angles_rad.T
    eccentric = mean + e * np.sin(mean)
    for _ in range(12):
        eccentric -= (eccentric - e * np.sin(eccentric) - mean) / (1.0 - e * np.cos(eccentric))
    root = np.sqrt(1.0 - e**2)
    x, y = a * (np.cos(eccentric) - e), a * root * np.sin(eccentric)
    rate = np.sqrt(MU_KM3_S2 / a) / (1.0 - e * np.cos(eccentric))
    vx, vy = -rate * np.sin(eccentric), rate * root * np.cos(eccentric)
    cn, sn, cp, sp, ci, si = (
        np.cos(node),
        np.sin(node),
        np.cos(perigee),
        np.sin(perigee),
        np.cos(inclination),
        np.sin(inclination),
    )
    p = np.stack([cn * cp - sn * sp * ci, sn * cp + cn * sp * ci, sp * si], axis=1)
    q = np.stack([-cn * sp - sn * cp * ci, -sn * sp + cn * cp * ci, cp * si], axis=1)
    return np.hstack([x[:, None] * p + y[:, None] * q, vx[:, None] * p + vy[:, None] * q])


def draw_breakup_speed_km_s(n: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Ejection speeds (n,) of 1 mm to 10 cm fragments of collisions: NASA breakup model (Johnson et al. 2001, ASR 28, 1377).

    Sizes follow N(> L) ~ L^-1.71; area to mass chi = log10(A/M) is normal about -0.3 to -1.0 (small fragments); the
    logarithm of speed (m/s) is normal about 0.9 chi + 2.9 with 0.4.
    """
    size_m = (0.001**-1.71 - rng.random(n) * (0.001**-1.71 - 0.1**-1.71)) ** (-1.0 / 1.71)
    log_size = np.log10(size_m)
    mean = np.where(log_size <= -1.75, -0.3, np.where(log_size < -1.25, -0.3 - 1.4 * (log_size + 1.75), -1.0))
    spread = np.where(log_size <= -3.5, 0.2, 0.2 + 0.1333 * (log_size + 3.5))
    chi = mean + spread * rng.standard_normal(n)
    return np.asarray(10.0 ** (0.9 * chi + 2.9 + 0.4 * rng.standard_normal(n)) * 1e-3)


def draw_breakup(n: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Elements (n, 3) of fragments thrown off catalogued orbits in random directions; decayed and escaped ones left out."""
    out = np.empty((0, 3))
    while len(out) < n:
        m = max(2 * (n - len(out)), 1000)
        states = state_of_elements(draw_catalogue(m, rng), rng.random((m, 3)) * 2.0 * np.pi)
        direction = rng.standard_normal((m, 3))
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        states[:, 3:] += draw_breakup_speed_km_s(m, rng)[:, None] * direction
        drawn = elements_of_states(states)
        alive = (drawn[:, 0] > 0.0) & (drawn[:, 0] * (1.0 - drawn[:, 1]) > _LOWEST_PERIGEE_KM) & (drawn[:, 0] < _LARGEST_A_KM)
        out = np.vstack([out, drawn[alive]])
    return out[:n]


def elements_of_states(states: NDArray[np.float64]) -> NDArray[np.float64]:
    """Elements (n, 3) a (km), e, i (rad) of states (n, 6)."""
    r, v = states[:, :3], states[:, 3:]
    radius, v2 = np.linalg.norm(r, axis=1), np.einsum("ij,ij->i", v, v)
    a = 1.0 / (2.0 / radius - v2 / MU_KM3_S2)
    h = np.cross(r, v)
    vector = np.cross(v, h) / MU_KM3_S2 - r / radius[:, None]
    inclination = np.arccos(np.clip(h[:, 2] / np.linalg.norm(h, axis=1), -1.0, 1.0))
    return np.column_stack([a, np.linalg.norm(vector, axis=1), inclination])


_BREAKUP_DRAWS = 2_000_000


@lru_cache(maxsize=1)
def breakup_density() -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Density per (km, 1, rad) of `draw_breakup` on a grid that widens outwards, and the edges in a, e and i.

    Drawn once per process with a fixed seed and smoothed over neighbouring cells: two million draws leave 1 % of noise in the
    cells that hold most of the mass.
    """
    a_edges = 6378.137 + np.concatenate([np.arange(100.0, 2400.0, 50.0), np.geomspace(2400.0, 53000.0, 30)])
    e_edges = np.concatenate(
        [[0.0, 0.002, 0.005], np.arange(0.01, 0.1, 0.01), np.arange(0.1, 0.3, 0.02), np.arange(0.3, 0.96, 0.05)]
    )
    i_edges = np.radians(np.arange(0.0, 181.0, 2.0))
    drawn = draw_breakup(_BREAKUP_DRAWS, np.random.default_rng(np.random.SeedSequence(20270129)))
    counts, _ = np.histogramdd(drawn, bins=(a_edges, e_edges, i_edges))
    for axis in range(3):
        counts = _blurred(counts, axis)
    volume = np.diff(a_edges)[:, None, None] * np.diff(e_edges)[None, :, None] * np.diff(i_edges)[None, None, :]
    return counts / counts.sum() / volume, a_edges, e_edges, i_edges


def _blurred(counts: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
    """Counts with a tenth moved to either neighbour along an axis; nothing leaves the grid."""
    moved = np.moveaxis(counts, axis, 0)
    out = 0.8 * moved
    out[1:] += 0.1 * moved[:-1]
    out[:-1] += 0.1 * moved[1:]
    out[0] += 0.1 * moved[0]
    out[-1] += 0.1 * moved[-1]
    return np.moveaxis(out, 0, axis)


@dataclass(frozen=True, kw_only=True)
class PriorShares:
    """Parts of the prior: catalogued fragments, breakup fragments, tail and geostationary ring; they need not sum to one."""

    catalogue: float
    breakup: float
    tail: float
    ring: float


@lru_cache(maxsize=8)
def prior_table(shares: PriorShares) -> PriorTable:
    """The mixture on one grid: the union of the edges of its parts."""
    counts, a_edges, e_edges, i_edges = catalogue_counts()
    volume = np.diff(a_edges)[:, None, None] * np.diff(e_edges)[None, :, None] * np.diff(i_edges)[None, None, :]
    parts = [(shares.catalogue * counts / counts.sum() / volume, a_edges, e_edges, i_edges)]
    if shares.breakup > 0.0:
        density, a_wide, e_wide, i_wide = breakup_density()
        parts.append((shares.breakup * density, a_wide, e_wide, i_wide))
    union = [np.unique(np.round(np.concatenate([part[k] for part in parts]), 9)) for k in (1, 2, 3)]
    middles = [0.5 * (edges[1:] + edges[:-1]) for edges in union]
    total = np.zeros(tuple(len(m) for m in middles))
    for density, *edges in parts:
        index = [np.searchsorted(edge, middle) - 1 for edge, middle in zip(edges, middles, strict=True)]
        inside = [(k >= 0) & (k < len(edge) - 1) for k, edge in zip(index, edges, strict=True)]
        total[np.ix_(*inside)] += density[np.ix_(*(k[ok] for k, ok in zip(index, inside, strict=True)))]
    return PriorTable(
        a_edges_km=union[0],
        e_edges=union[1],
        i_edges_rad=union[2],
        density=total,
        tail_share=shares.tail,
        ring_share=shares.ring,
    )


@njit(cache=True)
def phase_space_density(prior: PriorTable, a_km: float, e: float, i_rad: float) -> float:
    """p(r, v) in 1 / (km^3 (km/s)^3) for a state with these elements; zero for unbound and decaying orbits."""
    if not (0.0 < a_km < _LARGEST_A_KM) or e >= 1.0 or a_km * (1.0 - e) < _LOWEST_PERIGEE_KM:
        return 0.0
    density = 0.0
    ka = np.searchsorted(prior.a_edges_km, a_km) - 1
    ke = np.searchsorted(prior.e_edges, e) - 1
    ki = np.searchsorted(prior.i_edges_rad, i_rad) - 1
    if 0 <= ka < prior.density.shape[0] and 0 <= ke < prior.density.shape[1] and 0 <= ki < prior.density.shape[2]:
        density += prior.density[ka, ke, ki]
    sine = max(math.sin(i_rad), 1e-4)
    highest_e = 1.0 - _LOWEST_PERIGEE_KM / a_km
    # log-uniform in a over ln(60000 / 6500) = 2.22; e uniform in its square: rounder orbits are as likely per unit of e^2
    density += prior.tail_share / (2.22 * a_km) * 0.5 * sine * 2.0 * e / max(highest_e, 1e-3) ** 2
    offset = (a_km - 42164.0) / 400.0
    if abs(offset) < 6.0 and i_rad < 0.28 and e < 0.1:
        density += prior.ring_share * math.exp(-0.5 * offset * offset) / 1002.65 * math.exp(-e / 0.005) / 0.005 / 0.28
    return density / (0.5 * (2.0 * math.pi) ** 3 * MU_KM3_S2**1.5 * math.sqrt(a_km) * max(e, 1e-5) * sine)
