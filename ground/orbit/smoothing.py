"""A Kalman filter and its smoother along one arc of position fixes: motion, unmodelled acceleration, steady errors of the fixes.

Fifteen numbers are estimated at every node: position and velocity (km, km/s), an acceleration that the model lacks (Gauss-Markov,
km/s^2), and the part of the error of positions and of velocities that all fixes share. Extended filter and Rauch-Tung-Striebel
smoother (Tapley, Schutz & Born 2004, sections 4.7 and 4.15; Rauch et al. 1965, AIAA J. 3, 1445).
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ground.orbit.dynamics import LONGEST_STEP_S, acceleration

Array = NDArray[np.float64]

N_STATE = 15
"""Position, velocity and push (three each), and the steady error of the fixes (six)."""
_PROBE = np.array([1e-2, 1e-2, 1e-2, 1e-5, 1e-5, 1e-5, 1e-5, 1e-5, 1e-5])
"""Steps of position (km), velocity (km/s) and acceleration (km/s^2) for derivatives of the motion, which is close to linear."""


class ArcModel(NamedTuple):
    """How an arc moves and how its fixes err.

    spin : (3,) rad/s of the Earth for a camera that turns with it, zeros for one in orbit. push_km_s2, push_time_s : one sigma
    and correlation time of the unmodelled acceleration. steady : (6,) one sigma of the error that all fixes share.
    """

    spin: Array
    push_km_s2: float
    push_time_s: float
    steady: Array


@njit(cache=True)
def _pull(position: Array, push: Array, spin: Array, out: Array) -> None:
    """Acceleration (3,): gravity with J2, or that of a point of the turning Earth; and the push."""
    turning = spin[0] * spin[0] + spin[1] * spin[1] + spin[2] * spin[2]
    if turning > 0.0:
        along = spin[0] * position[0] + spin[1] * position[1] + spin[2] * position[2]
        for c in range(3):
            out[c] = spin[c] * along - turning * position[c] + push[c]
    else:
        acceleration(position, out)
        for c in range(3):
            out[c] += push[c]


@njit(cache=True)
def _move(moving: Array, dt_s: float, spin: Array) -> None:
    """Position, velocity, push (9,) moved in place by dt_s with a constant push; Runge-Kutta of fourth order."""
    n_steps = max(1, math.ceil(abs(dt_s) / LONGEST_STEP_S))
    h = dt_s / n_steps
    k1, k2, k3, k4, p = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    push = moving[6:]
    for _ in range(n_steps):
        _pull(moving[:3], push, spin, k1)
        for c in range(3):
            p[c] = moving[c] + 0.5 * h * moving[3 + c]
        _pull(p, push, spin, k2)
        for c in range(3):
            p[c] = moving[c] + 0.5 * h * (moving[3 + c] + 0.5 * h * k1[c])
        _pull(p, push, spin, k3)
        for c in range(3):
            p[c] = moving[c] + h * (moving[3 + c] + 0.5 * h * k2[c])
        _pull(p, push, spin, k4)
        for c in range(3):
            moving[c] += h * (moving[3 + c] + h / 6.0 * (k1[c] + k2[c] + k3[c]))
            moving[3 + c] += h / 6.0 * (k1[c] + 2.0 * k2[c] + 2.0 * k3[c] + k4[c])


@njit(cache=True)
def _predict(x: Array, dt_s: float, model: ArcModel, transition: Array, noise: Array) -> Array:
    """State (15,) after dt_s; its derivatives and the noise that came in are written to (15, 15) arrays."""
    out = x.copy()
    moved = x[:9].copy()
    _move(moved, dt_s, model.spin)
    transition[:] = 0.0
    probe = np.empty(9)
    for j in range(9):
        probe[:] = x[:9]
        probe[j] += _PROBE[j]
        _move(probe, dt_s, model.spin)
        for i in range(6):
            transition[i, j] = (probe[i] - moved[i]) / _PROBE[j]
    kept = math.exp(-abs(dt_s) / model.push_time_s)
    noise[:] = 0.0
    fresh = model.push_km_s2 * model.push_km_s2 * (1.0 - kept * kept)
    for c in range(3):
        transition[6 + c, 6 + c] = kept
        moved[6 + c] *= kept
        noise[6 + c, 6 + c] = fresh
        # the push that comes up inside the step has acted for half of it on average
        noise[3 + c, 3 + c] = fresh * dt_s * dt_s / 3.0
        noise[c, c] = fresh * dt_s**4 / 20.0
    for k in range(9, N_STATE):
        transition[k, k] = 1.0
    out[:9] = moved
    return out


@njit(cache=True)
def smooth_arc(
    t_s: Array, fix: Array, sigma: Array, used: NDArray[np.bool_], start: Array, start_sigma: Array, model: ArcModel
) -> tuple[Array, Array, float]:
    """States (n, 15), covariances (n, 15, 15) at the nodes, and the logarithm of the likelihood of the fixes.

    t_s : (n,) rising. fix, sigma : (n, 6) km, km/s; used : (n,) False for nodes without a fix. start, start_sigma : (6,) a state
    at the first node and its prior sigma.
    """
    n = len(t_s)
    filtered, predicted = np.empty((n, N_STATE)), np.empty((n, N_STATE))
    p_filtered, p_predicted = np.empty((n, N_STATE, N_STATE)), np.empty((n, N_STATE, N_STATE))
    steps = np.empty((n, N_STATE, N_STATE))
    transition, noise = np.zeros((N_STATE, N_STATE)), np.zeros((N_STATE, N_STATE))
    x, p = np.zeros(N_STATE), np.zeros((N_STATE, N_STATE))
    x[:6] = start
    for k in range(6):
        p[k, k] = start_sigma[k] * start_sigma[k]
        p[9 + k, 9 + k] = model.steady[k] * model.steady[k]
    for k in range(6, 9):
        p[k, k] = model.push_km_s2 * model.push_km_s2
    log_likelihood = 0.0
    gain = np.empty(N_STATE)
    if model.spin[0] != 0.0 or model.spin[1] != 0.0 or model.spin[2] != 0.0:
        # a point of the Earth has no velocity but the Earth's: v - spin x r = 0, to 1 mm/s
        rows = np.zeros((3, N_STATE))
        for c in range(3):
            rows[c, 3 + c] = 1.0
            rows[c, (c + 2) % 3] -= model.spin[(c + 1) % 3]
            rows[c, (c + 1) % 3] += model.spin[(c + 2) % 3]
        for c in range(3):
            row = rows[c]
            gain = p @ row
            variance = row @ gain + 1e-12
            x -= gain * ((row @ x) / variance)
            p -= np.outer(gain, gain) / variance
    for k in range(n):
        if k > 0:
            x = _predict(x, t_s[k] - t_s[k - 1], model, transition, noise)
            p = transition @ p @ transition.T + noise
            p = 0.5 * (p + p.T)
            steps[k] = transition
        predicted[k], p_predicted[k] = x, p
        if used[k]:
            for c in range(6):
                # a fix is the state plus the steady error
                for i in range(N_STATE):
                    gain[i] = p[i, c] + p[i, 9 + c]
                variance = gain[c] + gain[9 + c] + sigma[k, c] * sigma[k, c]
                innovation = fix[k, c] - x[c] - x[9 + c]
                x = x + gain * (innovation / variance)
                p = p - np.outer(gain, gain) / variance
                log_likelihood -= 0.5 * (innovation * innovation / variance + math.log(variance))
            p = 0.5 * (p + p.T)
        filtered[k], p_filtered[k] = x, p
    scale = np.empty(N_STATE)
    for k in range(n - 2, -1, -1):
        # (p_predicted)^-1 with rows and columns brought to ones: km beside km/s^2
        for i in range(N_STATE):
            scale[i] = 1.0 / math.sqrt(max(p_predicted[k + 1, i, i], 1e-40))
        scaled = p_predicted[k + 1] * np.outer(scale, scale)
        for i in range(N_STATE):
            scaled[i, i] += 1e-12
        back = np.linalg.solve(scaled, np.outer(scale, np.ones(N_STATE)) * (steps[k + 1] @ p_filtered[k])).T
        back = back * np.outer(np.ones(N_STATE), scale)
        filtered[k] = filtered[k] + back @ (filtered[k + 1] - predicted[k + 1])
        changed = back @ (p_filtered[k + 1] - p_predicted[k + 1]) @ back.T
        p_filtered[k] = p_filtered[k] + 0.5 * (changed + changed.T)
    return filtered, p_filtered, log_likelihood
