"""Asteroids of the main belt: points that stand where a camera looks against the Sun, in no star catalogue.

Numbers: 210 asteroids a square degree are brighter than R = 23 at opposition within a degree of the ecliptic; numbers grow with
absolute magnitude as 10^(0.51 H) to H = 15.4 and as 10^(0.30 H) beyond (SKADS: Gladman et al. 2009, Icarus 202, 104; V-R = 0.4).
Brightness: the H, G system (Bowell et al. 1989, Asteroids II, 524). Orbits: zones between the gaps of the belt; the shares of
zones, eccentricities and inclinations are rounded from Jedicke & Metcalfe 1998, Icarus 131, 245. Orbits are Kepler's.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from simulator.optics.instrument import InstrumentOptions
from simulator.platform.earth import AU_KM, DAY_S, LIGHT_KM_S, OBLIQUITY_RAD, sun_position_km, tai_ns_of_utc
from simulator.platform.kepler import Elements, eccentric_anomaly, perifocal_axes
from simulator.randomness import Effect, generator
from simulator.scene.stars import StarField

Array = NDArray[np.float64]

KINK_H: Final = 15.4  # where the slope of the numbers changes (Gladman et al. 2009)
_SLOPES: Final = (0.51, 0.30)  # of the logarithm of the number per magnitude, before and after the kink (Gladman et al. 2009)
NUMBER_AT_KINK: Final = 1.44e5
"""Asteroids brighter than that, such that the sky has SKADS' density."""
SLOPE_G: Final = 0.15  # the usual slope parameter of asteroids without one of their own (Bowell et al. 1989)
_ZONES: Final = np.array(
    [
        # from au, to au, share: Hungarias, inner, middle and outer belt on both sides of the 7:3 gap, Cybeles, Hildas
        [1.85, 2.00, 0.01],
        [2.10, 2.48, 0.23],
        [2.52, 2.80, 0.33],
        [2.85, 2.94, 0.12],
        [2.97, 3.25, 0.29],
        [3.32, 3.60, 0.01],
        [3.92, 4.00, 0.01],
    ]
)
_SPREAD_E: Final = 0.115  # of a Rayleigh distribution, rounded from Jedicke & Metcalfe 1998
_LARGEST_E: Final = 0.35  # where that distribution is cut: 1 % is beyond
_RANGES_OF_E: Final = 7  # 0.05 wide each: fewer would draw more that stay too faint, more would save little. Chosen, not measured
_SPREAD_I_RAD, _LARGEST_I_RAD = np.radians(7.5), np.radians(30.0)
_MEAN_B_V, _SPREAD_B_V = 0.77, 0.08
"""Between C types (0.70) and S types (0.86): Tedesco, Tholen & Zellner 1982, AJ 87, 1585."""
_GAUSS_RAD_DAY: Final = 0.01720209895  # Gauss's constant: mean motion at 1 au, au^1.5/day (IAU 1976)
ELEMENTS_UTC: Final = "2027-01-01T00:00:00"
"""Mean anomalies are those of this instant, so that a seed has the same belt at any epoch of a run."""
FIRST_ASTEROID_ID: Final = -(1 << 62) + 1000
"""Identity of asteroids in the truth of stars: this plus their number."""
_HELD_DEG: Final = 3.0  # margin about the field; a camera that turns farther has them drawn anew
_HELD_S: Final = 3600.0
"""Asteroids this far beyond the asked radius are kept for later frames so long: none moves by 1 deg in an hour."""


@dataclass(frozen=True, kw_only=True)
class AsteroidOptions:
    """Asteroids of the main belt, drawn by seed."""

    density: float = field(
        default=0.0, metadata={"doc": "factor on their number in nature, 0 for none", "min": 0.0, "max": 100.0}
    )
    faint_limit_mag: float = field(default=17.0, metadata={"doc": "V of the faintest", "min": 8.0, "max": 20.0})


@dataclass(frozen=True, kw_only=True, eq=False)
class Belt:
    """Heliocentric orbits: a in au, angles of the ecliptic of J2000 at `ELEMENTS_UTC`; absolute magnitudes and colours, (n,)."""

    elements: Elements
    h_mag: Array
    b_v: Array


def cumulative_number(h_mag: Array | float) -> Array:
    """Asteroids of the main belt brighter than an absolute magnitude."""
    beyond = np.asarray(h_mag, dtype=np.float64) - KINK_H
    return np.asarray(NUMBER_AT_KINK * 10.0 ** np.where(beyond < 0.0, _SLOPES[0] * beyond, _SLOPES[1] * beyond))


def draw_belt(options: AsteroidOptions, seed: int) -> Iterator[Belt]:
    """All asteroids that can become as bright as the limit, at perihelion against the Sun, in parts that fit into little memory.

    They are drawn by zone and range of eccentricity, each with the faintest absolute magnitude that can matter there.
    """
    rng = generator(seed, Effect.ASTEROIDS)
    edges_e = np.linspace(0.0, _LARGEST_E, _RANGES_OF_E + 1)
    below_e = 1.0 - np.exp(-0.5 * (edges_e / _SPREAD_E) ** 2)
    below_i = 1.0 - np.exp(-0.5 * (_LARGEST_I_RAD / _SPREAD_I_RAD) ** 2)
    for from_au, to_au, share in _ZONES:
        for k in range(_RANGES_OF_E):
            perihelion_au = from_au * (1.0 - edges_e[k + 1])
            faintest_h = options.faint_limit_mag - 5.0 * np.log10(perihelion_au * (perihelion_au - 1.0))
            factor = options.density * share * (below_e[k + 1] - below_e[k]) / below_e[-1]
            last = float(factor * cumulative_number(faintest_h))
            n = int(rng.poisson(last))
            relative = np.log10(last * (1.0 - rng.random(n)) / max(factor * NUMBER_AT_KINK, 1e-300))
            angles = 2.0 * np.pi * rng.random((3, n))
            elements = Elements(
                a_km=from_au + (to_au - from_au) * rng.random(n),
                e=_SPREAD_E * np.sqrt(-2.0 * np.log(1.0 - below_e[k] - (below_e[k + 1] - below_e[k]) * rng.random(n))),
                i_rad=_SPREAD_I_RAD * np.sqrt(-2.0 * np.log(1.0 - below_i * rng.random(n))),
                node_rad=angles[0],
                argp_rad=angles[1],
                mean_anomaly_rad=angles[2],
            )
            h_mag = KINK_H + np.where(relative < 0.0, relative / _SLOPES[0], relative / _SLOPES[1])
            yield Belt(elements=elements, h_mag=h_mag, b_v=_MEAN_B_V + _SPREAD_B_V * rng.standard_normal(n))


def whole(parts: Iterable[Belt]) -> Belt:
    """Parts of a belt as one."""
    belts = list(parts)
    return Belt(
        elements=Elements(**{k: np.concatenate([getattr(b.elements, k) for b in belts]) for k in Elements.__dataclass_fields__}),
        h_mag=np.concatenate([b.h_mag for b in belts]),
        b_v=np.concatenate([b.b_v for b in belts]),
    )


def heliocentric_au(elements: Elements, days: Array | float) -> Array:
    """Positions (n, 3), ICRS axes, a number of days after the instant of the elements; their a in au."""
    a, e = elements.a_km, elements.e
    ecc = eccentric_anomaly(elements.mean_anomaly_rad + _GAUSS_RAD_DAY * a**-1.5 * days, e)
    to_perihelion, ahead = perifocal_axes(elements)
    x, y, z = ((a * (np.cos(ecc) - e))[:, None] * to_perihelion + (a * np.sqrt(1.0 - e * e) * np.sin(ecc))[:, None] * ahead).T
    c, s = np.cos(OBLIQUITY_RAD), np.sin(OBLIQUITY_RAD)
    return np.stack([x, c * y - s * z, s * y + c * z], axis=-1)


def asteroid_magnitude(h_mag: Array, sun_au: Array, observer_au: Array, phase_rad: Array) -> Array:
    """V of asteroids of G = 0.15 by the H, G system (Bowell et al. 1989, eq. A4)."""
    half = np.tan(0.5 * phase_rad)
    dark, bright = np.exp(-3.33 * half**0.63), np.exp(-1.87 * half**1.22)
    return np.asarray(h_mag + 5.0 * np.log10(sun_au * observer_au) - 2.5 * np.log10((1.0 - SLOPE_G) * dark + SLOPE_G * bright))


def seen_from(belt: Belt, tai_ns: int, observer_km: Array) -> tuple[Array, Array]:
    """Directions (n, 3) when the light left that arrives now, not aberrated, and V (n,) of asteroids."""
    to_sun = (sun_position_km(tai_ns) - observer_km) / AU_KM
    days = (tai_ns - tai_ns_of_utc(ELEMENTS_UTC)) * 1e-9 / DAY_S
    place = heliocentric_au(belt.elements, days)
    delay_days = np.linalg.norm(place + to_sun, axis=1) * (AU_KM / LIGHT_KM_S / DAY_S)
    place = heliocentric_au(belt.elements, days - delay_days)
    vector = place + to_sun
    distance, sun = np.linalg.norm(vector, axis=1), np.linalg.norm(place, axis=1)
    phase = np.arccos(np.clip(np.sum(place * vector, axis=1) / (sun * distance), -1.0, 1.0))
    return vector / distance[:, None], asteroid_magnitude(belt.h_mag, sun, distance, phase)


class AsteroidSky:
    """Asteroids around a direction at an instant, as points of light."""

    def __init__(self, options: AsteroidOptions, instrument: InstrumentOptions, *, seed: int) -> None:
        self.options, self.instrument, self._seed = options, instrument, seed
        self._held: tuple[Array, float, int, Belt, NDArray[np.int64]] | None = None

    def around(self, direction: Array, radius_deg: float, tai_ns: int, observer_km: Array) -> StarField:
        """Those within a radius of a direction (3,) and some beyond it; observer_km : (3,) geocentric."""
        near, number = self._near(direction, radius_deg, tai_ns)
        seen, v_mag = seen_from(near, tai_ns, observer_km)
        bright = v_mag < self.options.faint_limit_mag
        v_mag, b_v = v_mag[bright], near.b_v[bright]
        return StarField(
            direction=seen[bright],
            flux_e_s=self.instrument.true_zero_point_e_s * 10.0 ** (-0.4 * v_mag) * self.instrument.colour_factor(b_v),
            star_id=FIRST_ASTEROID_ID + number[bright],
            v_mag=v_mag.astype(np.float32),
            b_v=b_v.astype(np.float32),
        )

    def _near(self, direction: Array, radius_deg: float, tai_ns: int) -> tuple[Belt, NDArray[np.int64]]:
        """Asteroids near a direction and their numbers, in growing order."""
        if self._held is not None:
            centre, reach_deg, since_ns, held, number = self._held
            apart_deg = np.degrees(np.arccos(np.clip(centre @ direction, -1.0, 1.0)))
            if apart_deg + radius_deg + 1.0 <= reach_deg and abs(tai_ns - since_ns) < _HELD_S * 1e9:
                return held, number
        reach_deg, first = radius_deg + _HELD_DEG, 0
        parts, numbers = [], []
        for part in draw_belt(self.options, self._seed):
            seen, v_mag = seen_from(part, tai_ns, np.zeros(3))
            within = (seen @ direction > np.cos(np.radians(reach_deg))) & (v_mag < self.options.faint_limit_mag + 0.5)
            elements = Elements(**{k: getattr(part.elements, k)[within] for k in Elements.__dataclass_fields__})
            parts.append(Belt(elements=elements, h_mag=part.h_mag[within], b_v=part.b_v[within]))
            numbers.append(first + np.flatnonzero(within).astype(np.int64))
            first += len(within)
        self._held = (direction, reach_deg, tai_ns, whole(parts), np.concatenate(numbers))
        return self._held[3:]
