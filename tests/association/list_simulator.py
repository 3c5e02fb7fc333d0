"""Tracklets of simulated days as lists, with a truth whose forces, integrator and axes are the simulator's.

The ground segment propagates with satkit (JPL ephemeris, degree 8, conical shadow, Runge-Kutta-Verner): nothing is shared with
`simulator.platform.all_forces` but numpy and the constants of nature.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulator.platform.all_forces import DAY_S, EARTH_KM, MU, STEP_S, Sky, between, sky_of, true_orbits

Array = NDArray[np.float64]

LIGHT = 299792.458
OBSERVER_HEIGHT_KM = 700.0


def observer_states(t_s: Array, sun_t0: Array) -> Array:
    """Places (k, 3) km of a telescope on a Sun-synchronous orbit over the terminator, evening node."""
    radius = EARTH_KM + OBSERVER_HEIGHT_KM
    inclination = math.radians(98.19)
    node = math.atan2(sun_t0[1], sun_t0[0]) + 0.5 * math.pi + math.radians(0.9856) * t_s / DAY_S
    u = math.sqrt(MU / radius**3) * t_s
    cu, su, cn, sn = np.cos(u), np.sin(u), np.cos(node), np.sin(node)
    ci, si = math.cos(inclination), math.sin(inclination)
    return radius * np.column_stack([cu * cn - su * ci * sn, cu * sn + su * ci * cn, su * si])


def kepler(a: float, e: float, i: float, node: float, perigee: float, anomaly: float) -> Array:
    """State (6,) of osculating elements, km and rad."""
    big = anomaly
    for _ in range(40):
        big = anomaly + e * math.sin(big)
    p = np.array([math.cos(big) - e, math.sqrt(1 - e * e) * math.sin(big), 0.0]) * a
    v = np.array([-math.sin(big), math.sqrt(1 - e * e) * math.cos(big), 0.0]) * math.sqrt(MU / a) / (1 - e * math.cos(big))
    turn = np.eye(3)
    for angle, about_x in ((perigee, False), (i, True), (node, False)):
        cos, sin = math.cos(angle), math.sin(angle)
        one = np.array([[1, 0, 0], [0, cos, -sin], [0, sin, cos]] if about_x else [[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
        turn = one @ turn
    return np.concatenate([turn @ p, turn @ v])


def population(rng: np.random.Generator, n: int) -> tuple[Array, Array]:
    """States (n, 6) and radiation coefficient times area over mass (n,): three fifths near GEO, two fifths of navigation orbits.

    One in ten of both has an eccentricity up to 0.15; inclinations of GEO follow drifting objects, 0 to 15 deg. The areas are
    those that the fit's prior expects: 0.02 m^2/kg, sigma 0.01, positive.
    """
    states = []
    for k in range(n):
        e = rng.uniform(0.0, 0.15) if rng.random() < 0.1 else min(abs(rng.normal(0.0, 0.004)), 0.02)
        turn = rng.uniform(0.0, 2.0 * math.pi, 3)
        if k % 5 < 3:
            states.append(kepler(rng.normal(42164.0, 60.0), e, math.radians(rng.uniform(0.02, 15.0)), *turn))
        else:
            a = rng.choice([25508.0, 26560.0, 27906.0, 29600.0]) + rng.normal(0.0, 30.0)
            states.append(kepler(a, e, math.radians(rng.normal(56.0, 2.5)), *turn))
    return np.array(states), np.maximum(rng.normal(0.02, 0.01, n), 0.002)


@dataclass(frozen=True, kw_only=True, eq=False)
class Seen:
    """A tracklet with its truth: epochs (k,) s after the start, observer (k, 3) km, direction (k, 3); owner -1 is clutter."""

    owner: int
    t_s: Array
    observer: Array
    direction: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Survey:
    """Five days of lists: what was seen, what was true (n, steps + 1, 6), and the sigma of a direction along each axis, rad."""

    sky: Sky
    seen: list[Seen]
    truth: Array
    area_m2_kg: Array
    sigma_rad: float


def light(states: Array, observer: Array) -> Array:
    """Directions (k, 3) towards where light that arrives now had left."""
    delay = np.zeros(len(states))
    line = states[:, :3] - observer
    for _ in range(3):
        delay = np.linalg.norm(line, axis=1) / LIGHT
        gravity = -MU * states[:, :3] / np.linalg.norm(states[:, :3], axis=1, keepdims=True) ** 3
        line = states[:, :3] - delay[:, None] * states[:, 3:] + 0.5 * delay[:, None] ** 2 * gravity - observer
    return line / np.linalg.norm(line, axis=1, keepdims=True)


def survey(
    seed: int, *, objects: int = 200, days: float = 5.0, a_day: float = 0.8, clutter: int = 60, sigma_arcsec: float = 0.5
) -> Survey:
    """Each object is seen on a day with probability `a_day`, for seven minutes (15 directions) at a random time when it can be.

    Can be: lit, 60 deg or more from the Sun, 5 deg or more above the limb. clutter : objects besides that are seen only once.
    """
    rng = np.random.default_rng([21, seed])
    sky = sky_of(25_000 * 86400 * 10**9, days + 1.0)
    start, area = population(rng, objects + clutter)
    truth = true_orbits(start, area, sky, days + 1.0)
    seen: list[Seen] = []
    for k in range(objects + clutter):
        for day in range(math.floor(days)) if k < objects else [rng.integers(0, math.floor(days))]:
            if k < objects and rng.random() > a_day:
                continue
            for _ in range(60):
                t = (day + rng.uniform(0.0, 0.99)) * DAY_S + 30.0 * np.arange(15)
                x, o = between(truth[k], t), observer_states(t, sky.sun[0])
                unit = light(x, o)
                sun = sky.sun[round(2 * t[0] / STEP_S)]
                sun = sun / np.linalg.norm(sun)
                along = x[:, :3] @ sun
                dark = (along < 0.0) & (np.linalg.norm(x[:, :3] - along[:, None] * sun, axis=1) < EARTH_KM + 100.0)
                nadir = np.degrees(np.arccos(-np.einsum("ij,ij->i", unit, o) / np.linalg.norm(o, axis=1)))
                limb = math.degrees(math.asin(EARTH_KM / (EARTH_KM + OBSERVER_HEIGHT_KM)))
                if not dark.any() and (unit @ sun < 0.5).all() and (nadir > limb + 5.0).all():
                    noisy = unit + math.radians(sigma_arcsec / 3600.0) * rng.normal(size=unit.shape)
                    noisy /= np.linalg.norm(noisy, axis=1, keepdims=True)
                    seen.append(Seen(owner=k if k < objects else -1, t_s=t, observer=o, direction=noisy))
                    break
    order = rng.permutation(len(seen))
    return Survey(
        sky=sky, seen=[seen[k] for k in order], truth=truth, area_m2_kg=area, sigma_rad=math.radians(sigma_arcsec / 3600.0)
    )


def bound(one: Survey, owner: int, used: list[Seen], t_s: float, area_sigma: float) -> Array:
    """Cramer-Rao bound (3, 3) km^2 of the place at `t_s`, from the directions that were seen.

    Unknown are the state and the area over mass, of which one sigma is known. Partials are differences of whole truths.
    """
    start, area = one.truth[owner][0], one.area_m2_kg[owner]
    days = (one.truth.shape[1] - 1) * STEP_S / DAY_S
    steps = np.array([0.05, 0.05, 0.05, 5e-6, 5e-6, 5e-6, 2e-3])
    starts = np.array([start + sign * steps[k] * np.eye(7)[k, :6] for k in range(7) for sign in (1.0, -1.0)])
    areas = np.array([area + sign * (steps[k] if k == 6 else 0.0) for k in range(7) for sign in (1.0, -1.0)])
    tables = true_orbits(starts, areas, one.sky, days)
    information = np.zeros((7, 7))
    information[6, 6] = area_sigma**-2
    for item in used:
        unit = [light(between(table, item.t_s), item.observer) for table in tables]
        slope = np.stack([(unit[2 * k] - unit[2 * k + 1]) / (2.0 * steps[k]) for k in range(7)], axis=-1)
        # a unit vector's changes lie in its tangent plane: three components hold what two along axes would
        information += np.einsum("nik,nil->kl", slope, slope) / one.sigma_rad**2
    at = np.array([t_s])
    place = [between(table, at)[0, :3] for table in tables]
    slope = np.stack([(place[2 * k] - place[2 * k + 1]) / (2.0 * steps[k]) for k in range(7)], axis=-1)
    scale = np.sqrt(np.diag(information))
    covariance = np.linalg.inv(information / np.outer(scale, scale)) / np.outer(scale, scale)
    return np.asarray(slope @ covariance @ slope.T)
