"""Encounters by importance sampling: which debris crosses the field during a run, and how often nature sends it.

Candidates are points of the field's pyramid (direction uniform, logarithm of range uniform) at random times of the run,
each with an orbit that passes through it. An orbit (a, e, i) with uniform node, perigee and anomaly has at radius r and
latitude b the density (Kessler 1981, Icarus 48, 39)

    s = 1 / (2 pi^3 r a sqrt((sin^2 i - sin^2 b) (r - q) (Q - r)))        objects / km^3

A candidate that stays in the field for a time D of a run of length W is met by a random instant with probability D / W, so
each stands for ``N s dV W / D / n`` encounters in nature. What a run shows is drawn among the detectable candidates
of a size class, without repetition, in proportion to that number; its weight is the class's natural number over the number drawn.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd.errors import UserError
from simulator.platform.earth import DAY_S
from simulator.platform.kepler import Elements, elements_of, velocity_through
from simulator.randomness import Effect, generator
from simulator.scene.debris import SizeClass, draw_orbits, low_orbit_share, number_larger
from simulator.scene.light import LightOptions
from simulator.scene.reflection import MIRROR_PHASE, lambert_flux, sunlit_fraction
from simulator.scene.surface import SurfaceOptions, Surfaces, draw_surfaces

Array = NDArray[np.float64]

FLUX_BLOCK = 1000
"""First number of the random streams of the flux's integral, apart from those of the draws."""

FLUX_DRAWS = 200_000
"""Of the integral of the flux: it scatters by 1 to 2.3 % from stream to stream (16 streams, 1 mm, 1 cm and 10 cm)."""

TRUTH_BLOCK = 2000  # first of its random streams, apart from those of the flux and of the draws
TRUTH_ROUNDS = 2  # rounds that are averaged: scatter falls with their root, time grows with them; chosen, not measured
TRUTH_EVEN_SHARE = 0.6
"""Streams and rounds of the integral of nature's number, and how many of its candidates have ranges even in volume."""

FARTHEST_FAST_KM = 11_000.0
"""Nothing is farther that moves by 0.1 deg/s: that takes 19 km/s, and a low orbit and an escape have 18.4 together."""

CELL_KM = 20.0  # wider cells blur shells; in narrower ones a few grazing orbits hold the sum. Chosen, not measured
CELL_SINE = 0.02
"""Half widths of the cells over which its densities are averaged."""

NEAR_SHARE = 100.0
"""Ranges below a hundredth of the reach are not proposed: they hold a millionth of the volume."""


@dataclass(frozen=True, kw_only=True)
class PopulationOptions:
    """Debris that a run meets. Counts are of the run, so that the density is boosted by count over nature."""

    classes: tuple[SizeClass, ...] = field(
        default=(
            SizeClass(from_mm=1.0, to_mm=3.0, count=4),
            SizeClass(from_mm=3.0, to_mm=10.0, count=5),
            SizeClass(from_mm=10.0, to_mm=100.0, count=6),
            SizeClass(from_mm=100.0, to_mm=3000.0, count=6),
        ),
        metadata={"doc": "size classes"},
    )
    snr_min: float = field(
        default=6.0, metadata={"doc": "objects below this expected S/N are not drawn", "min": 0.0, "max": 1000.0}
    )
    albedo: float = field(default=0.1, metadata={"doc": "Bond albedo, median of the pieces", "min": 0.001, "max": 1.0})
    surface: SurfaceOptions = field(default_factory=SurfaceOptions, metadata={"doc": "what differs from piece to piece"})
    slowest_deg_s: float = field(
        default=0.1,
        metadata={
            "doc": "objects slower than this are not drawn; many share the orbit type of the camera",
            "min": 0.0,
            "max": 1000.0,
        },
    )
    nearest_km: float = field(default=0.05, metadata={"doc": "smallest range at the drawn instant", "min": 0.001, "max": 1e5})
    farthest_km: float = field(default=3000.0, metadata={"doc": "largest range", "min": 0.1, "max": 1e5})
    low_orbit_share_small: float = field(
        default=0.65, metadata={"doc": "share of pieces below 1 cm in low orbits", "min": 0.0, "max": 1.0}
    )
    low_orbit_share_large: float = field(
        default=0.80, metadata={"doc": "share of pieces above 10 cm in low orbits", "min": 0.0, "max": 1.0}
    )
    spread_by_breakup: bool = field(default=True, metadata={"doc": "small pieces get a break-up's velocity change"})
    tumbling_share: float = field(
        default=0.3, metadata={"doc": "share of objects whose brightness varies", "min": 0.0, "max": 1.0}
    )
    candidates: int = field(default=60000, metadata={"doc": "candidates drawn for each size class", "min": 1000, "max": 10000000})

    def __post_init__(self) -> None:
        if self.nearest_km >= self.farthest_km:
            raise UserError(f"population.nearest: {self.nearest_km} km must be below population.farthest, {self.farthest_km} km")
        for k, c in enumerate(self.classes):
            if c.from_mm >= c.to_mm:
                raise UserError(f"population.classes[{k}].from: {c.from_mm} mm must be below its `to`, {c.to_mm} mm")


@dataclass(frozen=True, kw_only=True, eq=False)
class Window:
    """Field and sensitivity of the camera during the run, for choosing encounters.

    attitude : (3, 3) GCRS to camera at the middle. half_row, half_col : tangents of half the field. mid_row, mid_col : of its
    middle, which lies off the boresight where the read-out window does. flux_e_s : electrons per second of V = 0.
    noise_variance_e2 : per pixel and exposure. aperture_m : that defocuses near objects. effects : of light on its way.
    """

    observer_km: Array
    velocity_km_s: Array
    attitude: Array
    sun_km: Array
    half_row: float
    half_col: float
    duration_s: float
    exposure_s: float
    flux_e_s: float
    focal_px: float
    sigma_px: float
    noise_variance_e2: float
    aperture_m: float
    effects: LightOptions
    mid_row: float = 0.0
    mid_col: float = 0.0
    colour_factor: Callable[[Array], Array] | None = None
    """Electrons of a B-V over those of the Sun's at equal V; None for a grey camera."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Encounters:
    """Candidates of a size class: states at a time of the run (s after its middle), rates, and what the camera makes of them.

    natural : how many objects of nature in one run each stands for; per_day : how many that enter in a day.
    snr : expected in the best exposure.
    """

    size_m: Array
    time_s: Array
    position_km: Array
    velocity_km_s: Array
    range_km: Array
    rate_deg_s: Array
    stay_s: Array
    snr: Array
    natural: Array
    per_day: Array
    surfaces: Surfaces


def draw_candidates(
    options: PopulationOptions,
    size_class: SizeClass,
    window: Window,
    rng: np.random.Generator,
    *,
    even_share: float = 0.0,
    over_cells: bool = False,
    orbits: Callable[..., tuple[Array, Array, Array]] = draw_orbits,
) -> Encounters:
    """Candidates of one size class, undetectable ones included.

    even_share : of them have ranges even in volume, not in the logarithm: most of nature's objects are far. over_cells :
    densities are means over cells, which have no singularities. orbits : draws their orbits, with the signature of `draw_orbits`.
    """
    n = options.candidates
    low_m, high_m = size_class.from_mm * 1e-3, size_class.to_mm * 1e-3
    size_m = np.exp(rng.uniform(np.log(low_m), np.log(high_m), n))
    density = number_density(size_m) * np.log(high_m / low_m)  # per draw, log-uniform proposal
    population = density * low_orbit_share(size_m, options.low_orbit_share_small, options.low_orbit_share_large)
    # Nothing fainter than snr_min at zero phase and at rest can be drawn: cut the proposal's ranges there.
    surfaces = draw_surfaces(rng.spawn(1)[0], n, options.albedo, options.surface, window.colour_factor)
    reach = reach_km(size_m, surfaces, options.snr_min, window)
    far = np.clip(reach, options.nearest_km * 1.001, options.farthest_km)
    near = np.maximum(options.nearest_km, far / NEAR_SHARE)
    span = np.log(far / near)
    range_km = near * np.exp(rng.random(n) * span)
    shell_km3 = (far**3 - near**3) / 3.0
    if even_share > 0.0:
        even = np.cbrt(near**3 + 3.0 * rng.random(n) * shell_km3)
        range_km = np.where(rng.random(n) < even_share, even, range_km)
    per_km = (1.0 - even_share) / (range_km * span) + even_share * range_km**2 / shell_km3
    u, v = rng.uniform(-window.half_col, window.half_col, n), rng.uniform(-window.half_row, window.half_row, n)
    u, v = u + window.mid_col, v + window.mid_row
    time_s = rng.uniform(-0.5, 0.5, n) * window.duration_s
    slant = np.sqrt(1.0 + u * u + v * v)
    camera = np.stack([u, v, np.ones(n)], axis=1) / slant[:, None] * range_km[:, None]
    observer = window.observer_km + window.velocity_km_s * time_s[:, None]
    position = observer + camera @ window.attitude
    a_km, e, i_rad = orbits(rng, size_m, spread=options.spread_by_breakup)
    signs = rng.random(n) < 0.5, rng.random(n) < 0.5
    velocity = velocity_through(position, a_km, e, i_rad, *signs, just_missing=over_cells)
    solid_angle = 4.0 * window.half_row * window.half_col / slant**3
    volume_km3 = solid_angle * range_km**2 / per_km
    with np.errstate(invalid="ignore"):
        density = cell_density if over_cells else spatial_density
        natural = population * density(position, a_km, e, i_rad) * volume_km3
    relative = velocity - window.velocity_km_s
    stay_s = time_in_field(camera, relative @ window.attitude.T, time_s, window)
    whole_s = time_in_field(camera, relative @ window.attitude.T, np.zeros(n), replace(window, duration_s=2.0 * DAY_S))
    across = (
        relative
        - np.sum(relative * (position - observer), axis=1, keepdims=True) * (position - observer) / range_km[:, None] ** 2
    )
    rate_rad_s = np.linalg.norm(across, axis=1) / range_km
    effects = window.effects
    flux = surfaces.albedo * surfaces.colour * size_m**2
    flux *= lambert_flux(
        1.0, 1.0, position, observer, window.sun_km, phase_function=effects.phase_function, specular=surfaces.specular
    )
    if effects.earth_shadow:
        flux = flux * sunlit_fraction(position, window.sun_km)
    snr = expected_snr(flux * window.flux_e_s, rate_rad_s, stay_s, range_km, window)
    reached = np.isfinite(velocity).all(axis=1) & (stay_s > 0.0) & (reach > options.nearest_km)
    instant = np.nan_to_num(np.where(reached, natural, 0.0)) / n
    return Encounters(
        size_m=size_m,
        time_s=time_s,
        position_km=position,
        velocity_km_s=velocity,
        range_km=range_km,
        rate_deg_s=np.degrees(rate_rad_s),
        stay_s=stay_s,
        snr=np.where(reached, snr, 0.0),
        natural=instant * window.duration_s / np.maximum(stay_s, 1e-9),
        per_day=instant * DAY_S / np.maximum(whole_s, 1e-9),
        surfaces=surfaces,
    )


def natural_numbers(options: PopulationOptions, size_class: SizeClass, window: Window) -> tuple[float, float]:
    """Objects of a class with S/N of `snr_min` that nature sends through the field during a run: what the truth is made with.

    Those within `farthest`, and those at any range. The candidates of a run give the first to 20 % only, because few of them hold
    most of a class of large objects.
    """
    within = anywhere = 0.0
    endless = replace(options, farthest_km=max(options.farthest_km, FARTHEST_FAST_KM))
    for block in range(TRUTH_ROUNDS):
        rng = generator(0, Effect.POPULATION, block=TRUTH_BLOCK + block)
        found = draw_candidates(endless, size_class, window, rng, even_share=TRUTH_EVEN_SHARE, over_cells=True)
        kept = (found.snr >= options.snr_min) & (found.rate_deg_s >= options.slowest_deg_s)
        anywhere += float(found.natural[kept].sum())
        within += float(found.natural[kept & (found.range_km <= options.farthest_km)].sum())
    return within / TRUTH_ROUNDS, anywhere / TRUTH_ROUNDS


def natural_flux(options: PopulationOptions, size_class: SizeClass, window: Window, rng: np.random.Generator) -> float:
    """Objects of a class per km^2 and second at the camera: density times relative speed, from all directions together.

    Mean over a shell of 50 km above and below the camera: at a point, a few orbits that just graze it hold most of the sum.
    """
    n = FLUX_DRAWS
    low_m, high_m = size_class.from_mm * 1e-3, size_class.to_mm * 1e-3
    size_m = np.exp(rng.uniform(np.log(low_m), np.log(high_m), n))
    population = number_density(size_m) * np.log(high_m / low_m)
    population *= low_orbit_share(size_m, options.low_orbit_share_small, options.low_orbit_share_large)
    height_km = rng.uniform(-50.0, 50.0, n)
    here = window.observer_km * (1.0 + height_km / np.linalg.norm(window.observer_km))[:, None]
    a_km, e, i_rad = draw_orbits(rng, size_m, spread=options.spread_by_breakup)
    velocity = velocity_through(here, a_km, e, i_rad, rng.random(n) < 0.5, rng.random(n) < 0.5)
    speed = np.linalg.norm(velocity - window.velocity_km_s, axis=1)
    with np.errstate(invalid="ignore"):
        return float(np.mean(np.nan_to_num(population * spatial_density(here, a_km, e, i_rad) * speed)))


def number_density(size_m: Array) -> Array:
    """``-dN / d ln d`` of the size law."""
    step = 1.0005
    return np.asarray((number_larger(size_m / step) - number_larger(size_m * step)) / (2.0 * np.log(step)))


def spatial_density(position_km: Array, a_km: Array, e: Array, i_rad: Array) -> Array:
    """Mean number of objects per km^3 at positions (n, 3) of one object on each orbit (Kessler 1981, eq. 13).

    Zero where the orbit does not come.
    """
    radius = np.linalg.norm(position_km, axis=-1)
    sin_lat2 = (position_km[..., 2] / radius) ** 2
    radial = (radius - a_km * (1.0 - e)) * (a_km * (1.0 + e) - radius)
    lateral = np.sin(i_rad) ** 2 - sin_lat2
    inside = (radial > 0.0) & (lateral > 0.0)
    root = np.sqrt(np.where(inside, radial * lateral, 1.0))
    return np.where(inside, 1.0 / (2.0 * np.pi**3 * radius * a_km * root), 0.0)


def cell_density(position_km: Array, a_km: Array, e: Array, i_rad: Array) -> Array:
    """Mean of `spatial_density` over `CELL_KM` to both sides in radius and `CELL_SINE` in the sine of latitude, in closed form.

    With r = a (1 - e cos E) the radial factor integrates to the change of E over a e, the lateral one to
    that of asin(sin b / sin i).
    """
    radius = np.linalg.norm(position_km, axis=-1)
    sine = position_km[..., 2] / radius
    highest, shape = np.maximum(np.sin(i_rad), 1e-6), np.maximum(e, 1e-9)
    out = np.zeros(len(radius))
    # Most orbits come nowhere near: only the others are worth their inverse functions.
    there = np.flatnonzero((np.abs(radius - a_km) < a_km * shape + CELL_KM) & (np.abs(sine) < highest + CELL_SINE))
    radius, sine, a_km, shape, highest = radius[there], sine[there], a_km[there], shape[there], highest[there]

    def anomaly(r: Array) -> Array:
        return np.asarray(np.arccos(np.clip((1.0 - r / a_km) / shape, -1.0, 1.0)))

    def argument(s: Array) -> Array:
        return np.asarray(np.arcsin(np.clip(s / highest, -1.0, 1.0)))

    radial = anomaly(radius + CELL_KM) - anomaly(radius - CELL_KM)
    lateral = argument(sine + CELL_SINE) - argument(sine - CELL_SINE)
    out[there] = radial * lateral / (4.0 * CELL_KM * CELL_SINE) / (2.0 * np.pi**3 * radius * a_km)
    return out


def time_in_field(camera_km: Array, rate_km_s: Array, time_s: Array, window: Window) -> Array:
    """Seconds of the run that points (n, 3) of the camera frame, inside the field at `time_s`, spend in it, moving straight."""
    enter, leave = in_field(camera_km, rate_km_s, window)
    enter = np.maximum(enter, -0.5 * window.duration_s - time_s)
    leave = np.minimum(leave, 0.5 * window.duration_s - time_s)
    return np.asarray(np.maximum(leave - enter, 0.0))


def in_field(camera_km: Array, rate_km_s: Array, window: Window) -> tuple[Array, Array]:
    """When points (n, 3) of the camera frame that move straight enter and leave the field: seconds from now, - and +."""
    earliest, latest = np.full(len(camera_km), -np.inf), np.full(len(camera_km), np.inf)
    for axis, half, mid in ((0, window.half_col, window.mid_col), (1, window.half_row, window.mid_row)):
        place, moves = camera_km[:, axis] - mid * camera_km[:, 2], rate_km_s[:, axis] - mid * rate_km_s[:, 2]
        for sign in (1.0, -1.0):
            inside = half * camera_km[:, 2] + sign * place
            slope = half * rate_km_s[:, 2] + sign * moves
            with np.errstate(divide="ignore", invalid="ignore"):
                root = -inside / slope
            latest = np.where(slope < 0.0, np.minimum(latest, root), latest)
            earliest = np.where(slope > 0.0, np.maximum(earliest, root), earliest)
    return earliest, latest


def expected_snr(flux_e_s: Array, rate_rad_s: Array, stay_s: Array, range_km: Array, window: Window) -> Array:
    """Matched-filter S/N of the best exposure: a straight uniform trail of a Gaussian PSF on uniform noise.

    ``S = F / sqrt(2 sqrt(pi) s (L + 2 sqrt(pi) s) V)``, the defocus disc added to s by its second moment.
    """
    lit_s = np.minimum(window.exposure_s, stay_s)
    blur_px = window.aperture_m * 1e-3 / range_km * window.focal_px
    sigma = np.sqrt(window.sigma_px**2 + blur_px**2 / 16.0)
    width = 2.0 * np.sqrt(np.pi) * sigma
    length = rate_rad_s * lit_s * window.focal_px
    return np.asarray(flux_e_s * lit_s / np.sqrt(width * (length + width) * window.noise_variance_e2))


def reach_km(size_m: Array, surfaces: Surfaces, snr_min: float, window: Window) -> Array:
    """Range at which an object at rest, at zero phase and in focus, has the smallest S/N that counts."""
    sun2 = float(window.sun_km @ window.sun_km)
    direction = window.attitude[2]
    at_1_km = (
        lambert_flux(1.0, 1.0, direction[None], np.zeros((1, 3)), -direction[None] * np.sqrt(sun2))[0]
        * (1.0 - surfaces.specular + surfaces.specular * MIRROR_PHASE)
        * surfaces.albedo
        * surfaces.colour
        * size_m**2
    )
    still = expected_snr(at_1_km * window.flux_e_s, np.zeros(1), np.array([window.exposure_s]), np.array([1e9]), window)
    return np.asarray(np.sqrt(still / max(snr_min, 1e-3)))


@dataclass(frozen=True, kw_only=True, eq=False)
class Drawn:
    """Objects that the run shows, and what nature would have sent."""

    elements: Elements
    """(m,) osculating at `time_s` (seconds after the middle of the run)."""
    time_s: Array
    size_m: Array
    weight: Array
    surfaces: Surfaces
    natural_by_class: Array
    """Detectable objects of nature in the field during one run, for each size class."""
    per_day_by_class: Array
    """Detectable objects that enter the field per day, if the field stayed as it is in the middle of the run."""
    drawn_by_class: NDArray[np.intp]
    seed: int
    """That they were drawn with."""


def draw_encounters(options: PopulationOptions, window: Window, seed: int) -> Drawn:
    """Draw the run's objects.

    Raises UserError if a class to be drawn has no detectable candidate.
    """
    chosen: list[Encounters] = []
    picks: list[NDArray[np.intp]] = []
    weights: list[Array] = []
    natural, per_day = np.zeros(len(options.classes)), np.zeros(len(options.classes))
    for k, size_class in enumerate(options.classes):
        rng = generator(seed, Effect.POPULATION, block=k)
        found = draw_candidates(options, size_class, window, rng)
        detectable = (found.snr >= options.snr_min) & (found.rate_deg_s >= options.slowest_deg_s)
        share = np.where(detectable, found.natural, 0.0)
        per_day[k] = np.where(detectable, found.per_day, 0.0).sum()
        natural[k] = share.sum()
        if size_class.count == 0:
            continue
        if natural[k] <= 0.0:
            raise UserError(
                f"population.classes[{k}]: no debris of {size_class.from_mm:g} to {size_class.to_mm:g} mm reaches S/N "
                f"{options.snr_min:g} between {options.nearest_km:g} and {options.farthest_km:g} km; set count = 0"
            )
        if np.count_nonzero(share) < size_class.count:
            raise UserError(
                f"population.classes[{k}].count: only {np.count_nonzero(share)} candidates; raise population.candidates"
            )
        picks.append(rng.choice(len(share), size=size_class.count, replace=False, p=share / natural[k]))
        weights.append(np.full(size_class.count, natural[k] / size_class.count))
        chosen.append(found)

    def column(name: str) -> Array:
        parts = [getattr(f, name)[p] for f, p in zip(chosen, picks, strict=True)]
        return np.concatenate(parts) if parts else np.zeros(0)

    if chosen:
        elements = elements_of(column("position_km"), column("velocity_km_s"))
    else:
        none = np.zeros(0)
        elements = Elements(a_km=none, e=none, i_rad=none, node_rad=none, argp_rad=none, mean_anomaly_rad=none)
    return Drawn(
        elements=elements,
        time_s=column("time_s"),
        size_m=column("size_m"),
        weight=np.concatenate(weights) if weights else np.zeros(0),
        surfaces=_joined([f.surfaces.taken(p) for f, p in zip(chosen, picks, strict=True)]),
        natural_by_class=natural,
        per_day_by_class=per_day,
        drawn_by_class=np.array([c.count for c in options.classes], dtype=np.intp),
        seed=seed,
    )


def _joined(parts: list[Surfaces]) -> Surfaces:
    """Surfaces of all classes, one after the other."""
    none = np.zeros(0)
    albedo, specular, colour = (
        np.concatenate([getattr(s, name) for s in parts]) if parts else none for name in ("albedo", "specular", "colour")
    )
    return Surfaces(albedo=albedo, specular=specular, colour=colour)
