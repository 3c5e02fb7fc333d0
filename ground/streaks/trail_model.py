"""Mean of a trailed Gaussian PSF on pixels, its analytic derivatives, and Fisher scoring on them.

Trail frame: u along the reference chord, v across it (both px); x = (u - u_mid) / half runs from -1 to +1 between the
reference ends. The model of a pixel at (u, v) is

    mu = density * b(x) * [Phi((u - e0) / w0) - Phi((u - e1) / w1)] * N(v - c(x); w)

    b(x) = 1 + q1 x + q2 (x^2 - 1/3)        brightness along the trail, mean 1 between the reference ends
    c(x) = v_mid + slope x + sagitta (1/3 - x^2)   centre line; sagitta is the height of the arc over its chord

(Veres et al. 2012, arXiv 1209.6106, eq. 3, with brightness and curvature added). A pixel integrates the PSF over a unit
square: that convolution has covariance 1/12 along every direction, so the width is ``w^2 = sigma^2 + 1/12``; what is
left is the fourth cumulant, (cos^4 + sin^4) / 120 px^4 of the rotated square, which `QUARTIC` corrects across the trail.
"""

import math
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

PIXEL_VARIANCE_PX2: Final = 1.0 / 12.0
"""Second moment of a unit square along any direction."""

N_PARAMETERS: Final = 9
DENSITY, END0, END1, V_MID, SLOPE, SAGITTA, Q1, Q2, LN_WIDTH = range(N_PARAMETERS)
"""Order of the parameter vector: e-/px along the trail, px, px, px, px per half length, px, -, -, ln px."""

LN_PIXEL_WIDTH: Final = 0.5 * math.log(1.02 * PIXEL_VARIANCE_PX2)
"""Narrowest width: light of no width of its own still fills a pixel."""

REACH_WIDTHS: Final = 4.5
"""Pixels farther from the trail than this many widths hold nothing of it (1e-5 of its light) and are left out."""

TOLERANCE_SIGMA: Final = 0.02
"""Fisher scoring ends when no parameter moves by more than this part of its standard error."""

_SQRT_HALF: Final = math.sqrt(0.5)
_INV_SQRT_2PI: Final = 1.0 / math.sqrt(2.0 * math.pi)


def quartic_px4(angle_rad: float) -> float:
    """Fourth cumulant of a unit square projected on an axis at this angle to a pixel row (px^4)."""
    return -(math.cos(angle_rad) ** 4 + math.sin(angle_rad) ** 4) / 120.0


@njit(cache=True)
def edge(u: float, end: float, width: float) -> float:
    """Phi((u - end) / width); an end at -inf or +inf gives 1 or 0."""
    t = (u - end) / width
    if t > 6.0:
        return 1.0
    if t < -6.0:
        return 0.0
    return 0.5 * math.erfc(-t * _SQRT_HALF)


@njit(cache=True)
def profile(v: float, width: float, quartic: float) -> float:
    """Cross-trail profile: a Gaussian with the fourth-cumulant (Gram-Charlier) term of the pixel square."""
    t2 = (v / width) ** 2
    if t2 > 60.0:
        return 0.0
    correction = 1.0 + quartic / (24.0 * width**4) * (t2 * t2 - 6.0 * t2 + 3.0)
    return _INV_SQRT_2PI / width * math.exp(-0.5 * t2) * max(correction, 0.0)


@njit(cache=True)
def mean_e(
    parameters: NDArray[np.float64], u: float, v: float, u_mid: float, half: float, blur0: float, blur1: float, quartic: float
) -> float:
    """Expected electrons of one pixel; blur0, blur1: extra width of the ends (px)."""
    x = (u - u_mid) / half
    width = math.exp(parameters[LN_WIDTH])
    brightness = 1.0 + parameters[Q1] * x + parameters[Q2] * (x * x - 1.0 / 3.0)
    centre = parameters[V_MID] + parameters[SLOPE] * x + parameters[SAGITTA] * (1.0 / 3.0 - x * x)
    share = edge(u, parameters[END0], math.hypot(width, blur0)) - edge(u, parameters[END1], math.hypot(width, blur1))
    return parameters[DENSITY] * brightness * share * profile(v - centre, width, quartic)


@njit(cache=True)
def accumulate(
    parameters: NDArray[np.float64],
    u: NDArray[np.float64],
    v: NDArray[np.float64],
    value_e: NDArray[np.float64],
    variance_e2: NDArray[np.float64],
    u_mid: float,
    half: float,
    blur0: float,
    blur1: float,
    quartic: float,
    index: NDArray[np.int64],
    gradient: NDArray[np.float64],
    fisher: NDArray[np.float64],
) -> tuple[float, float, int]:
    """Score vector and Fisher matrix (filled in place) of the parameters `index`; chi2, S/N^2 and pixels used.

    Weights are 1 / (variance + model): the object's own Poisson noise, from the model and not from the data, so that
    the estimate is not biased. Derivatives are analytic; the fourth-cumulant term is left out of them (0.2 %).
    """
    gradient[:] = 0.0
    fisher[:] = 0.0
    derivative = np.empty(N_PARAMETERS)
    width = math.exp(parameters[LN_WIDTH])
    width0, width1 = math.hypot(width, blur0), math.hypot(width, blur1)
    reach = REACH_WIDTHS * width
    density, end0, end1 = parameters[DENSITY], parameters[END0], parameters[END1]
    v_mid, slope, sagitta = parameters[V_MID], parameters[SLOPE], parameters[SAGITTA]
    q1, q2 = parameters[Q1], parameters[Q2]
    first, last = end0 - REACH_WIDTHS * width0, end1 + REACH_WIDTHS * width1
    inv_half, inv_width, inv_width0, inv_width1 = 1.0 / half, 1.0 / width, 1.0 / width0, 1.0 / width1
    norm, kurtosis = _INV_SQRT_2PI / width, quartic / (24.0 * width**4)
    n = index.size
    chi2 = 0.0
    snr2 = 0.0
    used = 0
    for i in range(u.size):
        if u[i] < first or u[i] > last:
            continue
        x = (u[i] - u_mid) * inv_half
        x2 = x * x - 1.0 / 3.0
        offset = v[i] - (v_mid + slope * x - sagitta * x2)
        variance = variance_e2[i]
        if abs(offset) > reach or not variance < np.inf:
            continue
        v2 = (offset * inv_width) ** 2
        across = norm * math.exp(-0.5 * v2) * max(1.0 + kurtosis * (v2 * v2 - 6.0 * v2 + 3.0), 0.0)
        t0 = (u[i] - end0) * inv_width0
        t1 = (u[i] - end1) * inv_width1
        # most pixels are far from both ends
        share, d0, d1 = 1.0, 0.0, 0.0
        if t0 < 6.0:
            share = edge(u[i], end0, width0)
            d0 = _INV_SQRT_2PI * inv_width0 * math.exp(-0.5 * t0 * t0)
        if t1 > -6.0:
            share -= edge(u[i], end1, width1)
            d1 = _INV_SQRT_2PI * inv_width1 * math.exp(-0.5 * t1 * t1)
        brightness = 1.0 + q1 * x + q2 * x2
        unit = share * across
        mu = density * brightness * unit
        weight = 1.0 / (variance + max(mu, 0.0))
        residual = value_e[i] - mu
        chi2 += residual * residual * weight
        snr2 += mu * mu / variance
        used += 1
        amplitude = density * brightness * across
        slope_v = mu * offset * inv_width * inv_width
        derivative[DENSITY] = brightness * unit
        derivative[END0] = -amplitude * d0
        derivative[END1] = amplitude * d1
        derivative[V_MID] = slope_v
        derivative[SLOPE] = slope_v * x
        derivative[SAGITTA] = -slope_v * x2
        derivative[Q1] = density * unit * x
        derivative[Q2] = density * unit * x2
        along = amplitude * width * width * (-d0 * t0 * inv_width0 + d1 * t1 * inv_width1)
        derivative[LN_WIDTH] = mu * (v2 - 1.0) + along
        for j in range(n):
            wj = weight * derivative[index[j]]
            gradient[j] += wj * residual
            for k in range(j + 1):
                fisher[j, k] += wj * derivative[index[k]]
    for j in range(n):
        for k in range(j):
            fisher[k, j] = fisher[j, k]
    return chi2, snr2, used


@njit(cache=True)
def fisher_scoring(
    parameters: NDArray[np.float64],
    free: NDArray[np.bool_],
    limits: NDArray[np.float64],
    u: NDArray[np.float64],
    v: NDArray[np.float64],
    value_e: NDArray[np.float64],
    variance_e2: NDArray[np.float64],
    u_mid: float,
    half: float,
    blur0: float,
    blur1: float,
    quartic: float,
    max_iterations: int,
) -> tuple[NDArray[np.float64], NDArray[np.float64], float, float, int, bool]:
    """Iterate Fisher scoring on the free parameters: (parameters, covariance (9, 9), chi2, snr2, pixels, converged).

    limits : (9,) largest change of each parameter in one step (the trust region). Covariance is zero where fixed; it belongs to
    the place before the last step, which differs by `TOLERANCE_SIGMA` at most where the iteration converged.
    """
    p = parameters.copy()
    index = np.flatnonzero(free)
    n = index.size
    gradient = np.empty(n)
    fisher = np.empty((n, n))
    covariance = np.zeros((N_PARAMETERS, N_PARAMETERS))
    converged = False
    chi2 = np.inf
    snr2 = 0.0
    used = 0
    for iteration in range(max_iterations + 1):
        chi2, snr2, used = accumulate(p, u, v, value_e, variance_e2, u_mid, half, blur0, blur1, quartic, index, gradient, fisher)
        matrix = np.empty((n, n))
        right = np.empty(n)
        for a in range(n):
            right[a] = gradient[a]
            for b in range(n):
                matrix[a, b] = fisher[a, b]
            matrix[a, a] = matrix[a, a] * (1.0 + 1e-9) + 1e-30
        scale = np.sqrt(np.diag(matrix))
        for a in range(n):
            right[a] /= scale[a]
            for b in range(n):
                matrix[a, b] /= scale[a] * scale[b]
        inverse = np.linalg.pinv(matrix, 1e-10)
        for a in range(n):
            for b in range(n):
                covariance[index[a], index[b]] = inverse[a, b] / (scale[a] * scale[b])
        if iteration == max_iterations:
            break
        step = inverse @ right
        worst = 0.0
        shrink = 1.0
        for a in range(n):
            step[a] /= scale[a]
            shrink = min(shrink, limits[index[a]] / max(abs(step[a]), 1e-300))
            sigma = math.sqrt(covariance[index[a], index[a]])
            worst = max(worst, abs(step[a]) / max(sigma, 1e-300))
        for a in range(n):
            p[index[a]] += shrink * step[a]
        p[LN_WIDTH] = max(p[LN_WIDTH], LN_PIXEL_WIDTH)
        if worst < TOLERANCE_SIGMA:
            converged = True
            for a in range(n):
                chi2 -= gradient[a] * shrink * step[a]
            break
    return p, covariance, chi2, snr2, used, converged


@njit(cache=True)
def mean_all(
    parameters: NDArray[np.float64], u: NDArray[np.float64], v: NDArray[np.float64], half: float, blur0: float, blur1: float
) -> NDArray[np.float64]:
    """Expected electrons of many pixels, shape (n,); arguments of `mean_e`, without the fourth-cumulant term."""
    density, end0, end1 = parameters[DENSITY], parameters[END0], parameters[END1]
    v_mid, slope, sagitta = parameters[V_MID], parameters[SLOPE], parameters[SAGITTA]
    q1, q2 = parameters[Q1], parameters[Q2]
    width = math.exp(parameters[LN_WIDTH])
    width0, width1 = math.hypot(width, blur0), math.hypot(width, blur1)
    inv_half, inv_width, norm = 1.0 / half, 1.0 / width, _INV_SQRT_2PI / width
    out = np.zeros(u.size)
    for i in range(u.size):
        share = edge(u[i], end0, width0) - edge(u[i], end1, width1)
        x = u[i] * inv_half
        x2 = x * x - 1.0 / 3.0
        offset = (v[i] - v_mid - slope * x + sagitta * x2) * inv_width
        v2 = offset * offset
        if share != 0.0 and v2 < 60.0:
            out[i] = density * (1.0 + q1 * x + q2 * x2) * share * norm * math.exp(-0.5 * v2)
    return out


@njit(cache=True)
def line_scores(
    parameters: NDArray[np.float64],
    u: NDArray[np.float64],
    v: NDArray[np.float64],
    value_e: NDArray[np.float64],
    variance_e2: NDArray[np.float64],
    half: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Score and information, each (n,), of every pixel for a shift of the centre line where it lies."""
    width = math.exp(parameters[LN_WIDTH])
    slope = np.empty(u.size)
    information = np.empty(u.size)
    for i in range(u.size):
        x = u[i] / half
        offset = v[i] - parameters[V_MID] - parameters[SLOPE] * x - parameters[SAGITTA] * (1.0 / 3.0 - x * x)
        mu = mean_e(parameters, u[i], v[i], 0.0, half, 0.0, 0.0, 0.0)
        weight = 1.0 / (variance_e2[i] + max(mu, 0.0))
        derivative = mu * offset / (width * width)
        slope[i] = weight * derivative * (value_e[i] - mu)
        information[i] = weight * derivative * derivative
    return slope, information


def profiles(
    parameters: NDArray[np.float64], u: NDArray[np.float64], v: NDArray[np.float64], half: float, angle_rad: float
) -> NDArray[np.float64]:
    """Electrons per unit density, shape (n,), of pixels as if lit by the whole trail, brightness included (>= 5 % of mean)."""
    x = u / half
    width = math.exp(parameters[LN_WIDTH])
    centre = parameters[V_MID] + parameters[SLOPE] * x + parameters[SAGITTA] * (1.0 / 3.0 - x * x)
    t2 = ((v - centre) / width) ** 2
    correction = np.maximum(1.0 + quartic_px4(angle_rad) / (24.0 * width**4) * (t2 * t2 - 6.0 * t2 + 3.0), 0.0)
    brightness = np.maximum(1.0 + parameters[Q1] * x + parameters[Q2] * (x * x - 1.0 / 3.0), 0.05)
    out: NDArray[np.float64] = brightness * np.exp(-0.5 * t2) * (_INV_SQRT_2PI / width) * correction
    return out
