"""Trapped protons and electrons anywhere about the Earth: AP8 MAX and AE8 MAX, tabulated (see belts.md)."""

import math
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from scipy.interpolate import RegularGridInterpolator

Array = NDArray[np.float64]

MAP_EPOCH_JYEAR: Final = 2015.0  # epoch of the field whose L and B/B0 are tabulated (belts.md)
_FLOOR_LOG: Final = -2.0  # what the table holds where AP8 and AE8 have no flux, log10 of /cm2/s (belts.md)
_HARDEST_PROTON_MEV: Final = 1000.0  # the table ends at 300 MeV; where flux reaches zero beyond it is chosen, not measured
_HARDEST_ELECTRON_MEV: Final = 8.0
"""Integral fluxes are continued beyond the tables' last energies as exponentials that end here."""


class GeodeticPosition(NamedTuple):
    """Where the sensor is, WGS84."""

    lat_deg: float
    lon_deg: float
    altitude_km: float


ANOMALY: Final = GeodeticPosition(-30.0, -49.0, 700.0)
"""Peak of AP8 MAX above 50 MeV at 700 km, at the map's epoch."""

HORN: Final = GeodeticPosition(-60.0, 12.0, 700.0)
"""Peak of AE8 MAX above 2 MeV at 700 km: the outer belt's southern horn, at the map's epoch."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TrappedSpectrum:
    """Omnidirectional integral flux at one place. energy_mev : (n,) rising. above_cm2_s : (n,) falling."""

    energy_mev: Array
    above_cm2_s: Array

    def above(self, energy_mev: float) -> float:
        """Particles per cm2 and second above an energy; below the first one of the table, as above it."""
        if energy_mev >= self.energy_mev[-1]:
            return 0.0
        energy = max(energy_mev, float(self.energy_mev[0]))
        k = int(np.searchsorted(self.energy_mev, energy, side="right")) - 1
        share = (energy - self.energy_mev[k]) / (self.energy_mev[k + 1] - self.energy_mev[k])
        low, high = self.above_cm2_s[k], self.above_cm2_s[k + 1]
        if low <= 0.0 or high <= 0.0:
            return float(low * (1.0 - share) + high * share)
        return float(low ** (1.0 - share) * high**share)

    def draw_mev(self, rng: np.random.Generator, n: int, above_mev: float) -> Array:
        """Energies above a threshold."""
        fine = np.linspace(max(above_mev, float(self.energy_mev[0])), float(self.energy_mev[-1]), 2000)
        flux = np.array([self.above(float(e)) for e in fine])
        return np.asarray(np.interp(-rng.random(n) * flux[0], -flux, fine))


class _Tables(NamedTuple):
    place: "RegularGridInterpolator"
    inverse_l: Array
    share: Array
    energy_mev: dict[str, Array]
    log_flux: dict[str, Array]


@cache
def _tables() -> _Tables:
    """The tables, with longitude closed; places are looked up by latitude, longitude and logarithm of altitude."""
    from scipy.interpolate import RegularGridInterpolator  # takes a fifth of a second, which runs without belts do not need

    with resources.files("simulator.radiation").joinpath("belts.npz").open("rb") as file, np.load(file) as content:
        table = {name: content[name].astype(np.float64) for name in content.files}
    values = np.stack([table["ln_l_2000"] / 2000.0, table["ln_b_1000"] / 1000.0], axis=-1)
    values = np.concatenate([values, values[:, :, :1]], axis=2)
    lon = np.concatenate([table["lon_deg"], [table["lon_deg"][0] + 360.0]])
    place = RegularGridInterpolator((np.log(table["altitude_km"]), table["lat_deg"], lon), values)
    return _Tables(
        place=place,
        inverse_l=1.0 / table["l"],
        share=table["share"],
        energy_mev={kind: table[f"{kind}_mev"] for kind in ("electron", "proton")},
        log_flux={kind: table[f"{kind}_log_500"] / 500.0 for kind in ("electron", "proton")},
    )


def shell(position: GeodeticPosition, epoch_jyear: float = MAP_EPOCH_JYEAR, drift_deg_yr: float = 0.0) -> tuple[float, float]:
    """McIlwain's L and B/B0 at a place; the field of the map's epoch has since moved west by a drift."""
    place, (low, high) = _tables().place, (200.0, 60000.0)
    lon = position.lon_deg + drift_deg_yr * (epoch_jyear - MAP_EPOCH_JYEAR)
    altitude, latitude = min(max(position.altitude_km, low), high), min(max(position.lat_deg, -87.0), 87.0)
    log_l, log_b = np.ravel(place((math.log(altitude), latitude, (lon + 180.0) % 360.0 - 180.0)))
    return math.exp(log_l), math.exp(log_b)


def trapped(
    kind: str, position: GeodeticPosition, epoch_jyear: float = MAP_EPOCH_JYEAR, drift_deg_yr: float = 0.0
) -> TrappedSpectrum:
    """Spectrum of trapped particles ("proton", "electron") at a place; zero where none are."""
    tables = _tables()
    l_shell, b_ratio = shell(position, epoch_jyear, drift_deg_yr)
    energy, log_flux = tables.energy_mev[kind], tables.log_flux[kind]
    l_shell = float(np.clip(l_shell, 1.0 / tables.inverse_l[0], 1.0 / tables.inverse_l[-1]))
    ground = math.log(l_shell**3 * math.sqrt(4.0 - 3.0 / l_shell))
    at_l = float(np.interp(-1.0 / l_shell, -tables.inverse_l, np.arange(tables.inverse_l.size)))
    at_b = math.log(b_ratio) / ground / tables.share[1]
    outside = at_b >= tables.share.size - 1 or position.altitude_km > 60000.0
    i, j = min(int(at_l), tables.inverse_l.size - 2), min(int(at_b), tables.share.size - 2)
    a, b = at_l - i, at_b - j
    corners = log_flux[:, i : i + 2, j : j + 2]
    along_b = (1.0 - b) * corners[:, :, 0] + b * corners[:, :, 1]
    value = (1.0 - a) * along_b[:, 0] + a * along_b[:, 1]
    flux = np.where(outside | (value < _FLOOR_LOG + 0.1), 0.0, 10.0**value)
    hardest = _HARDEST_PROTON_MEV if kind == "proton" else _HARDEST_ELECTRON_MEV
    return _continued(energy, np.minimum.accumulate(flux), hardest)


def _continued(energy: Array, flux: Array, hardest_mev: float) -> TrappedSpectrum:
    """Spectrum continued by the exponential of the last two energies, to zero flux at the hardest particles."""
    further = np.linspace(energy[-1], hardest_mev, 9)[1:]
    if flux[-1] > 0.0:
        fold = (energy[-1] - energy[-2]) / max(math.log(flux[-2] / flux[-1]), 1e-6)
        beyond = flux[-1] * np.exp(-(further - energy[-1]) / fold)
        beyond[-1] = 0.0
    else:
        beyond = np.zeros(further.size)
    return TrappedSpectrum(energy_mev=np.concatenate([energy, further]), above_cm2_s=np.concatenate([flux, beyond]))
