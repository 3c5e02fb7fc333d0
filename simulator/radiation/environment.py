"""Which particles meet the sensor: cosmic rays by geomagnetic latitude, trapped protons by the map of the anomaly."""

import math
from functools import cache
from importlib import resources
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator

from simulator.radiation.energy_loss import PROTON_MEV
from simulator.radiation.options import RadiationOptions

MAP_EPOCH_JYEAR: Final = 2015.0
MAP_ALTITUDE_KM: Final = 780.0
_MAP_ENERGY_MEV: Final = 50.0
_ALTITUDE_SCALE_KM: Final = 690.0
"""AP8 MAX peaks of 3,750 at 700 km and 4,210 at 780 km (> 50 MeV) give this e-folding height."""
_FOLDING_MEV: Final = 97.0
"""AP8 MAX peaks of 3,750 above 50 and 2,240 above 100 MeV at 700 km: an exponential integral spectrum."""
_HARDEST_TRAPPED_MEV: Final = 1000.0
_POLE_LAT_DEG: Final = 80.7
_POLE_LON_DEG: Final = -72.7
"""Geomagnetic dipole axis of IGRF-13 for 2020 (Alken et al. 2021)."""
_CUTOFF_GV: Final = 14.9
"""Stoermer's vertical cutoff rigidity at the geomagnetic equator on the ground; falls with r^-2 and cos^4 of latitude."""

NUCLEI: Final = ((1.0, 1.0, 0.872), (2.0, 4.0, 0.118), (6.0, 12.0, 0.0045), (8.0, 16.0, 0.0045), (26.0, 56.0, 0.001))
"""Charge, mass number and share in number of cosmic-ray nuclei (Simpson 1983, Ann. Rev. Nucl. Part. Sci. 33, 323; silicon and its
neighbours joined to oxygen)."""


GROUND_RATE_CM2_S: Final = 1.0 / 60.0
"""Muons through a horizontal cm2 at sea level (Workman et al. 2022, section 30.3.1: about one per minute)."""

GROUND_RIGIDITY_GV: Final = 36.0
"""Muons of 4 GeV, their mean, have the beta gamma of a proton of this rigidity, and so lose as much."""

EQUATOR_RIGIDITY_GV: Final = 12.0
"""Cutoff where the environment is said to be quiet: the geomagnetic equator at 700 km."""


class GeodeticPosition(NamedTuple):
    """Where the sensor is, WGS84."""

    lat_deg: float
    lon_deg: float
    altitude_km: float


@cache
def _trapped_map() -> RegularGridInterpolator:
    """AP8 MAX omnidirectional proton flux above 50 MeV at 780 km, closed in longitude (see ap8max_p50_780km.md)."""
    with resources.files("simulator.radiation").joinpath("ap8max_p50_780km.npz").open("rb") as file, np.load(file) as table:
        lat, lon, flux = table["lat"], table["lon"], table["flux"]
    lon = np.concatenate([lon, [lon[0] + 360.0]])
    flux = np.concatenate([flux, flux[:, :1]], axis=1)
    return RegularGridInterpolator((lat, lon), flux, bounds_error=False, fill_value=0.0)


def trapped_omni_cm2_s(position: GeodeticPosition, epoch_jyear: float, drift_deg_yr: float) -> float:
    """Omnidirectional flux of trapped protons above 50 MeV, before any shield."""
    lon = position.lon_deg + drift_deg_yr * (epoch_jyear - MAP_EPOCH_JYEAR)
    lon = (lon + 180.0) % 360.0 - 180.0
    flux = float(_trapped_map()((np.clip(position.lat_deg, -84.0, 84.0), lon)))
    return flux * math.exp((position.altitude_km - MAP_ALTITUDE_KM) / _ALTITUDE_SCALE_KM)


def trapped_above(energy_mev: float) -> float:
    """Integral spectrum of trapped protons relative to 50 MeV."""
    floor = math.exp(-(_HARDEST_TRAPPED_MEV - _MAP_ENERGY_MEV) / _FOLDING_MEV)
    return max(math.exp(-(energy_mev - _MAP_ENERGY_MEV) / _FOLDING_MEV) - floor, 0.0) / (1.0 - floor)


def draw_trapped_mev(rng: np.random.Generator, n: int, above_mev: float) -> NDArray[np.float64]:
    """Energies of trapped protons above a threshold."""
    top = 1.0 - math.exp(-(_HARDEST_TRAPPED_MEV - above_mev) / _FOLDING_MEV)
    return above_mev - _FOLDING_MEV * np.log1p(-rng.random(n) * top)


def geomagnetic_latitude_deg(lat_deg: float, lon_deg: float) -> float:
    """Latitude about the dipole axis."""
    lat, lon = math.radians(lat_deg), math.radians(lon_deg - _POLE_LON_DEG)
    pole = math.radians(_POLE_LAT_DEG)
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
    """Integral spectrum of cosmic rays and draws from it."""

    def __init__(self, modulation_mv: float) -> None:
        log_energy = np.linspace(math.log(10.0), math.log(2e5), 2000)
        energy = np.exp(log_energy)
        weight = _cosmic_spectrum(energy, modulation_mv) * energy * (log_energy[1] - log_energy[0])
        above = np.cumsum(weight[::-1])[::-1]
        self._log_energy = log_energy
        self._above = above / above[0]

    def above(self, energy_mev: float) -> float:
        """Share of particles above an energy per nucleon."""
        return float(np.interp(math.log(max(energy_mev, 10.0)), self._log_energy, self._above))

    def draw_mev(self, rng: np.random.Generator, n: int, above_mev: float) -> NDArray[np.float64]:
        """Energies per nucleon above a threshold."""
        share = rng.random(n) * self.above(above_mev)
        return np.asarray(np.exp(np.interp(-share, -self._above, self._log_energy)))


def energy_of_rigidity_mev(rigidity_gv: float) -> float:
    """Kinetic energy of a proton of given rigidity."""
    return math.hypot(rigidity_gv * 1e3, PROTON_MEV) - PROTON_MEV


def cosmic_rate_cm2_s(options: RadiationOptions, spectrum: CosmicRaySpectrum, cutoff_gv: float) -> float:
    """Cosmic rays through one cm2 of a plane: measured equatorial and polar rates, joined by the spectrum above the cutoff."""
    equator = spectrum.above(energy_of_rigidity_mev(EQUATOR_RIGIDITY_GV))
    open_share = np.clip((spectrum.above(energy_of_rigidity_mev(cutoff_gv)) - equator) / (1.0 - equator), 0.0, 1.0)
    return options.quiet_rate_cm2_s * (1.0 + (options.polar_factor - 1.0) * float(open_share))
