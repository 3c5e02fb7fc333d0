"""Motion of everything that orbits the Earth, camera and objects alike: point mass and J2, integrated in GCRS axes.

The pole of the date is taken for the GCRS z axis. Higher harmonics, Moon, Sun, drag and light pressure are left out. They are
below 1e-5 of gravity and nearly the same for two bodies that meet. Satellites of a catalogue alone follow SGP4, the theory
that their element sets belong to.
"""

import math
from typing import Final

import numba
import numpy as np
from numpy.typing import NDArray

from simulator.platform.earth import EARTH_RADIUS_KM, J2, MU_KM3_S2

Array = NDArray[np.float64]

STEP_S: Final = 5.0
"""Longest Runge-Kutta step: 1 mm in an hour of a low orbit (tested)."""
SPACING_S: Final = 60.0
"""States are kept at multiples of this time, so that any instant costs only a few steps."""
_MU: Final = float(MU_KM3_S2)
_OBLATE_KM2: Final = 1.5 * float(J2) * float(EARTH_RADIUS_KM) ** 2


@numba.njit(cache=True)
def _acceleration(r: Array, out: Array) -> None:
    """Point mass and J2 (Vallado, 4th ed., eq. 8-30), km/s^2."""
    r2 = r[0] * r[0] + r[1] * r[1] + r[2] * r[2]
    gravity = -_MU / (r2 * math.sqrt(r2))
    oblate = _OBLATE_KM2 / r2
    z2 = 5.0 * r[2] * r[2] / r2
    out[0] = gravity * r[0] * (1.0 + oblate * (1.0 - z2))
    out[1] = gravity * r[1] * (1.0 + oblate * (1.0 - z2))
    out[2] = gravity * r[2] * (1.0 + oblate * (3.0 - z2))


@numba.njit(cache=True)
def _advance(state: Array, dt_s: float) -> None:
    """Move a state (6,) in place; classical Runge-Kutta of fourth order."""
    n_steps = math.ceil(abs(dt_s) / STEP_S)
    if n_steps == 0:
        return
    h = dt_s / n_steps
    k1, k2, k3, k4, at = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for _ in range(n_steps):
        _acceleration(state[:3], k1)
        for c in range(3):
            at[c] = state[c] + 0.5 * h * state[3 + c]
        _acceleration(at, k2)
        for c in range(3):
            at[c] = state[c] + 0.5 * h * (state[3 + c] + 0.5 * h * k1[c])
        _acceleration(at, k3)
        for c in range(3):
            at[c] = state[c] + h * (state[3 + c] + 0.5 * h * k2[c])
        _acceleration(at, k4)
        for c in range(3):
            state[c] += h * (state[3 + c] + h / 6.0 * (k1[c] + k2[c] + k3[c]))
            state[3 + c] += h / 6.0 * (k1[c] + 2.0 * k2[c] + 2.0 * k3[c] + k4[c])


@numba.njit(cache=True)
def _fill(kept: Array, first: int, spacing_s: float) -> None:
    """States (n, 6) from number `first` on, each a spacing after the one before."""
    for k in range(first, len(kept)):
        kept[k] = kept[k - 1]
        _advance(kept[k], spacing_s)


@numba.njit(cache=True)
def _at_times(kept: Array, spacing_s: float, time_s: Array, out: Array) -> None:
    """States (n, 6) at times of the sign of the spacing, from the kept ones before them."""
    for k in range(len(time_s)):
        nearest = int(time_s[k] / spacing_s)
        out[k] = kept[nearest]
        _advance(out[k], time_s[k] - nearest * spacing_s)


class OrbitMotion:
    """The orbit through a state (3,) km, (3,) km/s at time 0. Kept states depend on nothing but that state."""

    def __init__(self, position_km: Array, velocity_km_s: Array) -> None:
        start = np.concatenate([position_km, velocity_km_s]).astype(np.float64)[None]
        self._kept = {1: start, -1: start}

    def states(self, time_s: Array | float) -> tuple[Array, Array]:
        """Positions km and velocities km/s (..., 3) at times (...) before or after."""
        time_s = np.asarray(time_s, dtype=np.float64)
        flat = np.ascontiguousarray(time_s.ravel())
        out = np.empty((flat.size, 6))
        for sign in (1, -1):
            chosen = np.flatnonzero(flat >= 0.0 if sign > 0 else flat < 0.0)
            if chosen.size:
                part = np.empty((chosen.size, 6))
                wanted = flat[chosen]
                _at_times(self._until(sign, float(np.abs(wanted).max())), sign * SPACING_S, wanted, part)
                out[chosen] = part
        return out[:, :3].reshape(*time_s.shape, 3), out[:, 3:].reshape(*time_s.shape, 3)

    def _until(self, sign: int, farthest_s: float) -> Array:
        """Kept states of one side, up to a time at least."""
        kept, needed = self._kept[sign], int(farthest_s / SPACING_S) + 1
        if needed > len(kept):
            first = len(kept)
            kept = np.concatenate([kept, np.empty((max(needed, 2 * first) - first, 6))])
            _fill(kept, first, sign * SPACING_S)
            self._kept[sign] = kept
        return kept
