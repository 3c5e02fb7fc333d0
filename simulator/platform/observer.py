"""Where the camera is: Sun-synchronous orbit, Kepler orbit or ground site; position and velocity, GCRS, km and km/s."""

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd.errors import UserError
from simulator.platform import earth
from simulator.platform.kepler import Elements, elements_deg, state_of

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
        default=700.0, metadata={"doc": "height of the Sun-synchronous orbit", "min": 150.0, "max": 5900.0}
    )
    ltan_h: float = field(
        default=18.0, metadata={"doc": "local time of the ascending node at the epoch", "min": 0.0, "max": 24.0}
    )
    latitude_argument_deg: float = field(
        default=40.0, metadata={"doc": "argument of latitude at the epoch (Sun-synchronous)", "min": -360.0, "max": 720.0}
    )
    semi_major_axis_km: float = field(default=7078.137, metadata={"doc": "of the Kepler orbit", "min": 6500.0, "max": 1e6})
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
    """Kepler motion with the secular precession of node, perigee and anomaly by J2 (Vallado eq. 9-37 to 9-41).

    Short-period J2 terms (up to 10 km, with periods of half a revolution) are left out: the orbit is a realisation, not a
    forecast. The velocity is that of the precessing ellipse, consistent with the position to 1e-6.
    """

    elements: Elements
    epoch_tai_ns: int

    def state(self, tai_ns: int) -> tuple[Array, Array]:
        """(3,) km and (3,) km/s at an epoch."""
        dt_s = (tai_ns - self.epoch_tai_ns) * 1e-9
        el = self.elements
        node_rate, perigee_rate, anomaly_rate = j2_rates(float(el.a_km), float(el.e), float(el.i_rad))
        moved = Elements(
            a_km=el.a_km,
            e=el.e,
            i_rad=el.i_rad,
            node_rad=el.node_rad + node_rate * dt_s,
            argp_rad=el.argp_rad + perigee_rate * dt_s,
            mean_anomaly_rad=el.mean_anomaly_rad + anomaly_rate * dt_s,
        )
        position, velocity = state_of(moved, dt_s)
        scale = 1.0 + (perigee_rate + anomaly_rate) / np.sqrt(earth.MU_KM3_S2 / float(el.a_km) ** 3)
        precession = np.cross([0.0, 0.0, node_rate], position)
        return position, velocity * scale + precession


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


def sun_synchronous_inclination_rad(a_km: float) -> float:
    """Inclination at which the node of a circular orbit follows the mean Sun (360 deg in a tropical year)."""
    motion = np.sqrt(earth.MU_KM3_S2 / a_km**3)
    cosine = -(2 * np.pi / TROPICAL_YEAR_S) / (1.5 * earth.J2 * (earth.EARTH_RADIUS_KM / a_km) ** 2 * motion)
    if abs(cosine) > 1.0:
        raise UserError(
            f"platform.altitude: no Sun-synchronous orbit at {a_km - earth.EARTH_RADIUS_KM:.0f} km; allowed is up to 5900 km"
        )
    return float(np.arccos(cosine))


def make_observer(options: PlatformOptions, epoch_tai_ns: int) -> OrbitingObserver | SiteObserver:
    """The observer that the options describe, its elements given at the epoch.

    LTAN counts from the mean Sun, as it is defined: node = right ascension of the mean Sun + 15 deg (LTAN - 12 h).
    """
    if options.kind == "site":
        return SiteObserver(site=options.site)
    if options.kind == "kepler":
        elements = elements_deg(
            options.semi_major_axis_km,
            options.eccentricity,
            options.inclination_deg,
            options.node_deg,
            options.perigee_deg,
            options.mean_anomaly_deg,
        )
    else:
        a_km = earth.EARTH_RADIUS_KM + options.altitude_km
        inclination_deg = float(np.degrees(sun_synchronous_inclination_rad(a_km)))
        node_deg = float(np.degrees(mean_sun_ra_rad(epoch_tai_ns))) + 15.0 * (options.ltan_h - 12.0)
        elements = elements_deg(a_km, 0.0, inclination_deg, node_deg, 0.0, options.latitude_argument_deg)
    return OrbitingObserver(elements=elements, epoch_tai_ns=epoch_tai_ns)


def mean_sun_ra_rad(tai_ns: int) -> float:
    """Right ascension of the fictitious mean Sun: its mean longitude (Meeus, Astronomical Algorithms, eq. 25.2)."""
    century = (earth.jyear(tai_ns) - 2000.0) / 100.0
    return float(np.radians((280.46646 + 36000.76983 * century + 0.0003032 * century**2) % 360.0))
