"""Straggling: how the energy that one particle loses in the sensitive layer scatters about its most probable value."""

from functools import cache
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from simulator.radiation.energy_loss import (
    ELECTRON_MEV,
    PROTON_MEV,
    Material,
    beta_gamma,
    binding_width_kev,
    landau_xi_kev,
    maximum_transfer_mev,
    most_probable_loss_kev,
    stopping_power_mev_cm2_g,
)

PAIR_EV: Final = 3.65
"""Mean energy for one electron-hole pair in silicon (Scholze et al. 1998, J. Appl. Phys. 84, 2926: 3.66 eV)."""

FANO: Final = 0.115
"""Variance over mean of the number of pairs (Owens et al. 2002, Nucl. Instr. Meth. A 491, 437)."""

_LANDAU_MODE: Final = -0.22278298
"""Mode of the standard Landau distribution."""

_EULER_REST: Final = 0.4227843351
"""1 minus Euler's constant."""

_GAMMA_ABOVE: Final = 0.1
"""Least ratio xi / T_max at which a loss has enough collisions to be described by three moments."""

_NODES: Final = 8192
"""Even probabilities between the tails: interpolated quantiles are off by 3.4e-6 in probability, 0.3 % in loss, at most."""


class LandauTable(NamedTuple):
    """Standard Landau distribution: probabilities, their quantiles, and the mean of all that lies below each quantile."""

    probability: NDArray[np.float64]
    quantile: NDArray[np.float64]
    mean_below: NDArray[np.float64]


@cache
def landau_table() -> LandauTable:
    """Nodes dense in both tails, up to the millionth part of the upper one."""
    from scipy.stats import landau  # takes half a second, which programs that draw no particles do not need

    middle = (np.arange(_NODES) + 0.5) / _NODES
    tail = 10.0 ** np.linspace(-6.0, -3.0, 600)
    probability = np.unique(np.concatenate([tail, middle, 1.0 - tail]))
    quantile = landau.ppf(probability)
    steps = 0.5 * (quantile[1:] + quantile[:-1]) * np.diff(probability)
    integral = quantile[0] * probability[0] + np.concatenate([[0.0], np.cumsum(steps)])
    return LandauTable(probability, quantile, integral / probability)


def draw_loss_kev(
    rng: np.random.Generator,
    energy_mev_u: NDArray[np.float64],
    path_um: NDArray[np.float64],
    charge: NDArray[np.float64],
    material: Material,
    table: LandauTable,
    *,
    cut_kev: float = np.inf,
) -> NDArray[np.float64]:
    """Energy losses of heavy particles along their paths; their mean is Bethe's.

    cut_kev : collisions that give more than this are left out (they are electrons with tracks of their own).

    By kappa = xi / T_max (Seltzer & Berger 1964, NAS-NRC 1133, 187):

    * below 0.1 Landau's law about the most probable loss, its endless tail cut where the mean of Landau's variable is
      ``-(1 - C + beta^2 + ln kappa)``, which makes the mean loss right (as GEANT 3 does), plus the Gaussian width of bound
      electrons, itself cut where the loss would fall below a tenth of the most probable one;
    * above it (slow protons on long paths, heavy nuclei) a gamma distribution with Vavilov's mean, variance
      ``xi T_max (1 - beta^2 / 2)`` and skewness ``(1/2 - beta^2/3) / sqrt(kappa (1 - beta^2/2)^3)`` (Vavilov 1957).
    """
    bg = beta_gamma(energy_mev_u)
    beta2 = bg**2 / (1.0 + bg**2)
    hardest = 1e3 * maximum_transfer_mev(bg)
    top = np.minimum(hardest, cut_kev)
    xi = landau_xi_kev(energy_mev_u, path_um, material, charge)
    mean = 0.1 * stopping_power_mev_cm2_g(energy_mev_u, material, charge) * material.density_g_cm3 * path_um
    # What harder collisions would give on the mean: xi / T^2 (1 - beta^2 T / T_max) above the cut (PDG, equation 34.8).
    mean = mean - xi * (np.log(hardest / top) - beta2 * (1.0 - top / hardest))
    width = binding_width_kev(energy_mev_u, path_um, material, charge)
    mode = most_probable_loss_kev(energy_mev_u, path_um, material, charge)
    mean_lambda = -(_EULER_REST + beta2 * top / hardest + np.log(xi / top))
    return _scattered_loss_kev(rng, mean, mode, mean_lambda, xi, top, beta2 * top / hardest, width, table)


def draw_electron_loss_kev(
    rng: np.random.Generator,
    energy_mev: NDArray[np.float64],
    path_um: NDArray[np.float64],
    mean_kev: NDArray[np.float64],
    material: Material,
    table: LandauTable,
) -> NDArray[np.float64]:
    """The same for electrons of a mean loss: they give half of their energy at most (the faster one counts as the same).

    Landau's law knows a particle by its velocity only: that of a proton with the same beta gamma is asked.
    """
    equal_mev = np.asarray(energy_mev) / ELECTRON_MEV * PROTON_MEV
    one = np.ones(path_um.shape)
    xi = landau_xi_kev(equal_mev, path_um, material)
    mode = most_probable_loss_kev(equal_mev, path_um, material)
    width = binding_width_kev(equal_mev, path_um, material)
    mean_lambda = (mean_kev - mode) / xi + _LANDAU_MODE
    return _scattered_loss_kev(rng, mean_kev, mode, mean_lambda, xi, 500.0 * energy_mev, 0.5 * one, width, table)


def _scattered_loss_kev(
    rng: np.random.Generator,
    mean: NDArray[np.float64],
    mode: NDArray[np.float64],
    mean_lambda: NDArray[np.float64],
    xi: NDArray[np.float64],
    top: NDArray[np.float64],
    beta2: NDArray[np.float64],
    width: NDArray[np.float64],
    table: LandauTable,
) -> NDArray[np.float64]:
    """Landau's law for few collisions, a gamma distribution for many; beta2 : weight of the term of spin in the cross-section."""
    kappa = xi / top
    few = (kappa < _GAMMA_ABOVE) & (mode > 0.0)
    loss = np.empty_like(mean)
    loss[few] = _landau_loss_kev(rng, mode[few], xi[few], mean_lambda[few], width[few], table)
    many = ~few
    variance = xi[many] * top[many] * (1.0 - 0.5 * beta2[many])
    skewness = (0.5 - beta2[many] / 3.0) / np.sqrt(kappa[many] * (1.0 - 0.5 * beta2[many]) ** 3)
    shape = 4.0 / skewness**2
    scatter = (rng.standard_gamma(shape) - shape) / np.sqrt(shape)
    loss[many] = np.maximum(mean[many] + np.sqrt(variance) * scatter, 0.0)
    return loss


def _landau_loss_kev(
    rng: np.random.Generator,
    mode: NDArray[np.float64],
    xi: NDArray[np.float64],
    mean_lambda: NDArray[np.float64],
    width: NDArray[np.float64],
    table: LandauTable,
) -> NDArray[np.float64]:
    """The first case of `draw_loss_kev`, from the most probable loss and the mean that lambda shall have."""
    share = np.interp(mean_lambda, table.mean_below, table.probability)
    loss = mode + xi * (np.interp(rng.random(mode.size) * share, table.probability, table.quantile) - _LANDAU_MODE)
    cut = ndtr(np.clip((0.1 * mode - loss) / np.maximum(width, 1e-9), -8.0, 8.0))
    uniform = cut + rng.random(mode.size) * (1.0 - cut)
    return np.asarray(np.maximum(loss + width * ndtri(np.clip(uniform, 1e-12, 1.0 - 1e-12)), 0.0))
