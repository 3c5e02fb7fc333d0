"""Photons of a band against published values and another quadrature; stars' light in bands against mean dwarf colours."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import quad

from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.icd.errors import UserError
from simulator.optics.instrument import InstrumentOptions
from simulator.optics.passband import CurvePointOptions, Passband, colour_factor, sun_electrons_m2_s
from simulator.options import SimulatorOptions
from simulator.scene.stars import giants
from tests.authorities.passbands import BESSELL_1990, SUN_COLOURS

DWARFS = [
    ("B3V", -0.178, -0.08, -0.192),
    ("B5V", -0.156, -0.07, -0.165),
    ("B9V", -0.07, -0.028, -0.061),
    ("A0V", 0, 0.001, 0.004),
    ("A5V", 0.16, 0.089, 0.186),
    ("A9V", 0.27, 0.143, 0.294),
    ("F1V", 0.33, 0.19, 0.385),
    ("F3V", 0.39, 0.222, 0.449),
    ("F5V", 0.44, 0.252, 0.506),
    ("F9V", 0.56, 0.312, 0.62),
    ("G2V", 0.65, 0.363, 0.713),
    ("G6V", 0.7, 0.388, 0.758),
    ("G9V", 0.775, 0.423, 0.82),
    ("K1V", 0.857, 0.457, 0.879),
    ("K2V", 0.884, 0.482, 0.92),
    ("K3V", 0.99, 0.537, 1.013),
    ("K5V", 1.15, 0.685, 1.272),
    ("K6V", 1.24, 0.759, 1.42),
    ("K8V", 1.363, 0.843, 1.632),
    ("K9V", 1.4, 0.866, 1.699),
    ("M0V", 1.42, 0.889, 1.766),
    ("M0.5V", 1.445, 0.924, 1.886),
    ("M1.5V", 1.495, 0.978, 2.089),
    ("M2.5V", 1.522, 1.041, 2.306),
    ("M3V", 1.53, 1.079, 2.42),
    ("M3.5V", 1.6, 1.178, 2.68),
    ("M4V", 1.65, 1.241, 2.831),
]
"""Type, B-V, V-Rc, V-Ic of dwarfs (Pecaut & Mamajek 2013, ApJS 208, 9, table of 2022.04.16)."""

METAL_RICH_GIANTS = [(0.935, 1.135), (1.055, 1.275), (1.190, 1.435), (1.345, 1.625), (1.515, 1.865)]
"""B-V and V-I (Johnson) of giants of 5000 to 4000 K (Alonso et al. 1999, A&AS 140, 261, table 5, [Fe/H] = 0.2)."""

GIANT_TEMPERATURE = {
    "B": (0.4967, 0.7260, -0.1563, 0.0255, -0.0585, -0.0061),
    "R": (0.4530, 1.4347, -0.5883, -0.0156, -0.0096, -0.0039),
}
"""5040 K / T of giants as b0 + b1 X + b2 X^2 + b3 X [Fe/H] + b4 [Fe/H] + b5 [Fe/H]^2 with X = B-V or V-Rc (Gonzalez Hernandez &
Bonifacio 2009, A&A 497, 497, table 5)."""

PLANCK_C_J_NM = 6.62607015e-34 * 299792458.0 * 1e9


def flat(short_nm: float, long_nm: float) -> Passband:
    return Passband(short_nm=short_nm, long_nm=long_nm, peak=1.0)


def through(band: str) -> Passband:
    """A filter as electrons for each photon: the published responses are to energy, hence the wavelength."""
    at_nm, energy = BESSELL_1990[band]
    photons = energy / at_nm
    curve = tuple(
        CurvePointOptions(wavelength_nm=float(w), value=float(v)) for w, v in zip(at_nm, photons / photons.max(), strict=True)
    )
    return Passband(short_nm=float(at_nm[0]), long_nm=float(at_nm[-1]), peak=1.0, curves=(curve,))


def test_a_sun_of_v_0_sends_the_photons_of_the_astm_spectrum():
    """420 to 850 nm hold 4.12e10 photons/(m2 s) (ASTM G173-03, V = -26.76); the declared band decides, not a constant."""
    assert sun_electrons_m2_s(flat(420.0, 850.0)) == pytest.approx(4.12e10, rel=2e-3)
    narrow = sun_electrons_m2_s(flat(548.5, 553.5))
    # The spectral flux of V = 0 at V is 3.63e-11 W/(m2 nm) (Bessell, Castelli & Plez 1998, A&A 333, 231), 1.01e8 photons.
    assert narrow == pytest.approx(5.0 * 3.63e-11 / (PLANCK_C_J_NM / 551.0), rel=0.03)


def test_the_whole_spectrum_holds_the_energy_of_its_source():
    """ASTM G173-03, extraterrestrial, has 1347.9 W/m2 between 280 and 4000 nm."""
    edges = np.concatenate([np.arange(280.0, 1100.0, 5.0), np.arange(1100.0, 4000.1, 20.0)])
    energy = [sun_electrons_m2_s(flat(a, b)) * PLANCK_C_J_NM * np.log(b / a) / (b - a) for a, b in pairwise(edges)]
    assert sum(energy) * 10.0 ** (0.4 * 26.76) == pytest.approx(1347.9, rel=1e-3)


def test_curves_are_integrated_over_the_band():
    """Two curves against an adaptive quadrature of the same integrand, bin by bin."""
    optics = tuple(CurvePointOptions(wavelength_nm=w, value=v) for w, v in ((430.0, 0.2), (611.3, 0.9), (820.0, 0.5)))
    efficiency = tuple(CurvePointOptions(wavelength_nm=w, value=v) for w, v in ((400.0, 0.5), (570.0, 1.0), (900.0, 0.3)))
    band = Passband(short_nm=423.7, long_nm=841.2, peak=0.7, curves=(optics, efficiency))

    def integrand(nm: float) -> float:
        first, second = (np.interp(nm, [p.wavelength_nm for p in c], [p.value for p in c]) for c in (optics, efficiency))
        return 0.7 * float(first * second)

    total = 0.0
    for low in np.arange(420.0, 845.0, 5.0):
        a, b = max(low, 423.7), min(low + 5.0, 841.2)
        per_nm = sun_electrons_m2_s(flat(low, low + 5.0)) / 5.0
        total += per_nm * quad(integrand, a, b, points=[611.3] if a < 611.3 < b else None)[0]
    assert sun_electrons_m2_s(band) == pytest.approx(total, rel=1e-5)


def test_the_zero_point_of_the_default_camera():
    """20 cm, half an electron for each photon of 420 to 850 nm: 6.47e8 e-/s; a 5 nm filter leaves an eightieth."""
    camera = InstrumentOptions()
    assert camera.zero_point_e_s == pytest.approx(4.12e10 * np.pi * 0.01 * 0.5, rel=2e-3)
    narrow = replace(camera, band_short_nm=548.5, band_long_nm=553.5)
    assert narrow.zero_point_e_s == pytest.approx(camera.zero_point_e_s * 5.12e8 / 4.12e10, rel=0.01)
    assert camera.true_zero_point_e_s == pytest.approx(camera.zero_point_e_s * 10.0 ** (0.4 * 0.04), rel=1e-9)
    assert SimulatorOptions().instrument == camera


@pytest.mark.parametrize("name", ["throughput_curve", "quantum_efficiency_curve"])
def test_points_out_of_order_are_refused(name):
    points = tuple(CurvePointOptions(wavelength_nm=w) for w in (600.0, 500.0))
    with pytest.raises(UserError, match=f"instrument.{name}: 500 nm follows 600 nm; allowed are growing wavelengths"):
        InstrumentOptions(**{name: points})


@pytest.mark.parametrize(("spectral_type", "b_v", "v_r", "v_i"), DWARFS)
def test_colours_of_dwarfs(spectral_type, b_v, v_r, v_i):
    """V-Rc and V-Ic of dwarfs from their light in the bands R and I, 0.03 mag."""
    for band, wanted in (("R", v_r), ("I", v_i)):
        if wanted is None:
            continue
        colour = 2.5 * np.log10(colour_factor(np.array([b_v]), through(band))[0]) + SUN_COLOURS[band]
        assert colour == pytest.approx(wanted, abs=0.03), band


def test_the_sun_has_its_own_colour():
    assert colour_factor(np.array([0.653]), flat(420.0, 850.0))[0] == pytest.approx(1.0, abs=1e-6)


def colour_of_giant(b_v: float, band: str) -> float:
    return float(2.5 * np.log10(colour_factor(np.array([b_v]), through(band), np.array([True]))[0]) + SUN_COLOURS[band])


@pytest.mark.parametrize("b_v", [0.9, 1.0, 1.1, 1.2, 1.3, 1.4])
def test_v_r_of_giants(b_v):
    """V-Rc of giants of B-V and the disc's mean metallicity, [Fe/H] = -0.1, through their temperature, 0.05 mag."""
    metal, colour = -0.1, np.linspace(0.3, 0.9, 601)
    value = {"B": np.array([b_v]), "R": colour}
    theta = {
        k: b[0] + b[1] * x + b[2] * x**2 + b[3] * x * metal + b[4] * metal + b[5] * metal**2
        for (k, b), x in zip(GIANT_TEMPERATURE.items(), value.values(), strict=True)
    }
    assert colour_of_giant(b_v, "R") == pytest.approx(float(np.interp(theta["B"], theta["R"], colour)[0]), abs=0.05)


@pytest.mark.parametrize(("b_v", "v_i_johnson"), METAL_RICH_GIANTS)
def test_v_i_of_giants(b_v, v_i_johnson):
    """As red as giants rich in metals, brought to Cousins' system after Bessell (1979, PASP 91, 589), or up to 0.15 mag
    redder: at one B-V a star of less metal is cooler. A dwarf of B-V 1.5 is 0.8 mag redder."""
    assert 0.0 < colour_of_giant(b_v, "I") - 0.778 * v_i_johnson < 0.15


def test_reduced_proper_motions_part_giants_from_dwarfs():
    """Aldebaran, gamma Draconis and beta Andromedae are giants, epsilon Eridani and the dwarfs HIP 114622 and 73184 are not."""
    catalogue = StarCatalogue.embedded()
    stars = catalogue.cone(0.0, 0.0, 180.0, v_max=6.0)
    found = dict(zip(stars.hip.tolist(), giants(stars, catalogue.name).tolist(), strict=True))
    assert [found[hip] for hip in (21421, 87833, 5447, 37826)] == [True] * 4
    assert [found[hip] for hip in (16537, 114622, 73184)] == [False] * 3
