"""The true sky: catalogue stars displaced by their quoted errors, and fainter synthetic ones, as directions and fluxes."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from astropy import units as u
from numpy.typing import NDArray
from scipy.special import ndtri

from sboc_e2e.catalogue import StarCatalogue, Stars
from sboc_e2e.catalogue.healpix import grid
from sboc_e2e.icd.errors import UserError
from simulator.optics.instrument import InstrumentOptions
from simulator.randomness import Effect, generator, seed_word

Array = NDArray[np.float64]

MAS_RAD: Final = np.pi / 648000.0 / 1000.0

# Stars per square degree brighter than a magnitude, all-sky mean of Gaia DR3 counts.
_COUNT_MAG: Final = np.array([7.5, 9.0, 10.5, 12.0, 13.75, 15.5, 16.75, 18.0])
_COUNT_DEG2: Final = np.array([0.65, 4.05, 14.2, 55.4, 249.0, 972.0, 2366.0, 5345.0])
DWARFS_FROM_H: Final = 8.5
"""Reduced proper motion that parts red dwarfs from red giants."""
FAINT_B_V: Final = 0.75
"""Faint stars of the field are mostly late F to K dwarfs: B-V spread about this (Bahcall & Soneira 1980, ApJS 44, 73)."""
_COMPANION: Final = 1 << 61
"""Added to the number of a star for that of its companion."""
_CACHE_MARGIN_DEG: Final = 0.5
"""The pointing may move so far before the catalogue is searched anew."""


@dataclass(frozen=True, kw_only=True)
class StarOptions:
    """Which stars shine and how far they stand from where the catalogue has them."""

    enabled: bool = field(default=True, metadata={"doc": "stars shine"})
    catalogue_file: str = field(
        default="",
        metadata={
            "doc": "catalogue of the sky, made by `sboc catalogue build`; empty for the one that comes along. "
            "Ground uses it too unless `ground.catalogue_file` names another"
        },
    )
    catalogue_errors: float = field(
        default=1.0,
        metadata={"doc": "factor on the catalogue's quoted errors by which the true sky is displaced", "min": 0.0, "max": 100.0},
    )
    colours: bool = field(default=True, metadata={"doc": "flux follows a star's colour; off: all have the Sun's"})
    companion_share: float = field(
        default=0.0,
        metadata={"doc": "share of stars with an unlisted companion 2 to 60 arcsec away (Opik's law)", "min": 0.0, "max": 1.0},
    )
    variable_share: float = field(
        default=0.0,
        metadata={"doc": "share of stars that are not as bright as their catalogue says (variables)", "min": 0.0, "max": 1.0},
    )
    variable_amplitude_mag: float = field(default=0.1, metadata={"doc": "median amplitude of variables", "min": 0.0, "max": 5.0})
    faint_limit_mag: float = field(default=16.0, metadata={"doc": "V of the faintest synthetic stars", "min": 0.0, "max": 18.0})


@dataclass(frozen=True, kw_only=True, eq=False)
class StarField:
    """Stars around a direction, in sky order, catalogue stars first.

    direction : (n, 3) unit vectors, ICRS/GCRS axes, proper motion applied, not aberrated. flux_e_s : (n,) on axis.
    """

    direction: Array
    flux_e_s: Array
    star_id: NDArray[np.int64]
    v_mag: NDArray[np.float32]
    b_v: NDArray[np.float32]


def joined(fields: Sequence[StarField]) -> StarField:
    """Several fields as one, in their order."""
    return StarField(**{name: np.concatenate([getattr(f, name) for f in fields]) for name in StarField.__dataclass_fields__})


def unit_vectors(ra_deg: Array, dec_deg: Array) -> Array:
    """(n, 3) of right ascensions and declinations."""
    ra, dec = np.radians(ra_deg), np.radians(dec_deg)
    return np.stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)], axis=-1)


def angles_deg(vectors: Array) -> tuple[Array, Array]:
    """Right ascension [0, 360) and declination of vectors (..., 3)."""
    ra = np.degrees(np.arctan2(vectors[..., 1], vectors[..., 0])) % 360.0
    return ra, np.degrees(np.arctan2(vectors[..., 2], np.hypot(vectors[..., 0], vectors[..., 1])))


def sky_catalogue(options: StarOptions) -> StarCatalogue:
    """The star catalogue of the simulated sky. Raises `UserError` for a file that is no catalogue."""
    path = options.catalogue_file
    try:
        return StarCatalogue.open(path) if path else StarCatalogue.embedded()
    except UserError as error:
        raise UserError(f"stars.catalogue_file: {error}") from error


def over_mean_density(catalogue: StarCatalogue, mag: float, pixel_deg2: float) -> Array:
    """Stars (pixels,) of a catalogue over those of the all-sky mean brighter than a magnitude, one added to both."""
    return np.asarray((catalogue.pixel_counts + 1.0) / (float(cumulative_counts_deg2(mag)) * pixel_deg2 + 1.0))


def cumulative_counts_deg2(v_mag: Array | float) -> Array:
    """Mean number of stars per square degree brighter than V, log-linear between the counts."""
    return np.asarray(10.0 ** np.interp(v_mag, _COUNT_MAG, np.log10(_COUNT_DEG2)))


class StarSky:
    """Stars of any part of the sky at one epoch; the same star has the same place and flux whoever asks."""

    def __init__(
        self, options: StarOptions, instrument: InstrumentOptions, catalogue: StarCatalogue, *, seed: int, epoch_jyear: float
    ) -> None:
        self.options = options
        self.instrument = instrument
        self.catalogue = catalogue
        self.seed = seed
        self.epoch_jyear = epoch_jyear
        self._healpix = grid(catalogue.nside)
        self._held: tuple[Array, float, StarField] | None = None
        self._faint: dict[int, tuple[Array, Array, Array]] = {}

    def around(self, direction: Array, radius_deg: float) -> StarField:
        """All stars within a radius of a direction, and some beyond it (callers cut at the frame's edge).

        UserError when the catalogue has no star there.
        """
        if self._held is not None:
            centre, reach_deg, held = self._held
            separation = np.degrees(np.arccos(np.clip(centre @ direction, -1.0, 1.0)))
            if separation + radius_deg <= reach_deg:
                return held
        reach_deg = radius_deg + _CACHE_MARGIN_DEG
        found = self._search(direction, reach_deg)
        self._held = (direction, reach_deg, found)
        return found

    def _search(self, direction: Array, radius_deg: float) -> StarField:
        ra, dec = angles_deg(direction)
        stars = self.catalogue.cone(float(ra), float(dec), radius_deg, epoch_jyear=self.epoch_jyear)
        if len(stars) == 0:
            raise UserError(
                f"star catalogue {self.catalogue.name}: no star within {radius_deg:.2f} deg of RA {float(ra):.3f}, "
                f"Dec {float(dec):.3f} deg; choose a catalogue that covers the field"
            )
        bright = displaced(
            unit_vectors(stars.ra_deg, stars.dec_deg),
            stars.source_id,
            self.options.catalogue_errors * stars.sigma_mas.astype(np.float64) * MAS_RAD,
            seed_word(self.seed, Effect.CATALOGUE_ERRORS),
        )
        faint_direction, faint_v, faint_b_v, faint_id = self._faint_around(direction, radius_deg)
        v_mag = np.concatenate([stars.v_mag, faint_v]).astype(np.float32)
        b_v = np.concatenate([stars.b_v, faint_b_v]).astype(np.float32)
        camera = self.instrument
        direction_of = np.concatenate([bright, faint_direction])
        identity = np.concatenate([stars.source_id, faint_id])
        seen_mag = v_mag.astype(np.float64) + self._variation_mag(identity)
        giant = np.concatenate([giants(stars, self.catalogue.name), np.zeros(len(faint_v), dtype=np.bool_)])
        colour = camera.colour_factor(b_v.astype(np.float64), giant) if self.options.colours else 1.0
        found = StarField(
            direction=direction_of,
            flux_e_s=camera.true_zero_point_e_s * 10.0 ** (-0.4 * seen_mag) * colour,
            star_id=identity,
            v_mag=v_mag,
            b_v=b_v,
        )
        return self._with_companions(found)

    def _variation_mag(self, identity: NDArray[np.int64]) -> Array:
        """Magnitude of stars less that of the catalogue: sines of variables at a random phase, fixed for each star."""
        if self.options.variable_share == 0.0:
            return np.zeros(len(identity))
        chosen, amplitude, phase = uniforms(identity, seed_word(self.seed, Effect.COMPANIONS, 0), 3)
        peak = self.options.variable_amplitude_mag * np.exp(0.8 * ndtri(amplitude))
        return np.where(chosen < self.options.variable_share, peak * np.sin(2.0 * np.pi * phase), 0.0)

    def _with_companions(self, stars: StarField) -> StarField:
        """Stars, then their unlisted companions: even in the logarithm of the distance (Opik 1924), 0.5 to 6 mag fainter.

        A companion brighter than the catalogue's depth would be listed: it is left out.
        """
        if self.options.companion_share == 0.0:
            return stars
        chosen, apart, angle, fainter = uniforms(stars.star_id, seed_word(self.seed, Effect.COMPANIONS, 1), 4)
        drop_mag = 0.5 + 5.5 * fainter
        index = np.flatnonzero((chosen < self.options.companion_share) & (stars.v_mag + drop_mag > self.catalogue.v_max))
        radius = np.exp(np.log(2.0) + apart[index] * np.log(30.0)) * 1e3 * MAS_RAD
        first = stars.direction[index]
        east = np.stack([-first[:, 1], first[:, 0], np.zeros(len(first))], axis=-1)
        east /= np.maximum(np.linalg.norm(east, axis=-1, keepdims=True), 1e-12)
        turn = 2.0 * np.pi * angle[index][:, None]
        moved = first + radius[:, None] * (np.cos(turn) * east + np.sin(turn) * np.cross(first, east))
        moved /= np.linalg.norm(moved, axis=-1, keepdims=True)
        identity = -(np.abs(stars.star_id[index]) + _COMPANION)
        return StarField(
            direction=np.concatenate([stars.direction, moved]),
            flux_e_s=np.concatenate([stars.flux_e_s, stars.flux_e_s[index] * 10.0 ** (-0.4 * drop_mag[index])]),
            star_id=np.concatenate([stars.star_id, identity]),
            v_mag=np.concatenate([stars.v_mag, stars.v_mag[index] + drop_mag[index].astype(np.float32)]),
            b_v=np.concatenate([stars.b_v, stars.b_v[index]]),
        )

    def _faint_around(self, direction: Array, radius_deg: float) -> tuple[Array, Array, Array, NDArray[np.int64]]:
        """Synthetic stars between the catalogue's depth and the limit, drawn for whole HEALPix pixels."""
        from_mag, to_mag = self.catalogue.v_max, self.options.faint_limit_mag
        if from_mag >= to_mag:
            return np.zeros((0, 3)), np.zeros(0), np.zeros(0), np.zeros(0, dtype=np.int64)
        ra, dec = angles_deg(direction)
        pixels = np.sort(self._healpix.cone_search_lonlat(ra * u.deg, dec * u.deg, radius_deg * u.deg))
        drawn = [self._faint_of_pixel(int(p), from_mag, to_mag) for p in pixels]
        identity = np.concatenate([-(int(p) * 100_000 + 1 + np.arange(len(d[1]))) for p, d in zip(pixels, drawn, strict=True)])
        vectors, v_mag, b_v = (np.concatenate([d[k] for d in drawn]) for k in range(3))
        return vectors, v_mag, b_v, identity.astype(np.int64)

    def _faint_of_pixel(self, pixel: int, from_mag: float, to_mag: float) -> tuple[Array, Array, Array]:
        """Directions, V and B-V of one pixel's synthetic stars: all-sky counts scaled to the bright stars around.

        The density is interpolated between pixels, so that a cluster does not end at the edge of its pixel.
        """
        if pixel in self._faint:
            return self._faint[pixel]
        rng = generator(self.seed, Effect.FAINT_STARS, block=pixel)
        area_deg2 = self._healpix.pixel_area.to_value("deg2")
        base = float(cumulative_counts_deg2(from_mag))
        scale = over_mean_density(self.catalogue, from_mag, area_deg2)
        around = self._healpix.neighbours(pixel)
        peak = float(max(scale[pixel], scale[around[around >= 0]].max()))
        n = int(rng.poisson(peak * (float(cumulative_counts_deg2(to_mag)) - base) * area_deg2))
        longitude, latitude = self._healpix.healpix_to_lonlat(np.full(n, pixel), dx=rng.random(n), dy=rng.random(n))
        kept = rng.random(n) * peak < self._healpix.interpolate_bilinear_lonlat(longitude, latitude, scale)
        vectors = unit_vectors(longitude.deg[kept], latitude.deg[kept])
        n = len(vectors)
        nodes = np.linspace(from_mag, to_mag, 65)
        counts = cumulative_counts_deg2(nodes)
        v_mag = np.interp(rng.random(n), (counts - counts[0]) / (counts[-1] - counts[0]), nodes)
        b_v = np.clip(rng.normal(FAINT_B_V, 0.25, n), -0.2, 1.8)
        self._faint[pixel] = (vectors, v_mag, b_v)
        return self._faint[pixel]


def giants(stars: Stars, catalogue: str) -> NDArray[np.bool_]:
    """Which stars of a catalogue shine as giants where they are red: (n,).

    A red star of Tycho-2 is a dwarf where its reduced proper motion H = V + 5 log10(mu / arcsec/yr) + 5 is large: at 40 km/s
    across the line of sight H is M_V + 4.6, 11 for a K3 dwarf (M_V 6.7) and 6 for a clump giant (M_V 1). The B-V of a Gaia
    catalogue comes from BP-RP as Tycho's stars have it, so that the colours of those are right for all of its stars.
    """
    if catalogue.startswith("Gaia"):
        return np.ones(len(stars), dtype=np.bool_)
    motion_arcsec_yr = 1e-3 * np.hypot(stars.pm_ra_mas_yr, stars.pm_dec_mas_yr)
    return np.asarray(stars.v_mag + 5.0 * np.log10(np.maximum(motion_arcsec_yr, 1e-6)) + 5.0 < DWARFS_FROM_H)


def uniforms(identity: NDArray[np.int64], word: int, n: int) -> list[Array]:
    """n uniform numbers for each star, decided by its own number and a seed word."""
    bits, out = _hash64(identity.astype(np.uint64) ^ np.uint64(word)), []
    for _ in range(n):
        bits = _hash64(bits)
        out.append(((bits >> np.uint64(11)).astype(np.float64) + 0.5) * 2.0**-53)
    return out


def displaced(direction: Array, identity: NDArray[np.int64], sigma_rad: Array, word: int) -> Array:
    """Directions (n, 3) moved by normal errors (rad, each coordinate), decided by each star's own number and a seed word."""
    first = _hash64(identity.astype(np.uint64) ^ np.uint64(word))
    second = _hash64(first)
    u1 = ((first >> np.uint64(11)).astype(np.float64) + 0.5) * 2.0**-53
    u2 = (second >> np.uint64(11)).astype(np.float64) * 2.0**-53
    radius = np.sqrt(-2.0 * np.log(u1)) * sigma_rad
    east = np.stack([-direction[:, 1], direction[:, 0], np.zeros(len(direction))], axis=-1)
    east /= np.maximum(np.linalg.norm(east, axis=-1, keepdims=True), 1e-12)
    north = np.cross(direction, east)
    moved = direction + (radius * np.cos(2 * np.pi * u2))[:, None] * east + (radius * np.sin(2 * np.pi * u2))[:, None] * north
    return np.asarray(moved / np.linalg.norm(moved, axis=-1, keepdims=True))


def _hash64(value: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """SplitMix64 (Steele, Lea & Flood 2014, OOPSLA), an avalanche of 64 bits."""
    value = value + np.uint64(0x9E3779B97F4A7C15)
    value = (value ^ (value >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    value = (value ^ (value >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return value ^ (value >> np.uint64(31))
