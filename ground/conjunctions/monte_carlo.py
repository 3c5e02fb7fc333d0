"""Probability by trial: orbits drawn from both covariances, two-body motion, a count of pairs that come too near.

For encounters that last or repeat, where no single plane describes them. Drawn in equinoctial elements, where covariances that
tracking left stay normal, or in Cartesian coordinates, for states and covariances that are stated so.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.stats import beta

from ground.conjunctions.curved import cloud_of
from ground.conjunctions.encounter import StateEstimate, regular
from ground.conjunctions.equinoctial import equinoctial_of
from ground.orbit.dynamics import MU_KM3_S2
from sboc_e2e.icd.errors import UserError

Array = NDArray[np.float64]

_SEED: Final = 91  # any number: fixed, so that the same message always has the same probability
_BLOCK: Final = 100_000  # pairs drawn at once: 5 MB for each object. A limit of memory
_STEPS_PER_RADIAN: Final = 16
"""Steps of 3.6 deg, within which the distance of two orbits has one minimum; these are refined. Chosen, not measured."""


@dataclass(frozen=True, kw_only=True)
class Trial:
    """Hits among pairs drawn, and the share of hits with its 95 % interval (Clopper & Pearson)."""

    hits: int
    drawn: int
    probability: float
    low: float
    high: float


def monte_carlo(
    first: StateEstimate,
    second: StateEstimate,
    hard_body_km: float,
    drawn: int,
    window_s: tuple[float, float],
    *,
    cartesian: bool = False,
    enough_hits: int = 10_000,
) -> Trial:
    """Share of pairs that come nearer than `hard_body_km` within a window, s after the epoch of the states.

    drawn : pairs at most; fewer once there are enough hits.
    """
    if drawn < 1 or not window_s[0] < window_s[1]:
        raise UserError(f"Monte Carlo: expected pairs and a window that ends after it starts, got {drawn} and {window_s}")
    first, second = regular(first, second)
    rng = np.random.default_rng(_SEED)
    hits = done = 0
    while done < drawn and hits < enough_hits:
        n = min(_BLOCK, drawn - done)
        elements = [_drawn(e, rng.standard_normal((n, 6)), cartesian=cartesian) for e in (first, second)]
        hits += int(_hits(elements[0], elements[1], hard_body_km, window_s[0], window_s[1]))
        done += n
    low = float(beta.ppf(0.025, hits, done - hits + 1)) if hits else 0.0
    high = float(beta.ppf(0.975, hits + 1, done - hits)) if hits < done else 1.0
    return Trial(hits=hits, drawn=done, probability=hits / done, low=low, high=high)


def _drawn(estimate: StateEstimate, z: Array, *, cartesian: bool) -> Array:
    """Elements (n, 6) of orbits from whitened numbers (n, 6)."""
    cloud = cloud_of(estimate)
    if not cartesian:
        return cloud.drawn(z)
    scale = np.sqrt(np.maximum(np.diag(estimate.covariance), 1e-300))
    value, vector = np.linalg.eigh(estimate.covariance / np.outer(scale, scale))
    return equinoctial_of(estimate.state + z @ (scale[:, None] * vector * np.sqrt(np.maximum(value, 0.0))).T)


@njit(cache=True)
def _place(elements: Array, frame: Array, t: float, out: Array) -> None:
    """State (6,) at t of elements (6,) with frame (8,): f, g, semi-major axis, beta."""
    n, h, k = elements[0], elements[1], elements[2]
    a, b = frame[6], frame[7]
    mean = elements[5] + n * t
    angle = mean
    for _ in range(30):
        sine, cosine = math.sin(angle), math.cos(angle)
        step = (angle + h * cosine - k * sine - mean) / (1.0 - h * sine - k * cosine)
        angle -= step
        if abs(step) < 1e-13:
            break
    sine, cosine = math.sin(angle), math.cos(angle)
    x = a * ((1.0 - h * h * b) * cosine + h * k * b * sine - k)
    y = a * ((1.0 - k * k * b) * sine + h * k * b * cosine - h)
    rate = n * a / (1.0 - h * sine - k * cosine)
    x_dot = rate * (h * k * b * cosine - (1.0 - h * h * b) * sine)
    y_dot = rate * ((1.0 - k * k * b) * cosine - h * k * b * sine)
    for c in range(3):
        out[c] = x * frame[c] + y * frame[3 + c]
        out[3 + c] = x_dot * frame[c] + y_dot * frame[3 + c]


@njit(cache=True)
def _frame(elements: Array, out: Array) -> None:
    """Unit vectors f and g, semi-major axis and beta of elements (6,) into out (8,)."""
    p, q = elements[3], elements[4]
    scale = 1.0 / (1.0 + p * p + q * q)
    out[0], out[1], out[2] = (1.0 - p * p + q * q) * scale, 2.0 * p * q * scale, -2.0 * p * scale
    out[3], out[4], out[5] = 2.0 * p * q * scale, (1.0 + p * p - q * q) * scale, 2.0 * q * scale
    out[6] = (MU_KM3_S2 / (elements[0] * elements[0])) ** (1.0 / 3.0)
    out[7] = 1.0 / (1.0 + math.sqrt(1.0 - elements[1] * elements[1] - elements[2] * elements[2]))


@njit(cache=True)
def _approach(first: Array, second: Array) -> tuple[float, float, float]:
    """Of two states (6,): distance squared km^2, distance times its rate km^2/s (negative while they close), speed squared."""
    distance2 = opening = speed2 = 0.0
    for c in range(3):
        away, drift = second[c] - first[c], second[3 + c] - first[3 + c]
        distance2 += away * away
        opening += away * drift
        speed2 += drift * drift
    return distance2, opening, speed2


@njit(cache=True)
def _hits(first: Array, second: Array, hard_body_km: float, low_s: float, high_s: float) -> int:
    """How many pairs of elements (n, 6) come within a distance during a window: scanned for approaches, which are refined."""
    count = 0
    limit = hard_body_km * hard_body_km
    frame_1, frame_2 = np.empty(8), np.empty(8)
    state_1, state_2 = np.empty(6), np.empty(6)
    for s in range(len(first)):
        _frame(first[s], frame_1)
        _frame(second[s], frame_2)
        rate = max(first[s, 0], second[s, 0])
        steps = max(1, math.ceil((high_s - low_s) * rate * _STEPS_PER_RADIAN))
        dt = (high_s - low_s) / steps
        before = 0.0
        hit = False
        for k in range(steps + 1):
            t = low_s + k * dt
            _place(first[s], frame_1, t, state_1)
            _place(second[s], frame_2, t, state_2)
            distance2, opening, speed2 = _approach(state_1, state_2)
            if distance2 < limit:
                hit = True
                break
            # nothing nearer than the hard body can have happened since the last epoch unless it lies within reach
            reach = hard_body_km + 1.5 * math.sqrt(speed2) * dt
            if k > 0 and before < 0.0 and opening >= 0.0 and distance2 < reach * reach:
                for _ in range(12):
                    step = -opening / speed2
                    t += min(max(step, -dt), dt)
                    _place(first[s], frame_1, t, state_1)
                    _place(second[s], frame_2, t, state_2)
                    distance2, opening, speed2 = _approach(state_1, state_2)
                    if abs(opening) < 1e-9 * speed2 * dt or distance2 < limit:
                        break
                if distance2 < limit:
                    hit = True
                    break
                _place(first[s], frame_1, low_s + k * dt, state_1)
                _place(second[s], frame_2, low_s + k * dt, state_2)
                _, opening, _ = _approach(state_1, state_2)
            before = opening
        if hit:
            count += 1
    return count


def nearest_window(first: StateEstimate, second: StateEstimate) -> tuple[float, float]:
    """Half a revolution of the lower object before and after the epoch, s: what surrounds one closest approach."""
    rate = max(float(equinoctial_of(e.state[None])[0, 0]) for e in (first, second))
    return -math.pi / rate, math.pi / rate
