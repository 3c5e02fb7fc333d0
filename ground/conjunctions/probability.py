"""Probability that a normal distribution in the encounter plane puts the second object inside the hard-body circle.

Short encounters only: straight lines, constant covariances, velocities known (ground/conjunctions/curved.py tests that).
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import quad
from scipy.optimize import minimize_scalar
from scipy.special import erf, erfc
from scipy.stats import ncx2

from ground.conjunctions.encounter import Encounter

Array = NDArray[np.float64]

_RADII: Final = 96  # 96 x 720 and half as many each way differ by 2e-14 for sigma of 0.05 hard-body radii and more: a reference
_ANGLES: Final = 720  # of the polar grid; measured together with `_RADII`
_FINEST_SIGMA: Final = 0.05
"""Of the hard-body radius: smaller errors fall between the nodes of the polar grid (see `_RADII`)."""

CHAN_ERROR: Final = 0.01
"""Largest relative error at which Chan's form stands, by the bound of `equal_area_error`."""


@dataclass(frozen=True, kw_only=True)
class Dilution:
    """The largest probability that any scaling of the covariance gives, and whether better tracking would raise the probability.

    scale : factor of all standard deviations that gives `probability`. diluted : scale below 1, the covariance is larger than
    the worst one. A small probability then means poor knowledge, not safety (Alfano 2005, J. Astronaut. Sci. 53, 103).
    """

    probability: float
    scale: float
    diluted: bool


def principal(encounter: Encounter) -> tuple[Array, Array]:
    """Miss (2,) along the principal axes of the covariance, km, and standard deviations (2,) along them, rising."""
    value, vector = np.linalg.eigh(encounter.covariance_km2)
    return np.abs(vector.T @ encounter.miss_km), np.sqrt(value)


def alfano(encounter: Encounter) -> float:
    """The integral over the circle as one of error functions (Alfano 2005, J. Astronaut. Sci. 53, 103), to 1e-9 of itself."""
    miss, sigma = principal(encounter)
    return over_circle(miss, sigma, encounter.hard_body_km)


def over_circle(miss: Array, sigma: Array, radius: float) -> float:
    """Probability of a circle about the origin: exact along the short axis of the ellipse, adaptive along the long one.

    miss (2,), sigma (2,) : centre of the normal distribution and standard deviations along its principal axes, the shorter first,
    in the unit of the radius.
    """
    short, long = 0, 1

    def strip(angle: float) -> float:
        place, half = radius * np.sin(angle), radius * np.cos(angle)
        density = np.exp(-0.5 * ((place - miss[long]) / sigma[long]) ** 2) / (np.sqrt(2.0 * np.pi) * sigma[long])
        low, high = (-half - miss[short]) / sigma[short], (half - miss[short]) / sigma[short]
        return float(density * _normal_between(low, high) * half)

    # breaks where the strip's end passes the ellipse, and where the density peaks
    places = [miss[long] + k * sigma[long] for k in (-6.0, -2.0, 0.0, 2.0, 6.0)]
    if miss[short] < radius:
        edge = np.sqrt(radius**2 - miss[short] ** 2)
        places += [-edge, edge]
    breaks = sorted({float(np.arcsin(p / radius)) for p in places if abs(p) < radius})
    value, _ = quad(strip, -0.5 * np.pi, 0.5 * np.pi, points=breaks or None, epsabs=0.0, epsrel=1e-10, limit=400)
    return float(value)


def _normal_between(low: float, high: float) -> float:
    """Probability of a standard normal number between two bounds, without cancellation in the tails."""
    root = np.sqrt(0.5)
    if high < 0.0:
        return float(0.5 * (erfc(-high * root) - erfc(-low * root)))
    if low > 0.0:
        return float(0.5 * (erfc(low * root) - erfc(high * root)))
    return float(0.5 * (erf(high * root) - erf(low * root)))


def foster(encounter: Encounter) -> float:
    """The same integral in polar coordinates about the first object (Foster & Estes 1992, JSC-25898), on a fixed grid.

    NaN where an error is below `_FINEST_SIGMA` hard-body radii, which the grid does not resolve.
    """
    radius = encounter.hard_body_km
    if principal(encounter)[1][0] < _FINEST_SIGMA * radius:
        return float("nan")
    node, weight = np.polynomial.legendre.leggauss(_RADII)
    r = 0.5 * radius * (node + 1.0)
    angle = 2.0 * np.pi * np.arange(_ANGLES) / _ANGLES
    offset = r[:, None, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1) - encounter.miss_km
    inverse = np.linalg.inv(encounter.covariance_km2)
    exponent = -0.5 * np.einsum("ijk,kl,ijl->ij", offset, inverse, offset)
    density = np.exp(exponent) * np.sqrt(np.linalg.det(inverse)) / (2.0 * np.pi)
    return float((0.5 * radius * weight * r) @ density.sum(axis=1) * 2.0 * np.pi / _ANGLES)


def chan(encounter: Encounter) -> float:
    """Chan's series, which makes the ellipse a circle of equal area (Chan 2008, Spacecraft Collision Probability, eq. 5.6).

    The series is the distribution function of a noncentral chi-square of two degrees of freedom. NaN where the equal area may
    change it by more than `CHAN_ERROR`, and where that function underflows.
    """
    miss, sigma = principal(encounter)
    if equal_area_error(encounter) > CHAN_ERROR:
        return float("nan")
    value = float(ncx2.cdf(encounter.hard_body_km**2 / np.prod(sigma), 2, float(((miss / sigma) ** 2).sum())))
    return value if value > 0.0 else float("nan")


def equal_area_error(encounter: Encounter) -> float:
    """Bound of the relative error by which Chan's equal area changes the probability; 0 where the errors are round.

    The mean of a density p over a circle of radius R is p + R^2 / 8 times its Laplacian, plus higher orders. The ellipse that
    Chan takes instead has semi-axes R sqrt(s / l) and R sqrt(l / s), where the deviations are s and l and the miss (x, y):

        difference = R^2 / 8 (1/s - 1/l) (x^2/s^3 - y^2/l^3 - (1/s - 1/l))

    All terms are added with the same sign, so that none hides another: of 7,900 random encounters with a bound of 3 % or less
    no error exceeds its bound (tests/conjunctions/test_probability.py has 2,000).
    """
    miss, sigma = principal(encounter)
    uneven = float(1.0 / sigma[0] - 1.0 / sigma[1])
    return float(encounter.hard_body_km**2 / 8.0 * uneven * (float((miss**2 / sigma**3).sum()) + uneven))


def dilution(encounter: Encounter) -> Dilution:
    """The worst scaling of the covariance, its shape and the miss kept."""
    miss, sigma = principal(encounter)
    radius = encounter.hard_body_km
    distance = float(np.linalg.norm(miss / sigma))
    if float(np.linalg.norm(miss)) <= radius:
        return Dilution(probability=1.0, scale=0.0, diluted=True)

    def minus_log(log_scale: float) -> float:
        value = over_circle(miss, sigma * np.exp(log_scale), radius)
        return -float(np.log(value)) if value > 0.0 else 1e6

    # of a small circle the worst scale makes the miss sqrt(2) sigma (Alfano 2005); a large one moves it by its own size
    start = np.log(max(distance / np.sqrt(2.0), 1e-6))
    found = minimize_scalar(minus_log, bounds=(start - 3.0, start + 3.0), method="bounded")
    scale = float(np.exp(found.x))
    return Dilution(probability=float(np.exp(-found.fun)), scale=scale, diluted=scale < 1.0)
