"""Galaxies: small nebulous patches that no star catalogue has, elongated as short trails are.

Numbers grow as 10^(0.6 m), 9 a square degree being brighter than r = 16: between 9.8 by the luminosity function of Blanton et al.
2003, ApJ 592, 819 (Euclidean) and 8.0 by the 92 a square degree brighter than r = 17.77 of Strauss et al. 2002, AJ 124, 1810.
V-r is 0.36. Dust takes 0.15 mag for each unit of cosec b beyond the first. Seven in ten are discs seen from random sides
(exponential, 0.2 thick), the others have de Vaucouleurs' profile. Mean surface brightness within half of the light: V = 21.0
+- 0.6 mag/arcsec2, rounded from the sizes of Shen et al. 2003, MNRAS 343, 978. Clustering of galaxies is left out.
"""

from dataclasses import dataclass, field
from typing import Final

import numpy as np
from astropy import units as u
from numpy.typing import NDArray
from scipy.special import gammaincinv

from sboc_e2e.catalogue.healpix import grid
from simulator.optics.instrument import InstrumentOptions
from simulator.randomness import Effect, generator
from simulator.scene.stars import StarField, angles_deg, joined, unit_vectors

Array = NDArray[np.float64]

_AT_MAG: Final = 16.36  # V of r = 16: V-r is 0.36
_PER_DEG2: Final = 9.0  # brighter than that: between 8.0 and 9.8 of the two surveys (see above)
_BRIGHTEST_MAG: Final = 8.0
"""All brighter ones are known by name."""
GALACTIC_POLE: Final = np.array([-0.8676661356833737, -0.1980763872750533, 0.4559837919562393])
"""Direction of the north galactic pole, ICRS (192.85948 deg, 27.12825 deg)."""
_DUST_MAG: Final = 0.15  # V for each unit of cosec b (see above)
_DISCS: Final = 0.7  # share of galaxies; the others are ellipticals (see above)
_THICKNESS: Final = 0.2  # axis ratio of a disc from its side (see above)
_SURFACE_MAG, _SURFACE_SPREAD_MAG = 21.0, 0.6
_B_V, _B_V_SPREAD = 0.85, 0.12
"""Roberts & Haynes 1994, ARA&A 32, 115: 0.5 to 0.9 from late to early types, the bright sky having most of the latter."""
_LIGHT_DRAWN: Final = 0.98  # the rest is spread thinly: discs end at 3.5 radii of half of the light, ellipticals at 13.9
_POINTS_PER_PX2: Final = 40.0  # half of them lie within the ellipse of half of the light: 6 for each px^2 of it, 0.4 px apart
_FEWEST, _MOST = 12, 4000
"""Points of light that stand for a galaxy, in proportion to the square of its radius in pixels."""
_NSIDE: Final = 32  # HEALPix cells of 1.8 deg: a field has a few, and each is drawn whole
_MARGIN_DEG: Final = 0.5  # the pointing may move so far before the sky is searched anew
FIRST_GALAXY_ID: Final = -(1 << 61) - (1 << 60)
"""Identity of galaxies, downwards by 10,000 for each cell: apart from bodies and asteroids (-2^62 and up) and from clusters."""


@dataclass(frozen=True, kw_only=True)
class GalaxyOptions:
    """Galaxies, drawn by seed."""

    density: float = field(
        default=0.0, metadata={"doc": "factor on their number in nature, 0 for none", "min": 0.0, "max": 100.0}
    )
    faint_limit_mag: float = field(default=16.0, metadata={"doc": "V of the faintest", "min": 9.0, "max": 18.0})


@dataclass(frozen=True, kw_only=True, eq=False)
class Galaxies:
    """n galaxies. direction : (n, 3). radius_rad : of half of the light, along the major axis. sersic : index of the profile.

    ratio : of the axes. angle_rad : from north to east.
    """

    direction: Array
    v_mag: Array
    radius_rad: Array
    ratio: Array
    angle_rad: Array
    sersic: Array
    b_v: Array


def cumulative_galaxies_deg2(v_mag: Array | float) -> Array:
    """Galaxies a square degree brighter than V, at the galactic poles."""
    return np.asarray(_PER_DEG2 * 10.0 ** (0.6 * (np.asarray(v_mag) - _AT_MAG)))


def thinned_by_dust(direction: Array) -> Array:
    """Share of galaxies of a magnitude that dust leaves in directions (n, 3)."""
    sine = np.maximum(np.abs(direction @ GALACTIC_POLE), 0.02)
    return np.asarray(10.0 ** (-0.6 * _DUST_MAG * (1.0 / sine - 1.0)))


def draw_galaxies(options: GalaxyOptions, seed: int, pixel: int) -> Galaxies:
    """Those of one HEALPix pixel."""
    rng = generator(seed, Effect.GALAXIES, block=pixel)
    healpix = grid(_NSIDE)
    first, last = (float(cumulative_galaxies_deg2(m)) for m in (_BRIGHTEST_MAG, options.faint_limit_mag))
    n = int(rng.poisson(options.density * (last - first) * healpix.pixel_area.to_value("deg2")))
    longitude, latitude = healpix.healpix_to_lonlat(np.full(n, pixel), dx=rng.random(n), dy=rng.random(n))
    direction = unit_vectors(longitude.deg, latitude.deg)
    v_mag = _AT_MAG + np.log10((first + (last - first) * rng.random(n)) / _PER_DEG2) / 0.6
    disc, side, chance = rng.random((3, n))
    ratio = np.where(disc < _DISCS, np.sqrt(side**2 * (1.0 - _THICKNESS**2) + _THICKNESS**2), 0.5 + 0.5 * side)
    surface = _SURFACE_MAG + _SURFACE_SPREAD_MAG * rng.standard_normal(n)
    radius_arcsec = np.sqrt(10.0 ** (0.4 * (surface - v_mag)) / (2.0 * np.pi))
    kept = chance < thinned_by_dust(direction)
    columns = {
        "v_mag": v_mag,
        "radius_rad": radius_arcsec * np.pi / 648000.0,
        "ratio": ratio,
        "angle_rad": np.pi * rng.random(n),
        "sersic": np.where(disc < _DISCS, 1.0, 4.0),
        "b_v": _B_V + _B_V_SPREAD * rng.standard_normal(n),
    }
    return Galaxies(direction=direction[kept], **{name: values[kept] for name, values in columns.items()})


def points_of(galaxies: Galaxies, k: int, n: int) -> Array:
    """Directions (n, 3) of points with equal light that make up a galaxy: a spiral of the golden angle over its profile."""
    index = np.arange(n) + 0.5
    radius, turn = radius_of_light(float(galaxies.sersic[k]), _LIGHT_DRAWN * index / n), np.pi * (3.0 - np.sqrt(5.0)) * index
    along = galaxies.radius_rad[k] * radius * np.cos(turn)
    across = galaxies.radius_rad[k] * galaxies.ratio[k] * radius * np.sin(turn)
    middle = galaxies.direction[k]
    east = np.cross([0.0, 0.0, 1.0], middle)
    east /= np.linalg.norm(east)
    north = np.cross(middle, east)
    s, c = np.sin(galaxies.angle_rad[k]), np.cos(galaxies.angle_rad[k])
    seen = middle + along[:, None] * (s * east + c * north) + across[:, None] * (c * east - s * north)
    return np.asarray(seen / np.linalg.norm(seen, axis=1, keepdims=True))


def radius_of_light(sersic: float, share: Array) -> Array:
    """Radius, in those of half of the light, within which a share of a Sersic profile's light lies (Ciotti 1991, A&A 249, 99)."""
    return np.asarray((gammaincinv(2.0 * sersic, share) / gammaincinv(2.0 * sersic, 0.5)) ** sersic)


class GalaxySky:
    """Galaxies of any part of the sky as points of light; the same whoever asks."""

    def __init__(self, options: GalaxyOptions, instrument: InstrumentOptions, *, seed: int) -> None:
        self.options, self.instrument, self._seed = options, instrument, seed
        self._healpix = grid(_NSIDE)
        self._held: tuple[Array, float, StarField] | None = None

    def around(self, direction: Array, radius_deg: float) -> StarField:
        """Points of all galaxies within a radius of a direction (3,), and of some beyond it."""
        if self._held is not None:
            centre, reach_deg, held = self._held
            if np.degrees(np.arccos(np.clip(centre @ direction, -1.0, 1.0))) + radius_deg <= reach_deg:
                return held
        reach_deg = radius_deg + _MARGIN_DEG
        ra, dec = angles_deg(direction)
        pixels = np.sort(self._healpix.cone_search_lonlat(ra * u.deg, dec * u.deg, reach_deg * u.deg))
        made = joined([self._points(draw_galaxies(self.options, self._seed, int(p)), int(p)) for p in pixels])
        self._held = (direction, reach_deg, made)
        return made

    def _points(self, galaxies: Galaxies, pixel: int) -> StarField:
        radius_px = galaxies.radius_rad * self.instrument.focal_px
        counts = np.clip(_POINTS_PER_PX2 * galaxies.ratio * radius_px**2, _FEWEST, _MOST).astype(int)
        each = np.repeat(np.arange(len(counts)), counts)
        colour = self.instrument.colour_factor(galaxies.b_v)
        whole = _LIGHT_DRAWN * self.instrument.true_zero_point_e_s * 10.0 ** (-0.4 * galaxies.v_mag) * colour
        seen = [points_of(galaxies, k, int(n)) for k, n in enumerate(counts)]
        return StarField(
            direction=np.concatenate([np.zeros((0, 3)), *seen]),
            flux_e_s=(whole / counts)[each],
            star_id=FIRST_GALAXY_ID - (pixel * 10_000 + each.astype(np.int64)),
            v_mag=galaxies.v_mag[each].astype(np.float32),
            b_v=galaxies.b_v[each].astype(np.float32),
        )
