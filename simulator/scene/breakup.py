"""NASA's standard break-up model: how many pieces an explosion or a collision leaves, how large, how heavy and how fast.

Johnson, Krisko, Liou & Anz-Meador 2001, Adv. Space Res. 28, 1377, with the mass that enters the number of pieces of a
non-catastrophic collision as corrected by Krisko 2011, Orbital Debris Quarterly News 15(4). Lengths are the model's
characteristic lengths in m, lambda their logarithm, chi the logarithm of area over mass in m^2/kg. For large pieces chi is a
mixture of two normal distributions: one of them is chosen for each piece. Drag is not in it.
"""

from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd.errors import UserError

Array = NDArray[np.float64]

CATASTROPHIC_J_KG: Final = 40_000.0
"""Energy of the projectile over the target's mass from which all of the target breaks."""

LARGEST_M: Final = 1.0
"""The law of numbers ends here; what mass is left goes into pieces of this length and more."""

SMALL_M, LARGE_M = 0.08, 0.11
"""Below and above: the two branches of chi. Between them the branch is drawn, in proportion to the length."""

DUST_M: Final = 1e-4
"""Pieces between this and `smallest` are counted as mass that is not drawn; smaller ones weigh less than 1 % of them."""

MOST_PIECES: Final = 400_000  # a budget of memory and time, refused beyond; chosen, not measured
LONG_PIECES: Final = 400  # longer than `LARGEST_M`, drawn at a time until the mass is spent: enough for 10 t at once
SHARE_OF_MASS: Final = 0.999  # where less than a thousandth of the broken mass is left over, it counts as dust


@dataclass(frozen=True, kw_only=True)
class BreakupOptions:
    """The break-up of a chosen object at a chosen time."""

    object: str = field(
        default="", metadata={"doc": "name or number of a satellite of objects.satellites, or name of an objects.orbit"}
    )
    when_h: float = field(default=0.0, metadata={"doc": "time after the epoch of the run", "min": -8760.0, "max": 876000.0})
    cause: str = field(default="explosion", metadata={"doc": "what breaks it", "choices": ("explosion", "collision")})
    structure: str = field(default="spacecraft", metadata={"doc": "kind of object", "choices": ("spacecraft", "rocket_body")})
    mass_kg: float = field(default=800.0, metadata={"doc": "mass of the object", "min": 0.1, "max": 1e6})
    factor: float = field(
        default=1.0, metadata={"doc": "explosions: number of pieces over that of the model (its S)", "min": 0.01, "max": 10.0}
    )
    projectile_kg: float = field(default=10.0, metadata={"doc": "collisions: mass that hits", "min": 1e-6, "max": 1e6})
    impact_km_s: float = field(default=10.0, metadata={"doc": "collisions: relative speed", "min": 0.01, "max": 20.0})
    smallest_mm: float = field(
        default=100.0, metadata={"doc": "pieces below this length are not drawn", "min": 1.0, "max": 500.0}
    )

    def __post_init__(self) -> None:
        if not self.object:
            raise UserError("objects.breakup.object: empty; name a satellite of objects.satellites or an objects.orbit")


@dataclass(frozen=True, kw_only=True, eq=False)
class Pieces:
    """n pieces: length (m), cross-section (m^2), mass (kg), change of velocity (n, 3) m/s.

    dust_kg : of pieces too small to be drawn. The masses and it add up to what broke.
    """

    length_m: Array
    area_m2: Array
    mass_kg: Array
    kick_m_s: Array
    dust_kg: float

    @property
    def diameter_m(self) -> Array:
        """Of spheres with the same cross-sections."""
        return np.asarray(np.sqrt(4.0 * self.area_m2 / np.pi))


def is_catastrophic(options: BreakupOptions) -> bool:
    """Whether a collision breaks all of its target."""
    energy_j = 0.5 * options.projectile_kg * (1e3 * options.impact_km_s) ** 2
    return energy_j / options.mass_kg >= CATASTROPHIC_J_KG


def number_larger(options: BreakupOptions, length_m: Array | float) -> Array:
    """Pieces longer than a length."""
    length = np.asarray(length_m, dtype=np.float64)
    if options.cause == "explosion":
        return np.asarray(6.0 * options.factor * length**-1.6)
    mass = options.mass_kg + options.projectile_kg
    if not is_catastrophic(options):
        mass = options.projectile_kg * options.impact_km_s**2
    return np.asarray(0.1 * mass**0.75 * length**-1.71)


def area_m2_of(length_m: Array) -> Array:
    """Mean cross-section of pieces."""
    length = np.asarray(length_m, dtype=np.float64)
    return np.where(length < 0.00167, 0.540424 * length**2, 0.556945 * length**2.0047077)


def draw_chi(rng: np.random.Generator, length_m: Array, structure: str) -> Array:
    """Logarithm of area over mass (m^2/kg) of pieces (n,)."""
    lam = np.log10(length_m)
    n = len(lam)
    small = np.clip(-0.3 - 1.4 * (lam + 1.75), -1.0, -0.3)
    small = small + np.clip(0.2 + 0.1333 * (lam + 3.5), 0.2, None) * rng.standard_normal(n)
    alpha, mean_1, sigma_1, mean_2, sigma_2 = mixture_of(lam, structure)
    first = rng.random(n) < alpha
    large = np.where(first, mean_1, mean_2) + np.where(first, sigma_1, sigma_2) * rng.standard_normal(n)
    is_large = rng.random(n) < np.clip((length_m - SMALL_M) / (LARGE_M - SMALL_M), 0.0, 1.0)
    return np.where(is_large, large, small)


def mixture_of(lam: Array, structure: str) -> tuple[Array, Array, Array, Array, Array]:
    """Share of the first normal distribution of chi, its mean and sigma, those of the second, for pieces of 11 cm and more."""
    x = np.asarray(lam, dtype=np.float64)

    def ramp(low: float, high: float, at_low: float, slope: float, at_high: float) -> Array:
        return np.where(x <= low, at_low, np.where(x >= high, at_high, at_low + slope * (x - low)))

    if structure == "rocket_body":
        return (
            ramp(-1.4, 0.0, 1.0, -0.3571, 0.5), ramp(-0.5, 0.0, -0.45, -0.9, -0.9), np.full_like(x, 0.55),
            np.full_like(x, -0.9), ramp(-1.0, 0.1, 0.28, -0.1636, 0.1),
        )  # fmt: skip
    return (
        ramp(-1.95, 0.55, 0.0, 0.4, 1.0), ramp(-1.1, 0.0, -0.6, -0.318, -0.95), ramp(-1.3, -0.3, 0.1, 0.2, 0.3),
        ramp(-0.7, -0.1, -1.2, -1.333, -2.0), ramp(-0.5, -0.3, 0.5, -1.0, 0.3),
    )  # fmt: skip


def draw_speed_m_s(rng: np.random.Generator, chi: Array, cause: str) -> Array:
    """Change of velocity of pieces (n,)."""
    mean = 0.9 * chi + 2.9 if cause == "collision" else 0.2 * chi + 1.85
    return np.asarray(10.0 ** (mean + 0.4 * rng.standard_normal(len(chi))))


def draw_pieces(options: BreakupOptions, rng: np.random.Generator) -> Pieces:
    """Pieces of a break-up whose masses add up to what broke.

    Lengths between `smallest` and 1 m follow the law of numbers, to the next whole piece. The rest of the mass goes into longer
    pieces, one after the other; the last takes what is left. None is longer than 1.5 m or a cube of the parent's mass and
    100 kg/m^3. Where the law asks for more mass than there is, the heaviest pieces are left out. UserError for more pieces than
    can be carried.
    """
    low = options.smallest_mm * 1e-3
    expected = float(number_larger(options, low) - number_larger(options, LARGEST_M))
    if expected > MOST_PIECES:
        raise UserError(
            f"objects.breakup {options.object!r}: {expected:.0f} pieces above {options.smallest_mm:g} mm; "
            f"allowed are {MOST_PIECES}: raise `smallest`"
        )
    slope = 1.6 if options.cause == "explosion" else 1.71
    length = _power_law(rng, int(expected + rng.random()), low, LARGEST_M, slope)
    chi = draw_chi(rng, length, options.structure)
    area = area_m2_of(length)
    mass = area / 10.0**chi
    broken = _broken_kg(options)
    dust = _dust_kg(options, rng)
    room = max(broken - dust, 0.0)
    order = np.argsort(mass)
    kept = np.sort(order[np.cumsum(mass[order]) <= room])
    length, chi, area, mass = length[kept], chi[kept], area[kept], mass[kept]
    rest = room - float(mass.sum())
    longest = max((options.mass_kg / 100.0) ** (1.0 / 3.0), 1.5)
    if rest > (1.0 - SHARE_OF_MASS) * broken:
        more, chi_more = np.zeros(0), np.zeros(0)
        heavy = np.zeros(0)
        while float(heavy.sum()) < rest:
            some = _power_law(rng, LONG_PIECES, LARGEST_M, longest, slope)
            more, chi_more = np.concatenate([more, some]), np.concatenate([chi_more, draw_chi(rng, some, options.structure)])
            heavy = area_m2_of(more) / 10.0**chi_more
        whole = min(int(np.searchsorted(np.cumsum(heavy), rest)), len(heavy) - 1)
        more, chi_more, heavy = more[: whole + 1], chi_more[: whole + 1], heavy[: whole + 1].copy()
        heavy[-1] = rest - float(heavy[:-1].sum())
        # the last piece keeps its area over mass and is as long as its mass allows, which is no longer than it was drawn
        area_more = heavy * 10.0**chi_more
        more[-1] = (area_more[-1] / 0.556945) ** (1.0 / 2.0047077)
        length, chi = np.concatenate([length, more]), np.concatenate([chi, chi_more])
        area, mass = np.concatenate([area, area_more]), np.concatenate([mass, heavy])
    else:
        dust += rest
    heading = rng.standard_normal((len(length), 3))
    heading /= np.linalg.norm(heading, axis=1, keepdims=True)
    kick = heading * draw_speed_m_s(rng, chi, options.cause)[:, None]
    return Pieces(length_m=length, area_m2=area, mass_kg=mass, kick_m_s=kick, dust_kg=dust)


def _broken_kg(options: BreakupOptions) -> float:
    """Mass that breaks: all of an exploding object, both bodies of a catastrophic collision, else what a crater throws out."""
    if options.cause == "explosion":
        return options.mass_kg
    if is_catastrophic(options):
        return options.mass_kg + options.projectile_kg
    return min(options.projectile_kg * options.impact_km_s**2, options.mass_kg)


def _dust_kg(options: BreakupOptions, rng: np.random.Generator) -> float:
    """Mean mass of the pieces that are too small to be drawn, at most half of what breaks."""
    low = options.smallest_mm * 1e-3
    some = np.geomspace(DUST_M, low, 4000)
    chi = draw_chi(rng, some, options.structure)
    number = -np.gradient(np.asarray(number_larger(options, some)), np.log(some))
    weight = number * np.log(some[1] / some[0])
    return float(min(np.sum(weight * area_m2_of(some) / 10.0**chi), 0.5 * _broken_kg(options)))


def _power_law(rng: np.random.Generator, n: int, low: float, high: float, slope: float) -> Array:
    """Lengths with ``N(> L)`` in proportion to ``L^-slope`` between two ends."""
    u = rng.random(n)
    return np.asarray((low**-slope - u * (low**-slope - high**-slope)) ** (-1.0 / slope))
