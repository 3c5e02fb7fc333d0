"""An orbit from three directions by Gooding's method: no orbit, no range and no arc of their own are needed.

Unknown are the ranges at the first and the third epoch. Lambert's problem between them gives an orbit for each way round and
number of revolutions; where it misses the second direction, both ranges are corrected by Newton's steps (Gooding 1997, Celestial
Mechanics and Dynamical Astronomy 66, 387). Several orbits may meet three directions: all that are found are returned.
"""

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ground.association.lambert import lambert
from ground.determination.measurements import Directions
from ground.orbit.dynamics import EARTH_RADIUS_KM, LIGHT_KM_S, MU_KM3_S2
from ground.sky.sphere import east_north
from sboc_e2e.icd import tai
from sboc_e2e.icd.errors import UserError

Array = NDArray[np.float64]

_START_KM: Final = np.array(
    [300.0, 600.0, 1_000.0, 1_800.0, 3_000.0, 5_000.0, 8_000.0, 13_000.0, 20_000.0, 28_000.0, 36_000.0, 45_000.0]
)
"""Ranges to start from, the first and the third alike or one step apart."""
_MOST_STEPS: Final = 30  # a budget of work; Newton's steps double the digits once near. Chosen, not measured
_MET_RAD: Final = 1e-10  # 2e-5 arcsec: far below any direction's error; 0.4 cm at 40,000 km
_SAME: Final = 1e-4
"""Relative difference of both ranges below which two solutions are one."""
_STEP: Final = 1e-6  # relative step of forward differences, 40 m at 40,000 km: the slope errs by some 1e-6, Newton needs less
_NEAREST_KM: Final = 10.0  # lower clamp of a range; keeps it positive
_FARTHEST_KM: Final = 200_000.0  # upper clamp of a range: half of the way to the Moon, beyond every orbit looked for
_TURN_STEPS: Final = 60
"""20 steps of Newton (0.5 rad at most) reach 3e-13 of the axis for e < 0.95 within five turns (800 drawn orbits)."""


@njit(cache=True)
def kepler_step(state: Array, dt_s: float, out: Array) -> bool:
    """State (6,) of two-body motion dt_s later by Lagrange's coefficients (Battin 1999, eq. 4.42); False for no ellipse."""
    r0 = math.sqrt(state[0] ** 2 + state[1] ** 2 + state[2] ** 2)
    v2 = state[3] ** 2 + state[4] ** 2 + state[5] ** 2
    inverse_a = 2.0 / r0 - v2 / MU_KM3_S2
    if inverse_a <= 0.0:
        return False
    a = 1.0 / inverse_a
    rate = math.sqrt(MU_KM3_S2 / a**3)
    sigma = (state[0] * state[3] + state[1] * state[4] + state[2] * state[5]) / math.sqrt(MU_KM3_S2)
    sine, cosine = sigma / math.sqrt(a), 1.0 - r0 / a
    turn = rate * dt_s
    for _ in range(_TURN_STEPS):
        f = turn - cosine * math.sin(turn) + sine * (1.0 - math.cos(turn)) - rate * dt_s
        slope = 1.0 - cosine * math.cos(turn) + sine * math.sin(turn)
        step = f / slope
        # far from circles Newton overshoots
        step = min(max(step, -0.5), 0.5)
        turn -= step
        if abs(step) < 1e-14:
            break
    c, s = math.cos(turn), math.sin(turn)
    r = a + (r0 - a) * c + sigma * math.sqrt(a) * s
    f = 1.0 - a / r0 * (1.0 - c)
    g = a * sigma / math.sqrt(MU_KM3_S2) * (1.0 - c) + r0 * math.sqrt(a / MU_KM3_S2) * s
    f_dot = -math.sqrt(MU_KM3_S2 * a) / (r * r0) * s
    g_dot = 1.0 - a / r * (1.0 - c)
    for k in range(3):
        out[k] = f * state[k] + g * state[3 + k]
        out[3 + k] = f_dot * state[k] + g_dot * state[3 + k]
    return True


@njit(cache=True)
def _missed(
    rho: Array, t_s: Array, observers: Array, lines: Array, axes: Array, revolutions: int, late: bool, short: bool, state: Array,
    out: Array,
) -> bool:  # fmt: skip
    """By what (rad, along two axes) an orbit through two ranges misses the second direction, and its state there."""
    first = observers[0] + rho[0] * lines[0]
    third = observers[2] + rho[1] * lines[2]
    normal = np.empty(3)
    for c in range(3):
        d, e = (c + 1) % 3, (c + 2) % 3
        normal[c] = first[d] * third[e] - first[e] * third[d]
    if not short:
        normal = -normal
    # light left by its way earlier
    t_first = t_s[0] - rho[0] / LIGHT_KM_S
    dt = t_s[2] - rho[1] / LIGHT_KM_S - t_first
    speeds, start = np.empty(6), np.empty(6)
    if dt <= 0.0 or not lambert(first, third, dt, revolutions, normal, late, speeds):
        return False
    start[:3] = first
    start[3:] = speeds[:3]
    rho_2 = 0.5 * (rho[0] + rho[1])
    line = np.empty(3)
    for _ in range(3):
        if not kepler_step(start, t_s[1] - rho_2 / LIGHT_KM_S - t_first, state):
            return False
        line = state[:3] - observers[1]
        rho_2 = math.sqrt((line * line).sum())
    if (line * lines[1]).sum() <= 0.0:
        return False
    out[0] = (line * axes[0]).sum() / rho_2
    out[1] = (line * axes[1]).sum() / rho_2
    return True


@njit(cache=True)
def _corrected(
    rho: Array, t_s: Array, observers: Array, lines: Array, axes: Array, revolutions: int, late: bool, short: bool, state: Array
) -> bool:
    """Newton's steps from two ranges (2,), in place, halved while they gain nothing; whether the second direction is met."""
    here, there, moved = np.empty(2), np.empty(2), np.empty(6)
    slope = np.empty((2, 2))
    if not _missed(rho, t_s, observers, lines, axes, revolutions, late, short, state, here):
        return False
    for _ in range(_MOST_STEPS):
        size = (here * here).sum()
        if size < _MET_RAD**2:
            return True
        for k in range(2):
            nudged = rho.copy()
            nudged[k] *= 1.0 + _STEP
            if not _missed(nudged, t_s, observers, lines, axes, revolutions, late, short, moved, there):
                return False
            slope[:, k] = (there - here) / (nudged[k] - rho[k])
        determinant = slope[0, 0] * slope[1, 1] - slope[0, 1] * slope[1, 0]
        if determinant == 0.0:
            return False
        step = np.empty(2)
        step[0] = (slope[1, 1] * here[0] - slope[0, 1] * here[1]) / determinant
        step[1] = (slope[0, 0] * here[1] - slope[1, 0] * here[0]) / determinant
        # no range changes by more than a half at once
        share = min(1.0, 0.5 / max(abs(step[0] / rho[0]), abs(step[1] / rho[1]), 1e-12))
        gained = False
        for _ in range(8):
            trial = rho - share * step
            if trial.min() > _NEAREST_KM and trial.max() < _FARTHEST_KM:
                met = _missed(trial, t_s, observers, lines, axes, revolutions, late, short, moved, there)
                if met and (there * there).sum() < size:
                    gained = True
                    break
            share *= 0.5
        if not gained:
            # the directions' own rounding
            return bool(size < 1e4 * _MET_RAD**2)
        rho[:] = trial
        here[:] = there
        state[:] = moved
    return False


def gooding(t_tai_ns: NDArray[np.int64], observers_km: Array, directions: Array, most_revolutions: int = 0) -> Array:
    """States (k, 6) km, km/s at the second epoch (less its light time) of the ellipses that meet three directions; k may be 0.

    t_tai_ns : (3,), rising, of reception. observers_km, directions : (3, 3), GCRS axes; light time is not removed from them.
    most_revolutions : whole ones between first and third epoch that are tried. Orbits whose perigee lies within the Earth are
    left out. Two bodies, no oblateness. UserError for epochs that do not rise.
    """
    if len(t_tai_ns) != 3 or (np.diff(t_tai_ns) <= 0).any():
        raise UserError("initial orbit: three directions at rising epochs are expected")
    t_s = (np.asarray(t_tai_ns) - int(t_tai_ns[1])) / tai.NS_PER_S
    axes = np.vstack(east_north(directions[1]))
    found: list[tuple[Array, Array]] = []
    starts = [(a, b) for i, a in enumerate(_START_KM) for b in _START_KM[max(i - 1, 0) : i + 2]]
    ways = [(m, late, short) for m in range(most_revolutions + 1) for late in ((False, True) if m else (False,))
            for short in (True, False)]  # fmt: skip
    for revolutions, late, short in ways:
        for pair in starts:
            rho, state = np.array(pair), np.empty(6)
            if not _corrected(rho, t_s, observers_km, directions, axes, revolutions, late, short, state):
                continue
            if _perigee_km(state) < EARTH_RADIUS_KM:
                continue
            if all(np.abs(rho / other - 1.0).max() > _SAME or np.abs(state - s).max() > 1.0 for other, s in found):
                found.append((rho, state))
    return np.array([state for _, state in found]).reshape(-1, 6)


def _perigee_km(state: Array) -> float:
    r, v = state[:3], state[3:]
    spin = np.cross(r, v)
    eccentric = np.cross(v, spin) / MU_KM3_S2 - r / np.linalg.norm(r)
    return float(spin @ spin / MU_KM3_S2 / (1.0 + np.linalg.norm(eccentric)))


def starts_of(tracklets: Sequence[Directions], most_revolutions: int) -> tuple[Array, int]:
    """States (k, 6) and their epoch from the first, the middle and the last of three or more tracklets in order of time."""
    chosen = [tracklets[0], tracklets[len(tracklets) // 2], tracklets[-1]]
    rows = [(d, len(d.t_tai_ns) // 2) for d in chosen]
    t = np.array([d.t_tai_ns[m] for d, m in rows], dtype=np.int64)
    where, lines = (np.array([getattr(d, name)[m] for d, m in rows]) for name in ("observer_km", "direction"))
    return gooding(t, where, lines, most_revolutions), int(t[1])
