"""Cosmic rays at the sensor: rate, nuclei and spectrum by geomagnetic latitude and solar modulation."""

import math
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from simulator.radiation.belts import GeodeticPosition
from simulator.radiation.energy_loss import PROTON_MEV
from simulator.radiation.options import RadiationOptions

POLE_LAT_DEG: Final = 80.7  # geocentric, towards the north
POLE_LON_DEG: Final = -72.7
"""Geomagnetic dipole axis of IGRF-13 for 2020 (Alken et al. 2021)."""
_CUTOFF_GV: Final = 14.9
"""Stoermer's vertical cutoff rigidity at the geomagnetic equator on the ground; falls with r^-2 and cos^4 of latitude.

It is B R c / 4 of a dipole of 3.12e-5 T. The 2.98e-5 T of 2020 would make it 14.2 GV.
"""

NUCLEI: Final = ((1.0, 1.0, 0.872), (2.0, 4.0, 0.118), (6.0, 12.0, 0.0045), (8.0, 16.0, 0.0045), (26.0, 56.0, 0.001))
"""Charge, mass number and share in number of cosmic-ray nuclei (Simpson 1983, Ann. Rev. Nucl. Part. Sci. 33, 323; silicon and its
neighbours joined to oxygen)."""


GROUND_RATE_CM2_S: Final = 1.0 / 60.0
"""Muons through a horizontal cm2 at sea level (Workman et al. 2022, section 30.3.1: about one per minute)."""

GROUND_RIGIDITY_GV: Final = 36.0
"""Muons of 4 GeV, their mean, have the beta gamma of a proton of this rigidity, and so lose as much."""

RATE_MODULATION_MV: Final = 650.0
"""Solar modulation at which the quiet and polar rates of the options hold."""

EQUATOR_RIGIDITY_GV: Final = 12.0
"""Cutoff of the quiet environment: the geomagnetic equator at 700 km."""


def geomagnetic_latitude_deg(lat_deg: float, lon_deg: float) -> float:
    """Latitude about the dipole axis."""
    lat, lon = math.radians(lat_deg), math.radians(lon_deg - POLE_LON_DEG)
    pole = math.radians(POLE_LAT_DEG)
    return math.degrees(math.asin(math.sin(lat) * math.sin(pole) + math.cos(lat) * math.cos(pole) * math.cos(lon)))


def cutoff_rigidity_gv(position: GeodeticPosition) -> float:
    """Stoermer's vertical cutoff (e.g. Smart & Shea 2005, Adv. Space Res. 36, 2012)."""
    latitude = math.radians(geomagnetic_latitude_deg(position.lat_deg, position.lon_deg))
    return _CUTOFF_GV * math.cos(latitude) ** 4 / (1.0 + position.altitude_km / 6371.2) ** 2


def _cosmic_spectrum(energy_mev: NDArray[np.float64], modulation_mv: float) -> NDArray[np.float64]:
    """Differential spectrum of cosmic-ray protons per m2 s sr GeV: force-field modulation of the interstellar one.

    Local interstellar spectrum of Burger, Potgieter & Heber 2000 as parametrised by Usoskin et al. 2005
    (J. Geophys. Res. 110, A12108, equations 1 and 2).
    """
    rest_gev = PROTON_MEV * 1e-3
    energy = energy_mev * 1e-3
    outside = energy + modulation_mv * 1e-3
    rigidity = np.sqrt(outside * (outside + 2.0 * rest_gev))
    interstellar = 1.9e4 * rigidity**-2.78 / (1.0 + 0.4866 * rigidity**-2.51)
    return np.asarray(interstellar * energy * (energy + 2.0 * rest_gev) / (outside * (outside + 2.0 * rest_gev)))


class CosmicRaySpectrum:
    """Integral spectrum of cosmic rays at a solar modulation, and draws from it."""

    def __init__(self, modulation_mv: float) -> None:
        log_energy = np.linspace(math.log(10.0), math.log(2e5), 2000)
        energy = np.exp(log_energy)
        weight = _cosmic_spectrum(energy, modulation_mv) * energy * (log_energy[1] - log_energy[0])
        self._log_energy = log_energy
        self._above = np.cumsum(weight[::-1])[::-1] * 1e-7

    def above(self, energy_mev: float) -> float:
        """Protons per cm2, second and steradian above an energy (of a nucleon, as a shape, for nuclei)."""
        return float(np.interp(math.log(max(energy_mev, 10.0)), self._log_energy, self._above))

    def draw_mev(self, rng: np.random.Generator, n: int, above_mev: float) -> NDArray[np.float64]:
        """Energies per nucleon above a threshold."""
        share = rng.random(n) * self.above(above_mev)
        return np.asarray(np.exp(np.interp(-share, -self._above, self._log_energy)))


def energy_of_rigidity_mev(rigidity_gv: float) -> float:
    """Kinetic energy of a proton of given rigidity."""
    return math.hypot(rigidity_gv * 1e3, PROTON_MEV) - PROTON_MEV


def energy_of_nucleus_mev_u(rigidity_gv: float, charge: float, mass_number: float) -> float:
    """Kinetic energy per nucleon of a nucleus of given rigidity."""
    return energy_of_rigidity_mev(rigidity_gv * charge / mass_number)


def nuclei_through(spectrum: CosmicRaySpectrum, cutoff_gv: float, *, nuclei: bool) -> NDArray[np.float64]:
    """Intensities of the kinds of `NUCLEI` above their own cutoffs of rigidity: shares hold at equal energy per nucleon."""
    kinds = NUCLEI if nuclei else NUCLEI[:1]
    return np.array([share * spectrum.above(energy_of_nucleus_mev_u(cutoff_gv, z, a)) for z, a, share in kinds])


@cache
def _reference(nuclei: bool) -> tuple[float, float]:
    """Intensities at `EQUATOR_RIGIDITY_GV` and without a cutoff, at the modulation for which rates are quoted."""
    spectrum = CosmicRaySpectrum(RATE_MODULATION_MV)
    equator, pole = (float(nuclei_through(spectrum, r, nuclei=nuclei).sum()) for r in (EQUATOR_RIGIDITY_GV, 0.0))
    return equator, pole


def cosmic_rate_cm2_s(options: RadiationOptions, spectrum: CosmicRaySpectrum, cutoff_gv: float) -> float:
    """Cosmic rays through one cm2 of a plane: equatorial and polar rates measured at `RATE_MODULATION_MV`, joined by the
    spectrum above the cutoff and carried to the modulation of the options by it."""
    equator, pole = _reference(options.nuclei)
    here = float(nuclei_through(spectrum, cutoff_gv, nuclei=options.nuclei).sum())
    hard = float(nuclei_through(spectrum, max(cutoff_gv, EQUATOR_RIGIDITY_GV), nuclei=options.nuclei).sum())
    opened = (here - hard) / (pole - equator)
    return options.quiet_rate_cm2_s * (hard / equator + (options.polar_factor - 1.0) * opened)
