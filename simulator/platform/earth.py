"""Earth, Sun and time: constants and the ephemerides that the platform and the scene need, from ERFA.

Everything is GCRS axes, kilometres and seconds. ERFA's `epv00` is the ephemeris of the Earth (a few km, far below
1 mas of aberration and 1 arcsec of Sun direction).
"""

import warnings
from functools import lru_cache
from typing import Final

import erfa
import numpy as np
from astropy.time import Time
from numpy.typing import NDArray

from sboc_e2e.icd import tai
from sboc_e2e.icd.errors import UserError
from simulator.platform import earth_orientation

MU_KM3_S2: Final = 398600.4418  # WGS 84, IERS Conventions 2010
EARTH_RADIUS_KM: Final = 6378.137  # equatorial radius, WGS 84
J2: Final = 1.08262668e-3
"""Second zonal harmonic, EGM96: sqrt(5) times its normalised coefficient, 4.84165372e-4."""
FLATTENING: Final = 1.0 / 298.257223563  # of the ellipsoid, a defining number of WGS 84
OMEGA_EARTH_RAD_S: Final = 7.292115e-5  # rotation of the Earth, a defining number of WGS 84
AU_KM: Final = 149597870.7  # exact, IAU 2012 resolution B2
SUN_RADIUS_KM: Final = 695700.0  # nominal, IAU 2015 resolution B3
LIGHT_KM_S: Final = 299792.458  # exact by the definition of the metre, SI
DAY_S: Final = 86400.0  # seconds in a day of TAI or TT
OBLIQUITY_RAD: Final = np.radians(23.4392911)
"""Mean obliquity of J2000, 84381.448 arcsec (IAU 1976); that of IAU 2006 is 0.042 arcsec less."""


def tai_ns_of_utc(epoch_utc: str) -> int:
    """TAI nanoseconds of an ISO-8601 UTC epoch.

    UserError if it cannot be read or lies outside the Earth-orientation data that are installed.
    """
    try:
        with warnings.catch_warnings():  # ERFA calls years "dubious" that the table below refuses anyway
            warnings.simplefilter("ignore", erfa.ErfaWarning)
            atomic = Time(epoch_utc.removesuffix("Z"), scale="utc", format="isot" if "T" in epoch_utc else "iso").tai
    except ValueError as error:
        raise UserError(f"epoch_utc: {epoch_utc!r} is not an ISO-8601 date in UTC, like 2027-01-29T00:00:00") from error
    tai_ns = tai.from_jd_parts(atomic.jd1, atomic.jd2)
    refuse_outside_data(tai_ns)
    return tai_ns


def utc_text(tai_ns: int) -> str:
    """ISO-8601 UTC of an epoch, to the nanosecond."""
    return str(Time(*tai.to_jd_parts(tai_ns), format="jd", scale="tai", precision=9).utc.isot)


def refuse_outside_data(tai_ns: int) -> None:
    """UserError for an epoch that the installed Earth-orientation data do not cover."""
    days = earth_orientation.daily_values().mjd
    first, last = days[0], days[-1]
    time = Time(*tai.to_jd_parts(tai_ns), format="jd", scale="tai")
    if not first <= time.mjd <= last:
        allowed = f"{Time(first, format='mjd').iso[:10]} to {Time(last, format='mjd').iso[:10]}"
        raise UserError(f"epoch_utc: {time.iso[:10]} lies outside the Earth-orientation data; allowed is {allowed}")


def tt_parts(tai_ns: int) -> tuple[float, float]:
    """Julian date (TT) as whole days and a fraction."""
    jd1, jd2 = tai.to_jd_parts(tai_ns)
    return jd1, jd2 + 32.184 / DAY_S


def jyear(tai_ns: int) -> float:
    """Julian epoch (years)."""
    jd1, jd2 = tt_parts(tai_ns)
    return 2000.0 + ((jd1 - 2451545.0) + jd2) / 365.25


def earth_velocity_km_s(tai_ns: int) -> NDArray[np.float64]:
    """Barycentric velocity of the Earth, (3,), BCRS axes (ERFA `epv00`)."""
    _, barycentric = erfa.epv00(*tt_parts(tai_ns))
    return np.asarray(barycentric["v"]) * (AU_KM / DAY_S)


@lru_cache(maxsize=1024)  # pointing, sky and light each ask for the same instant
def sun_position_km(tai_ns: int) -> NDArray[np.float64]:
    """Geocentric position of the Sun's centre, (3,), GCRS axes, geometric (light time moves it by less than 1e-7 rad).

    The array is shared and cannot be written to.
    """
    heliocentric, _ = erfa.epv00(*tt_parts(tai_ns))
    out = -np.asarray(heliocentric["p"]) * AU_KM
    out.flags.writeable = False
    return out


@lru_cache(maxsize=512)
def itrs_from_gcrs(tai_ns: int) -> NDArray[np.float64]:
    """(3, 3) matrix that takes GCRS vectors to ITRS: IAU 2006/2000A with UT1 and polar motion from the IERS tables."""
    now = earth_orientation.at(tai_ns)
    out = np.array(erfa.c2t06a(*tt_parts(tai_ns), *now.ut1, now.x_rad, now.y_rad)).reshape(3, 3)
    out.flags.writeable = False
    return out


def geodetic_position_km(longitude_deg: float, latitude_deg: float, height_m: float) -> NDArray[np.float64]:
    """ITRS position of a WGS84 site, (3,) (ERFA `gd2gc`, ellipsoid 1)."""
    return np.asarray(erfa.gd2gc(1, np.radians(longitude_deg), np.radians(latitude_deg), height_m)) / 1000.0
