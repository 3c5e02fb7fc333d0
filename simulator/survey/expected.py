"""What a survey expects: passages without Poisson's scatter, and the flux of the population through shells."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from simulator.platform import earth
from simulator.platform.kepler import velocity_through
from simulator.platform.observer import OrbitingObserver
from simulator.randomness import Effect, generator
from simulator.scene.debris import SizeClass
from simulator.scene.encounters import cell_density
from simulator.survey.blocks import CHUNK
from simulator.survey.candidates import candidates, pool_of
from simulator.survey.flight import Flight, instants_of
from simulator.survey.passages import orbits_of

Array = NDArray[np.float64]

EXPECTED_ROUNDS: Final = 6  # with pools of their own; their scatter is the error of their mean. Time grows with them
EXPECTED_BLOCK: Final = 8_000_000  # first random stream of the rounds, beside those of the pilot, the pools and the flux
FLUX_PIECES: Final = 40_000  # of a pool of 200,000, for each shell: time against scatter. Chosen, not measured
FLUX_BLOCK: Final = 7_000_000  # random streams of the flux, beside those of the pools and the rounds
HIGHEST_SHELL_KM: Final = 2000.0  # the usual upper border of low orbits
LOWEST_SHELL_KM: Final = 300.0
"""The lowest and the highest shell are open; their flux is taken from here and to here."""


def expected_passages(
    flight: Flight, size_edges_m: Array, altitude_edges_km: Array, inclination_edges_deg: Array, span_s: float
) -> Array:
    """Passages (rounds, sizes, altitudes, inclinations) expected in a time from the epoch on, without Poisson's scatter.

    Each round has pools of its own: its scatter is what the pieces of a pool leave.
    """
    edges = [np.array(size_edges_m), np.array(altitude_edges_km), np.array(inclination_edges_deg)]
    sizes = [(c.from_mm, c.to_mm) for c in flight.options.population.classes if c.count]
    out = np.zeros([EXPECTED_ROUNDS, *(len(e) - 1 for e in edges)])
    for k in range(len(size_edges_m) - 1):
        low, high = 1e3 * float(size_edges_m[k]), 1e3 * float(size_edges_m[k + 1])
        # a survey has no objects between and beyond its classes
        parts = [(max(low, a), min(high, b)) for a, b in sizes if max(low, a) < min(high, b) * (1.0 - 1e-9)]
        for part, (a, b) in enumerate(parts):
            for turn in range(EXPECTED_ROUNDS):
                rng = generator(flight.seed, Effect.SURVEY, EXPECTED_BLOCK + turn, 10 * k + part)
                at = instants_of(flight, np.sort(rng.random(360)) * span_s, span_s)
                pool = pool_of(flight, SizeClass(from_mm=a, to_mm=b, count=1), rng)
                found = candidates(flight, at, pool, CHUNK, rng)
                weight = np.where(found.snr >= flight.options.population.snr_min, found.natural, 0.0)
                _, _, i_deg = orbits_of(found)
                altitude = np.linalg.norm(found.position_km, axis=1) - earth.EARTH_RADIUS_KM
                inside = np.clip(altitude, edges[1][0], edges[1][-1] * (1.0 - 1e-9))
                table, _ = np.histogramdd(np.stack([found.size_m, inside, i_deg], axis=1), bins=edges, weights=weight)
                out[turn] += table
    return out


def model_flux(flight: Flight, size_edges_m: Array, altitude_edges_km: Array, inclination_edges_deg: Array) -> Array:
    """Objects per km^2 and year (sizes, altitudes, inclinations) of the scenario's population: density times relative speed.

    On a circular orbit of the camera's inclination at heights even within each shell, all directions together; inclinations
    are those of the objects.
    """
    observer = flight.carrier.observer
    if not isinstance(observer, OrbitingObserver):
        raise TypeError("a flight has an observer in orbit")
    place, speed = observer.motion.states(np.linspace(0.0, 5_900.0, 240))
    up = place / np.linalg.norm(place, axis=1, keepdims=True)
    ahead = np.cross(np.cross(place, speed), place)
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    out = np.zeros((len(size_edges_m) - 1, len(altitude_edges_km) - 1, len(inclination_edges_deg) - 1))
    for k in range(len(size_edges_m) - 1):
        rng = generator(flight.seed, Effect.SURVEY, FLUX_BLOCK, k + 1)
        size_class = SizeClass(from_mm=1e3 * float(size_edges_m[k]), to_mm=1e3 * float(size_edges_m[k + 1]), count=1)
        pool = pool_of(flight, size_class, rng)
        n = FLUX_PIECES
        a_km, e, i_rad, population = pool.a_km[:n], pool.e[:n], pool.i_rad[:n], pool.population[:n]
        band = np.searchsorted(inclination_edges_deg, np.degrees(i_rad), side="right") - 1
        for j in range(len(altitude_edges_km) - 1):
            top = min(float(altitude_edges_km[j + 1]), HIGHEST_SHELL_KM)
            low = max(float(altitude_edges_km[j]), LOWEST_SHELL_KM)
            r = earth.EARTH_RADIUS_KM + rng.uniform(low, top, n)
            at = rng.integers(len(up), size=n)
            here = up[at] * r[:, None]
            with np.errstate(invalid="ignore"):
                density = np.nan_to_num(cell_density(here, a_km, e, i_rad))
            signs = rng.random((2, n)) < 0.5
            theirs = velocity_through(here, a_km, e, i_rad, signs[0], signs[1], just_missing=True)
            ours = ahead[at] * np.sqrt(earth.MU_KM3_S2 / r)[:, None]
            relative = np.nan_to_num(np.linalg.norm(theirs - ours, axis=1))
            flux = population * density * relative / n * 365.25 * earth.DAY_S
            out[k, j] = np.bincount(np.clip(band, 0, out.shape[2] - 1), weights=flux, minlength=out.shape[2])
    return out
