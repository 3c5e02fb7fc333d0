"""Apparent directions of catalogue stars: as seen from the moving camera, GCRS axes.

The astrometric transformation of the IAU SOFA/ERFA routines for a space observer (`apcs`, `atciqz`): light deflection by
the Sun and aberration by the observer's barycentric velocity, Earth's (`epv00`) plus the geocentric one of the camera.
Parallax is left out (catalogue parallaxes are unknown; 0.05 arcsec at 20 pc).
"""

from typing import Any

import erfa
import numpy as np
from numpy.typing import NDArray

from ground.sky.sphere import unit_vectors
from sboc_e2e.icd.frame import FrameHeader, ObserverState
from sboc_e2e.icd.tai import to_jd_parts

Array = NDArray[np.float64]

TT_MINUS_TAI_DAYS = 32.184 / 86400.0
EARTH_GM_M3_S2 = 3.986004418e14


def jyear_of(tai_ns: int) -> float:
    """Julian epoch (TT, which is TDB to 2 ms)."""
    day, fraction = to_jd_parts(tai_ns)
    return 2000.0 + ((day - 2451545.0) + fraction + TT_MINUS_TAI_DAYS) / 365.25


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
