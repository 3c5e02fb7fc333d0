"""Which arcs may be of one object: boundary values between every two, held against what each arc says of its own motion.

Unknown are the two ranges. Lambert's problem gives the velocities at both ends for every number of revolutions that the arcs'
own periods allow; they, and the ranges, are compared with both arcs' Gaussians. What two bodies leave out (the oblateness, Sun
and Moon) is allowed for as a doubt of velocity that grows with time.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ground.association.arc import ArcOrbit
from ground.association.lambert import dot, lambert
from ground.orbit.dynamics import MU_KM3_S2
from sboc_e2e.icd import tai

Array = NDArray[np.float64]

_PLACES: Final = np.array([2, 3, 4, 5])
_STEPS: Final = 8
"""A budget of Gauss-Newton steps. Pairs of geostationary arcs of 30 s took up to 7 from the start that is nearest."""
_OFFSETS: Final = np.array([-1.5, -0.75, 0.0, 0.75, 1.5])
"""Sigmas from a weak arc's range where solutions are looked for."""
_PLANES_RAD: Final = 0.451
"""26 deg (cosine 0.9) between the planes of two sharp arcs: wide enough for what forces do in days. Chosen, not measured."""
_PLANE_SIGMAS: Final = 4.0  # as for periods
_LEAST_SINE: Final = 0.03
"""1.7 deg from half and whole turns: bounds the doubt there, which has no bound by the formula. Chosen, not measured."""
_NEAREST_KM: Final = 100.0  # of an object; no range below it is followed. Chosen, not measured
_PERIOD_SIGMAS: Final = 4.0  # a right pair in 16,000 has a period beyond it; a Gaussian's tails


@dataclass(frozen=True, kw_only=True, eq=False)
class Pairs:
    """Pairs (n,) of arcs, the first earlier, with the least chi2 (six degrees of freedom) and the state (n, 6) at the first."""

    first: NDArray[np.int64]
    second: NDArray[np.int64]
    chi2: Array
    state: Array


def pairs_of(arcs: Sequence[ArcOrbit], *, longest_days: float, chi2_limit: float, doubt_km_s: float) -> Pairs:
    """All pairs that one two-body orbit may explain.

    doubt_km_s : one sigma of velocity that two-body motion is wrong by after a day, at the range of geostationary orbits.
    """
    epoch = np.array([a.t_tai_ns for a in arcs], dtype=np.int64)
    order = np.argsort(epoch, kind="stable")
    t_s: Array = np.asarray((epoch[order] - epoch[order[0]]) / tai.NS_PER_S)
    chosen = [arcs[k] for k in order]
    mean = np.array([a.mean for a in chosen])
    place = np.array([[a.observer_km, a.observer_km_s] for a in chosen])
    axes = np.array([a.axes for a in chosen])
    covariance = np.array([a.covariance[np.ix_(_PLACES, _PLACES)] for a in chosen])
    states = np.array([a.state for a in chosen])
    rate, rate_sigma = _mean_motions(chosen, states)
    normal = np.cross(states[:, :3], states[:, 3:])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    first, second, chi2, state = _search(
        t_s, mean, place, axes, covariance, rate, rate_sigma, normal, _tilts(chosen, states),
        np.array([a.is_weak for a in chosen]), 86400.0 * longest_days, chi2_limit, doubt_km_s,
    )  # fmt: skip
    return Pairs(first=order[first], second=order[second], chi2=chi2, state=state)


def _mean_motions(arcs: Sequence[ArcOrbit], states: Array) -> tuple[Array, Array]:
    """Mean motions (n,) rad/s of arcs and one sigma."""
    r = np.linalg.norm(states[:, :3], axis=1)
    inverse_a = 2.0 / r - np.einsum("ij,ij->i", states[:, 3:], states[:, 3:]) / MU_KM3_S2
    inverse_a = np.maximum(inverse_a, 1e-6)
    rate = np.sqrt(MU_KM3_S2 * inverse_a**3)
    slope = np.concatenate([-2.0 * states[:, :3] / r[:, None] ** 3, -2.0 / MU_KM3_S2 * states[:, 3:]], axis=1)
    slope *= (1.5 * rate / inverse_a)[:, None]
    # partials of the state with respect to the six coordinates, by columns
    turn = np.array([_state_partials(a) for a in arcs])
    along = np.einsum("ni,nij->nj", slope, turn)
    variance = np.einsum("ni,nij,nj->n", along, np.array([a.covariance for a in arcs]), along)
    return rate, np.sqrt(variance)


def _tilts(arcs: Sequence[ArcOrbit], states: Array) -> Array:
    """One sigma (n,) rad of the direction of each arc's plane, from that of its velocity."""
    turn = np.array([_state_partials(a)[3:] for a in arcs])
    variance = np.einsum("nij,njk,nik->n", turn, np.array([a.covariance for a in arcs]), turn)
    return np.asarray(np.sqrt(variance) / np.linalg.norm(states[:, 3:], axis=1))


def _state_partials(arc: ArcOrbit) -> Array:
    """(6, 6) of the state with respect to an arc's coordinates at its mean."""
    q, axes = arc.mean, arc.axes
    out = np.zeros((6, 6))
    out[:3, 0], out[:3, 1], out[:3, 4] = q[4] * axes[0], q[4] * axes[1], axes[2]
    out[3:, 2], out[3:, 3] = q[4] * axes[0], q[4] * axes[1]
    out[3:, 4] = q[2] * axes[0] + q[3] * axes[1]
    out[3:, 5] = axes[2]
    return out


@njit(cache=True)
def _left(
    rho_1: float, rho_2: float, ends: Array, mean: Array, normal: Array, dt_s: float, revolutions: int, late: bool,
    speed: Array, places: Array, out: Array,
) -> bool:  # fmt: skip
    """What two ranges leave of both arcs' numbers: (8,) tangential velocities over range, range, velocity along the line.

    speed (6,), places (2, 3) : work space; velocities at both ends are left in speed.
    """
    one, two = places[0], places[1]
    for c in range(3):
        one[c], two[c] = ends[0, 0, c] + rho_1 * ends[0, 3, c], ends[1, 0, c] + rho_2 * ends[1, 3, c]
    if not lambert(one, two, dt_s, revolutions, normal, late, speed):
        return False
    for end in range(2):
        rho, v = rho_1 if end == 0 else rho_2, places[end]
        for c in range(3):
            v[c] = speed[3 * end + c] - ends[end, 4, c]
        out[4 * end] = dot(v, ends[end, 1]) / rho - mean[end, 2]
        out[4 * end + 1] = dot(v, ends[end, 2]) / rho - mean[end, 3]
        out[4 * end + 2] = rho - mean[end, 4]
        out[4 * end + 3] = dot(v, ends[end, 3]) - mean[end, 5]
    return True


@njit(cache=True)
def _whitened(white: Array, values: Array, out: Array) -> None:
    """Both arcs' numbers (8,), each by its own matrix (2, 4, 4); into out."""
    for end in range(2):
        for row in range(4):
            total = 0.0
            for col in range(row + 1):  # the inverse of a lower triangle is one
                total += white[end, row, col] * values[4 * end + col]
            out[4 * end + row] = total


@njit(cache=True)
def _sine(ends: Array, mean: Array) -> float:
    """Sine of the angle between both places, at the arcs' own ranges."""
    one, two = ends[0, 0] + mean[0, 4] * ends[0, 3], ends[1, 0] + mean[1, 4] * ends[1, 3]
    cosine = (one * two).sum() / math.sqrt((one * one).sum() * (two * two).sum())
    return math.sqrt(max(1.0 - cosine * cosine, 0.0))


@njit(cache=True)
def _whitener(covariance: Array, rho: float, doubt: float) -> Array:
    """(4, 4) that makes an arc's numbers white, with a doubt (km/s) of velocity added."""
    total = covariance.copy()
    total[0, 0] += (doubt / rho) ** 2
    total[1, 1] += (doubt / rho) ** 2
    total[3, 3] += doubt**2
    scale = np.sqrt(np.diag(total))
    for a in range(4):
        for b in range(4):
            total[a, b] /= scale[a] * scale[b]
    out = np.linalg.inv(np.linalg.cholesky(total))
    for a in range(4):
        for b in range(4):
            out[a, b] /= scale[b]
    return out


@njit(cache=True)
def _joined(
    ends: Array, mean: Array, white: Array, normal: Array, dt_s: float, revolutions: int, late: bool, limit: float, start: Array,
    state: Array,
) -> float:  # fmt: skip
    """Least chi2 over both ranges from a start (2,), and the state at the first; infinite where no orbit is found."""
    rho = start.copy()
    here, moved, speed, places = np.empty(8), np.empty(8), np.empty(6), np.empty((2, 3))
    z, changed, slope = np.empty(8), np.empty(2), np.empty((2, 8))
    best = np.inf
    for step in range(_STEPS):
        if not _left(rho[0], rho[1], ends, mean, normal, dt_s, revolutions, late, speed, places, here):
            return best
        _whitened(white, here, z)
        chi2 = 0.0
        for k in range(8):
            chi2 += z[k] * z[k]
        if chi2 < best:
            best = chi2
            for c in range(3):
                state[c], state[3 + c] = ends[0, 0, c] + rho[0] * ends[0, 3, c], speed[c]
        # a pair that is wrong by so much after a step does not become right
        if step == _STEPS - 1 or (step >= 2 and best > 1e3 * limit):
            break
        for k in range(2):
            changed[0], changed[1] = rho[0], rho[1]
            changed[k] += 1.0  # km
            if not _left(changed[0], changed[1], ends, mean, normal, dt_s, revolutions, late, speed, places, moved):
                return best
            for n in range(8):
                moved[n] -= here[n]
            _whitened(white, moved, slope[k])
        aa = ab = bb = az = bz = 0.0
        for n in range(8):
            a, b = slope[0, n], slope[1, n]
            aa, ab, bb, az, bz = aa + a * a, ab + a * b, bb + b * b, az + a * z[n], bz + b * z[n]
        determinant = aa * bb - ab * ab
        if not determinant > 0.0:
            return best
        rho[0] -= (bb * az - ab * bz) / determinant
        rho[1] -= (aa * bz - ab * az) / determinant
        if rho[0] < _NEAREST_KM or rho[1] < _NEAREST_KM:
            return best
    return best


@njit(cache=True)
def _search(
    t_s: Array, mean: Array, place: Array, axes: Array, covariance: Array, rate: Array, rate_sigma: Array, normal: Array,
    tilt: Array, weak: NDArray[np.bool_], longest_s: float, limit: float, doubt: float,
) -> tuple[NDArray[np.int64], NDArray[np.int64], Array, Array]:  # fmt: skip
    """Pairs of arcs in order of time, by index, with chi2 and state."""
    first, second, cost, found = [np.int64(0)], [np.int64(0)], [0.0], [np.zeros(6)]
    ends, both = np.empty((2, 5, 3)), np.empty((2, 6))
    white = np.empty((2, 4, 4))
    state, kept, start = np.empty(6), np.empty(6), np.empty(2)
    offsets = np.where(weak[:, None], np.sqrt(covariance[:, 2, 2])[:, None] * _OFFSETS, 0.0)
    several = np.where(weak, len(_OFFSETS), 1)
    for i in range(len(t_s)):
        for j in range(i + 1, len(t_s)):
            dt = t_s[j] - t_s[i]
            if dt > longest_s:
                break
            # periods that both arcs allow
            low = max(rate[i] - _PERIOD_SIGMAS * rate_sigma[i], rate[j] - _PERIOD_SIGMAS * rate_sigma[j])
            high = min(rate[i] + _PERIOD_SIGMAS * rate_sigma[i], rate[j] + _PERIOD_SIGMAS * rate_sigma[j])
            # arcs at once are no pair of an orbit's ends: the batch judges them
            if high <= low or high * dt < 0.02:
                continue
            between = math.acos(min(max(dot(normal[i], normal[j]), -1.0), 1.0))
            if between > _PLANES_RAD + _PLANE_SIGMAS * (tilt[i] + tilt[j]):
                continue
            ends[0, 0], ends[1, 0] = place[i, 0], place[j, 0]
            ends[0, 1:4], ends[1, 1:4] = axes[i], axes[j]
            ends[0, 4], ends[1, 4] = place[i, 1], place[j, 1]
            both[0], both[1] = mean[i], mean[j]
            # near half and whole turns the plane hangs on what two bodies leave out
            wrong = doubt * max(dt / 86400.0, 0.1) / max(_sine(ends, both), _LEAST_SINE)
            for end in range(2):
                n = i if end == 0 else j
                # two-body motion is wronger nearer to the Earth: the oblateness goes with the fourth power, the speed with n
                near = (rate[n] / 7.292e-5) ** (5.0 / 3.0)
                white[end] = _whitener(covariance[n], mean[n, 4], wrong * max(near, 1.0))
            axis = normal[i] + normal[j]
            best = np.inf
            least = max(int(low * dt / (2.0 * np.pi)) - 1, 0)
            most = int(high * dt / (2.0 * np.pi)) + 1
            for revolutions in range(least, most + 1):
                for late in range(2):
                    if revolutions == 0 and late == 1:
                        continue
                    for at in range(several[i] * several[j]):
                        start[0] = mean[i, 4] + offsets[i, at // several[j]]
                        start[1] = mean[j, 4] + offsets[j, at % several[j]]
                        if start.min() < _NEAREST_KM:
                            continue
                        chi2 = _joined(ends, both, white, axis, dt, revolutions, late == 1, limit, start, state)
                        if chi2 < best:
                            best = chi2
                            kept[:] = state
            if best < limit:
                first.append(np.int64(i))
                second.append(np.int64(j))
                cost.append(best)
                found.append(kept.copy())
    out = np.empty((len(found) - 1, 6))
    for k in range(1, len(found)):
        out[k - 1] = found[k]
    return np.array(first[1:]), np.array(second[1:]), np.array(cost[1:]), out
