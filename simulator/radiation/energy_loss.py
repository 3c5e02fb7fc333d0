"""Energy loss of protons and nuclei: Bethe's mean, Landau's straggling, and the range in a shield.

Formulas of the Particle Data Group, "Passage of particles through matter" (Workman et al. 2022, PTEP 083C01, section 34):
mean loss equation 34.5, maximum transfer 34.4, density correction 34.7, most probable loss 34.12.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

ELECTRON_MEV: Final = 0.51099895  # rest energy, CODATA 2018
PROTON_MEV: Final = 938.27209  # rest energy, CODATA 2018
K_MEV_CM2_MOL: Final = 0.307075  # 4 pi N_A r_e^2 m_e c^2 (Workman et al. 2022, table 34.1)


@dataclass(frozen=True, kw_only=True)
class Material:
    """An absorber with Sternheimer's density-effect parameters (Sternheimer, Berger & Seltzer 1984, ADNDT 30, 261).

    shells_kev : (electrons of the atom in a shell, ionisation energy in keV), for straggling in thin layers.
    """

    z: float
    a: float
    density_g_cm3: float
    excitation_ev: float
    x0: float
    x1: float
    c: float
    slope: float
    power: float
    delta0: float
    shells_kev: tuple[tuple[float, float], ...] = ()

    @property
    def z_over_a(self) -> float:
        """Electrons per atomic mass unit."""
        return self.z / self.a


SILICON: Final = Material(
    z=14, a=28.0855, density_g_cm3=2.329, excitation_ev=173.0,
    x0=0.2015, x1=2.8716, c=4.4355, slope=0.14921, power=3.2546, delta0=0.14,
    shells_kev=((2, 1.839), (8, 0.118)),
)  # fmt: skip
ALUMINIUM: Final = Material(
    z=13, a=26.9815, density_g_cm3=2.699, excitation_ev=166.0,
    x0=0.1708, x1=3.0127, c=4.2395, slope=0.08024, power=3.6345, delta0=0.12
)  # fmt: skip
COPPER: Final = Material(
    z=29, a=63.546, density_g_cm3=8.960, excitation_ev=322.0,
    x0=-0.0254, x1=3.2792, c=4.4190, slope=0.14339, power=2.9044, delta0=0.08
)  # fmt: skip
SHIELDS: Final = {"aluminium": ALUMINIUM, "copper": COPPER}


def beta_gamma(energy_mev_u: ArrayLike, mass_mev: float = PROTON_MEV) -> NDArray[np.float64]:
    """Momentum over mass of a particle of given kinetic energy (of one nucleon, for nuclei)."""
    tau = np.asarray(energy_mev_u, dtype=np.float64) / mass_mev
    return np.sqrt(tau * (tau + 2.0))


def density_correction(bg: NDArray[np.float64], material: Material) -> NDArray[np.float64]:
    """Sternheimer's delta(beta gamma), equation 34.7."""
    x = np.log10(bg)
    high = 2.0 * math.log(10.0) * x - material.c
    middle = high + material.slope * np.clip(material.x1 - x, 0.0, None) ** material.power
    low = material.delta0 * 10.0 ** (2.0 * (np.minimum(x, material.x0) - material.x0))
    return np.asarray(np.where(x >= material.x1, high, np.where(x >= material.x0, middle, low)))


def maximum_transfer_mev(bg: NDArray[np.float64], mass_mev: float = PROTON_MEV) -> NDArray[np.float64]:
    """Largest energy given to one free electron, equation 34.4."""
    ratio = ELECTRON_MEV / mass_mev
    gamma = np.sqrt(1.0 + bg**2)
    return np.asarray(2.0 * ELECTRON_MEV * bg**2 / (1.0 + 2.0 * gamma * ratio + ratio**2))


SHELL_LOWEST: Final = 0.13
"""Momentum over mass down to which the shell correction was fitted (8 MeV protons); it is held constant below."""


def shell_correction(bg: NDArray[np.float64], material: Material) -> NDArray[np.float64]:
    """Shell correction C/Z to the logarithm of Bethe's formula (Barkas & Berger 1964, NASA SP-3013; Leo 1994, equation 2.33)."""
    x = np.maximum(bg, SHELL_LOWEST) ** -2.0
    square = (0.422377 + (0.0304043 - 0.00038106 * x) * x) * x * 1e-6
    cube = (3.858019 + (-0.1667989 + 0.00157955 * x) * x) * x * 1e-9
    return np.asarray((square * material.excitation_ev**2 + cube * material.excitation_ev**3) / material.z)


def stopping_power_mev_cm2_g(
    energy_mev_u: ArrayLike, material: Material, charge: ArrayLike = 1.0, mass_mev: float = PROTON_MEV
) -> NDArray[np.float64]:
    """Mean electronic energy loss per g/cm2 (Bethe with density and shell corrections, equation 34.5), proportional to charge
    squared. Barkas and Bloch corrections are left out."""
    bg = beta_gamma(energy_mev_u, mass_mev)
    beta2 = bg**2 / (1.0 + bg**2)
    excitation = material.excitation_ev * 1e-6
    bracket = (
        0.5 * np.log(2.0 * ELECTRON_MEV * bg**2 * maximum_transfer_mev(bg, mass_mev) / excitation**2)
        - beta2
        - 0.5 * density_correction(bg, material)
        - shell_correction(bg, material)
    )
    return np.asarray(K_MEV_CM2_MOL * material.z_over_a * np.asarray(charge) ** 2 / beta2 * np.maximum(bracket, 0.1))


def landau_xi_kev(
    energy_mev_u: ArrayLike, length_um: ArrayLike, material: Material, charge: ArrayLike = 1.0
) -> NDArray[np.float64]:
    """Landau's width parameter ``xi = K/2 (Z/A) z^2 rho x / beta^2``."""
    bg = beta_gamma(energy_mev_u)
    beta2 = bg**2 / (1.0 + bg**2)
    depth_g_cm2 = material.density_g_cm3 * np.asarray(length_um) * 1e-4
    return np.asarray(1e3 * 0.5 * K_MEV_CM2_MOL * material.z_over_a * np.asarray(charge) ** 2 * depth_g_cm2 / beta2)


def most_probable_loss_kev(
    energy_mev_u: ArrayLike, length_um: ArrayLike, material: Material, charge: ArrayLike = 1.0
) -> NDArray[np.float64]:
    """Most probable energy loss in a layer, equation 34.12 (Landau 1944; Bichsel 1988, Rev. Mod. Phys. 60, 663)."""
    bg = beta_gamma(energy_mev_u)
    beta2 = bg**2 / (1.0 + bg**2)
    xi = landau_xi_kev(energy_mev_u, length_um, material, charge)
    excitation_kev = material.excitation_ev * 1e-3
    return np.asarray(
        xi
        * (
            np.log(2.0 * ELECTRON_MEV * 1e3 * bg**2 / excitation_kev)
            + np.log(xi / excitation_kev)
            + 0.2
            - beta2
            - density_correction(bg, material)
        )
    )


def binding_width_kev(
    energy_mev_u: ArrayLike, length_um: ArrayLike, material: Material, charge: ArrayLike = 1.0
) -> NDArray[np.float64]:
    """Gaussian width that electron binding adds to Landau's straggling in thin layers.

    Shulek et al. 1967 (Sov. J. Nucl. Phys. 4, 400): ``sigma^2 = (8/3) xi sum_i (Z_i/Z) I_i ln(2 m c^2 beta^2 / I_i)``. A shell is
    counted in the share ``n / (1 + n)``, n = xi Z_i / (Z I_i) being about the number of its ionisations: fewer than one
    collision is no Gaussian.
    """
    bg = beta_gamma(energy_mev_u)
    beta2 = bg**2 / (1.0 + bg**2)
    xi = landau_xi_kev(energy_mev_u, length_um, material, charge)
    variance = np.zeros(np.broadcast(xi).shape)
    for electrons, binding_kev in material.shells_kev:
        share = electrons / material.z
        number = xi * share / binding_kev
        logarithm = np.log(np.maximum(2.0 * ELECTRON_MEV * 1e3 * beta2 / binding_kev, 1.0))
        variance = variance + 8.0 / 3.0 * xi * share * binding_kev * logarithm * number / (1.0 + number)
    return np.sqrt(variance)


class StoppingRange:
    """Range of protons in a material (continuous slowing down) and its inverse; nuclei scale as A / z^2."""

    _LOWEST_MEV = 1.0

    def __init__(self, material: Material) -> None:
        from scipy.interpolate import CubicSpline  # takes a fifth of a second, which runs without particles do not need

        log_energy = np.linspace(math.log(self._LOWEST_MEV), math.log(2e5), 600)
        energy = np.exp(log_energy)
        per_log = CubicSpline(log_energy, energy / stopping_power_mev_cm2_g(energy, material)).antiderivative()
        # Below 1 MeV the range is a small part of any shield: R ~ E^1.77 there (Bragg-Kleeman).
        start = self._LOWEST_MEV / float(stopping_power_mev_cm2_g(self._LOWEST_MEV, material)) / 1.77
        self.material = material
        self._log_energy = log_energy
        self._log_range = np.log(per_log(log_energy) - per_log(log_energy[0]) + start)

    def range_g_cm2(self, energy_mev: ArrayLike) -> NDArray[np.float64]:
        """Range of protons of given energies (1 MeV to 200 GeV)."""
        return np.asarray(np.exp(np.interp(np.log(energy_mev), self._log_energy, self._log_range)))

    def energy_behind_mev_u(
        self, energy_mev_u: ArrayLike, shield_mm: float, charge: ArrayLike = 1.0, mass_number: ArrayLike = 1.0
    ) -> NDArray[np.float64]:
        """Energy per nucleon left behind a shield; 0 for what stops in it."""
        scale = np.asarray(charge) ** 2 / np.asarray(mass_number)
        rest = self.range_g_cm2(energy_mev_u) - scale * self.material.density_g_cm3 * shield_mm * 0.1
        inside = rest > math.exp(self._log_range[0])
        log_rest = np.log(np.where(inside, rest, 1.0))
        return np.asarray(np.where(inside, np.exp(np.interp(log_rest, self._log_range, self._log_energy)), 0.0))

    def stopped_below_mev_u(self, shield_mm: float, charge: float = 1.0, mass_number: float = 1.0) -> float:
        """Energy per nucleon of particles that a shield just stops."""
        depth = self.material.density_g_cm3 * shield_mm * 0.1 * charge**2 / mass_number
        if depth <= math.exp(self._log_range[0]):
            return self._LOWEST_MEV
        return float(np.exp(np.interp(math.log(depth), self._log_range, self._log_energy)))
