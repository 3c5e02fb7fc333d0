"""Two-body motion with the oblateness of the Earth, and osculating elements of a state. GCRS axes, km and s.

The pole of the date is taken for the GCRS z axis: over the arcs of this package (minutes) the 0.15 deg between them change
the J2 acceleration, itself a thousandth of gravity, by less than a hundredth.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ground.sky.apparent import EARTH_GM_M3_S2
from ground.sky.published import LIGHT_M_S

MU_KM3_S2 = EARTH_GM_M3_S2 / 1e9
"""398,600.4418."""
EARTH_RADIUS_KM = 6378.1366
"""The radius that belongs to `J2`: IERS Conventions (2010), table 1.1, zero-tide system."""
J2 = 1.0826359e-3
"""Dynamical form factor, IERS Conventions (2010), table 1.1, zero-tide system."""
LIGHT_KM_S = LIGHT_M_S / 1e3
"""299,792.458, exact (SI)."""
LONGEST_STEP_S = 20.0
"""One Runge-Kutta step: a low orbit is then wrong by less than a millimetre per step."""


@njit(cache=True)
def acceleration(r: NDArray[np.float64], out: NDArray[np.float64]) -> None:
    """Point mass and J2 (Vallado 2013, eq. 8-30), km/s^2, into out (3,)."""
    r2 = r[0] * r[0] + r[1] * r[1] + r[2] * r[2]
    inverse_r = 1.0 / math.sqrt(r2)
    gravity = -MU_KM3_S2 * inverse_r * inverse_r * inverse_r
    oblate = 1.5 * J2 * EARTH_RADIUS_KM * EARTH_RADIUS_KM / r2
    z2 = 5.0 * r[2] * r[2] / r2
    out[0] = gravity * r[0] * (1.0 + oblate * (1.0 - z2))
    out[1] = gravity * r[1] * (1.0 + oblate * (1.0 - z2))
    out[2] = gravity * r[2] * (1.0 + oblate * (3.0 - z2))


@njit(cache=True)
def advance(state: NDArray[np.float64], dt_s: float) -> None:
    """Move a state (6,) km, km/s by dt_s in place, classical Runge-Kutta of fourth order."""
    n_steps = max(1, math.ceil(abs(dt_s) / LONGEST_STEP_S))
    h = dt_s / n_steps
    k1, k2, k3, k4, p = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for _ in range(n_steps):
        acceleration(state[:3], k1)
        for c in range(3):
            p[c] = state[c] + 0.5 * h * state[3 + c]
        acceleration(p, k2)
        for c in range(3):
            p[c] = state[c] + 0.5 * h * (state[3 + c] + 0.5 * h * k1[c])
        acceleration(p, k3)
        for c in range(3):
            p[c] = state[c] + h * (state[3 + c] + 0.5 * h * k2[c])
        acceleration(p, k4)
        for c in range(3):
            state[c] += h * (state[3 + c] + h / 6.0 * (k1[c] + k2[c] + k3[c]))
            state[3 + c] += h / 6.0 * (k1[c] + 2.0 * k2[c] + 2.0 * k3[c] + k4[c])


@njit(cache=True)
def propagate(state: NDArray[np.float64], dt_s: NDArray[np.float64]) -> NDArray[np.float64]:
    """States (n, 6) at times dt_s (n,) after that of `state` (6,)."""
    out = np.empty((len(dt_s), 6))
    for k in range(len(dt_s)):
        out[k] = state
        advance(out[k], dt_s[k])
    return out


@njit(cache=True)
def elements(rx: float, ry: float, rz: float, vx: float, vy: float, vz: float) -> tuple[float, float, float]:
    """Osculating semi-major axis (km; negative: unbound), eccentricity and inclination (rad)."""
    r = math.sqrt(rx * rx + ry * ry + rz * rz)
    v2 = vx * vx + vy * vy + vz * vz
    radial = rx * vx + ry * vy + rz * vz
    inverse_a = 2.0 / r - v2 / MU_KM3_S2
    hx, hy, hz = ry * vz - rz * vy, rz * vx - rx * vz, rx * vy - ry * vx
    h = math.sqrt(hx * hx + hy * hy + hz * hz)
    # e cos E = 1 - r/a and e sin E = r.v / sqrt(mu a): no cancellation for small e; e from h for unbound states
    cosine = r * v2 / MU_KM3_S2 - 1.0
    sine2 = radial * radial * inverse_a / MU_KM3_S2
    e2 = cosine * cosine + sine2
    inclination = math.acos(min(1.0, max(-1.0, hz / h))) if h > 0.0 else 0.0
    a = 1.0 / inverse_a if inverse_a != 0.0 else math.inf
    return a, math.sqrt(max(e2, 0.0)), inclination
