"""Runs as lists: encounters of the simulator (its own orbits, densities and light), found by a plain threshold, no pixels."""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.special import ndtr

from ground.population.encounters import Watch
from ground.population.flux import (
    ALBEDO,
    ALBEDO_SIGMA_LN,
    MEAN_ALBEDO_SIGMA_LN,
    ORBITS_SIGMA_LN,
    PHASE_SIGMA_LN,
    RESPONSE_SIGMA_LN,
    SIZE_EDGES_M,
    Counted,
    Flux,
    flux_of,
)
from ground.population.injection import SNR_GRID, Efficiency
from simulator.platform.earth import sun_position_km
from simulator.scene.debris import SizeClass
from simulator.scene.encounters import Encounters, PopulationOptions, Window, draw_candidates, natural_flux
from simulator.scene.light import LightOptions
from simulator.scene.surface import SurfaceOptions

TAI_NS = 2_180_000_000_000_000_000  # early 2027, in ns since 1958
THRESHOLD, FRAME_S, EXPOSURE_S, FRAMES = 7.2, 0.25, 0.2, 24
FOCAL_PX, HALF, ZERO_POINT_E_S, NOISE_E, PSF_PX = 44444.0, 2048.0 / 44444.0, 4.7e8, 2.84, 0.9
CANDIDATES = 400_000
FARTHEST_KM = 11_000.0  # of the simulator's objects: beyond it all are slower than 0.1 deg/s, as nature's are
EVEN_SHARE = 0.6  # of its candidates have ranges even in volume, since most of the large ones are far
KEPT = 0.93  # share of what a frame's threshold finds that ends in a tracklet


@dataclass(frozen=True, kw_only=True)
class Class:
    """Candidates of the simulator in one class, and its natural flux (km^-2 s^-1)."""

    found: Encounters
    flux_km2_s: float


def window(mid: tuple[float, float] = (0.0, 0.0), *, behind_deg: float = 0.0, earth_shadow: bool = False) -> Window:
    """A camera in an orbit of 700 km that looks away from the Sun. mid : tangents of the middle of its read-out window.

    behind_deg : of its place from the terminator towards the middle of the night.
    """
    sun = sun_position_km(TAI_NS)
    ahead = -sun / np.linalg.norm(sun)
    side = np.cross([0.0, 0.0, 1.0], ahead)
    side /= np.linalg.norm(side)
    attitude = np.stack([side, np.cross(ahead, side), ahead])
    behind = np.radians(behind_deg)
    position = 7078.0 * (np.cos(behind) * attitude[1] + np.sin(behind) * ahead)
    velocity = 7.5044 * np.cross(attitude[1], ahead)
    return Window(
        observer_km=position, velocity_km_s=velocity, attitude=attitude, sun_km=sun, half_row=HALF, half_col=HALF,
        duration_s=FRAMES * FRAME_S, exposure_s=EXPOSURE_S, flux_e_s=ZERO_POINT_E_S, focal_px=FOCAL_PX, sigma_px=PSF_PX,
        noise_variance_e2=NOISE_E**2, aperture_m=0.2, effects=LightOptions(earth_shadow=earth_shadow),
        mid_row=mid[0], mid_col=mid[1],
    )  # fmt: skip


def watch_of(seen: Window) -> Watch:
    """The same as ground knows it."""
    t = FRAME_S * np.arange(FRAMES)
    offset = t - t.mean()
    n = len(t)
    return Watch(
        t_s=t, position_km=seen.observer_km + offset[:, None] * seen.velocity_km_s,
        velocity_km_s=np.broadcast_to(seen.velocity_km_s, (n, 3)).copy(),
        attitude=np.broadcast_to(seen.attitude, (n, 3, 3)).copy(),
        sun=seen.sun_km / np.linalg.norm(seen.sun_km), half_row=HALF, half_col=HALF, focal_px=FOCAL_PX, exposure_s=EXPOSURE_S,
        frame_s=FRAME_S, zero_point_mag=2.5 * np.log10(ZERO_POINT_E_S), noise_e=NOISE_E, psf_sigma_px=PSF_PX, aperture_m=0.2,
        mid_row=seen.mid_row, mid_col=seen.mid_col,
    )  # fmt: skip


GREY = SurfaceOptions(
    albedo_scatter=0.0, specular_share=0.0, reddening_mag=0.0, colour_scatter_mag=0.0, facet_share=0.0, glint_share=0.0
)


def classes(albedo: float = ALBEDO, *, snr_min: float = 1.0, candidates: int = CANDIDATES) -> list[Class]:
    """Candidates of every class of the product."""
    # Grey Lambert spheres: the scatter of albedos comes in `run`.
    options = PopulationOptions(candidates=candidates, albedo=albedo, snr_min=snr_min, surface=GREY, farthest_km=FARTHEST_KM)
    seen, rng = window(), np.random.default_rng(7)
    out = []
    for low, high in pairwise(SIZE_EDGES_M):
        one = SizeClass(from_mm=1e3 * low, to_mm=1e3 * high, count=1)
        found = draw_candidates(options, one, seen, rng, even_share=EVEN_SHARE, over_cells=True)
        keep = (found.natural > 0.0) & (found.rate_deg_s >= options.slowest_deg_s)
        kept = {name: getattr(found, name)[keep] for name in vars(found) if name != "surfaces"}
        found = replace(found, **kept, surfaces=found.surfaces.taken(np.flatnonzero(keep)))
        out.append(Class(found=found, flux_km2_s=natural_flux(options, one, seen, rng)))
    return out


def chance(snr: np.ndarray) -> np.ndarray:
    """Of being found in one frame: noise of one sigma about the threshold."""
    return np.asarray(ndtr(snr - THRESHOLD))


def efficiency(rng: np.random.Generator, trials: int = 24) -> Efficiency:
    """What injection would give: counts of `trials` at each S/N."""
    p = np.repeat(chance(np.array(SNR_GRID))[:, None], 4, axis=1)
    return Efficiency(
        found=rng.binomial(trials, p), tried=np.full(p.shape, trials), lengths_px=(10.0, 30.0, 100.0, 300.0), control=np.zeros(1),
        images="list", n_images=1, threshold=THRESHOLD, n_threshold=100,
    )  # fmt: skip


def exposure_km2_s(one: Class, rng: np.random.Generator) -> float:
    """Effective exposure of a class: expected tracklets (but for linking) over its flux, albedos scattered."""
    found = one.found
    total = 0.0
    for _ in range(20):
        p = chance(found.snr * np.exp(ALBEDO_SIGMA_LN * rng.standard_normal(len(found.snr))))
        n = np.floor(found.stay_s / FRAME_S + rng.random(len(p)))
        twice = 1.0 - (1.0 - p) ** n - n * p * (1.0 - p) ** np.maximum(n - 1.0, 0.0)
        total += float(np.where(n >= 2, twice, 0.0) @ found.natural) / 20.0
    return total / one.flux_km2_s


def run(
    made: list[Class], watch: Watch, rng: np.random.Generator, *, expected: float, as_assumed: bool
) -> tuple[Flux, np.ndarray]:
    """A run in which `expected` objects of each class would reach S/N 6, and its true flux per class, km^-2 year^-1.

    as_assumed : light and orbits are what the product assumes; otherwise they are off by draws from its systematic terms.
    """
    light, density = np.hypot(MEAN_ALBEDO_SIGMA_LN, PHASE_SIGMA_LN), np.hypot(ORBITS_SIGMA_LN, RESPONSE_SIGMA_LN)
    mean, more = (1.0, 1.0) if as_assumed else np.exp(np.array([light, density]) * rng.standard_normal(2))
    sizes, truth, seen_between, between = [], [], 0.0, 0.0
    for one in made:
        found = one.found
        nominal = found.natural[found.snr >= 6.0].sum()
        boost = expected / nominal
        truth.append(boost * one.flux_km2_s * 365.25 * 86400.0)
        number = rng.poisson(boost * more * found.natural.sum())
        who = rng.choice(len(found.natural), size=number, p=found.natural / found.natural.sum())
        own = mean * np.exp(ALBEDO_SIGMA_LN * rng.standard_normal(number))
        frames = found.stay_s[who] / FRAME_S
        frames = np.floor(frames + rng.random(number)).astype(int)
        # what is measured is what was found: noise near the threshold included
        snr = (found.snr[who] * own)[:, None] + rng.standard_normal((number, FRAMES))
        hit = (np.arange(FRAMES) < frames[:, None]) & (snr > THRESHOLD) & (rng.random((number, FRAMES)) < KEPT)
        kept = hit.sum(axis=1) >= 2
        light = (snr * hit).sum(axis=1) / np.maximum(hit.sum(axis=1), 1) / found.snr[who]
        first, last = np.argmax(hit, axis=1), FRAMES - 1 - np.argmax(hit[:, ::-1], axis=1)
        seen_between += float((hit.sum(axis=1) - 2)[kept].sum())
        between += float(((last - first - 1) * chance(found.snr[who] * own))[kept].sum())
        estimate = found.size_m[who] * np.sqrt(light) * np.exp(0.05 * rng.standard_normal(number))
        sizes.append(estimate[kept])
    size = np.concatenate(sizes)
    counted = Counted(
        size_m=size,
        probability=np.full(len(size), 0.9999),
        range_sigma_ln=0.05,
        n_single=0,
        n_single_false=0.0,
        n_vetoed=0,
        n_slow=0,
        frames_seen=min(seen_between, between),
        frames_expected=between,
    )
    return flux_of(counted, watch, efficiency(rng), rng), np.array(truth)
