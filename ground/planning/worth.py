"""Information that a visit adds on an orbit.

The unknowns are the six equinoctial elements at the start of the plan, each in units of its error there, so that what is known
at first is the unit matrix. A visit measures two angles. Its worth is half the logarithm of the determinant of the knowledge
after it over that before (nats; Lindley 1956, Ann. Math. Stat. 27, 986), which falls with each further visit. The partial
derivatives are of two-body motion. Over the days of a plan the oblateness turns the orbit, but hardly changes the derivatives.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ground.orbit.dynamics import MU_KM3_S2
from ground.planning.options import KnowledgeOptions

Array = NDArray[np.float64]

_STEP: Final = 1e-3
"""Of a difference quotient, in units of the error of an element."""

_NEWTON_STEPS: Final = 12  # a budget of work; the loop ends earlier, where corrections are below `_SETTLED_RAD`
_SETTLED_RAD: Final = 1e-9
"""A correction after which the next is below the rounding of angles: Newton's steps square the error."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Views:
    """k possible observations. target, slot : (k,). told : (k, 2, 6) derivatives of the two angles by the elements, in units of
    the errors of both."""

    target: NDArray[np.int64]
    slot: NDArray[np.int64]
    told: Array


def views_of(
    state: Array,
    dt_s: Array,
    target: NDArray[np.int64],
    slot: NDArray[np.int64],
    line_km: Array,
    sigma_rad: Array,
    knowledge: KnowledgeOptions,
) -> Views:
    """Observations of targets. state : (m, 6) at the start of the plan. dt_s : (n,) epochs of the slots after it.

    target, slot : (k,) which and when. line_km : (k, 3) from the station. sigma_rad : (k,) error of each angle.
    """
    elements = equinoctial(state)
    sigma = element_sigma(elements[:, 0], knowledge)
    first, second = _tangents(line_km)
    range_km = np.linalg.norm(line_km, axis=1)
    told = np.empty((len(target), 2, 6))
    for column in range(6):
        step = np.zeros(6)
        step[column] = _STEP
        change = sigma[target] * step
        ahead = positions(elements[target] + change, dt_s[slot])
        behind = positions(elements[target] - change, dt_s[slot])
        shift = (ahead - behind) / (2.0 * _STEP * range_km[:, None])
        told[:, 0, column] = np.sum(shift * first, axis=1) / sigma_rad
        told[:, 1, column] = np.sum(shift * second, axis=1) / sigma_rad
    return Views(target=target, slot=slot, told=told)


def element_sigma(a_km: Array, knowledge: KnowledgeOptions) -> Array:
    """Errors (m, 6) of a (km), h, k, p, q and mean longitude (rad) from those of positions.

    An error of a grows along the orbit by 1.5 n t da; h and k move a position by a, p and q by 2 a, for each unit.
    """
    motion = np.sqrt(MU_KM3_S2 / a_km**3)
    across = knowledge.across_km / a_km
    drift = knowledge.drift_km_day / 86400.0 / (1.5 * motion)
    return np.stack([drift, across, across, 0.5 * across, 0.5 * across, knowledge.along_km / a_km], axis=1)


def equinoctial(state: Array) -> Array:
    """Elements (m, 6) of states (m, 6): a, h = e sin w', k = e cos w', p, q = tan(i/2) (sin, cos) node, mean longitude.

    Broucke & Cefola 1972, Celest. Mech. 5, 303. Not defined at an inclination of 180 deg.
    """
    r, v = state[:, :3], state[:, 3:]
    distance = np.linalg.norm(r, axis=1)
    a = 1.0 / (2.0 / distance - np.sum(v * v, axis=1) / MU_KM3_S2)
    momentum = np.cross(r, v)
    normal = momentum / np.linalg.norm(momentum, axis=1)[:, None]
    p, q = normal[:, 0] / (1.0 + normal[:, 2]), -normal[:, 1] / (1.0 + normal[:, 2])
    f, g = _frame(p, q)
    eccentricity = np.cross(v, momentum) / MU_KM3_S2 - r / distance[:, None]
    k, h = np.sum(eccentricity * f, axis=1), np.sum(eccentricity * g, axis=1)
    x, y = np.sum(r * f, axis=1), np.sum(r * g, axis=1)
    root = np.sqrt(1.0 - h * h - k * k)
    beta = 1.0 / (1.0 + root)
    cosine = k + ((1.0 - k * k * beta) * x - h * k * beta * y) / (a * root)
    sine = h + ((1.0 - h * h * beta) * y - h * k * beta * x) / (a * root)
    longitude = np.arctan2(sine, cosine) + h * cosine - k * sine
    return np.stack([a, h, k, p, q, longitude], axis=1)


def positions(elements: Array, dt_s: Array) -> Array:
    """Two-body positions (k, 3) km of elements (k, 6), dt_s (k,) after their epoch; Newton's steps on Kepler's equation."""
    a, h, k, p, q, longitude = elements.T
    mean = longitude + np.sqrt(MU_KM3_S2 / a**3) * dt_s
    eccentric = mean.copy()
    for _ in range(_NEWTON_STEPS):
        sine, cosine = np.sin(eccentric), np.cos(eccentric)
        correction = (eccentric + h * cosine - k * sine - mean) / (1.0 - h * sine - k * cosine)
        eccentric -= correction
        if np.max(np.abs(correction), initial=0.0) < _SETTLED_RAD:
            break
    sine, cosine = np.sin(eccentric), np.cos(eccentric)
    beta = 1.0 / (1.0 + np.sqrt(1.0 - h * h - k * k))
    x = a * ((1.0 - h * h * beta) * cosine + h * k * beta * sine - k)
    y = a * ((1.0 - k * k * beta) * sine + h * k * beta * cosine - h)
    f, g = _frame(p, q)
    return np.asarray(x[:, None] * f + y[:, None] * g)


def _frame(p: Array, q: Array) -> tuple[Array, Array]:
    """Axes (n, 3) of the equinoctial frame in the plane of the orbit."""
    scale = 1.0 / (1.0 + p * p + q * q)
    f = scale[:, None] * np.stack([1.0 - p * p + q * q, 2.0 * p * q, -2.0 * p], axis=1)
    g = scale[:, None] * np.stack([2.0 * p * q, 1.0 + p * p - q * q, 2.0 * q], axis=1)
    return f, g


def _tangents(line: Array) -> tuple[Array, Array]:
    """Two unit vectors (k, 3) across lines (k, 3) and each other."""
    along = line / np.linalg.norm(line, axis=1)[:, None]
    pole = np.where(np.abs(along[:, 2:3]) < 0.9, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0])
    first = np.cross(pole, along)
    first /= np.linalg.norm(first, axis=1)[:, None]
    return first, np.cross(along, first)
