"""The posterior of a tracklet as states: equally probable samples, their mean and covariance, and a test of normality."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.special import gammainc, ndtr

from ground.orbit.attributable import Attributable
from ground.orbit.dynamics import LIGHT_KM_S, MU_KM3_S2, advance
from ground.orbit.posterior import Posterior
from ground.orbit.scan import Problem, curve, target_state
from sboc_e2e.icd.products import OrbitState

Array = NDArray[np.float64]

N_DRAWN: Final = 2048
"""Samples from which mean, covariance and shape are taken."""
N_PUBLISHED: Final = 256
"""Every eighth of the drawn ones, to keep messages small: they give the mean to 6 % of sigma, sigma to 4 %."""
_SEED: Final = 20270129  # any number: fixed, so that the same tracklet always has the same samples
_LARGEST_DEVIATION: Final = 0.12
"""Largest difference of a distribution function from the normal one. The content of an interval then errs by at most this
much."""
_LARGEST_TAIL: Final = 0.015
"""Share beyond the surface that leaves out 0.1 % of a normal distribution (chi-square of six, 22.46)."""
_TAIL_CHI2: Final = 22.458  # chi-square of six degrees of freedom that 0.1 % exceed


@dataclass(frozen=True, kw_only=True, eq=False)
class Shape:
    """How far samples are from a normal distribution with their mean and covariance.

    deviation : largest difference of distribution functions, over the six coordinates, the six principal axes and the
    distance from the mean.
    tail : share beyond the surface that should leave out 0.1 %.
    """

    deviation: float
    tail: float

    @property
    def gaussian(self) -> bool:
        """Whether mean and covariance describe the samples."""
        return self.deviation < _LARGEST_DEVIATION and self.tail < _LARGEST_TAIL

    def words(self) -> str:
        """The figures of the test and their limits, in words."""
        return (
            f"largest deviation of a distribution function from the normal one {self.deviation:.3f} (Gaussian below "
            f"{_LARGEST_DEVIATION:g}), share beyond the 99.9 % surface {100 * self.tail:.2f} % (below {100 * _LARGEST_TAIL:g} %)"
        )


def shape_of(samples: Array) -> Shape:
    """Shape of equally weighted samples (n, k) with a covariance of full rank."""
    n, k = samples.shape
    offset = samples - samples.mean(axis=0)
    scale = offset.std(axis=0)
    value, axes = np.linalg.eigh(np.cov((offset / scale).T, bias=True))
    whitened = (offset / scale) @ axes / np.sqrt(np.maximum(value, 1e-14))
    middle = ((np.arange(n) + 0.5) / n)[:, None]
    each = np.abs(ndtr(np.sort(np.hstack([whitened, offset / scale]), axis=0)) - middle).max()
    square = np.sort((whitened**2).sum(axis=1))
    radial = np.abs(gammainc(0.5 * k, 0.5 * square) - middle[:, 0]).max()
    return Shape(deviation=float(max(each, radial)), tail=float((square > _TAIL_CHI2).mean()))


def state_of(posterior: Posterior, data: Attributable, problem: Problem, observer_covariance: Array) -> OrbitState:
    """States at the attributable's reference epoch: direction, rate, range and range rate, and where the camera was.

    observer_covariance : (6, 6) km, km/s at that epoch. The samples come from the weighted orbits by systematic resampling in
    order of their range (Kitagawa 1996, J. Comput. Graph. Stat. 5, 1), so that every orbit with the weight of a sample is
    included.
    """
    rng = np.random.default_rng(_SEED)
    order = np.lexsort((posterior.range_rate_km_s, posterior.range_km))
    cumulative = np.cumsum(posterior.weight[order])
    at = (np.arange(N_DRAWN) + rng.random()) / N_DRAWN * cumulative[-1]
    chosen = order[np.minimum(np.searchsorted(cumulative, at), len(order) - 1)]
    range_rate = posterior.range_rate_km_s[chosen] + (rng.random(N_DRAWN) - 0.5) * posterior.rate_width_km_s[chosen]
    conditional = data.covariance[:2, 2:] @ np.linalg.inv(data.covariance[2:, 2:])
    left = data.covariance[:2, :2] - conditional @ data.covariance[2:, :2]
    value, axes = np.linalg.eigh(0.5 * (left + left.T))
    place_noise = (rng.standard_normal((N_DRAWN, 2)) * np.sqrt(np.maximum(value, 0.0))) @ axes.T
    value, axes = np.linalg.eigh(observer_covariance)
    camera_noise = (rng.standard_normal((N_DRAWN, 6)) * np.sqrt(np.maximum(value, 0.0))) @ axes.T
    states = (
        _states(
            problem,
            data.place_offset,
            np.ascontiguousarray(data.place_matrix),
            np.ascontiguousarray(conditional),
            posterior.range_km[chosen],
            range_rate,
            np.ascontiguousarray(posterior.rate_shift_rad_s[chosen]),
            place_noise,
        )
        + camera_noise
    )
    shape = shape_of(states)
    published = states[rng.integers(N_DRAWN // N_PUBLISHED) :: N_DRAWN // N_PUBLISHED]
    return OrbitState(
        t_tai_ns=data.t_ref_tai_ns,
        mean=states.mean(axis=0),
        covariance=np.cov(states.T),
        gaussian=shape.gaussian,
        shape=shape.words(),
        sample_weight=np.full(N_PUBLISHED, 1.0 / N_PUBLISHED),
        sample_state=published,
    )


@njit(cache=True)
def _states(
    problem: Problem,
    place_offset: Array,
    place_matrix: Array,
    conditional: Array,
    range_km: Array,
    range_rate_km_s: Array,
    rate_shift: Array,
    place_noise: Array,
) -> Array:
    """States (n, 6) at the reference epoch of weighted orbits (n,); place_noise (n, 2) : of the direction at a given rate."""
    n, k2 = len(range_km), len(problem.form.linear)
    out = np.empty((n, 6))
    work, path = np.empty(6), np.empty(k2)
    line = np.empty(3)
    for s in range(n):
        curve(problem, range_km[s], range_rate_km_s[s], work, path)
        drawn = np.empty(2)
        for c in range(2):
            expected = problem.form.rate_offset[c]
            for j in range(k2):
                expected -= problem.form.rate_matrix[c, j] * path[j]
            drawn[c] = rate_shift[s, c] - expected
        place = np.empty(2)
        for c in range(2):
            place[c] = place_offset[c] + place_noise[s, c] + conditional[c, 0] * drawn[0] + conditional[c, 1] * drawn[1]
            for j in range(k2):
                place[c] -= place_matrix[c, j] * path[j]
        target_state(problem, range_km[s], range_rate_km_s[s], rate_shift[s, 0], rate_shift[s, 1], work)
        length = 0.0
        for c in range(3):
            line[c] = problem.axes[2, c] + place[0] * problem.axes[0, c] + place[1] * problem.axes[1, c]
            length += line[c] * line[c]
        for c in range(3):
            turned = line[c] / np.sqrt(length) - problem.axes[2, c]
            work[c] += range_km[s] * turned
            work[3 + c] += range_rate_km_s[s] * turned
        # from the epoch at which the light left to that at which it came
        advance(work, range_km[s] / LIGHT_KM_S)
        out[s] = work
    return out


def latitude_argument_of(state: Array) -> Array:
    """Angle (n,) rad from the ascending node to the object, which needs no perigee, of states (n, 6)."""
    r = state[:, :3]
    momentum = np.cross(r, state[:, 3:])
    momentum /= np.linalg.norm(momentum, axis=1, keepdims=True)
    node = np.arctan2(momentum[:, 0], -momentum[:, 1])
    node_line = np.column_stack([np.cos(node), np.sin(node), np.zeros(len(node))])
    return np.asarray(np.arctan2((r * np.cross(momentum, node_line)).sum(axis=1), (r * node_line).sum(axis=1)))


def elements_of(state: Array) -> Array:
    """Osculating elements (n, 6) of states (n, 6): a (km), e, i, node, argument of perigee, mean anomaly (rad; last three >= 0).

    Of a circular or an equatorial orbit, angles that do not exist are measured from the node and from the x axis.
    """
    r, v = state[:, :3], state[:, 3:]
    distance = np.linalg.norm(r, axis=1)
    momentum = np.cross(r, v)
    h = np.linalg.norm(momentum, axis=1)
    a = 1.0 / (2.0 / distance - (v**2).sum(axis=1) / MU_KM3_S2)
    towards = np.cross(v, momentum) / MU_KM3_S2 - r / distance[:, None]
    e = np.linalg.norm(towards, axis=1)
    inclination = np.arccos(np.clip(momentum[:, 2] / h, -1.0, 1.0))
    node = np.arctan2(momentum[:, 0], -momentum[:, 1])
    node_line = np.column_stack([np.cos(node), np.sin(node), np.zeros(len(node))])
    across = np.cross(momentum / h[:, None], node_line)
    perigee = np.arctan2((towards * across).sum(axis=1), (towards * node_line).sum(axis=1))
    true = latitude_argument_of(state) - perigee
    with np.errstate(invalid="ignore"):
        eccentric = np.arctan2(np.sqrt(1.0 - e**2) * np.sin(true), e + np.cos(true))
        mean = eccentric - e * np.sin(eccentric)
    full = 2.0 * np.pi
    return np.column_stack([a, e, inclination, node % full, perigee % full, mean % full])


def angle_quantiles_deg(angle_rad: Array) -> Array:
    """5 %, 50 % and 95 % points (3,) of equally weighted angles about their mean direction; the median in [0, 360)."""
    middle = np.angle(np.exp(1j * angle_rad).mean())
    away = (angle_rad - middle + np.pi) % (2.0 * np.pi) - np.pi
    points = np.degrees(middle + np.percentile(away, [5.0, 50.0, 95.0]))
    return np.asarray(points - 360.0 * np.floor(points[1] / 360.0))
