"""Tracklets of simulated days as lists, with a truth whose forces, integrator and axes are its own.

Gravity of the Earth to degree and order 4 (EGM96, typed in), Sun and Moon from ERFA's series, rotation of the Earth from ERFA,
radiation pressure on a sphere with a cylindrical shadow; Runge-Kutta of fourth order. The ground segment propagates with satkit
(JPL ephemeris, degree 8, conical shadow, Runge-Kutta-Verner): nothing is shared but numpy and the constants of nature.
"""

import math
from dataclasses import dataclass

import erfa
import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

MU, MU_SUN, MU_MOON = 398600.4418, 1.32712440018e11, 4902.800066
EARTH_KM, AU_KM, LIGHT = 6378.1363, 149597870.7, 299792.458
SUN_PRESSURE = 4.56e-6
"""N/m^2 at one astronomical unit."""
STEP_S = 60.0
DAY_S = 86400.0
TAI_1958_JD = 2436204.5
OBSERVER_HEIGHT_KM = 700.0
# normalised, 1e-6: (degree, order, C, S) of EGM96
EGM96 = (
    (2, 0, -484.165371736, 0.0), (2, 1, -0.000186988, 0.001195280), (2, 2, 2.439143524, -1.400166837),
    (3, 0, 0.957254174, 0.0), (3, 1, 2.029988822, 0.248513159), (3, 2, 0.904627769, -0.619025944),
    (3, 3, 0.721072657, 1.414356270), (4, 0, 0.539873864, 0.0), (4, 1, -0.536321617, -0.473440266),
    (4, 2, 0.350694106, 0.662671573), (4, 3, 0.990771804, -0.200928369), (4, 4, -0.188560803, 0.308853169),
)  # fmt: skip


def _coefficients() -> tuple[Array, Array]:
    c, s = np.zeros((5, 5)), np.zeros((5, 5))
    c[0, 0] = 1.0
    for n, m, cos, sin in EGM96:
        norm = math.sqrt((1 if m == 0 else 2) * (2 * n + 1) * math.factorial(n - m) / math.factorial(n + m))
        c[n, m], s[n, m] = 1e-6 * norm * cos, 1e-6 * norm * sin
    return c, s


C, S = _coefficients()


@dataclass(frozen=True, kw_only=True, eq=False)
class Sky:
    """What the forces need at half steps from an epoch on: Sun and Moon (n, 3) km, rotation to Earth-fixed axes (n, 3, 3)."""

    t0_tai_ns: int
    sun: Array
    moon: Array
    fixed: Array


def sky_of(t0_tai_ns: int, days: float) -> Sky:
    """Tables every half step."""
    t = np.arange(0.0, days * DAY_S + STEP_S, 0.5 * STEP_S)
    day, rest = divmod(t0_tai_ns, 86400 * 10**9)
    tt1, tt2 = TAI_1958_JD + day, (rest * 1e-9 + t + 32.184) / DAY_S
    heliocentric, _ = erfa.epv00(tt1, tt2)
    sun = -AU_KM * heliocentric["p"]
    moon = AU_KM * erfa.moon98(tt1, tt2)["p"]
    # UT1 - UTC below 0.1 s turns the tesserals by 2": nothing
    ut1 = (rest * 1e-9 + t - 37.0) / DAY_S
    fixed = erfa.c2t06a(tt1, tt2, tt1, ut1, 0.0, 0.0)
    return Sky(t0_tai_ns=t0_tai_ns, sun=sun, moon=moon, fixed=fixed)


@njit(cache=True)
def _gravity(x: Array, c: Array, s: Array, out: Array) -> None:
    """Acceleration in Earth-fixed axes by Cunningham's recursion (Montenbruck & Gill 2000, section 3.2.4)."""
    v, w = np.zeros((6, 6)), np.zeros((6, 6))
    r2 = x[0] ** 2 + x[1] ** 2 + x[2] ** 2
    rho = EARTH_KM * EARTH_KM / r2
    x0, y0, z0 = EARTH_KM * x[0] / r2, EARTH_KM * x[1] / r2, EARTH_KM * x[2] / r2
    v[0, 0] = EARTH_KM / math.sqrt(r2)
    for m in range(6):
        if m > 0:
            v[m, m] = (2 * m - 1) * (x0 * v[m - 1, m - 1] - y0 * w[m - 1, m - 1])
            w[m, m] = (2 * m - 1) * (x0 * w[m - 1, m - 1] + y0 * v[m - 1, m - 1])
        for n in range(m + 1, 6):
            v[n, m] = (2 * n - 1) / (n - m) * z0 * v[n - 1, m]
            w[n, m] = (2 * n - 1) / (n - m) * z0 * w[n - 1, m]
            if n > m + 1:
                v[n, m] -= (n + m - 1) / (n - m) * rho * v[n - 2, m]
                w[n, m] -= (n + m - 1) / (n - m) * rho * w[n - 2, m]
    ax = ay = az = 0.0
    for n in range(5):
        for m in range(n + 1):
            cc, ss = c[n, m], s[n, m]
            if m == 0:
                ax -= cc * v[n + 1, 1]
                ay -= cc * w[n + 1, 1]
                az -= (n + 1) * cc * v[n + 1, 0]
            else:
                f = 0.5 * (n - m + 1) * (n - m + 2)
                ax += 0.5 * (-cc * v[n + 1, m + 1] - ss * w[n + 1, m + 1]) + f * (cc * v[n + 1, m - 1] + ss * w[n + 1, m - 1])
                ay += 0.5 * (-cc * w[n + 1, m + 1] + ss * v[n + 1, m + 1]) + f * (-cc * w[n + 1, m - 1] + ss * v[n + 1, m - 1])
                az += (n - m + 1) * (-cc * v[n + 1, m] - ss * w[n + 1, m])
    k = MU / EARTH_KM**2
    out[0], out[1], out[2] = k * ax, k * ay, k * az


@njit(cache=True)
def _slope(y: Array, sun: Array, moon: Array, fixed: Array, area: float, c: Array, s: Array, out: Array) -> None:
    x, a = np.empty(3), np.empty(3)
    for i in range(3):
        x[i] = fixed[i, 0] * y[0] + fixed[i, 1] * y[1] + fixed[i, 2] * y[2]
    _gravity(x, c, s, a)
    for i in range(3):
        out[i] = y[3 + i]
        out[3 + i] = fixed[0, i] * a[0] + fixed[1, i] * a[1] + fixed[2, i] * a[2]
    ds = dm = ss = sm = dot = 0.0
    for i in range(3):
        ds += (sun[i] - y[i]) ** 2
        dm += (moon[i] - y[i]) ** 2
        ss += sun[i] ** 2
        sm += moon[i] ** 2
        dot += sun[i] * y[i]
    ds, dm, ss, sm = ds**0.5, dm**0.5, ss**0.5, sm**0.5
    away = dot / ss
    aside = math.sqrt(max(y[0] ** 2 + y[1] ** 2 + y[2] ** 2 - away * away, 0.0))
    lit = 0.0 if away < 0.0 and aside < EARTH_KM else 1.0
    push = 1e-3 * SUN_PRESSURE * area * lit * AU_KM**2
    for i in range(3):
        out[3 + i] += MU_SUN * ((sun[i] - y[i]) / ds**3 - sun[i] / ss**3)
        out[3 + i] += MU_MOON * ((moon[i] - y[i]) / dm**3 - moon[i] / sm**3)
        out[3 + i] -= push * (sun[i] - y[i]) / ds**3


@njit(cache=True)
def _integrate(start: Array, area: Array, sun: Array, moon: Array, fixed: Array, c: Array, s: Array, steps: int) -> Array:
    h = STEP_S
    out = np.empty((len(start), steps + 1, 6))
    k1, k2, k3, k4 = np.empty(6), np.empty(6), np.empty(6), np.empty(6)
    for n in range(len(start)):
        y = start[n].copy()
        out[n, 0] = y
        for j in range(steps):
            a, b = 2 * j + 1, 2 * j + 2
            _slope(y, sun[2 * j], moon[2 * j], fixed[2 * j], area[n], c, s, k1)
            _slope(y + 0.5 * h * k1, sun[a], moon[a], fixed[a], area[n], c, s, k2)
            _slope(y + 0.5 * h * k2, sun[a], moon[a], fixed[a], area[n], c, s, k3)
            _slope(y + h * k3, sun[b], moon[b], fixed[b], area[n], c, s, k4)
            y += h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
            out[n, j + 1] = y
    return out


def true_orbits(start: Array, area_m2_kg: Array, sky: Sky, days: float) -> Array:
    """States (n, steps + 1, 6) every minute."""
    steps = round(days * DAY_S / STEP_S)
    return np.asarray(_integrate(start, area_m2_kg, sky.sun, sky.moon, sky.fixed, C, S, steps))


def between(states: Array, t_s: Array) -> Array:
    """States (k, 6) at times t_s (k,) from a table every minute (steps + 1, 6): Hermite of fifth order by the table's own forces.

    Velocities and positions at six nodes by Lagrange; 60 s of an orbit of half a day leave 1e-9 km.
    """
    j = np.clip(np.floor(t_s / STEP_S).astype(int) - 2, 0, len(states) - 6)
    u = t_s / STEP_S - j
    out = np.zeros((len(t_s), 6))
    for a in range(6):
        weight = np.ones(len(t_s))
        for b in range(6):
            if a != b:
                weight *= (u - b) / (a - b)
        out += weight[:, None] * states[j + a]
    return out


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
