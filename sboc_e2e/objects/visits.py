"""A scenario flown again at other hours: the same objects under all forces, the same orbit of the camera, the field on the ring.

Each visit is a run of its own, with its own noise and calibration. Where the camera looks follows from the first visit and from
how the geostationary ring turns, never from where the objects are.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd.errors import UserError
from sboc_e2e.planning.flown import kepler_keys
from sboc_e2e.registry import Registry
from sboc_e2e.scenario import Scenario, from_document, option_models
from simulator.chain import Simulator
from simulator.platform import earth
from simulator.platform.observer import OrbitingObserver, make_observer
from simulator.scene.sources import OrbitOptions
from simulator.scene.stars import sky_catalogue

Array = NDArray[np.float64]

RING_KM: Final = 42_164.0
"""Radius of the geostationary orbit."""
MOST_HOURS: Final = 30.0 * 24.0
"""A month: what an update of the store looks back to."""
AREA_TO_MASS_M2_KG: Final = (0.02, 0.01, 0.002)
"""Mean, one sigma and least value of what is drawn for each object: what the fits expect (`AssociationOptions`)."""
_AREA_STREAM: Final = 21
"""First number of the seed of these draws, so that no stream of the simulator is used twice."""


def visits_of(found: Scenario, hours: Sequence[float], registry: Registry) -> tuple[list[Scenario], tuple[OrbitOptions, ...]]:
    """A scenario for each visit, hours after the scenario's epoch, and the orbits of its objects.

    UserError for a scenario whose camera rests on no field or that has no objects of its own, and for hours that do not rise.
    """
    pointing = found.simulator.pointing
    if pointing.law != "inertial":
        raise UserError(f'scenario {found.name}: pointing.law: visits need "inertial", not "{pointing.law}"')
    rising = all(a < b for a, b in pairwise(hours))
    if not hours or not rising or not 0.0 <= hours[0] <= hours[-1] <= MOST_HOURS:
        raise UserError(f"--visit: expected rising hours from 0 to {MOST_HOURS:g}, got {', '.join(f'{h:g}' for h in hours)}")
    simulator = Simulator(found.simulator, seed=found.seed, catalogue=sky_catalogue(found.simulator.stars))
    orbits = _with_areas(simulator.lasting_objects(), found.seed)
    if not orbits:
        raise UserError(f"scenario {found.name}: objects: visits need objects.passing or objects.orbit")
    epoch = earth.tai_ns_of_utc(found.simulator.epoch_utc)
    half_ns = round(0.5e9 * found.simulator.frames / found.simulator.frame_rate_hz)
    observer = make_observer(found.simulator.platform, epoch)
    boresight = _unit(pointing.ra_deg, pointing.dec_deg)
    ring_km = _on_ring(observer.state(epoch + half_ns)[0], boresight, found.name)
    document = found.document()
    document["objects"] = option_models.to_document(replace(found.simulator.objects, orbit=orbits, passing=()))
    out = []
    for number, hour in enumerate(hours):
        start = epoch + round(hour * 3.6e12)
        there_km = _turned(ring_km, earth.OMEGA_EARTH_RAD_S * 3600.0 * hour)
        line = there_km - observer.state(start + half_ns)[0]
        ra = float(np.degrees(np.arctan2(line[1], line[0]))) % 360.0
        dec = float(np.degrees(np.arcsin(line[2] / np.linalg.norm(line))))
        tables = {
            **document,
            "description": f"visit {number} of {len(hours)}: {found.description}",
            "seed": found.seed + number,
            "epoch_utc": earth.utc_text(start),
            "pointing": {**document["pointing"], "ra": f"{ra!r} deg", "dec": f"{dec!r} deg"},
        }
        if isinstance(observer, OrbitingObserver):
            tables["platform"] = {**document["platform"], **kepler_keys(*observer.state(start))}
        out.append(from_document(tables, name=f"{found.name}-{number}", registry=registry, where=found.name))
    return out, orbits


def _with_areas(orbits: tuple[OrbitOptions, ...], seed: int) -> tuple[OrbitOptions, ...]:
    """Orbits with a light pressure of their own each."""
    mean, sigma, least = AREA_TO_MASS_M2_KG
    drawn = np.maximum(np.random.default_rng([_AREA_STREAM, seed]).normal(mean, sigma, len(orbits)), least)
    return tuple(replace(o, area_to_mass_m2_kg=float(a)) for o, a in zip(orbits, drawn, strict=True))


def _unit(ra_deg: float, dec_deg: float) -> Array:
    ra, dec = np.radians(ra_deg), np.radians(dec_deg)
    return np.array([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])


def _on_ring(observer_km: Array, line: Array, name: str) -> Array:
    """Where a line of sight (3,) leaves the sphere of the ring's radius, (3,) km."""
    along = float(observer_km @ line)
    inside = RING_KM**2 - float(observer_km @ observer_km) + along**2
    if inside < 0.0:
        raise UserError(f"scenario {name}: pointing: the field does not meet the geostationary ring's radius")
    return np.asarray(observer_km + (inside**0.5 - along) * line)


def _turned(vector: Array, angle_rad: float) -> Array:
    """A vector (3,) turned about the pole of GCRS, 0.15 deg from the Earth's of 2027."""
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([cos * vector[0] - sin * vector[1], sin * vector[0] + cos * vector[1], vector[2]])
