"""Equinoctial elements: a covariance from tracking stays normal in them where it is bent in Cartesian coordinates.

Mean motion n (rad/s), h = e sin(w+W), k = e cos(w+W), p = tan(i/2) sin W, q = tan(i/2) cos W, mean longitude (rad): Broucke &
Cefola 1972, Celest. Mech. 5, 303, with n for a. Two-body motion moves the last one alone, as the first says: what is normal
once stays so. Singular for i = 180 deg only.
"""

import numpy as np
from numpy.typing import NDArray

from ground.orbit.dynamics import MU_KM3_S2

Array = NDArray[np.float64]

_NEWTON = 12  # six steps reach 1e-7 rad for e = 0.95 and 12 the rounding; for e = 0.99 Newton's start is too far and diverges


def equinoctial_of(state: Array) -> Array:
    """Elements (n, 6) of states (n, 6) km, km/s; NaN for those that are not bound."""
    r, v = state[:, :3], state[:, 3:]
    distance = np.linalg.norm(r, axis=1)
    momentum = np.cross(r, v)
    w = momentum / np.linalg.norm(momentum, axis=1, keepdims=True)
    a = 1.0 / (2.0 / distance - (v**2).sum(axis=1) / MU_KM3_S2)
    p, q = w[:, 0] / (1.0 + w[:, 2]), -w[:, 1] / (1.0 + w[:, 2])
    f, g = _axes(p, q)
    towards = np.cross(v, momentum) / MU_KM3_S2 - r / distance[:, None]
    h, k = (towards * g).sum(axis=1), (towards * f).sum(axis=1)
    x, y = (r * f).sum(axis=1), (r * g).sum(axis=1)
    with np.errstate(invalid="ignore"):
        root = np.sqrt(1.0 - h * h - k * k)
    beta = 1.0 / (1.0 + root)
    cosine = k + ((1.0 - k * k * beta) * x - h * k * beta * y) / (a * root)
    sine = h + ((1.0 - h * h * beta) * y - h * k * beta * x) / (a * root)
    longitude = np.arctan2(sine, cosine)
    with np.errstate(invalid="ignore"):
        n = np.sqrt(MU_KM3_S2 / a**3)
    return np.column_stack([n, h, k, p, q, longitude + h * np.cos(longitude) - k * np.sin(longitude)])


def _axes(p: Array, q: Array) -> tuple[Array, Array]:
    """Unit vectors (n, 3) f and g of the equinoctial frame."""
    scale = 1.0 / (1.0 + p * p + q * q)
    f = np.column_stack([1.0 - p * p + q * q, 2.0 * p * q, -2.0 * p]) * scale[:, None]
    g = np.column_stack([2.0 * p * q, 1.0 + p * p - q * q, 2.0 * q]) * scale[:, None]
    return f, g


def state_at(elements: Array, dt_s: Array | float) -> Array:
    """States (n, 6) km, km/s of elements (n, 6), dt_s (n,) or one number after their epoch, two-body motion."""
    n, h, k, p, q, mean = elements.T
    a = np.cbrt(MU_KM3_S2 / n**2)
    mean = mean + n * dt_s
    angle = mean.copy()
    for _ in range(_NEWTON):
        sine, cosine = np.sin(angle), np.cos(angle)
        step = (angle + h * cosine - k * sine - mean) / (1.0 - h * sine - k * cosine)
        angle -= step
        if np.abs(step).max(initial=0.0) < 1e-14:
            break
    sine, cosine = np.sin(angle), np.cos(angle)
    beta = 1.0 / (1.0 + np.sqrt(1.0 - h * h - k * k))
    x = a * ((1.0 - h * h * beta) * cosine + h * k * beta * sine - k)
    y = a * ((1.0 - k * k * beta) * sine + h * k * beta * cosine - h)
    rate = n * a / (1.0 - h * sine - k * cosine)
    x_dot = rate * (h * k * beta * cosine - (1.0 - h * h * beta) * sine)
    y_dot = rate * ((1.0 - k * k * beta) * cosine - h * k * beta * sine)
    f, g = _axes(p, q)
    return np.hstack([x[:, None] * f + y[:, None] * g, x_dot[:, None] * f + y_dot[:, None] * g])


def partials(elements: Array) -> Array:
    """Matrix (6, 6) d(state)/d(elements) at the epoch, by central differences of steps that lose half of the digits."""
    step = np.array([1e-7 * elements[0], 1e-7, 1e-7, 1e-7, 1e-7, 1e-7])
    away = np.vstack([np.diag(step), -np.diag(step)])
    states = state_at(elements + away, 0.0)
    return np.asarray((states[:6] - states[6:]).T / (2.0 * step))
