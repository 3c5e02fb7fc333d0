"""Interval that models leave for the number of pieces seen a day: the number for other albedos and populations.

Each alternative replaces one assumption, on the same random numbers. Alternatives that give more pieces add in quadrature (of
logarithms). So do those that give fewer.

    albedo      median 0.175 (Mulrooney, Matney & Barker 2008, AMOS), or 0.08, a fifth below the usual 0.1 (assumed)
    surfaces    all Lambert, or all with half of their light mirror-like (Hejduk 2011, AMOS)
    orbits      small pieces without a break-up's velocity change; all pieces in low orbits
    size law    1.3 times more or fewer above 10 cm, 2 times below 1 cm: assumed, of the order by which MASTER and ORDEM differ
                (Krisko et al. 2015, Acta Astronaut. 113, 204)
"""

from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from simulator.randomness import Effect, generator
from simulator.scene.debris import SizeClass, draw_orbits
from simulator.scene.encounters import PopulationOptions, Window, draw_candidates

Array = NDArray[np.float64]

SNR: Final = 8.0
"""Expected S/N from which a piece counts as seen."""
ALBEDOS: Final = (0.08, 0.175)  # lowest and highest median of the albedo (see above)
CANDIDATES: Final = 20_000  # each has the same random numbers, so that ratios scatter less than rates. Chosen, not measured
BLOCK: Final = 3000
"""First number of these random streams, apart from those of the draws."""


@dataclass(frozen=True, kw_only=True)
class Seen:
    """Pieces of a class seen per day; low, high : of the models, as factors on it."""

    per_day: float
    low: float
    high: float


def seen_per_day(options: PopulationOptions, size_class: SizeClass, window: Window, class_number: int) -> Seen:
    """Pieces of a class that enter the field in a day and reach `SNR`, and the interval that models leave."""
    few = replace(options, candidates=CANDIDATES)
    orbits = _SameOrbits()

    def rate(changed: PopulationOptions) -> float:
        rng = generator(0, Effect.POPULATION, block=BLOCK + class_number)
        found = draw_candidates(changed, size_class, window, rng, orbits=orbits)
        return float(found.per_day[(found.snr >= SNR) & (found.rate_deg_s >= options.slowest_deg_s)].sum())

    nominal = rate(few)
    if nominal <= 0.0:
        return Seen(per_day=0.0, low=1.0, high=1.0)
    others = [
        *(rate(replace(few, albedo=a)) for a in ALBEDOS),
        *(rate(replace(few, surface=replace(few.surface, specular_share=s))) for s in (0.0, 0.5)),
        rate(replace(few, spread_by_breakup=not few.spread_by_breakup)),
        rate(replace(few, low_orbit_share_small=1.0, low_orbit_share_large=1.0)),
    ]
    size_m = 1e-3 * np.sqrt(size_class.from_mm * size_class.to_mm)
    law = float(number_factor(np.array([size_m]))[0])
    logs = np.log(np.maximum([*others, nominal * law, nominal / law], 1e-9) / nominal)
    low, high = (float(np.sqrt(np.sum(np.clip(sign * logs, 0.0, None) ** 2))) for sign in (-1.0, 1.0))
    return Seen(per_day=nominal, low=float(np.exp(-low)), high=float(np.exp(high)))


class _SameOrbits:
    """`draw_orbits` for the alternatives of one class: all reach it with equal diameters and random numbers, and pay once."""

    def __init__(self) -> None:
        self._drawn: dict[bool, tuple[tuple[Array, Array, Array], Any]] = {}

    def __call__(self, rng: np.random.Generator, size_m: Array, *, spread: bool) -> tuple[Array, Array, Array]:
        if spread not in self._drawn:
            orbits = draw_orbits(rng, size_m, spread=spread)
            self._drawn[spread] = orbits, rng.bit_generator.state
        orbits, rng.bit_generator.state = self._drawn[spread]
        return orbits


def number_factor(size_m: Array) -> Array:
    """By how much population models differ in the number of pieces: 2 below 1 cm, 1.3 above 10 cm."""
    share = np.clip(np.log10(size_m / 0.01), 0.0, 1.0)
    return np.asarray(2.0 ** (1.0 - share) * 1.3**share)
