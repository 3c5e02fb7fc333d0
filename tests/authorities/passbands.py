"""Passbands of Bessell (1990, PASP 102, 1181), the Sun's colours, and magnitudes of spectra through them."""

import numpy as np

# fmt: off
BESSELL_1990: dict[str, tuple[np.ndarray, np.ndarray]] = {
    "B": (
        np.array([
            360, 370, 380, 390, 400, 410, 420, 430, 440, 450, 460, 470, 480, 490, 500, 510, 520, 530, 540, 550, 560,
        ], dtype=float),
        np.array([
            0, 0.03, 0.134, 0.567, 0.92, 0.978, 1, 0.978, 0.935, 0.853, 0.74, 0.64, 0.536, 0.424, 0.325, 0.235, 0.15,
            0.095, 0.043, 0.009, 0,
        ], dtype=float),
    ),
    "V": (
        np.array([
            470, 480, 490, 500, 510, 520, 530, 540, 550, 560, 570, 580, 590, 600, 610, 620, 630, 640, 650, 660, 670, 680,
            690, 700,
        ], dtype=float),
        np.array([
            0, 0.03, 0.163, 0.458, 0.78, 0.967, 1, 0.973, 0.898, 0.792, 0.684, 0.574, 0.461, 0.359, 0.27, 0.197, 0.135,
            0.081, 0.045, 0.025, 0.017, 0.013, 0.009, 0,
        ], dtype=float),
    ),
    "R": (
        np.array([
            550, 560, 570, 580, 590, 600, 610, 620, 630, 640, 650, 660, 670, 680, 690, 700, 710, 720, 730, 740, 750, 800,
            850, 900,
        ], dtype=float),
        np.array([
            0, 0.23, 0.74, 0.91, 0.98, 1, 0.98, 0.96, 0.93, 0.9, 0.86, 0.81, 0.78, 0.72, 0.67, 0.61, 0.56, 0.51, 0.46,
            0.4, 0.35, 0.14, 0.03, 0,
        ], dtype=float),
    ),
    "I": (
        np.array([
            700, 710, 720, 730, 740, 750, 760, 770, 780, 790, 800, 810, 820, 830, 840, 850, 860, 870, 880, 890, 900, 910,
            920,
        ], dtype=float),
        np.array([
            0, 0.024, 0.232, 0.555, 0.785, 0.91, 0.965, 0.985, 0.99, 0.995, 1, 1, 0.99, 0.98, 0.95, 0.91, 0.86, 0.75,
            0.56, 0.33, 0.15, 0.03, 0,
        ], dtype=float),
    ),
}
# fmt: on
"""Wavelength (nm) and response to energy, from table 2 of the paper (as speclite 1.0.0 has them)."""

SUN_COLOURS = {"B": 0.653, "R": 0.356, "I": 0.701}
"""B-V, V-Rc and V-Ic of the Sun (Ramirez et al. 2012, ApJ 752, 5)."""


def magnitude(wavelength_nm: np.ndarray, energy_flux: np.ndarray, band: str) -> float:
    """Magnitude, without zero point, of a spectrum (energy per wavelength)."""
    at_nm, response = BESSELL_1990[band]
    fine_nm = np.arange(at_nm[0], at_nm[-1] + 0.01, 0.25)
    through = np.interp(fine_nm, at_nm, response)
    flux = np.trapezoid(np.interp(fine_nm, wavelength_nm, energy_flux) * through, fine_nm)
    return float(-2.5 * np.log10(flux / np.trapezoid(through, fine_nm)))
