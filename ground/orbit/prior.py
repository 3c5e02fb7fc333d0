"""Prior of orbits: catalogued debris, breakup velocities, and wide tails.

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
from ground.sky.apparent import EARTH_RADIUS_KM

CATALOGUE_FILE = "leo_deb_hist_2023.npz"
BREAKUP_FILE = "breakup_fragments.npz"
LOWEST_PERIGEE_KM = EARTH_RADIUS_KM + 120.0
"""Below this an object decays within the revolution in which it would be seen."""
LARGEST_A_KM = 60000.0
"""Beyond the geostationary ring and the disposal orbits above it; catalogued debris with larger axes is rare."""


class PriorTable(NamedTuple):
    """Element density as cells: probability per (km, 1, rad) in `density` (na, ne, ni), and weights of the analytic parts.

    tail_share : log-uniform in a, uniform in e^2 below the decay limit, isotropic in inclination. ring_share : the
    geostationary ring and objects that have left it.
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
            stored["alt_edges"] + EARTH_RADIUS_KM,
            stored["ecc_edges"].copy(),
            np.radians(stored["inc_edges"]),
        )


@lru_cache(maxsize=1)
def breakup_density() -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Density per (km, 1, rad) of `breakup.draw_breakup`, from ten million stored draws, and the edges in a, e and i."""
    with np.load(str(files("ground.orbit") / BREAKUP_FILE), allow_pickle=False) as stored:
        counts = stored["counts"].astype(np.float64)
        a_edges, e_edges, i_edges = stored["a_edges_km"].copy(), stored["e_edges"].copy(), np.radians(stored["i_edges_deg"])
    volume = np.diff(a_edges)[:, None, None] * np.diff(e_edges)[None, :, None] * np.diff(i_edges)[None, None, :]
    return counts / counts.sum() / volume, a_edges, e_edges, i_edges


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
    if not (0.0 < a_km < LARGEST_A_KM) or e >= 1.0 or a_km * (1.0 - e) < LOWEST_PERIGEE_KM:
        return 0.0
    density = 0.0
    ka = np.searchsorted(prior.a_edges_km, a_km) - 1
    ke = np.searchsorted(prior.e_edges, e) - 1
    ki = np.searchsorted(prior.i_edges_rad, i_rad) - 1
    if 0 <= ka < prior.density.shape[0] and 0 <= ke < prior.density.shape[1] and 0 <= ki < prior.density.shape[2]:
        density += prior.density[ka, ke, ki]
    sine = max(math.sin(i_rad), 1e-4)
    highest_e = 1.0 - LOWEST_PERIGEE_KM / a_km
    # log-uniform in a over ln(60000 / 6500) = 2.22; e uniform in its square: rounder orbits are as likely per unit of e^2
    density += prior.tail_share / (2.22 * a_km) * 0.5 * sine * 2.0 * e / max(highest_e, 1e-3) ** 2
    offset = (a_km - 42164.0) / 400.0
    if abs(offset) < 6.0 and i_rad < 0.28 and e < 0.1:
        density += prior.ring_share * math.exp(-0.5 * offset * offset) / 1002.65 * math.exp(-e / 0.005) / 0.005 / 0.28
    return density / (0.5 * (2.0 * math.pi) ** 3 * MU_KM3_S2**1.5 * math.sqrt(a_km) * max(e, 1e-5) * sine)
