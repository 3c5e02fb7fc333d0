"""Straggling: how the energy that one particle loses in the sensitive layer scatters about its most probable value."""

from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri
from scipy.stats import landau

from simulator.radiation.energy_loss import (
    Material,
    beta_gamma,
    binding_width_kev,
    landau_xi_kev,
    maximum_transfer_mev,
    most_probable_loss_kev,
)

PAIR_EV: Final = 3.65
"""Mean energy for one electron-hole pair in silicon (Scholze et al. 1998, J. Appl. Phys. 84, 2926: 3.66 eV)."""

FANO: Final = 0.115
"""Variance over mean of the number of pairs (Owens et al. 2002, Nucl. Instr. Meth. A 491, 437)."""

_LANDAU_MODE: Final = -0.22278298
"""Mode of the standard Landau distribution: the most probable loss lies there."""
_NODES: Final = 8192


@cache
def landau_quantiles() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Probabilities and quantiles of the standard Landau distribution.

    Nodes are dense in both tails; beyond the last one, at 1 - 1e-5, losses exceed the largest transfer of any proton here.
    """
    middle = (np.arange(_NODES) + 0.5) / _NODES
    tail = 10.0 ** np.linspace(-5.0, -3.0, 200)
    probability = np.unique(np.concatenate([tail, middle, 1.0 - tail]))
    return probability, landau.ppf(probability)


def draw_loss_kev(
    rng: np.random.Generator,
    energy_mev_u: NDArray[np.float64],
    path_um: NDArray[np.float64],
    charge: NDArray[np.float64],
    material: Material,
    quantiles: tuple[NDArray[np.float64], NDArray[np.float64]],
) -> NDArray[np.float64]:
    """Energy losses of particles along their paths: Landau's law plus the Gaussian width of bound electrons.

    The Gaussian is cut where the loss would fall below a tenth of the most probable one; losses end at the most probable one
    plus the largest transfer to one electron.
    """
    xi = landau_xi_kev(energy_mev_u, path_um, material, charge)
    mode = most_probable_loss_kev(energy_mev_u, path_um, material, charge)
    loss = mode + xi * (np.interp(rng.random(mode.size), *quantiles) - _LANDAU_MODE)
    width = binding_width_kev(energy_mev_u, path_um, material, charge)
    share = ndtr(np.clip((0.1 * mode - loss) / np.maximum(width, 1e-9), -8.0, 8.0))
    uniform = share + rng.random(mode.size) * (1.0 - share)
    loss = loss + width * ndtri(np.clip(uniform, 1e-12, 1.0 - 1e-12))
    return np.asarray(np.clip(loss, 0.0, mode + 1e3 * maximum_transfer_mev(beta_gamma(energy_mev_u))))
