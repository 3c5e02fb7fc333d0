"""Lambert's problem with several revolutions: the two-body orbits that join two places in a given time.

Izzo 2015 (Celestial Mechanics and Dynamical Astronomy 121, 1): time of flight as a function of his variable x in (-1, 1) for
ellipses (and beyond 1 for hyperbolas, which are not looked for here), roots by Halley's steps inside brackets.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ground.orbit.dynamics import MU_KM3_S2

Array = NDArray[np.float64]

_STEPS = 40  # 40 steps, mostly halvings, leave 4e-13 of x in 1,500 drawn problems to 8 turns, 20 steps 5e-5; 80 change nothing
_EDGE = 1e-9  # keeps x off -1 and 1, where the time of flight is infinite or the orbit a parabola


@njit(cache=True)
def _flight(x: float, lam: float, revolutions: int) -> float:
    """Dimensionless time of flight of an ellipse (Izzo, eq. 9: Lagrange's form)."""
    a = 1.0 / (1.0 - x * x)
    alpha = 2.0 * math.acos(x)
    y = min(max(lam * lam / a, 0.0), 1.0)
    beta = 2.0 * math.asin(math.sqrt(y))
    if lam < 0.0:
        beta = -beta
    return 0.5 * a * math.sqrt(a) * ((alpha - math.sin(alpha)) - (beta - math.sin(beta)) + 2.0 * math.pi * revolutions)


@njit(cache=True)
def _slope(x: float, t: float, lam: float) -> float:
    """dT/dx (Izzo, eq. 22)."""
    y = math.sqrt(1.0 - lam * lam * (1.0 - x * x))
    return (3.0 * t * x - 2.0 + 2.0 * lam**3 * x / y) / (1.0 - x * x)


@njit(cache=True)
def _root(low: float, high: float, target: float, lam: float, revolutions: int, rising: bool) -> float:
    """x between two at which the flight takes a time; Newton, halving where it leaves the bracket. NaN without one."""
    f_low, f_high = _flight(low, lam, revolutions) - target, _flight(high, lam, revolutions) - target
    if f_low * f_high > 0.0:
        return math.nan
    x = 0.5 * (low + high)
    for _ in range(_STEPS):
        t = _flight(x, lam, revolutions)
        f = t - target
        if (f > 0.0) == rising:
            high = x
        else:
            low = x
        step = f / _slope(x, t, lam)
        new = x - step
        if not low < new < high:
            new = 0.5 * (low + high)
        if abs(new - x) < 1e-13:
            return new
        x = new
    return x


@njit(cache=True)
def _quickest(lam: float, revolutions: int) -> float:
    """x of the shortest flight with a given number of revolutions (one or more): where the slope is zero."""
    low, high = -1.0 + _EDGE, 1.0 - _EDGE
    x = 0.0
    for _ in range(_STEPS):
        t = _flight(x, lam, revolutions)
        slope = _slope(x, t, lam)
        if slope > 0.0:
            high = x
        else:
            low = x
        # d2T/dx2 (Izzo, eq. 22)
        y = math.sqrt(1.0 - lam * lam * (1.0 - x * x))
        bend = (3.0 * t + 5.0 * x * slope + 2.0 * (1.0 - lam * lam) * (lam / y) ** 3) / (1.0 - x * x)
        new = x - slope / bend if bend > 0.0 else math.inf
        if not low < new < high:
            new = 0.5 * (low + high)
        if abs(new - x) < 1e-12:
            return new
        x = new
    return x


@njit(cache=True)
def dot(one: Array, other: Array) -> float:
    """Product of two vectors (3,), without an array of its own."""
    return one[0] * other[0] + one[1] * other[1] + one[2] * other[2]


@njit(cache=True)
def lambert(first: Array, second: Array, dt_s: float, revolutions: int, normal: Array, late: bool, out: Array) -> bool:
    """Velocities at both places (3,) km into `out` (6,) km/s; False where no ellipse takes that time.

    normal : (3,) on whose side the angular momentum lies. late : of the two orbits with one or more revolutions that with
    the larger x (the smaller eccentric way); without revolutions there is one, and `late` is not looked at.
    """
    r1, r2 = math.sqrt(dot(first, first)), math.sqrt(dot(second, second))
    u1, u2, h = np.empty(3), np.empty(3), np.empty(3)
    chord = 0.0
    for c in range(3):
        chord += (second[c] - first[c]) ** 2
        u1[c], u2[c] = first[c] / r1, second[c] / r2
    chord = math.sqrt(chord)
    half = 0.5 * (r1 + r2 + chord)
    h[0] = u1[1] * u2[2] - u1[2] * u2[1]
    h[1] = u1[2] * u2[0] - u1[0] * u2[2]
    h[2] = u1[0] * u2[1] - u1[1] * u2[0]
    size = math.sqrt(dot(h, h))
    if size < 1e-9:
        return False
    lam = math.sqrt(max(1.0 - chord / half, 0.0))
    if dot(h, normal) < 0.0:
        lam, size = -lam, -size
    for c in range(3):
        h[c] /= size
    target = math.sqrt(2.0 * MU_KM3_S2 / half**3) * dt_s
    low, high = -1.0 + _EDGE, 1.0 - _EDGE
    if revolutions == 0:
        x = _root(low, high, target, lam, 0, False)
    else:
        turn = _quickest(lam, revolutions)
        x = _root(turn, high, target, lam, revolutions, True) if late else _root(low, turn, target, lam, revolutions, False)
    if math.isnan(x):
        return False
    # velocities from x (Izzo, section 3.3)
    y = math.sqrt(1.0 - lam * lam * (1.0 - x * x))
    gamma = math.sqrt(0.5 * MU_KM3_S2 * half)
    rho = (r1 - r2) / chord
    sigma = math.sqrt(max(1.0 - rho * rho, 0.0))
    radial_1 = gamma * ((lam * y - x) - rho * (lam * y + x)) / r1
    radial_2 = -gamma * ((lam * y - x) + rho * (lam * y + x)) / r2
    around_1 = gamma * sigma * (y + lam * x) / r1
    around_2 = gamma * sigma * (y + lam * x) / r2
    for c in range(3):
        d, e = (c + 1) % 3, (c + 2) % 3
        out[c] = radial_1 * u1[c] + around_1 * (h[d] * u1[e] - h[e] * u1[d])
        out[3 + c] = radial_2 * u2[c] + around_2 * (h[d] * u2[e] - h[e] * u2[d])
    return True
