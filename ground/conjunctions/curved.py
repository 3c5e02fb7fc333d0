"""Probability of one encounter without straight lines: orbits that bend, velocities in doubt, normal in equinoctial elements.

The twelve elements are whitened numbers z. Two directions of z move the miss, ten do not in first order. For each draw of the
ten, the two are solved for a hit; the density about it, over the disc of the hard body, is what that draw adds (conditional
Monte Carlo about the most probable hit: Hasofer & Lind 1974, J. Eng. Mech. 100, 111). Where the two-dimensional probability
holds both agree; their ratio is the test of its assumptions.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri
from scipy.stats import qmc

from ground.conjunctions.encounter import Encounter, StateEstimate, encounter_of, regular
from ground.conjunctions.equinoctial import equinoctial_of, partials, state_at
from ground.conjunctions.probability import over_circle
from sboc_e2e.icd.errors import UserError

Array = NDArray[np.float64]

_SEED: Final = 4021  # any number: fixed, so that the same message always has the same probability
_BATCHES: Final = 8  # independent sets of draws, whose scatter gives the error (of the error itself a quarter)
_DRAWS: Final = 256
"""Of each batch; a power of two, which Sobol's points want."""
_STEPS_TO_HIT: Final = 40  # a budget of Newton's steps; draws that do not hit are counted in `lost`
_STEP_OF_Z: Final = 1e-3  # of one sigma, central: the error goes with its square (1e-6 of the curvature), rounding is far below
_LARGEST_STEP: Final = 3.0  # sigmas in one step: beyond, the orbits bend too much for Newton's step
_RADII: Final = 24
"""Nodes of the disc. With `_ANGLES` good to 1e-11 for sigma of 0.1 hard-body radii and more, 3e-4 at 0.05, 20 % at 0.02."""
_ANGLES: Final = 72  # see `_RADII`. Half of both numbers: 2e-14 for sigma of 0.3 hard-body radii, 5e-4 at 0.1
_FINEST_SIGMA: Final = 0.1
"""Of the hard-body radius: draws with smaller errors in the plane are integrated adaptively (see `_RADII`)."""
_SLOW: Final = 3.0
"""Sigmas along the motion that the drift must exceed: three of CARA's 53 messages are slow by it (docs/objects.md)."""
_NEAR_ENOUGH: Final = 1e-3
"""Of the hard-body radius: how near to a hit a solution must come."""


@dataclass(frozen=True, kw_only=True)
class CurvedProbability:
    """Probability of one encounter and its scatter (one sigma) over independent batches of draws.

    distance_sigma : of the most probable hit from the mean, in the space of both orbits. lost : share of draws without a hit.
    slow : miss and position errors are not small compared with the drift of the objects in a radian of their orbits, so that
    there may be several encounters, or one that lasts. reliable : one encounter, most draws have a hit, their sum is settled to 5
    %.
    """

    probability: float
    scatter: float
    distance_sigma: float
    lost: float
    slow: bool

    @property
    def reliable(self) -> bool:
        """Whether the figure may be published without plain Monte Carlo."""
        return not self.slow and self.lost < 0.02 and self.probability > 0.0 and self.scatter < 0.05 * self.probability


@dataclass(frozen=True, kw_only=True, eq=False)
class Cloud:
    """Orbits of one object: elements (6,) at the epoch, and the matrix (6, 6) that makes whitened numbers elements."""

    elements: Array
    root: Array

    def drawn(self, z: Array) -> Array:
        """Elements (n, 6) of whitened numbers (n, 6)."""
        return np.asarray(self.elements + z @ self.root.T)


def cloud_of(estimate: StateEstimate) -> Cloud:
    """The orbit of an estimate with its covariance in equinoctial elements. UserError for an orbit that is not bound."""
    elements = equinoctial_of(estimate.state[None])[0]
    if not (np.isfinite(elements).all() and elements[0] > 0.0):
        raise UserError(f"{estimate.name}: the orbit is not bound; orbits about the Earth are expected")
    inverse = np.linalg.inv(partials(elements))
    covariance = inverse @ estimate.covariance @ inverse.T
    scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    value, vector = np.linalg.eigh(covariance / np.outer(scale, scale))
    return Cloud(elements=elements, root=scale[:, None] * vector * np.sqrt(np.maximum(value, 0.0)))


def curved(first: StateEstimate, second: StateEstimate, hard_body_km: float) -> CurvedProbability:
    """The probability of the encounter near the epoch of two states, on two-body orbits."""
    first, second = regular(first, second)
    encounter = encounter_of(first, second, hard_body_km)
    clouds = (cloud_of(first), cloud_of(second))
    slow = is_slow(first, second, encounter)
    centre, found = _most_probable_hit(clouds, encounter)
    if not found:
        return CurvedProbability(probability=0.0, scatter=0.0, distance_sigma=float("nan"), lost=1.0, slow=slow)
    slope = _slope(clouds, encounter, centre[None])[0]
    basis, _, _ = np.linalg.svd(slope.T, full_matrices=True)
    across, free = basis[:, :2], basis[:, 2:]
    start = across.T @ centre
    sums, lost = [], 0
    for batch in range(_BATCHES):
        uniform = qmc.Sobol(10, seed=_SEED + batch).random(_DRAWS)
        eta = ndtri(np.clip(uniform, 1e-12, 1.0 - 1e-12))
        rest = eta @ free.T
        xi = np.tile(start, (_DRAWS, 1))
        for _ in range(_STEPS_TO_HIT):
            z = rest + xi @ across.T
            miss = _miss(clouds, encounter, z)
            good = np.linalg.norm(miss, axis=1) < _NEAR_ENOUGH * encounter.hard_body_km
            if good.all():
                break
            xi = np.where(good[:, None], xi, xi - _limited(_solved(_slope(clouds, encounter, z) @ across, miss)))
        lost += int((~good).sum())
        each = _over_disc(_slope(clouds, encounter, z) @ across, xi, encounter.hard_body_km)
        sums.append(np.where(good, each, 0.0).mean())
    return CurvedProbability(
        probability=float(np.mean(sums)),
        scatter=float(np.std(sums, ddof=1) / np.sqrt(_BATCHES)),
        distance_sigma=float(np.linalg.norm(centre)),
        lost=lost / (_BATCHES * _DRAWS),
        slow=slow,
    )


def is_slow(first: StateEstimate, second: StateEstimate, encounter: Encounter) -> bool:
    """Whether the objects stay near each other for a good part of a revolution."""
    drift = encounter.speed_km_s / max(float(equinoctial_of(e.state[None])[0, 0]) for e in (first, second))
    along = float(encounter.axes[2] @ (first.covariance + second.covariance)[:3, :3] @ encounter.axes[2]) ** 0.5
    miss = float(np.linalg.norm(encounter.miss_km))
    return drift < 2.0 * miss + _SLOW * along


def _over_disc(slope: Array, xi: Array, radius: float) -> Array:
    """Integral (n,) of the standard normal density over what slopes (n, 2, 2) map on a disc, about points xi (n, 2)."""
    node, weight = np.polynomial.legendre.leggauss(_RADII)
    r = 0.5 * radius * (node + 1.0)
    angle = 2.0 * np.pi * (np.arange(_ANGLES) + 0.5) / _ANGLES
    place = (r[:, None, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)).reshape(-1, 2)
    share = np.repeat(0.5 * radius * weight * r * 2.0 * np.pi / _ANGLES, _ANGLES)
    det = np.abs(np.linalg.det(slope))
    inverse = np.linalg.inv(np.where((det > 0.0)[:, None, None], slope, np.eye(2)))
    there = xi[:, None, :] + np.einsum("nij,kj->nki", inverse, place)
    density = np.exp(-0.5 * (there**2).sum(axis=2)) / (2.0 * np.pi)
    out = np.where(det > 0.0, density @ share / np.where(det > 0.0, det, 1.0), 0.0)
    # about xi the disc is slope @ x near slope @ xi, with x standard normal: singular values are the errors in the plane
    u, sigma, _ = np.linalg.svd(slope)
    for k in np.flatnonzero((det > 0.0) & (sigma[:, 1] < _FINEST_SIGMA * radius)):
        out[k] = over_circle(np.abs(u[k].T @ slope[k] @ xi[k])[::-1], sigma[k, ::-1], radius)
    return np.asarray(out)


def _most_probable_hit(clouds: tuple[Cloud, Cloud], encounter: Encounter) -> tuple[Array, bool]:
    """The whitened numbers (12,) nearest to zero with a miss of zero, and whether they were found (Hasofer, Lind, Rackwitz)."""
    z = np.zeros(12)
    for _ in range(4 * _STEPS_TO_HIT):
        slope = _slope(clouds, encounter, z[None])[0]
        miss = _miss(clouds, encounter, z[None])[0]
        gram = slope @ slope.T
        if not np.isfinite(gram).all() or np.linalg.cond(gram) > 1e14:
            return z, False
        wanted = slope.T @ np.linalg.solve(gram, slope @ z - miss)
        step = wanted - z
        z = z + step * min(1.0, _LARGEST_STEP / max(float(np.linalg.norm(step)), 1e-12))
        if np.linalg.norm(step) < 1e-4 and np.linalg.norm(miss) < _NEAR_ENOUGH * encounter.hard_body_km:
            return z, True
    return z, False


def _limited(step: Array) -> Array:
    """Steps (n, 2) no longer than what a Newton step is good for."""
    length = np.linalg.norm(step, axis=1, keepdims=True)
    return np.asarray(step * np.minimum(1.0, _LARGEST_STEP / np.maximum(length, 1e-12)))


def _solved(matrix: Array, value: Array) -> Array:
    """Solutions (n, 2) of two equations each; zero where they do not determine one."""
    det = matrix[:, 0, 0] * matrix[:, 1, 1] - matrix[:, 0, 1] * matrix[:, 1, 0]
    safe = np.where(np.abs(det) > 0.0, det, np.inf)
    first = (matrix[:, 1, 1] * value[:, 0] - matrix[:, 0, 1] * value[:, 1]) / safe
    second = (matrix[:, 0, 0] * value[:, 1] - matrix[:, 1, 0] * value[:, 0]) / safe
    return np.stack([first, second], axis=1)


def _slope(clouds: tuple[Cloud, Cloud], encounter: Encounter, z: Array) -> Array:
    """d(miss)/dz (n, 2, 12) by central differences."""
    n = len(z)
    away = _STEP_OF_Z * np.vstack([np.eye(12), -np.eye(12)])
    miss = _miss(clouds, encounter, (z[:, None, :] + away).reshape(-1, 12)).reshape(n, 24, 2)
    return np.asarray(np.swapaxes((miss[:, :12] - miss[:, 12:]) / (2.0 * _STEP_OF_Z), 1, 2))


def _miss(clouds: tuple[Cloud, Cloud], encounter: Encounter, z: Array) -> Array:
    """Miss (n, 2) km at closest approach of orbits z (n, 12), in the plane across each one's own relative velocity."""
    elements = clouds[0].drawn(z[:, :6]), clouds[1].drawn(z[:, 6:])
    t = np.full(len(z), encounter.tca_s)
    for _ in range(4):
        relative = state_at(elements[1], t) - state_at(elements[0], t)
        speed2 = (relative[:, 3:] ** 2).sum(axis=1)
        step = -(relative[:, :3] * relative[:, 3:]).sum(axis=1) / np.maximum(speed2, 1e-18)
        t = t + np.clip(step, -600.0, 600.0)
        if np.abs(step).max() < 1e-7:
            break
    relative = state_at(elements[1], t) - state_at(elements[0], t)
    along = relative[:, 3:] / np.linalg.norm(relative[:, 3:], axis=1, keepdims=True)
    first = encounter.axes[0] - (along @ encounter.axes[0])[:, None] * along
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(along, first)
    return np.stack([(relative[:, :3] * first).sum(axis=1), (relative[:, :3] * second).sum(axis=1)], axis=1)
