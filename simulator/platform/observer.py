"""Where the camera is: Sun-synchronous orbit, orbit of given elements or ground site; GCRS axes, km and km/s."""

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd.errors import UserError
from simulator.platform import earth
from simulator.platform.kepler import Elements, elements_deg, elements_in, elements_of, state_of
from simulator.platform.orbit_motion import OrbitMotion

Array = NDArray[np.float64]

TROPICAL_YEAR_S = 365.2421897 * earth.DAY_S


@dataclass(frozen=True, kw_only=True)
class SiteOptions:
    """A ground site on the WGS84 ellipsoid."""

    longitude_deg: float = field(default=-6.631, metadata={"doc": "east longitude", "min": -180.0, "max": 360.0})
    latitude_deg: float = field(default=38.216, metadata={"doc": "geodetic latitude", "min": -90.0, "max": 90.0})
    height_m: float = field(default=565.0, metadata={"doc": "height above the ellipsoid", "min": -500.0, "max": 9000.0})


@dataclass(frozen=True, kw_only=True)
class PlatformOptions:
    """What carries the camera. The defaults are a 700 km Sun-synchronous orbit with LTAN 18:00."""

    kind: str = field(
        default="sun_synchronous", metadata={"doc": "the carrier", "choices": ("sun_synchronous", "kepler", "site")}
    )
    altitude_km: float = field(
        default=700.0, metadata={"doc": "height of the Sun-synchronous orbit at the epoch", "min": 150.0, "max": 5900.0}
    )
    ltan_h: float = field(
        default=18.0, metadata={"doc": "local time of the ascending node at the epoch", "min": 0.0, "max": 24.0}
    )
    latitude_argument_deg: float = field(
        default=40.0, metadata={"doc": "argument of latitude at the epoch (Sun-synchronous)", "min": -360.0, "max": 720.0}
    )
    semi_major_axis_km: float = field(
        default=7078.137, metadata={"doc": "osculating, at the epoch, of the Kepler orbit", "min": 6500.0, "max": 1e6}
    )
    eccentricity: float = field(default=0.001, metadata={"doc": "of the Kepler orbit", "min": 0.0, "max": 0.98})
    inclination_deg: float = field(default=98.0, metadata={"doc": "of the Kepler orbit", "min": 0.0, "max": 180.0})
    node_deg: float = field(default=0.0, metadata={"doc": "right ascension of its ascending node", "min": -360.0, "max": 360.0})
    perigee_deg: float = field(
        default=0.0, metadata={"doc": "argument of perigee of the Kepler orbit", "min": -360.0, "max": 360.0}
    )
    mean_anomaly_deg: float = field(
        default=0.0, metadata={"doc": "of the Kepler orbit at the epoch", "min": -360.0, "max": 360.0}
    )
    site: SiteOptions = field(default_factory=SiteOptions, metadata={"doc": "ground site"})

    def __post_init__(self) -> None:
        if self.kind == "kepler" and self.semi_major_axis_km * (1.0 - self.eccentricity) < earth.EARTH_RADIUS_KM + 100.0:
            perigee_km = self.semi_major_axis_km * (1.0 - self.eccentricity) - earth.EARTH_RADIUS_KM
            raise UserError(
                f"platform: perigee height {perigee_km:.0f} km lies inside the Earth's atmosphere; allowed is >= 100 km"
            )


class Observer(Protocol):
    """Position and velocity of the camera."""

    def state(self, tai_ns: int) -> tuple[Array, Array]:
        """(3,) km and (3,) km/s, GCRS axes, geocentric."""
        ...


@dataclass(frozen=True, kw_only=True, eq=False)
class OrbitingObserver:
    """A camera in orbit; its motion obeys the same forces as that of objects."""

    motion: OrbitMotion
    epoch_tai_ns: int

    def state(self, tai_ns: int) -> tuple[Array, Array]:
        """(3,) km and (3,) km/s at an epoch."""
        return self.motion.states((tai_ns - self.epoch_tai_ns) * 1e-9)


@dataclass(frozen=True, kw_only=True, eq=False)
class SiteObserver:
    """A site that turns with the Earth (ERFA Earth orientation, IERS tables)."""

    site: SiteOptions

    def state(self, tai_ns: int) -> tuple[Array, Array]:
        """(3,) km and (3,) km/s at an epoch."""
        fixed = earth.geodetic_position_km(self.site.longitude_deg, self.site.latitude_deg, self.site.height_m)
        rotation = earth.itrs_from_gcrs(tai_ns)
        spin = np.array([0.0, 0.0, earth.OMEGA_EARTH_RAD_S])
        return rotation.T @ fixed, rotation.T @ np.cross(spin, fixed)

    def up(self, tai_ns: int) -> Array:
        """Unit vector of the geodetic zenith, GCRS axes."""
        lon, lat = np.radians(self.site.longitude_deg), np.radians(self.site.latitude_deg)
        zenith = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
        return np.asarray(earth.itrs_from_gcrs(tai_ns).T @ zenith)


def j2_rates(a_km: float, e: float, i_rad: float) -> tuple[float, float, float]:
    """Secular rates (rad/s) of node, argument of perigee and mean anomaly (beyond the mean motion) by J2."""
    motion = np.sqrt(earth.MU_KM3_S2 / a_km**3)
    p = a_km * (1.0 - e * e)
    factor = 1.5 * earth.J2 * (earth.EARTH_RADIUS_KM / p) ** 2 * motion
    node = -factor * np.cos(i_rad)
    perigee = factor * (2.0 - 2.5 * np.sin(i_rad) ** 2)
    anomaly = factor * np.sqrt(1.0 - e * e) * (1.0 - 1.5 * np.sin(i_rad) ** 2)
    return float(node), float(perigee), float(anomaly)


def sun_synchronous(a_km: float, node_deg: float, latitude_argument_deg: float) -> Elements:
    """Osculating elements, circular at the epoch, of an orbit whose node follows the mean Sun (360 deg in a tropical year).

    The inclination of the secular J2 rate is corrected until the integrated node does so over ten nodal revolutions.
    """
    motion = np.sqrt(earth.MU_KM3_S2 / a_km**3)
    wanted = 2 * np.pi / TROPICAL_YEAR_S
    cosine = -wanted / (1.5 * earth.J2 * (earth.EARTH_RADIUS_KM / a_km) ** 2 * motion)
    if abs(cosine) > 1.0:
        raise UserError(
            f"platform.altitude: no Sun-synchronous orbit at {a_km - earth.EARTH_RADIUS_KM:.0f} km; allowed is up to 5900 km"
        )
    for _ in range(3):
        elements = elements_deg(a_km, 0.0, float(np.degrees(np.arccos(cosine))), node_deg, 0.0, latitude_argument_deg)
        _, perigee_rate, anomaly_rate = j2_rates(a_km, 0.0, float(elements.i_rad))
        later_s = 10.0 * 2 * np.pi / (motion + perigee_rate + anomaly_rate)
        moved = elements_of(*OrbitMotion(*state_of(elements)).states(later_s))
        turned = (float(moved.node_rad) - float(elements.node_rad) + np.pi) % (2 * np.pi) - np.pi
        cosine = np.clip(cosine * wanted * later_s / turned, -1.0, 1.0)
    return elements


def make_observer(options: PlatformOptions, epoch_tai_ns: int) -> OrbitingObserver | SiteObserver:
    """The observer that the options describe, its elements given at the epoch.

    LTAN counts from the mean Sun by definition: node = right ascension of the mean Sun + 15 deg (LTAN - 12 h).
    """
    if options.kind == "site":
        return SiteObserver(site=options.site)
    if options.kind == "kepler":
        elements = elements_in(options)
    else:
        a_km = earth.EARTH_RADIUS_KM + options.altitude_km
        node_deg = float(np.degrees(mean_sun_ra_rad(epoch_tai_ns))) + 15.0 * (options.ltan_h - 12.0)
        elements = sun_synchronous(a_km, node_deg, options.latitude_argument_deg)
    return OrbitingObserver(motion=OrbitMotion(*state_of(elements)), epoch_tai_ns=epoch_tai_ns)


def mean_sun_ra_rad(tai_ns: int) -> float:
    """Right ascension of the fictitious mean Sun: its mean longitude (Meeus, Astronomical Algorithms, eq. 25.2)."""
    century = (earth.jyear(tai_ns) - 2000.0) / 100.0
    return float(np.radians((280.46646 + 36000.76983 * century + 0.0003032 * century**2) % 360.0))
