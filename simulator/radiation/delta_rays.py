"""Delta rays: electrons that a proton or nucleus knocks out so hard that they leave tracks of their own."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from simulator.radiation.energy_loss import ELECTRON_MEV, SILICON, beta_gamma, landau_xi_kev, maximum_transfer_mev

Array = NDArray[np.float64]

CUT_KEV: Final = 30.0
"""Energy above which they have tracks: 8 um of range in silicon, about a pixel. Softer ones belong to the parent's track."""


@dataclass(frozen=True, kw_only=True, eq=False)
class DeltaRays:
    """(m,) each: the parent's index, where on its path (0 to 1), energy; direction (m, 3)."""

    parent: NDArray[np.int64]
    share: Array
    energy_mev: Array
    direction: Array


def knocked_out(rng: np.random.Generator, energy_mev_u: Array, charge: Array, path_um: Array, direction: Array) -> DeltaRays:
    """Those of particles on their paths.

    ``d2N/dT = xi / T^2 (1 - beta^2 T / T_max)`` and ``cos = T (p_max / p T_max)`` from Workman et al. 2022, section 34.2.5.
    """
    bg = beta_gamma(energy_mev_u)
    beta2 = bg**2 / (1.0 + bg**2)
    hardest = np.maximum(1e3 * maximum_transfer_mev(bg), CUT_KEV)
    xi = landau_xi_kev(energy_mev_u, path_um, SILICON, charge)
    # More are proposed than there are: xi / T^2, then thinned by the factor of spin.
    parent = np.repeat(np.arange(path_um.size), rng.poisson(xi * (1.0 / CUT_KEV - 1.0 / hardest)))
    top = hardest[parent]
    energy_kev = 1.0 / (1.0 / CUT_KEV - rng.random(parent.size) * (1.0 / CUT_KEV - 1.0 / top))
    kept = rng.random(parent.size) > beta2[parent] * energy_kev / top
    parent, energy_kev, top = parent[kept], energy_kev[kept], top[kept]
    rest_kev = 1e3 * ELECTRON_MEV
    cosine = np.sqrt(energy_kev * (top + 2.0 * rest_kev) / (top * (energy_kev + 2.0 * rest_kev)))
    return DeltaRays(
        parent=parent.astype(np.int64),
        share=rng.random(parent.size),
        energy_mev=1e-3 * energy_kev,
        direction=turned(direction[parent], np.minimum(cosine, 1.0), rng.random(parent.size) * 2.0 * np.pi),
    )


def turned(direction: Array, cosine: Array, azimuth: Array) -> Array:
    """Unit vectors at given angles from unit vectors (n, 3)."""
    helper = np.where(np.abs(direction[:, 2:]) < 0.9, np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0]))
    one = np.cross(direction, helper)
    one /= np.linalg.norm(one, axis=1, keepdims=True)
    two = np.cross(direction, one)
    sine = np.sqrt(1.0 - cosine**2)[:, None]
    return np.asarray(cosine[:, None] * direction + sine * (np.cos(azimuth)[:, None] * one + np.sin(azimuth)[:, None] * two))
