"""Diffuse light: zodiacal light, stars too faint to draw, and stray light; electrons per pixel and second."""

from dataclasses import dataclass, field
from typing import Final

import numba
import numpy as np
from numpy.typing import NDArray

from simulator.optics.vignetting import illumination_of_row
from simulator.platform.earth import OBLIQUITY_RAD
from simulator.scene.asteroids import AsteroidOptions
from simulator.scene.galaxies import GALACTIC_POLE, GalaxyOptions

Array = NDArray[np.float64]

S10_MAG: Final = 27.78
"""V surface brightness (mag / arcsec2) of one star of V = 10 in a square degree."""

# Leinert et al. 1998, A&AS 127, 1, table 17: zodiacal light at 500 nm, 1e-8 W m-2 sr-1 um-1, seen from the Earth's orbit.
# One S10 is 1.28 of these. Cells nearer to the Sun than the table's are filled with its innermost values.
_LONGITUDE_DEG: Final = np.array([0, 5, 10, 15, 20, 25, 30, 35, 40, 45, 60, 75, 90, 105, 120, 135, 150, 165, 180.0])
_LATITUDE_DEG: Final = np.array([0, 5, 10, 15, 20, 25, 30, 45, 60, 75, 90.0])
_ZODIACAL: Final = np.array(
    [
        [11500, 6780, 4740, 3140, 1610, 985, 640, 275, 150, 100, 77],
        [11500, 6780, 4740, 2940, 1540, 945, 625, 271, 150, 100, 77],
        [11500, 6780, 4740, 2470, 1370, 865, 590, 264, 148, 100, 77],
        [11500, 6780, 3440, 1860, 1110, 755, 525, 251, 146, 100, 77],
        [6400, 4480, 2410, 1410, 910, 635, 454, 237, 141, 99, 77],
        [3840, 2830, 1730, 1100, 749, 545, 410, 223, 136, 97, 77],
        [2480, 1870, 1220, 845, 615, 467, 365, 207, 131, 95, 77],
        [1650, 1270, 910, 680, 510, 397, 320, 193, 125, 93, 77],
        [1180, 940, 700, 530, 416, 338, 282, 179, 120, 92, 77],
        [910, 730, 555, 442, 356, 292, 250, 166, 116, 90, 77],
        [505, 442, 352, 292, 243, 209, 183, 134, 104, 86, 77],
        [338, 317, 269, 227, 196, 172, 151, 116, 93, 82, 77],
        [259, 251, 225, 193, 166, 147, 132, 104, 86, 79, 77],
        [212, 210, 197, 170, 150, 133, 119, 96, 82, 77, 77],
        [188, 186, 177, 154, 138, 125, 113, 90, 77, 74, 77],
        [179, 178, 166, 147, 134, 122, 110, 90, 77, 73, 77],
        [179, 178, 165, 148, 137, 127, 116, 96, 79, 72, 77],
        [196, 192, 179, 165, 151, 141, 131, 104, 82, 72, 77],
        [230, 212, 195, 178, 163, 148, 134, 105, 83, 72, 77],
    ],
    dtype=np.float64,
)  # fmt: skip - one line for each longitude, as in the paper

# Integrated light of stars fainter than V = 16 and diffuse galactic light, S10, against galactic latitude (smoothed from
# Leinert et al. 1998, sections 9 to 11; good to about 30 %).
_GALACTIC_LATITUDE_DEG: Final = np.array([0.0, 5.0, 10.0, 20.0, 30.0, 60.0, 90.0])
_UNRESOLVED_S10: Final = np.array([200.0, 120.0, 75.0, 50.0, 38.0, 28.0, 25.0])

SKY_GRID: Final = 9
"""Nodes across a frame. Linear values between them err by 0.4 % of the sky opposite to the Sun, by 1.1 % at kinks of the table
(5 deg)."""


@dataclass(frozen=True, kw_only=True)
class SkyOptions:
    """Diffuse background; each part is scaled by its factor, 0 switches it off."""

    zodiacal: float = field(default=1.0, metadata={"doc": "factor on the zodiacal light", "min": 0.0, "max": 100.0})
    unresolved: float = field(
        default=1.0, metadata={"doc": "factor on unresolved stars and diffuse galactic light", "min": 0.0, "max": 100.0}
    )
    structure: float = field(
        default=0.0,
        metadata={
            "doc": "rms of the logarithm of the unresolved light over the sky (cirrus), 0 for none",
            "min": 0.0,
            "max": 2.0,
        },
    )
    moon: bool = field(default=False, metadata={"doc": "the Moon shines, and its light scatters in air and optics"})
    planets: bool = field(default=False, metadata={"doc": "planets shine"})
    asteroids: AsteroidOptions = field(default_factory=AsteroidOptions, metadata={"doc": "asteroids of the main belt"})
    clusters: bool = field(default=False, metadata={"doc": "globular clusters shine"})
    galaxies: GalaxyOptions = field(default_factory=GalaxyOptions, metadata={"doc": "galaxies"})
    earth: bool = field(
        default=True, metadata={"doc": "the Earth hides stars, shines in the field and scatters in optics (orbits)"}
    )


def ecliptic_of(directions: Array) -> tuple[Array, Array]:
    """Ecliptic longitude and latitude (rad, mean obliquity of J2000) of GCRS directions (..., 3)."""
    c, s = np.cos(OBLIQUITY_RAD), np.sin(OBLIQUITY_RAD)
    x, y, z = directions[..., 0], directions[..., 1], directions[..., 2]
    return np.arctan2(c * y + s * z, x), np.arcsin(np.clip(c * z - s * y, -1.0, 1.0))


def zodiacal_s10(directions: Array, sun_direction: Array) -> Array:
    """Zodiacal light (S10) in GCRS directions (..., 3), bilinear in Leinert's table."""
    longitude, latitude = ecliptic_of(directions)
    sun_longitude, _ = ecliptic_of(sun_direction)
    from_sun = np.degrees(np.abs((longitude - sun_longitude + np.pi) % (2 * np.pi) - np.pi))
    x = np.interp(from_sun, _LONGITUDE_DEG, np.arange(_LONGITUDE_DEG.size))
    y = np.interp(np.degrees(np.abs(latitude)), _LATITUDE_DEG, np.arange(_LATITUDE_DEG.size))
    i = np.minimum(x.astype(int), _LONGITUDE_DEG.size - 2)
    j = np.minimum(y.astype(int), _LATITUDE_DEG.size - 2)
    fx, fy = x - i, y - j
    low = _ZODIACAL[i, j] * (1 - fx) + _ZODIACAL[i + 1, j] * fx
    high = _ZODIACAL[i, j + 1] * (1 - fx) + _ZODIACAL[i + 1, j + 1] * fx
    return np.asarray((low * (1 - fy) + high * fy) / 1.28)


def unresolved_s10(directions: Array) -> Array:
    """Stars fainter than V = 16 and diffuse galactic light (S10) in GCRS directions (..., 3)."""
    latitude_deg = np.degrees(np.abs(np.arcsin(np.clip(directions @ GALACTIC_POLE, -1.0, 1.0))))
    return np.asarray(np.interp(latitude_deg, _GALACTIC_LATITUDE_DEG, _UNRESOLVED_S10))


def unresolved_flux(options: SkyOptions, directions: Array) -> Array:
    """The part of faint stars and diffuse galactic light in `diffuse_flux`."""
    return np.asarray(options.unresolved * unresolved_s10(directions) * 10.0 ** (-0.4 * S10_MAG))


def diffuse_flux(options: SkyOptions, directions: Array, sun_km: Array) -> Array:
    """Flux of one square arcsecond of sky in GCRS directions (n, 3), in units of a V = 0 star."""
    zodiacal = zodiacal_s10(directions, sun_km / np.linalg.norm(sun_km))
    s10 = options.zodiacal * zodiacal + options.unresolved * unresolved_s10(directions)
    return np.asarray(s10 * 10.0 ** (-0.4 * S10_MAG))


@numba.njit(cache=True)
def fill_diffuse(
    image_e: NDArray[np.float32],
    light_nodes: NDArray[np.float32],
    light_step_px: int,
    grid_e: NDArray[np.float32],
    stray_e: float,
    gradient: float,
) -> None:
    """Set an image (rows, cols) to sky times illumination plus stray light.

    light_nodes, light_step_px : an `IlluminationGrid`.
    grid_e : (g, g) electrons per pixel at equally spaced nodes from corner to corner, interpolated bilinearly.
    stray_e : at the middle column; `gradient` is its relative change from the first column to the last.
    """
    rows, cols = image_e.shape
    last = grid_e.shape[0] - 1
    stray = np.empty(cols, np.float32)
    for c in range(cols):
        stray[c] = stray_e * (1.0 + gradient * (c / max(cols - 1, 1) - 0.5))
    step = max(cols - 1, 1) / last  # columns between nodes
    nodes = np.empty(last + 1)
    light, light_ends = np.empty(cols, np.float32), np.empty((2, cols), np.float32)
    for r in range(rows):
        illumination_of_row(light_nodes, light_step_px, r, light_ends, light)
        y = r / max(rows - 1, 1) * last
        i = min(int(y), last - 1)
        for j in range(last + 1):
            nodes[j] = grid_e[i, j] + (y - i) * (grid_e[i + 1, j] - grid_e[i, j])
        for j in range(last):
            first = int(np.ceil(j * step))
            beyond = cols if j == last - 1 else int(np.ceil((j + 1) * step))
            slope = np.float32((nodes[j + 1] - nodes[j]) / step)
            level = np.float32(nodes[j] + slope * (first - j * step))
            for c in range(first, min(beyond, cols)):
                image_e[r, c] = (level + slope * np.float32(c - first)) * light[c] + stray[c]
