"""Electrons in shield and sensitive layer: range, collisional loss, and paths that scatter and curl up where they stop."""

import math
from typing import Final

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray

from simulator.radiation.energy_loss import ELECTRON_MEV, K_MEV_CM2_MOL, SILICON, Material, density_correction

Array = NDArray[np.float64]

LOWEST_MEV: Final = 0.3
"""Belt electrons below this are left out: 0.2 mm of aluminium, less than any window, stop them."""

_STOPPED_MEV: Final = 0.01
"""Energy below which an electron's path (1 um) is shorter than any pixel: the rest of it stays where it is."""

_RADIATION_LENGTH_UM: Final = 93700.0
"""Of silicon (Particle Data Group)."""

_SCATTER_MEV: Final = 13.6 * (1.0 + 0.038 * math.log(50.0 / _RADIATION_LENGTH_UM))
"""Highland's multiple-scattering constant (Workman et al. 2022, equation 34.16) with its logarithm for paths of 50 um."""


def range_g_cm2(energy_mev: ArrayLike) -> Array:
    """Extrapolated range in light materials (Katz & Penfold 1952, Rev. Mod. Phys. 24, 28): 0.412 E^(1.265 - 0.0954 ln E) up to
    2.5 MeV, 0.530 E - 0.106 above."""
    energy = np.asarray(energy_mev, dtype=np.float64)
    low = np.minimum(np.maximum(energy, 1e-3), 2.5)
    return np.asarray(np.where(energy > 2.5, 0.530 * energy - 0.106, 0.412 * low ** (1.265 - 0.0954 * np.log(low))))


def energy_of_range_mev(depth_g_cm2: ArrayLike) -> Array:
    """Energy whose range is a depth."""
    energy = np.geomspace(0.01, 50.0, 2000)
    return np.asarray(np.interp(np.asarray(depth_g_cm2, dtype=np.float64), range_g_cm2(energy), energy))


def behind_shield_mev(energy_mev: Array, shield_g_cm2: float) -> Array:
    """Energy left behind a shield, 0 for what stops in it. Straggling and bremsstrahlung are left out."""
    rest = range_g_cm2(energy_mev) - shield_g_cm2
    return np.where(rest > 0.0, energy_of_range_mev(np.maximum(rest, 0.0)), 0.0)


def stopping_power_mev_cm2_g(energy_mev: ArrayLike, material: Material) -> Array:
    """Mean collisional loss per g/cm2 (Berger & Seltzer; ICRU 37, equation 2.8, Moeller's cross-section)."""
    tau = np.asarray(energy_mev, dtype=np.float64) / ELECTRON_MEV
    beta2 = tau * (tau + 2.0) / (tau + 1.0) ** 2
    excitation = material.excitation_ev * 1e-6 / ELECTRON_MEV
    moeller = 1.0 - beta2 + (tau**2 / 8.0 - (2.0 * tau + 1.0) * math.log(2.0)) / (tau + 1.0) ** 2
    bracket = np.log(tau**2 * (tau + 2.0) / (2.0 * excitation**2)) + moeller
    bracket = bracket - density_correction(np.sqrt(tau * (tau + 2.0)), material)
    return np.asarray(0.5 * K_MEV_CM2_MOL * material.z_over_a / beta2 * np.maximum(bracket, 0.1))


_LOG_ENERGY: Final = np.linspace(math.log(5e-3), math.log(1e3), 600)
_LOSS_MEV_UM: Final = stopping_power_mev_cm2_g(np.exp(_LOG_ENERGY), SILICON) * SILICON.density_g_cm3 * 1e-4


def walk(
    rng: np.random.Generator,
    place_um: Array,
    direction: Array,
    energy_mev: Array,
    loss_factor: Array,
    layer_um: float,
    step_um: float,
    *,
    scattering: bool = True,
) -> tuple[Array, NDArray[np.int64]]:
    """Paths of electrons through the layer.

    place_um : (n, 3) start along rows, cols and depth (0 to `layer_um`). direction : (n, 3) unit vectors. loss_factor : (n,)
    of the mean loss, for straggling. Returns segments (m, 7): row, col, depth at both ends (um) and MeV left on them; and
    the electron of each. A path ends where it leaves the layer or stops.
    """
    constant_mev = _SCATTER_MEV if scattering else 0.0
    first, second = float(_LOG_ENERGY[0]), float(_LOG_ENERGY[1])
    place, heading = np.ascontiguousarray(place_um), np.ascontiguousarray(direction)
    lengths_um = (layer_um, step_um)
    found: tuple[Array, NDArray[np.int64]] = _walk(
        rng, place, heading, energy_mev, loss_factor, lengths_um, constant_mev, (first, second), _LOSS_MEV_UM
    )
    return found


@numba.njit(cache=True)
def _walk(
    rng: np.random.Generator,
    place_um: Array,
    direction: Array,
    energy_mev: Array,
    loss_factor: Array,
    lengths_um: tuple[float, float],
    scatter_mev: float,
    logs: tuple[float, float],
    loss_mev_um: Array,
) -> tuple[Array, NDArray[np.int64]]:
    """The loop of `walk`; the loss is looked up in a table even in the logarithm of energy, with its first two in `logs`."""
    (layer_um, step_um), (first_log, second_log) = lengths_um, logs
    segments = np.empty((8 * energy_mev.size + 64, 7))
    of = np.empty(segments.shape[0], np.int64)
    m = 0
    for k in range(energy_mev.size):
        energy = energy_mev[k]
        x, y, z = place_um[k]
        u, v, w = direction[k]
        while energy > 0.0:
            at = (math.log(max(energy, 5e-3)) - first_log) / (second_log - first_log)
            i = min(int(at), loss_mev_um.size - 2)
            loss = (loss_mev_um[i] + (at - i) * (loss_mev_um[i + 1] - loss_mev_um[i])) * loss_factor[k]
            step = min(step_um, 0.15 * energy / loss)
            left = min(loss * step, energy)
            if energy < _STOPPED_MEV:
                step, left = 1e-3, energy
            out = False
            share = 1.0
            if z + w * step > layer_um:
                share, out = (layer_um - z) / (w * step), True
            elif z + w * step < 0.0:
                share, out = -z / (w * step), True
            if m == of.size:
                longer = np.empty((2 * m, 7))
                longer[:m] = segments
                more = np.empty(2 * m, np.int64)
                more[:m] = of
                segments, of = longer, more
            segments[m, 0], segments[m, 1], segments[m, 2] = x, y, z
            x, y, z = x + u * step * share, y + v * step * share, z + w * step * share
            segments[m, 3], segments[m, 4], segments[m, 5] = x, y, z
            segments[m, 6] = left * share
            of[m] = k
            m += 1
            if out:
                break
            # Scattering by the momentum before the step; p beta = E (E + 2 m) / (E + m).
            p_beta = energy * (energy + 2.0 * ELECTRON_MEV) / (energy + ELECTRON_MEV)
            angle = min(scatter_mev / p_beta * math.sqrt(step / _RADIATION_LENGTH_UM), 1.0)
            energy -= left
            a, b = angle * rng.standard_normal(), angle * rng.standard_normal()
            # Two unit vectors across the direction.
            across = math.sqrt(u * u + v * v)
            if across > 1e-6:
                e1, e2 = -v / across, u / across
            else:
                e1, e2 = 1.0, 0.0
            f1, f2, f3 = -w * e2, w * e1, u * e2 - v * e1
            u, v, w = u + a * e1 + b * f1, v + a * e2 + b * f2, w + b * f3
            norm = math.sqrt(u * u + v * v + w * w)
            u, v, w = u / norm, v / norm, w / norm
    return segments[:m], of[:m]
