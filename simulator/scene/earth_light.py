"""The Earth in sight of an orbiting camera: sunlit ground and air, airglow, and how much of the sky behind shines through.

Rays pass a sphere after the polar axis is stretched. Ground and clouds are a Lambert sphere; its albedo is such that the Earth at
quadrature has the V of Mallama & Hilton 2018 (Astronomy and Computing 25, 10). The air scatters once by Rayleigh's law and
falls off exponentially; below the Sun's horizon it is lit above the shadow's edge only. Airglow is a layer 90 km up. Cities,
aurora and the shapes of clouds are left out.
"""

from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from simulator.optics.far_scatter import ARCSEC2_PER_SR, FarScatterOptions, veil_per_arcsec2
from simulator.platform.earth import AU_KM, EARTH_RADIUS_KM, FLATTENING
from simulator.scene.atmosphere import SCALE_HEIGHT_KM
from simulator.scene.reflection import SUN_V_MAG

Array = NDArray[np.float64]

ALBEDO: Final = 0.475  # fitted to the V of the whole Earth at quadrature; 0.25 mag at phases of 60 to 120 deg (see above)
ZENITH_DEPTH: Final = 0.2
"""Vertical optical depth of air and aerosol at 550 nm at sea level."""
AIRGLOW_KM: Final = 90.0  # middle of the layer above the ground (see above)
AIRGLOW_WIDTH_KM: Final = 10.0  # of the layer; a thinner one has a brighter and thinner edge. Chosen, not measured
AIRGLOW_MAG: Final = 22.3
"""V of a square arcsecond of airglow at the zenith (Leinert et al. 1998, A&AS 127, 1, section 6)."""
AIR_TOP_KM: Final = 150.0  # above the airglow; the air that a ray grazes there has an optical depth of 1e-7
_SAMPLES: Final = 1500  # directions; 30,000 change the veil by 0.4 %, and by 12 % where the baffle's shade begins


def earth_reach_rad(observer_km: Array) -> float:
    """Angle from nadir to the top of the air."""
    return float(np.arcsin(min((EARTH_RADIUS_KM + AIR_TOP_KM) / float(np.linalg.norm(observer_km)), 1.0)))


def earth_light(directions: Array, observer_km: Array, sun_km: Array) -> tuple[Array, Array]:
    """Light of a square arcsecond in unit directions (n, 3), in units of a V = 0 star, and the sky's transmission there, (n,)."""
    stretch = np.array([1.0, 1.0, 1.0 / (1.0 - FLATTENING)])
    place, ray = observer_km * stretch, directions * stretch
    ray = ray / np.linalg.norm(ray, axis=-1, keepdims=True)
    sun = sun_km / np.linalg.norm(sun_km)
    along = -(ray @ place)
    nearest = place + along[:, None] * ray
    closest_km = np.linalg.norm(nearest, axis=-1)
    tangent_km = np.where(along > 0.0, closest_km - EARTH_RADIUS_KM, np.linalg.norm(place) - EARTH_RADIUS_KM)
    ground = tangent_km < 0.0
    half_km = np.sqrt(np.maximum(EARTH_RADIUS_KM**2 - closest_km**2, 0.0))
    point = np.where(ground[:, None], place + (along - half_km)[:, None] * ray, nearest)
    up = point / np.linalg.norm(point, axis=-1, keepdims=True)
    sun_height = up @ sun
    flux_sun = 10.0 ** (-0.4 * SUN_V_MAG) * (AU_KM / np.linalg.norm(sun_km)) ** 2 / ARCSEC2_PER_SR
    height_km = np.maximum(tangent_km, 0.0)
    # Where the Sun is below the horizon, what lies in the Earth's shadow does not scatter.
    depression = np.arcsin(np.clip(-sun_height, 0.0, 1.0))
    shadow_km = EARTH_RADIUS_KM * (1.0 / np.maximum(np.cos(depression), 1e-3) - 1.0)
    # A ray to the ground meets as much air as cosine and curvature leave, one past the limb the Chapman depth of both sides.
    slant = np.sqrt(2.0 * np.pi * EARTH_RADIUS_KM / SCALE_HEIGHT_KM)
    down = np.clip(-np.sum(ray * up, axis=-1), 0.5 / slant, 1.0)
    path = np.where(ground, np.minimum(1.0 / down, 0.5 * slant), slant)
    depth = ZENITH_DEPTH * path * np.exp(-height_km / SCALE_HEIGHT_KM)
    lit_depth = ZENITH_DEPTH * path * np.exp(-np.maximum(height_km, shadow_km) / SCALE_HEIGHT_KM)
    cosine = ray @ sun
    phase = 0.75 * (1.0 + cosine * cosine) / (4.0 * np.pi)
    air = flux_sun * phase * (1.0 - np.exp(-lit_depth))
    soil = np.where(ground, flux_sun * ALBEDO / np.pi * np.maximum(sun_height, 0.0), 0.0)
    # The Lambert sphere stands for ground and air together where it is lit: the air's own light is seen beyond its edge.
    light = np.maximum(soil, air) + _airglow(closest_km, ground, along > 0.0)
    return np.asarray(light), np.where(ground, 0.0, np.exp(-depth))


def _airglow(closest_km: Array, ground: NDArray[np.bool_], ahead: NDArray[np.bool_]) -> Array:
    """Airglow of rays: the length of path in the layer over its thickness."""
    inner, outer = (EARTH_RADIUS_KM + AIRGLOW_KM + s * 0.5 * AIRGLOW_WIDTH_KM for s in (-1.0, 1.0))
    half = np.sqrt(np.maximum(outer**2 - closest_km**2, 0.0)) - np.sqrt(np.maximum(inner**2 - closest_km**2, 0.0))
    crossings = np.where(ground, 1.0, np.where(ahead, 2.0, 0.0))
    return np.asarray(10.0 ** (-0.4 * AIRGLOW_MAG) * crossings * half / AIRGLOW_WIDTH_KM)


@cache
def _spiral() -> tuple[Array, Array, Array]:
    """Even points over a cap, each (n,): the share of its area below them, cosine and sine of their turn about its middle."""
    k = np.arange(_SAMPLES) + 0.5
    turn = np.pi * (1.0 + np.sqrt(5.0)) * k
    return k / _SAMPLES, np.cos(turn), np.sin(turn)


def earth_veil(options: FarScatterOptions, directions: Array, observer_km: Array, sun_km: Array) -> Array:
    """Light that the camera scatters from the visible Earth into a square arcsecond of directions (n, 3), V = 0 units."""
    reach, nadir = earth_reach_rad(observer_km), -observer_km / np.linalg.norm(observer_km)
    share, cos_turn, sin_turn = _spiral()
    cosine = 1.0 - (1.0 - np.cos(reach)) * share
    sine = np.sqrt(1.0 - cosine**2)
    x, y, z = nadir
    side = np.array([y, -x, 0.0] if abs(z) < 0.9 else [0.0, z, -y])  # nadir x the axis that is farther from it
    side /= np.linalg.norm(side)
    other = np.array([y * side[2] - z * side[1], z * side[0] - x * side[2], x * side[1] - y * side[0]])  # nadir x side
    seen = cosine[:, None] * nadir + sine[:, None] * (cos_turn[:, None] * side + sin_turn[:, None] * other)
    light, _ = earth_light(seen, observer_km, sun_km)
    solid_arcsec2 = 2.0 * np.pi * (1.0 - np.cos(reach)) / _SAMPLES * ARCSEC2_PER_SR
    apart = np.arccos(np.clip(directions @ seen.T, -1.0, 1.0))
    return np.asarray(veil_per_arcsec2(options, apart) @ (light * solid_arcsec2))
