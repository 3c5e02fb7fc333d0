"""Orbits of fragments: catalogued ones, and the same with the velocities that the NASA breakup model throws them off with.

`breakup_fragments.npz`, which the prior reads, holds ``breakup_counts(10_000_000, default_rng(SeedSequence(20270129)))``.
"""

import numpy as np
from numpy.typing import NDArray

from ground.orbit.dynamics import MU_KM3_S2
from ground.orbit.prior import LARGEST_A_KM, LOWEST_PERIGEE_KM, catalogue_counts
from ground.sky.apparent import EARTH_RADIUS_KM


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
        todo = todo[out[todo, 0] * (1.0 - out[todo, 1]) < LOWEST_PERIGEE_KM]
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
        alive = (drawn[:, 0] > 0.0) & (drawn[:, 0] * (1.0 - drawn[:, 1]) > LOWEST_PERIGEE_KM) & (drawn[:, 0] < LARGEST_A_KM)
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


def breakup_counts(
    n: int, rng: np.random.Generator
) -> tuple[NDArray[np.uint32], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Counts of n draws on a grid that widens outwards, and its edges in a (km), e and i (deg)."""
    a_edges = EARTH_RADIUS_KM + np.concatenate([np.arange(100.0, 2400.0, 50.0), np.geomspace(2400.0, 53000.0, 30)])
    e_widening = [np.arange(0.01, 0.1, 0.01), np.arange(0.1, 0.3, 0.02), np.arange(0.3, 0.96, 0.05)]
    e_edges = np.concatenate([[0.0, 0.002, 0.005], *e_widening])
    i_edges_deg = np.arange(0.0, 181.0, 2.0)
    counts = np.zeros((len(a_edges) - 1, len(e_edges) - 1, len(i_edges_deg) - 1), dtype=np.uint32)
    for start in range(0, n, 500_000):
        drawn = draw_breakup(min(500_000, n - start), rng)
        drawn[:, 2] = np.degrees(drawn[:, 2])
        counts += np.histogramdd(drawn, bins=(a_edges, e_edges, i_edges_deg))[0].astype(np.uint32)
    return counts, a_edges, e_edges, i_edges_deg
