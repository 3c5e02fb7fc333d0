"""The scan: at each range the posterior of range rate and transverse velocity, as weighted orbits."""

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ground.orbit.attributable import CurveForm
from ground.orbit.dynamics import LIGHT_KM_S, MU_KM3_S2, advance, elements
from ground.orbit.prior import PriorTable, phase_space_density

N_COLUMNS = 9
"""Of a weighted orbit: natural log weight per ln(range), range (km), a (km), e, i (rad); range rate (km/s), the width that stands
for (km/s), and the correction of the transverse rate along e1 and e2 (rad/s)."""

_RIDGE_STEPS = 22  # range rates on each side of the ridge, growing from the smallest step by a constant ratio
_WINDOW_STEPS = 24  # even range rates over the window, 0.57 sigma apart: a trapezium sum over a Gaussian needs no finer ones
_WINDOW_SIGMA = 6.5  # half width of the window; a Gaussian has 8e-11 outside
_SMALLEST_STEP_KM_S = 5e-4  # of the range rate along the ridge, where the prior's orbits are sharp: 0.5 m/s. Chosen, not measured


class Problem(NamedTuple):
    """Everything the scan of one tracklet needs, in km, s and rad (see `Attributable`)."""

    observer: NDArray[np.float64]
    observer_at_node: NDArray[np.float64]
    axes: NDArray[np.float64]
    rate: NDArray[np.float64]
    form: CurveForm
    rate_factor: NDArray[np.float64]


@njit(cache=True)
def target_state(
    problem: Problem, range_km: float, range_rate_km_s: float, du: float, dv: float, out: NDArray[np.float64]
) -> None:
    """State (6,) of the target when it sent the light of the reference epoch; du, dv correct the nominal rate (rad/s)."""
    doppler = 1.0 - range_rate_km_s / LIGHT_KM_S
    for c in range(3):
        out[c] = problem.observer[c] + range_km * problem.axes[2, c]
        across = (problem.rate[0] + du) * problem.axes[0, c] + (problem.rate[1] + dv) * problem.axes[1, c]
        velocity = problem.observer[3 + c] + range_rate_km_s * problem.axes[2, c] + range_km * across
        # epochs of reception are stretched against those of emission
        out[3 + c] = velocity / doppler


@njit(cache=True)
def curve(
    problem: Problem, range_km: float, range_rate_km_s: float, state: NDArray[np.float64], out: NDArray[np.float64]
) -> None:
    """Plane coordinates (2k,) at the nodes of the orbit with the nominal rate."""
    k = len(problem.form.node_s)
    middle = 0
    for j in range(k):
        if abs(problem.form.node_s[j]) < abs(problem.form.node_s[middle]):
            middle = j
    for way in (1, -1):
        target_state(problem, range_km, range_rate_km_s, 0.0, 0.0, state)
        epoch = 0.0
        j = middle if way == 1 else middle - 1
        while 0 <= j < k:
            emitted = problem.form.node_s[j] * (1.0 - range_rate_km_s / LIGHT_KM_S)
            advance(state, emitted - epoch)
            epoch = emitted
            x, y, z = 0.0, 0.0, 0.0
            for c in range(3):
                d = state[c] - problem.observer_at_node[j, c]
                x += d * problem.axes[0, c]
                y += d * problem.axes[1, c]
                z += d * problem.axes[2, c]
            # an object that passes the camera within the arc would not be a streak: its direction diverges, so does chi-square
            z = max(z, 1e-6)
            out[j], out[k + j] = x / z, y / z
            j += way


@njit(cache=True)
def _dot(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    total = 0.0
    for i in range(len(a)):
        total += a[i] * b[i]
    return total


@njit(cache=True)
def _form(matrix: NDArray[np.float64], a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    total = 0.0
    for i in range(len(a)):
        row = 0.0
        for j in range(len(b)):
            row += matrix[i, j] * b[j]
        total += a[i] * row
    return total


@njit(cache=True)
def best_range_rate(
    problem: Problem, range_km: float, start_km_s: float, low_km_s: float, high_km_s: float, work: NDArray[np.float64]
) -> tuple[float, float]:
    """Range rate that the data prefer at a range, and its sigma (km/s), by Gauss-Newton inside [low, high]. work : (3, 2k)."""
    arc = max(problem.form.node_s[-1] - problem.form.node_s[0], 1e-3)
    state = np.empty(6)
    rate, sigma = min(max(start_km_s, low_km_s), high_km_s), math.inf
    for _ in range(6):
        step = min(0.01 * range_km / arc, 0.5)
        curve(problem, range_km, rate, state, work[0])
        curve(problem, range_km, rate + step, state, work[1])
        curve(problem, range_km, rate - step, state, work[2])
        for i in range(work.shape[1]):
            work[1, i] = (work[1, i] - work[2, i]) / (2.0 * step)
        curvature = _form(problem.form.quadratic, work[1], work[1])
        if not curvature > 1e-12:
            return rate, math.inf
        sigma = 1.0 / math.sqrt(curvature)
        slope = _dot(problem.form.linear, work[1]) - _form(problem.form.quadratic, work[0], work[1])
        better = min(max(rate + slope / curvature, low_km_s), high_km_s)
        done = abs(better - rate) < 0.02 * sigma
        rate = better
        if done:
            break
    return rate, sigma


@njit(cache=True)
def _parabola(coefficients: NDArray[np.float64], u: float) -> float:
    return float(coefficients[0] + u * (coefficients[1] + u * coefficients[2]))


@njit(cache=True)
def _eccentricity(
    problem: Problem, range_km: float, rate: float, du: NDArray[np.float64], state: NDArray[np.float64], span: NDArray[np.float64]
) -> float:
    """Eccentricity at a range rate; du : (2, 3) polynomial of the rate correction in the scaled range rate."""
    u = (rate - span[0]) / span[1]
    target_state(problem, range_km, rate, _parabola(du[0], u), _parabola(du[1], u), state)
    _, e, _ = elements(state[0], state[1], state[2], state[3], state[4], state[5])
    return e


@njit(cache=True)
def scan_range(
    problem: Problem,
    prior: PriorTable,
    range_km: float,
    start_km_s: float,
    normal: NDArray[np.float64],
    log_range_weight: float,
    out: NDArray[np.float64],
) -> tuple[int, float, float]:
    """Weighted orbits (n, N_COLUMNS) at one range into `out`; how many, log of their summed weight, preferred range rate.

    normal : (draws, 2) standard normal numbers for the transverse rate. log_range_weight : of the volume and size law.
    """
    r2 = v_along = speed2 = 0.0
    for c in range(3):
        position = problem.observer[c] + range_km * problem.axes[2, c]
        across = problem.rate[0] * problem.axes[0, c] + problem.rate[1] * problem.axes[1, c]
        velocity = problem.observer[3 + c] + range_km * across
        r2 += position * position
        v_along += velocity * problem.axes[2, c]
        speed2 += velocity * velocity
    room = v_along * v_along - speed2 + 2.0 * MU_KM3_S2 / math.sqrt(r2)
    if room <= 0.0:
        return 0, -math.inf, start_km_s
    low, high = -v_along - math.sqrt(room), -v_along + math.sqrt(room)
    k2 = len(problem.form.linear)
    work = np.empty((3, k2))
    centre, sigma = best_range_rate(problem, range_km, start_km_s, low, high, work)
    first, last = max(low, centre - _WINDOW_SIGMA * sigma), min(high, centre + _WINDOW_SIGMA * sigma)
    if last - first < 1e-7:
        first, last = max(low, centre - 1e-6), min(high, centre + 1e-6)
    span = np.array([0.5 * (first + last), 0.5 * (last - first)])
    state = np.empty(6)
    for j in range(3):
        curve(problem, range_km, span[0] + (j - 1) * span[1], state, work[j])
    # the curve as a parabola in u = (rate - span[0]) / span[1]
    for i in range(k2):
        minus, zero, plus = work[0, i], work[1, i], work[2, i]
        work[0, i], work[1, i], work[2, i] = zero, 0.5 * (plus - minus), 0.5 * (plus + minus) - zero
    quartic = np.zeros(5)
    quartic[0] = problem.form.constant
    shift = np.zeros((2, 3))
    for p in range(3):
        quartic[p] -= 2.0 * _dot(problem.form.linear, work[p])
        for q in range(3):
            quartic[p + q] += _form(problem.form.quadratic, work[p], work[q])
        for c in range(2):
            shift[c, p] = (problem.form.rate_offset[c] if p == 0 else 0.0) - _dot(problem.form.rate_matrix[c], work[p])
    # the nominal curve holds the nominal rate already: what the data want beyond it
    n_draws = len(normal)
    rates = np.empty(2 * _RIDGE_STEPS + _WINDOW_STEPS + 2)
    count = 0
    total = 0.0
    peak = -math.inf
    for draw in range(n_draws):
        du = shift.copy()
        for c in range(2):
            du[c, 0] += problem.rate_factor[c, 0] * normal[draw, 0] + problem.rate_factor[c, 1] * normal[draw, 1]
        best, best_e = span[0], math.inf
        for j in range(13):
            rate = first + (last - first) * j / 12.0
            e = _eccentricity(problem, range_km, rate, du, state, span)
            if e < best_e:
                best, best_e = rate, e
        left, right = max(first, best - (last - first) / 12.0), min(last, best + (last - first) / 12.0)
        for _ in range(18):
            inner_left, inner_right = left + 0.382 * (right - left), left + 0.618 * (right - left)
            if _eccentricity(problem, range_km, inner_left, du, state, span) < _eccentricity(
                problem, range_km, inner_right, du, state, span
            ):
                right = inner_right
            else:
                left = inner_left
        best = 0.5 * (left + right)
        n = 0
        for j in range(_WINDOW_STEPS):
            rates[n] = first + (last - first) * j / (_WINDOW_STEPS - 1.0)
            n += 1
        ratio = max((last - first) / _SMALLEST_STEP_KM_S, 2.0) ** (1.0 / (_RIDGE_STEPS - 1))
        step = _SMALLEST_STEP_KM_S
        for _ in range(_RIDGE_STEPS):
            if best + step < last:
                rates[n] = best + step
                n += 1
            if best - step > first:
                rates[n] = best - step
                n += 1
            step *= ratio
        grid = np.sort(rates[:n])
        for j in range(n):
            u = (grid[j] - span[0]) / span[1]
            chi2 = quartic[0] + u * (quartic[1] + u * (quartic[2] + u * (quartic[3] + u * quartic[4])))
            target_state(
                problem,
                range_km,
                grid[j],
                _parabola(du[0], u),
                _parabola(du[1], u),
                state,
            )
            a, e, inclination = elements(state[0], state[1], state[2], state[3], state[4], state[5])
            density = phase_space_density(prior, a, e, inclination)
            width = 0.5 * (grid[min(j + 1, n - 1)] - grid[max(j - 1, 0)])
            if density > 0.0 and width > 0.0:
                log_weight = math.log(density * width / n_draws) - 0.5 * chi2 + log_range_weight
                out[count, 0], out[count, 1] = log_weight, range_km
                out[count, 2], out[count, 3], out[count, 4] = a, e, inclination
                out[count, 5], out[count, 6] = grid[j], width
                out[count, 7], out[count, 8] = _parabola(du[0], u), _parabola(du[1], u)
                count += 1
                if log_weight > peak:
                    total = total * math.exp(peak - log_weight) + 1.0 if peak > -math.inf else 1.0
                    peak = log_weight
                else:
                    total += math.exp(log_weight - peak)
    return count, peak + math.log(total) if count > 0 else -math.inf, centre


def rows_per_range(n_draws: int) -> int:
    """How many rows `scan_range` may write."""
    return n_draws * (2 * _RIDGE_STEPS + _WINDOW_STEPS + 2)
