"""The motion of one object over the sky: a projective straight line with a small acceleration, and its evidence.

An object that moves uniformly relative to the camera at X(t) = X0 + V t, seen in the tangent plane of a fixed direction,
is at ``x(t) = (x0 + v t) / (1 + kappa t)``: a straight line whose speed changes because the range does (kappa = range rate
over range). Written as ``x0 + v t - kappa t x(t) = x(t)`` it is linear in (x0, v, kappa), and solved exactly by linear
least squares. Differential gravity adds a constant acceleration with a narrow prior.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ground.link.hypotheses import CROSSING, ENTERING, FULL, LEAVING, POINT, Nodes

N_PARAMETERS = 7
"""x0, y0 (rad), vx, vy (rad/s), kappa (1/s), ax, ay (rad/s^2) on the tangent plane at the track's mean direction."""

_LOG_2PI = math.log(2.0 * math.pi)
_LOG_SPEEDS = 12.0
"""Natural logarithm of the ratio of the fastest to the slowest speed a track may have: the prior is uniform in log speed."""
_SLOWEST_RAD_S = 1e-6  # 0.2 arcsec/s: keeps the logarithm of the speed finite for what stands still
_STUDENT_NU = 3.0
"""Degrees of freedom of an end's error: the smallest integer with a finite variance, for tails of change points."""
_ROBUST_PASSES = 4  # the first is Gaussian, three reweigh. A budget of work; chosen, not measured
_ROBUST_MEMBERS = 4
"""Tracks with fewer members have too few ends to identify a wrong one."""


@njit(cache=True)
def tangent_basis(centre: NDArray[np.float64], basis: NDArray[np.float64]) -> None:
    """Two unit vectors east and north of `centre` (3,) into basis (2, 3); towards +x and +y at the poles."""
    horizontal = math.hypot(centre[0], centre[1])
    if horizontal > 1e-9:
        basis[0, 0], basis[0, 1], basis[0, 2] = -centre[1] / horizontal, centre[0] / horizontal, 0.0
    else:
        basis[0, 0], basis[0, 1], basis[0, 2] = 1.0, 0.0, 0.0
    basis[1, 0] = centre[1] * basis[0, 2] - centre[2] * basis[0, 1]
    basis[1, 1] = centre[2] * basis[0, 0] - centre[0] * basis[0, 2]
    basis[1, 2] = centre[0] * basis[0, 1] - centre[1] * basis[0, 0]


@njit(cache=True)
def to_plane(unit: NDArray[np.float64], centre: NDArray[np.float64], basis: NDArray[np.float64]) -> tuple[float, float]:
    """Gnomonic coordinates (rad) of a direction."""
    depth = unit[0] * centre[0] + unit[1] * centre[1] + unit[2] * centre[2]
    x = unit[0] * basis[0, 0] + unit[1] * basis[0, 1] + unit[2] * basis[0, 2]
    y = unit[0] * basis[1, 0] + unit[1] * basis[1, 1] + unit[2] * basis[1, 2]
    return x / depth, y / depth


@njit(cache=True)
def position_on_plane(theta: NDArray[np.float64], t_s: float) -> tuple[float, float]:
    """Plane coordinates (rad) at an epoch relative to the track's reference epoch."""
    growth = 1.0 + theta[4] * t_s
    half_t2 = 0.5 * t_s * t_s
    return (theta[0] + theta[2] * t_s + theta[5] * half_t2) / growth, (theta[1] + theta[3] * t_s + theta[6] * half_t2) / growth


@njit(cache=True)
def velocity_on_plane(theta: NDArray[np.float64], t_s: float) -> tuple[float, float]:
    """Plane velocity (rad/s) at an epoch relative to the track's reference epoch."""
    growth = 1.0 + theta[4] * t_s
    x, y = position_on_plane(theta, t_s)
    return (theta[2] + theta[5] * t_s - theta[4] * x) / growth, (theta[3] + theta[6] * t_s - theta[4] * y) / growth


@njit(cache=True)
def kappa_sigma(speed_rad_s: float) -> float:
    """Width of the prior of range rate over range (1/s): radial speeds of some times the transverse one, and a tail for those
    that come head on."""
    return min(4.0 * speed_rad_s + 0.05, 2.0)


@njit(cache=True)
def _cholesky_solve(matrix: NDArray[np.float64], vector: NDArray[np.float64]) -> float:
    """Solve in place for a symmetric positive matrix (its lower triangle becomes the factor); log determinant, or NaN."""
    n = len(vector)
    log_det = 0.0
    for i in range(n):
        for j in range(i + 1):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[j, k]
            if i == j:
                if not total > 0.0:
                    return math.nan
                matrix[i, i] = math.sqrt(total)
                log_det += 2.0 * math.log(matrix[i, i])
            else:
                matrix[i, j] = total / matrix[j, j]
    for i in range(n):
        total = vector[i]
        for k in range(i):
            total -= matrix[i, k] * vector[k]
        vector[i] = total / matrix[i, i]
    for i in range(n - 1, -1, -1):
        total = vector[i]
        for k in range(i + 1, n):
            total -= matrix[k, i] * vector[k]
        vector[i] = total / matrix[i, i]
    return log_det


@njit(cache=True)
def anchor(nodes: Nodes, node: int, late: bool) -> int:
    """Which of the two points of a hypothesis carries an epoch: the later one if wanted and known, else the earlier."""
    kind = nodes.kind[node]
    if kind == ENTERING:
        return 1
    if kind == LEAVING:
        return 0
    return 1 if late else 0


@njit(cache=True)
def _ends(
    nodes: Nodes,
    node: int,
    centre: NDArray[np.float64],
    basis: NDArray[np.float64],
    t_ref: float,
    speed: float,
    out: NDArray[np.float64],
) -> tuple[float, float, int]:
    """Ends of a hypothesis into out (2, 4): x, y (rad) on the plane, epoch (s) after `t_ref`, 1 where the shutter set it, else 0.

    Returns the trail's direction on the plane and the number of ends: a point has one. An end that the frame's edge cut lies
    on the path, but its epoch follows from the other one and the speed (rad/s).
    """
    kind = nodes.kind[node]
    for p in range(2):
        out[p, 0], out[p, 1] = to_plane(nodes.unit[node, p], centre, basis)
        out[p, 2], out[p, 3] = nodes.t_s[node, p] - t_ref, 1.0
    if kind == POINT:
        return 1.0, 0.0, 1
    dx, dy = out[1, 0] - out[0, 0], out[1, 1] - out[0, 1]
    length = math.hypot(dx, dy)
    if kind == ENTERING:
        out[0, 2], out[0, 3] = out[1, 2] - length / speed, 0.0
    elif kind == LEAVING:
        out[1, 2], out[1, 3] = out[0, 2] + length / speed, 0.0
    if length > 0.0:
        return dx / length, dy / length, 2
    return 1.0, 0.0, 2


@njit(cache=True)
def fit_motion(
    nodes: Nodes,
    members: NDArray[np.int64],
    log_area: float,
    sigma_acceleration: float,
    centre: NDArray[np.float64],
    basis: NDArray[np.float64],
    theta: NDArray[np.float64],
    factor: NDArray[np.float64],
) -> tuple[float, float, int, float]:
    """Fit one track; fills centre (3,), basis (2, 3), theta (7,) and factor (7, 7), the Cholesky factor of the information.

    members : hypotheses in time order. log_area : of the field, ln(rad^2). sigma_acceleration : rad/s^2.
    Returns chi-square, log evidence (natural, of all coordinates, in rad), number of coordinates, reference epoch (s).
    The evidence is Laplace's: priors uniform over the field and in log speed and direction, kappa (`kappa_sigma`) and
    accelerations normal.
    """
    n = len(members)
    centre[:] = 0.0
    t_ref = 0.0
    for k in range(n):
        node = members[k]
        for p in range(2):
            t_ref += nodes.t_s[node, p] / (2.0 * n)
            for c in range(3):
                centre[c] += nodes.unit[node, p, c]
    norm = math.sqrt(centre[0] ** 2 + centre[1] ** 2 + centre[2] ** 2)
    for c in range(3):
        centre[c] /= norm
    tangent_basis(centre, basis)

    first, last = members[0], members[n - 1]
    p_first, p_last = anchor(nodes, first, False), anchor(nodes, last, True)
    xf, yf = to_plane(nodes.unit[first, p_first], centre, basis)
    xl, yl = to_plane(nodes.unit[last, p_last], centre, basis)
    span = nodes.t_s[last, p_last] - nodes.t_s[first, p_first]
    speed = max(math.hypot(xl - xf, yl - yf) / max(span, 1e-6), _SLOWEST_RAD_S)
    sigma_kappa = kappa_sigma(speed)

    information = factor
    design = np.zeros(N_PARAMETERS)
    ends = np.empty((2, 4))
    weights = np.ones((n, 2))
    log_det, chi2 = 0.0, 0.0
    for attempt in range(_ROBUST_PASSES):
        information[:] = 0.0
        theta[:] = 0.0
        information[4, 4] = 1.0 / sigma_kappa**2
        information[5, 5] = information[6, 6] = 1.0 / sigma_acceleration**2
        log_noise = 0.0
        n_rows = 0
        for k in range(n):
            node = members[k]
            ux, uy, n_ends = _ends(nodes, node, centre, basis, t_ref, speed, ends)
            for p in range(n_ends):
                x, y, t = ends[p, 0], ends[p, 1], ends[p, 2]
                timed = ends[p, 3] > 0.0
                for across in range(2):
                    if across == 0 and not timed:
                        continue
                    nx, ny = (-uy, ux) if across == 1 else (ux, uy)
                    sigma = nodes.sigma_rad[node, 2] if across == 1 else nodes.sigma_rad[node, p]
                    weight = (1.0 if across == 1 else math.sqrt(weights[k, p])) / sigma
                    value = (nx * x + ny * y) * weight
                    design[0], design[1] = nx * weight, ny * weight
                    design[2], design[3] = design[0] * t, design[1] * t
                    design[4] = -value * t
                    design[5], design[6] = 0.5 * design[2] * t, 0.5 * design[3] * t
                    for i in range(N_PARAMETERS):
                        theta[i] += design[i] * value
                        for j in range(i + 1):
                            information[i, j] += design[i] * design[j]
                    log_noise += math.log(sigma)
                    n_rows += 1
        log_det = _cholesky_solve(information, theta)
        if math.isnan(log_det):
            return math.inf, -math.inf, n_rows, t_ref
        robust = attempt > 0
        chi2 = (theta[4] / sigma_kappa) ** 2 + (theta[5] ** 2 + theta[6] ** 2) / sigma_acceleration**2
        chi2 += _residual_chi2(nodes, members, centre, basis, theta, t_ref, speed, robust, weights)
        free = max(n_rows - 4, 1)
        if n < _ROBUST_MEMBERS or (not robust and chi2 < free + 3.0 * math.sqrt(2.0 * free)):
            break
    moving = max(math.hypot(theta[2], theta[3]), _SLOWEST_RAD_S)
    log_prior = -log_area - (_LOG_2PI + 2.0 * math.log(moving) + math.log(_LOG_SPEEDS))
    log_prior -= math.log(sigma_kappa) + 2.0 * math.log(sigma_acceleration)
    log_evidence = -0.5 * chi2 - 0.5 * n_rows * _LOG_2PI - log_noise + log_prior + 2.0 * _LOG_2PI - 0.5 * log_det
    return chi2, log_evidence, n_rows, t_ref


@njit(cache=True)
def _residual_chi2(
    nodes: Nodes,
    members: NDArray[np.int64],
    centre: NDArray[np.float64],
    basis: NDArray[np.float64],
    theta: NDArray[np.float64],
    t_ref: float,
    speed: float,
    robust: bool,
    weights: NDArray[np.float64],
) -> float:
    """Chi-square of the same rows as in `fit_motion`, from residuals; fills weights (n, 2) of a Student distribution.

    robust : ends contribute ``(nu + 1) ln(1 + r^2 / nu)`` along the trail, because they are change points, and a star or an edge
    may hide a piece of the trail.
    """
    chi2 = 0.0
    ends = np.empty((2, 4))
    for k in range(len(members)):
        node = members[k]
        ux, uy, n_ends = _ends(nodes, node, centre, basis, t_ref, speed, ends)
        for p in range(n_ends):
            x, y, t = ends[p, 0], ends[p, 1], ends[p, 2]
            timed = ends[p, 3] > 0.0
            dx = theta[0] + theta[2] * t + 0.5 * theta[5] * t * t - x * (1.0 + theta[4] * t)
            dy = theta[1] + theta[3] * t + 0.5 * theta[6] * t * t - y * (1.0 + theta[4] * t)
            if timed:
                pull2 = ((dx * ux + dy * uy) / nodes.sigma_rad[node, p]) ** 2
                chi2 += (_STUDENT_NU + 1.0) * math.log(1.0 + pull2 / _STUDENT_NU) if robust else pull2
                weights[k, p] = (_STUDENT_NU + 1.0) / (_STUDENT_NU + pull2)
            chi2 += ((-dx * uy + dy * ux) / nodes.sigma_rad[node, 2]) ** 2
    return chi2


@njit(cache=True)
def usable(nodes: Nodes, node: int) -> bool:
    """Whether a hypothesis can take part in a link."""
    return nodes.kind[node] != CROSSING


@njit(cache=True)
def is_full(nodes: Nodes, node: int) -> bool:
    """Whether both ends carry epochs, so that the hypothesis knows its own velocity."""
    return nodes.kind[node] == FULL
