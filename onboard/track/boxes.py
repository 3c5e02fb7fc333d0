"""Boxes of velocities by the name of an orbit: where objects of a kind may move among the stars, seen from here, in px/s.

Orbits of the kind are placed where lines of sight of the field reach their radii, with each inclination and both directions that
lead through there. The box is the smallest that holds all their motions.
"""

import math
from dataclasses import dataclass
from itertools import product
from typing import Final

import numpy as np
from numpy.typing import NDArray

from onboard.track.stack import Box
from sboc_e2e.icd.frame import FrameHeader

Array = NDArray[np.float64]

GM_M3_S2: Final = 3.986004418e14
"""Of the Earth (IERS Conventions 2010)."""

FIELD_POINTS: Final = (-1.0, 0.0, 1.0)  # places of the field at which rates are taken: corners, edges and middle
RADII: Final = 5  # distances within an orbit's range at which rates are taken; `MARGIN` covers what lies between. Chosen
MARGIN: Final = 0.05
"""Share that half widths are widened by: orbits between the samples, and the attitude's motion."""

LEAST_HALF_PX_S: Final = 0.05  # a box without width would hold no velocity; this is half a pixel in ten seconds. Chosen


@dataclass(frozen=True, kw_only=True)
class OrbitKind:
    """Ranges of semi-major axis (m), eccentricity, inclination (deg), and radius at which the objects are looked for (m)."""

    semi_major_axis_m: tuple[float, float]
    eccentricity: tuple[float, float]
    inclination_deg: tuple[float, float]
    radius_m: tuple[float, float]


KINDS: Final = {
    "geo": OrbitKind(
        semi_major_axis_m=(42.164e6, 42.164e6),
        eccentricity=(0.0, 0.0),
        inclination_deg=(0.0, 15.0),
        radius_m=(42.164e6, 42.164e6),
    ),
    "meo": OrbitKind(
        semi_major_axis_m=(25.5e6, 29.6e6), eccentricity=(0.0, 0.0), inclination_deg=(54.0, 65.0), radius_m=(25.5e6, 29.6e6)
    ),
    "molniya": OrbitKind(
        semi_major_axis_m=(26.56e6, 26.56e6), eccentricity=(0.69, 0.74), inclination_deg=(62.0, 65.0), radius_m=(38.0e6, 45.0e6)
    ),
}
"""GEO: inclinations of the geosynchronous region (IADC 2007, 15 deg). MEO: GLONASS to Galileo. Molniya: about its apogee, where
objects spend half of their time."""

BLIND_PX_PER_FRAME: Final = 3.2
"""Half width of the blind box: faster points are lines that `joint` follows."""


def blind_box(period_s: float) -> Box:
    """All velocities up to `BLIND_PX_PER_FRAME` along either axis."""
    half = BLIND_PX_PER_FRAME / period_s
    return Box(row_px_s=0.0, col_px_s=0.0, half_row_px_s=half, half_col_px_s=half)


def named_box(kind: str, header: FrameHeader, focal_px: float) -> Box | None:
    """The box of a kind of orbit for a frame; None where its header lacks attitude or observer, or no such orbit is in view."""
    if header.attitude is None or header.observer is None:
        return None
    to_camera = _matrix(header.attitude.quaternion)
    half = 0.5 * np.array([header.rows, header.cols]) / focal_px
    found = []
    for by_row, by_col in product(FIELD_POINTS, FIELD_POINTS):
        in_camera = np.array([by_col * half[1], by_row * half[0], 1.0])
        in_camera /= np.linalg.norm(in_camera)
        sight = to_camera.T @ in_camera
        for rate in motions(KINDS[kind], sight, header.observer.position_m, header.observer.velocity_m_s):
            moving = to_camera @ rate
            # of (x / z, y / z), which columns and rows follow
            place = in_camera[:2] / in_camera[2]
            found.append(focal_px * (moving[:2] - place * moving[2])[::-1] / in_camera[2])
    if not found:
        return None
    low, high = np.min(found, axis=0), np.max(found, axis=0)
    middle, width = 0.5 * (low + high), np.maximum(0.5 * (1.0 + MARGIN) * (high - low), LEAST_HALF_PX_S)
    return Box(row_px_s=float(middle[0]), col_px_s=float(middle[1]), half_row_px_s=float(width[0]), half_col_px_s=float(width[1]))


def motions(kind: OrbitKind, sight: Array, position_m: Array, velocity_m_s: Array) -> list[Array]:
    """Rates (3,) of the direction, rad/s, of objects of a kind along a line of sight (3,), GCRS axes."""
    out = []
    along = float(position_m @ sight)
    for radius in np.linspace(*kind.radius_m, RADII if kind.radius_m[0] < kind.radius_m[1] else 1):
        range_m = -along + math.sqrt(max(along**2 + radius**2 - float(position_m @ position_m), 0.0))
        up = (position_m + range_m * sight) / radius
        east = np.array([-up[1], up[0], 0.0]) / max(math.hypot(up[0], up[1]), 1e-12)
        north, level = np.cross(up, east), max(math.hypot(up[0], up[1]), 1e-12)
        least, most = kind.inclination_deg
        # no orbit is inclined by less than the latitude of its places
        least = max(least, math.degrees(math.acos(min(level, 1.0))))
        if least > most:
            continue
        for a, e, i in product(kind.semi_major_axis_m, kind.eccentricity, np.linspace(least, most, 3)):
            speed2, across = GM_M3_S2 * (2.0 / radius - 1.0 / a), math.sqrt(GM_M3_S2 * a * (1.0 - e**2)) / radius
            if speed2 < across**2 * (1.0 - 1e-6):
                continue
            outward = math.sqrt(max(speed2 - across**2, 0.0))
            # cos(inclination) = cos(latitude) cos(heading from the east)
            heading = math.acos(min(math.cos(math.radians(i)) / level, 1.0))
            for sense, radial in product((-1.0, 1.0), (-1.0, 1.0)):
                way = across * (math.cos(heading) * east + sense * math.sin(heading) * north) + radial * outward * up
                relative = way - velocity_m_s
                out.append((relative - float(relative @ sight) * sight) / range_m)
    return out


def _matrix(q: Array) -> Array:
    """Matrix of a unit quaternion, scalar last, that rotates GCRS directions into the camera frame."""
    x, y, z, w = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
