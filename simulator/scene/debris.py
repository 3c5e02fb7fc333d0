"""The debris population: number of pieces by size, and their orbits."""

from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from simulator.platform.earth import EARTH_RADIUS_KM
from simulator.platform.kepler import Elements, size_shape_inclination, state_of

Array = NDArray[np.float64]

HISTOGRAM_PATH: Final = Path(__file__).parent / "leo_deb_hist_2023.npz"
BLOCK: Final = 4096  # orbits whose intermediate arrays fit a core's cache together. Chosen


@dataclass(frozen=True, kw_only=True)
class SizeClass:
    """A range of diameters and how many objects of it a run shows."""

    from_mm: float = field(default=1.0, metadata={"doc": "smallest diameter", "min": 0.05, "max": 1e5})
    to_mm: float = field(default=10.0, metadata={"doc": "largest diameter", "min": 0.05, "max": 1e5})
    count: int = field(default=3, metadata={"doc": "objects drawn", "min": 0, "max": 10000})


@cache
def orbit_histogram() -> tuple[NDArray[np.intp], Array, Array, Array, Array]:
    """Cumulative weights of the occupied cells of the joint histogram, and their lower edges and widths.

    Returns (flat cell numbers, cumulative shares, altitude edges, eccentricity edges, inclination edges).
    """
    with np.load(HISTOGRAM_PATH) as content:
        counts = content["H"].astype(np.float64)
        edges = content["alt_edges"], content["ecc_edges"], content["inc_edges"]
    cells = np.flatnonzero(counts)
    share = np.cumsum(counts.ravel()[cells])
    return cells, share / share[-1], *edges


def draw_orbits(rng: np.random.Generator, size_m: Array, *, spread: bool) -> tuple[Array, Array, Array]:
    """Semi-major axis (km), eccentricity and inclination (rad) for pieces of given diameters.

    Cell by its count, uniform inside it; perigees below 150 km are drawn anew. With `spread`, the velocity change of a
    break-up (Johnson et al. 2001, ASR 28, 1377) at a random point of the orbit widens the catalogued distribution, which
    holds pieces of 10 cm and more.
    """
    n = len(size_m)
    a_km, e, inclination = np.zeros(n), np.zeros(n), np.zeros(n)
    todo = np.arange(n)
    while todo.size:
        a_new, e_new, i_new = _draw_catalogued(rng, todo.size)
        if spread:
            a_new, e_new, i_new = _break_up(rng, a_new, e_new, i_new, size_m[todo])
        good = (a_new * (1.0 - e_new) > EARTH_RADIUS_KM + 150.0) & (e_new < 0.95) & (a_new > 0.0) & (a_new < 60000.0)
        kept = todo[good]
        a_km[kept], e[kept], inclination[kept] = a_new[good], e_new[good], i_new[good]
        todo = todo[~good]
    return a_km, e, inclination


def _draw_catalogued(rng: np.random.Generator, n: int) -> tuple[Array, Array, Array]:
    cells, share, altitude, eccentricity, inclination = orbit_histogram()
    shape = (altitude.size - 1, eccentricity.size - 1, inclination.size - 1)
    i, j, k = np.unravel_index(cells[np.searchsorted(share, rng.random(n), side="right")], shape)

    def inside(edges: Array, cell: NDArray[np.intp]) -> Array:
        return np.asarray(edges[cell] + rng.random(n) * (edges[cell + 1] - edges[cell]))

    return EARTH_RADIUS_KM + inside(altitude, i), inside(eccentricity, j), np.radians(inside(inclination, k))


def _break_up(rng: np.random.Generator, a_km: Array, e: Array, i_rad: Array, size_m: Array) -> tuple[Array, Array, Array]:
    """Elements after an isotropic velocity change at a random point."""
    n = len(a_km)
    angles = rng.uniform(0.0, 2 * np.pi, (3, n))
    kick = rng.standard_normal((n, 3))
    kick *= (breakup_speed_m_s(rng, size_m) * 1e-3 / np.linalg.norm(kick, axis=1))[:, None]
    a_new, e_new, i_new = np.zeros(n), np.zeros(n), np.zeros(n)
    for first in range(0, n, BLOCK):
        part = slice(first, first + BLOCK)
        node, argp, anomaly = angles[:, part]
        position, velocity = state_of(
            Elements(a_km=a_km[part], e=e[part], i_rad=i_rad[part], node_rad=node, argp_rad=argp, mean_anomaly_rad=anomaly)
        )
        with np.errstate(invalid="ignore"):
            a_new[part], e_new[part], i_new[part] = size_shape_inclination(position, velocity + kick[part])
    unbound = ~np.isfinite(a_new) | (a_new <= 0.0)
    return np.where(unbound, -1.0, a_new), np.where(unbound, 0.0, e_new), i_new


def breakup_speed_m_s(rng: np.random.Generator, size_m: Array) -> Array:
    """Velocity change of collision fragments by diameter.

    Johnson et al. 2001: ``log10 A/M`` normal about a mean that falls from -0.3 (below 1.8 cm) to -1 (above 5.6 cm), the
    branch for pieces below 8 cm; ``log10 dv = N(0.9 log10 A/M + 2.9, 0.4)`` m/s. Larger pieces, whose catalogued orbits
    hold their own velocity changes already, fade out between 8 and 11 cm.
    """
    logarithm = np.log10(size_m)
    mean = np.clip(-0.3 - 1.4 * (logarithm + 1.75), -1.0, -0.3)
    sigma = np.clip(0.2 + 0.1333 * (logarithm + 3.5), 0.2, None)
    area_to_mass = mean + sigma * rng.standard_normal(len(size_m))
    speed = 10.0 ** (0.9 * area_to_mass + 2.9 + 0.4 * rng.standard_normal(len(size_m)))
    return np.asarray(speed * np.clip((0.11 - size_m) / 0.03, 0.0, 1.0))


def number_larger(size_m: Array | float) -> Array:
    """Objects in Earth orbit larger than a diameter: 3.65e4 (d / 10 cm)^-1.45, below 1 cm 1.04e6 (d / 1 cm)^-2.10.

    Fitted to ESA's MASTER-8 population of 2021.
    """
    size = np.asarray(size_m, dtype=np.float64)
    return np.where(size >= 0.01, 3.65e4 * (size / 0.1) ** -1.45, 1.04e6 * (size / 0.01) ** -2.10)


def low_orbit_share(size_m: Array, small: float, large: float) -> Array:
    """Share of the population in low orbits, by diameter: `small` below 1 cm, `large` above 10 cm."""
    return np.asarray(small + (large - small) * np.clip(np.log10(np.asarray(size_m) / 0.01), 0.0, 1.0))
