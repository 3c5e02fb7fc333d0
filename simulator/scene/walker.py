"""Constellations: circular orbits in evenly spaced planes (Walker 1984, J. Brit. Interplanet. Soc. 37, 559: i: T/P/F)."""

from dataclasses import dataclass, field

import numpy as np

from sboc_e2e.icd.errors import UserError
from simulator.platform.earth import EARTH_RADIUS_KM
from simulator.platform.kepler import Elements


@dataclass(frozen=True, kw_only=True)
class WalkerOptions:
    """A Walker constellation. Satellites are called NAME-1 and so on, plane after plane."""

    name: str = field(default="walker", metadata={"doc": "name"})
    satellites: int = field(default=24, metadata={"doc": "all satellites (T)", "min": 1, "max": 100000})
    planes: int = field(default=3, metadata={"doc": "planes (P), a divisor of T", "min": 1, "max": 10000})
    phasing: int = field(default=1, metadata={"doc": "F: planes differ in phase by F 360 deg / T", "min": 0, "max": 9999})
    altitude_km: float = field(default=550.0, metadata={"doc": "height over 6378.137 km", "min": 150.0, "max": 60000.0})
    inclination_deg: float = field(default=53.0, metadata={"doc": "inclination", "min": 0.0, "max": 180.0})
    spread_deg: float = field(
        default=360.0, metadata={"doc": "angle over which nodes are spread: 360 delta, 180 star", "min": 1.0, "max": 360.0}
    )
    node_deg: float = field(
        default=0.0, metadata={"doc": "right ascension of the first plane's node", "min": -360.0, "max": 360.0}
    )
    size_m: float = field(default=2.2, metadata={"doc": "diameter", "min": 1e-3, "max": 1000.0})
    albedo: float = field(default=0.175, metadata={"doc": "Bond albedo", "min": 0.001, "max": 1.0})

    def __post_init__(self) -> None:
        if self.satellites % self.planes:
            raise UserError(f"objects.walker {self.name!r}: {self.satellites} satellites do not fill {self.planes} planes evenly")
        if self.phasing >= self.planes:
            raise UserError(f"objects.walker {self.name!r}: phasing {self.phasing}; allowed is below the {self.planes} planes")


def walker_elements(options: WalkerOptions) -> Elements:
    """Elements (T,) at the epoch of the run, plane after plane."""
    number = np.arange(options.satellites)
    each = options.satellites // options.planes
    plane, place = number // each, number % each
    node = options.node_deg + options.spread_deg * plane / options.planes
    phase = 360.0 * place / each + 360.0 * options.phasing * plane / options.satellites
    zero = np.zeros(options.satellites)
    return Elements(
        a_km=zero + EARTH_RADIUS_KM + options.altitude_km,
        e=zero,
        i_rad=zero + np.radians(options.inclination_deg),
        node_rad=np.radians(node % 360.0),
        argp_rad=zero,
        mean_anomaly_rad=np.radians(phase % 360.0),
    )
