"""Apparent directions of catalogue stars: as seen from the moving camera, GCRS axes.

The astrometric transformation of the IAU SOFA/ERFA routines for a space observer (`apcs`, `atciqz`): light deflection by
the Sun and aberration by the observer's barycentric velocity, Earth's (`epv00`) plus the geocentric one of the camera.
Parallax is left out (catalogue parallaxes are unknown; 0.05 arcsec at 20 pc).
"""

from typing import Any, Final

import erfa
import numpy as np
from numpy.typing import NDArray

from ground.sky.sphere import unit_vectors
from sboc_e2e.icd.frame import FrameHeader, ObserverState
from sboc_e2e.icd.tai import to_jd_parts

Array = NDArray[np.float64]

TT_MINUS_TAI_DAYS: Final = float(erfa.TTMTAI / erfa.DAYSEC)
"""32.184 s, exact (IAU 1991, recommendation IV)."""
EARTH_GM_M3_S2: Final = 3.986004418e14
"""IERS Conventions (2010), table 1.1, TCG-compatible. The TDB-compatible value is smaller by 1.5e-8 of it."""
EARTH_RADIUS_KM: Final = float(erfa.eform(1)[0] / 1e3)
"""6378.137: semi-major axis of the WGS 84 ellipsoid. Published heights are above a sphere of this radius."""
EARTH_SPIN_RAD_S: Final = 7.292115e-5
"""Nominal mean angular velocity, IERS Conventions (2010), table 1.2. The length of the day varies it by some 1e-8 of it."""


def jyear_of(tai_ns: int) -> float:
    """Julian epoch (TT, which is TDB to 2 ms)."""
    day, fraction = to_jd_parts(tai_ns)
    return 2000.0 + ((day - erfa.DJ00) + fraction + TT_MINUS_TAI_DAYS) / erfa.DJY


def mid_frame_tai_ns(header: FrameHeader) -> int:
    """Mid-exposure of the middle row: the epoch of a frame's attitude."""
    return header.t_start_tai_ns + round(header.line_time_ns * 0.5 * (header.rows - 1)) + header.exposure_ns // 2


def observer_at(observer: ObserverState | None, tai_ns: int) -> tuple[Array, Array]:
    """Position (m) and velocity (m/s) of the camera, GCRS, moved along its orbit from the telemetered epoch.

    A second-order step in the Earth's central field: 1 mm/s after 1 s. Without telemetry the geocentre, at rest.
    """
    if observer is None:
        return np.zeros(3), np.zeros(3)
    dt = (tai_ns - observer.tai_ns) * 1e-9
    r, v = np.asarray(observer.position_m), np.asarray(observer.velocity_m_s)
    distance = float(np.linalg.norm(r))
    pull = -EARTH_GM_M3_S2 / distance**3 * r if distance > 1e6 else np.zeros(3)
    return r + v * dt + 0.5 * pull * dt * dt, v + pull * dt


def apparent_context(tai_ns: int, position_m: Array, velocity_m_s: Array) -> Any:
    """ERFA's star-independent parameters (`apcs`) for a camera at this GCRS position and velocity."""
    day, fraction = to_jd_parts(tai_ns)
    fraction += TT_MINUS_TAI_DAYS
    heliocentric, barycentric = erfa.epv00(day, fraction)
    observer = np.zeros((), dtype=erfa.dt_pv)
    observer["p"], observer["v"] = position_m, velocity_m_s
    return erfa.apcs(day, fraction, observer, barycentric, heliocentric["p"])


def apparent_directions(ra_deg: Array, dec_deg: Array, tai_ns: int, position_m: Array, velocity_m_s: Array) -> Array:
    """Unit vectors (n, 3) in GCRS axes of stars at ICRS positions (of date), seen from the camera."""
    context = apparent_context(tai_ns, position_m, velocity_m_s)
    return unit_vectors(*erfa.atciqz(np.radians(ra_deg), np.radians(dec_deg), context))
