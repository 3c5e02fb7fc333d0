"""Energy loss in silicon, aluminium and copper against PSTAR, Groom's muon table and a numerical Landau convolution.

Authorities
-----------
PSTAR : Berger, Coursey, Zucker & Chang, NIST Standard Reference Database 124; total stopping power of protons in MeV cm2/g.
Groom : Groom, Mokhov & Striganov 2001, Atomic Data and Nuclear Data Tables 78, 183, table of muons in silicon (file
    muE_silicon_Si.txt of the Particle Data Group): ionisation loss, loss restricted to transfers below 50 keV.
"""

import math

import numpy as np
import pytest
from scipy import integrate

from simulator.radiation.energy_loss import (
    ALUMINIUM,
    COPPER,
    ELECTRON_MEV,
    SILICON,
    StoppingRange,
    landau_xi_kev,
    most_probable_loss_kev,
    stopping_power_mev_cm2_g,
)

MUON_MEV = 105.65839
PROTON_MEV = 938.27209

PSTAR_ENERGY_MEV = (
    10.0,
    15.0,
    20.0,
    30.0,
    50.0,
    75.0,
    100.0,
    150.0,
    200.0,
    300.0,
    500.0,
    1000.0,
    2000.0,
    3000.0,
    5000.0,
    10000.0,
)
PSTAR = {
    "silicon": (
        SILICON,
        (34.59, 25.29, 20.20, 14.69, 9.856, 7.227, 5.838, 4.383, 3.628, 2.853, 2.230, 1.801, 1.666, 1.668, 1.720, 1.830),
    ),
    "aluminium": (
        ALUMINIUM,
        (33.76, 24.66, 19.69, 14.31, 9.594, 7.031, 5.678, 4.262, 3.526, 2.773, 2.167, 1.750, 1.618, 1.619, 1.668, 1.768),
    ),
    "copper": (
        COPPER,
        (27.09, 20.10, 16.20, 11.91, 8.090, 5.979, 4.852, 3.664, 3.042, 2.400, 1.880, 1.521, 1.407, 1.409, 1.454, 1.552),
    ),
}
PSTAR_ALUMINIUM_LOW = ((1.0, 172.0), (1.5, 132.8), (2.0, 109.5), (3.0, 82.50), (4.0, 67.07), (5.0, 56.95), (7.0, 44.30))

GROOM_KINETIC_MEV = (10.0, 20.0, 40.0, 80.0, 100.0, 200.0, 300.0, 500.0, 1000.0, 2000.0, 5000.0, 10000.0)
GROOM_IONISATION = (6.363, 3.912, 2.608, 1.965, 1.849, 1.678, 1.665, 1.703, 1.803, 1.922, 2.074, 2.177)


@pytest.mark.parametrize("name", PSTAR)
def test_stopping_power_agrees_with_pstar_to_2_percent(name):
    material, published = PSTAR[name]
    energy = np.array(PSTAR_ENERGY_MEV)
    ratio = stopping_power_mev_cm2_g(energy, material) / np.array(published)
    assert np.abs(ratio - 1.0).max() < 0.02


def test_ionisation_by_muons_agrees_with_groom_to_1_percent():
    # The table adds bremsstrahlung from atomic electrons, 0.6 % at 10 GeV.
    ratio = stopping_power_mev_cm2_g(np.array(GROOM_KINETIC_MEV), SILICON, mass_mev=MUON_MEV) / np.array(GROOM_IONISATION)
    assert np.abs(ratio - 1.0).max() < 0.01


def test_loss_is_proportional_to_the_square_of_the_charge():
    assert stopping_power_mev_cm2_g(500.0, SILICON, 26.0) == pytest.approx(
        676.0 * float(stopping_power_mev_cm2_g(500.0, SILICON))
    )


def test_range_in_aluminium_agrees_with_the_integral_of_pstar_to_2_percent():
    energy = np.array([e for e, _ in PSTAR_ALUMINIUM_LOW] + list(PSTAR_ENERGY_MEV))
    stopping = np.array([s for _, s in PSTAR_ALUMINIUM_LOW] + list(PSTAR["aluminium"][1]))
    fine = np.geomspace(1.0, 1000.0, 4000)
    power = np.exp(np.interp(np.log(fine), np.log(energy), np.log(stopping)))
    # Range at 1 MeV: 3.9 mg/cm2 (PSTAR).
    published = 0.0039 + integrate.cumulative_trapezoid(1.0 / power, fine, initial=0.0)
    for at_mev in (20.0, 50.0, 100.0, 500.0):
        ours = float(StoppingRange(ALUMINIUM).range_g_cm2(at_mev))
        assert ours == pytest.approx(float(np.interp(at_mev, fine, published)), rel=0.02)


def test_what_stops_in_the_shield_does_not_arrive():
    shield = StoppingRange(ALUMINIUM)
    stopped = shield.stopped_below_mev_u(10.0)
    # 2.699 g/cm2: a little below the 2.91 g/cm2 that 50 MeV protons run.
    assert 46.0 < stopped < 50.0
    behind = shield.energy_behind_mev_u(np.array([0.95 * stopped, 1.05 * stopped, 500.0]), 10.0)
    assert behind[0] == 0.0
    assert 0.0 < behind[1] < 20.0
    # 500 MeV protons lose about 2.167 MeV cm2/g x 2.699 g/cm2.
    assert 500.0 - behind[2] == pytest.approx(5.86, rel=0.02)


def landau_from_collisions(xi_kev: float, restricted_kev: float, top_kev: float) -> tuple[np.ndarray, np.ndarray]:
    """Density of the loss in a layer from single collisions: compound Poisson with Rutherford's law above 0.2 keV.

    Losses in smaller collisions count with their mean, which is the published loss restricted to 50 keV less what Rutherford's
    law puts between 0.2 and 50 keV. `top_kev` ends the grid; collisions beyond it move no mode and are left out.
    """
    smallest, step = 0.2, 0.02
    size = 1 << 16
    loss = np.arange(size) * step
    inside = (loss > smallest) & (loss < top_kev)
    # Collisions between the borders of each cell: the integral of xi / loss^2.
    rate = np.where(inside, xi_kev / np.maximum(loss - 0.5 * step, step) - xi_kev / (loss + 0.5 * step), 0.0)
    transform = np.exp(np.fft.rfft(rate) - rate.sum())
    density = np.fft.irfft(transform, size) / step
    density[0] = 0.0  # the probability of no collision at all
    return loss + restricted_kev - (rate * loss)[loss < 50.0].sum(), density


@pytest.mark.parametrize(("kinetic_mev", "restricted"), [(100.0, 1.506), (300.0, 1.281), (1000.0, 1.289), (5000.0, 1.342)])
@pytest.mark.parametrize("thickness_um", [100.0, 300.0, 1000.0])
def test_most_probable_loss_agrees_with_a_convolution_of_single_collisions_to_2_percent(kinetic_mev, restricted, thickness_um):
    momentum_ratio = math.sqrt((kinetic_mev / MUON_MEV) * (kinetic_mev / MUON_MEV + 2.0))
    proton_mev = PROTON_MEV * (math.sqrt(1.0 + momentum_ratio**2) - 1.0)
    xi = float(landau_xi_kev(proton_mev, thickness_um, SILICON))
    depth_g_cm2 = SILICON.density_g_cm3 * thickness_um * 1e-4
    loss, density = landau_from_collisions(xi, 1e3 * restricted * depth_g_cm2, 1200.0)
    mode = loss[np.argmax(density)]
    assert float(most_probable_loss_kev(proton_mev, thickness_um, SILICON)) == pytest.approx(mode, rel=0.02)


def test_width_parameter_is_the_textbook_one():
    # xi = 0.1535 MeV cm2/g z^2 (Z/A) rho x / beta^2 (Leo 1994, Techniques for Nuclear and Particle Physics, equation 2.92).
    proton_mev = 3000.0
    gamma = 1.0 + proton_mev / PROTON_MEV
    beta2 = 1.0 - gamma**-2
    expected = 153.5 * (14 / 28.0855) * 2.329 * 0.03 / beta2
    assert float(landau_xi_kev(proton_mev, 300.0, SILICON)) == pytest.approx(expected, rel=1e-3)
    assert pytest.approx(0.510999, rel=1e-5) == ELECTRON_MEV
