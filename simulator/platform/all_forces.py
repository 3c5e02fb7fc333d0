"""Motion under all forces that count in high orbits, for objects that are met again on other days.

Gravity of the Earth to degree and order 4 (EGM96), Sun and Moon from ERFA's series, rotation of the Earth from ERFA, radiation
pressure on a sphere with a cylindrical shadow; Runge-Kutta of fourth order in steps of a minute. Left out: higher harmonics,
drag, tides, relativity. The ground segment shares nothing of it but the constants of nature.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import erfa
import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

MU: Final = 398600.4418  # of the Earth, km^3/s^2, EGM96
MU_SUN: Final = 1.32712440018e11  # of the Sun, km^3/s^2, DE405
MU_MOON: Final = 4902.800066  # of the Moon, km^3/s^2, DE421
EARTH_KM: Final = 6378.1363
"""Radius that the coefficients of EGM96 belong to."""
AU_KM: Final = 149597870.7  # by definition, IAU 2012
SUN_PRESSURE: Final = 4.56e-6
"""N/m^2 at one astronomical unit."""
STEP_S: Final = 60.0  # leaves millimetres in a day of a high orbit
NODES: Final = 6
"""Of the polynomial between steps."""
DAY_S: Final = 86400.0  # seconds of a day
TAI_1958_JD: Final = 2436204.5  # Julian date of the epoch of TAI nanoseconds
EGM96 = (
    (2, 0, -484.165371736, 0.0), (2, 1, -0.000186988, 0.001195280), (2, 2, 2.439143524, -1.400166837),
    (3, 0, 0.957254174, 0.0), (3, 1, 2.029988822, 0.248513159), (3, 2, 0.904627769, -0.619025944),
    (3, 3, 0.721072657, 1.414356270), (4, 0, 0.539873864, 0.0), (4, 1, -0.536321617, -0.473440266),
    (4, 2, 0.350694106, 0.662671573), (4, 3, 0.990771804, -0.200928369), (4, 4, -0.188560803, 0.308853169),
)  # fmt: skip
"""Normalised coefficients of the field of 1996 in units of 1e-6: degree, order, cosine, sine."""


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


@lru_cache(maxsize=4)
def sky_of(t0_tai_ns: int, days: float) -> Sky:
    """Tables every half step, forward from an epoch, or back from it where `days` is negative. Shared: not to be written to."""
    half_s = math.copysign(0.5 * STEP_S, days)
    t = np.arange(0.0, days * DAY_S + 2.0 * half_s, half_s)
    day, rest = divmod(t0_tai_ns, 86400 * 10**9)
    tt1, tt2 = TAI_1958_JD + day, (rest * 1e-9 + t + 32.184) / DAY_S
    heliocentric, _ = erfa.epv00(tt1, tt2)
    sun = -AU_KM * heliocentric["p"]
    moon = AU_KM * erfa.moon98(tt1, tt2)["p"]
    # TAI - UT1 of the years about 2026; a second turns the tesserals by 15", which is nothing
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
def _integrate(
    start: Array, area: Array, sun: Array, moon: Array, fixed: Array, c: Array, s: Array, steps: int, h: float
) -> Array:
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
    """States (n, steps + 1, 6) every minute, forward or, where `days` and the sky's are negative, back.

    start : (n, 6) km, km/s. area_m2_kg : (n,) radiation coefficient times area over mass.
    """
    steps = round(abs(days) * DAY_S / STEP_S)
    return np.asarray(_integrate(start, area_m2_kg, sky.sun, sky.moon, sky.fixed, C, S, steps, math.copysign(STEP_S, days)))


def between(states: Array, t_s: Array) -> Array:
    """States (k, 6) at times t_s (k,) from a table every minute (steps + 1, 6).

    Velocities and positions at six nodes by Lagrange; 60 s of an orbit of half a day leave 1e-9 km.
    """
    j = np.clip(np.floor(t_s / STEP_S).astype(int) - 2, 0, len(states) - NODES)
    u = t_s / STEP_S - j
    out = np.zeros((len(t_s), 6))
    for a in range(NODES):
        weight = np.ones(len(t_s))
        for b in range(NODES):
            if a != b:
                weight *= (u - b) / (a - b)
        out += weight[:, None] * states[j + a]
    return out


def motion(state: Array, epoch_tai_ns: int, area_m2_kg: float) -> Callable[[Array], Array]:
    """Positions (n, 3) km at seconds (n,) before or after the epoch of a state (6,) km, km/s."""
    tables: dict[int, Array] = {}

    def side(sign: int, farthest_s: float) -> Array:
        """States every minute of one side, at least so far and a few minutes on."""
        if sign not in tables or (len(tables[sign]) - NODES) * STEP_S < farthest_s:
            # whole hours: objects of one epoch share the sky
            days = sign * math.ceil((farthest_s + NODES * STEP_S) / 3600.0) * 3600.0 / DAY_S
            tables[sign] = true_orbits(state[None], np.array([area_m2_kg]), sky_of(epoch_tai_ns, days), days)[0]
        return tables[sign]

    def positions_km(time_s: Array) -> Array:
        out = np.empty((len(time_s), 3))
        for sign in (1, -1):
            chosen = time_s >= 0.0 if sign > 0 else time_s < 0.0
            if chosen.any():
                away_s = np.abs(time_s[chosen])
                out[chosen] = between(side(sign, float(away_s.max())), away_s)[:, :3]
        return out

    return positions_km
