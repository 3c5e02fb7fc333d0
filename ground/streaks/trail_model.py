"""Mean of a trailed Gaussian PSF on pixels, its analytic derivatives, and Fisher scoring on them.

Trail frame: u along the reference chord from its middle, v across it (both px); x = u / half runs from -1 to +1 between the
reference ends. The model of a pixel at (u, v) is

    mu = density * b(x) * [Phi((u - e0) / w0) - Phi((u - e1) / w1)] * N(v - c(x); w)

    b(x) = 1 + q1 x + q2 (x^2 - 1/3)        brightness along the trail, mean 1 between the reference ends
    c(x) = v_mid + slope x + sagitta (1/3 - x^2)   centre line; sagitta is the height of the arc over its chord

(Veres et al. 2012, arXiv 1209.6106, eq. 3, with brightness and curvature added). A pixel integrates the PSF over a unit
square: that convolution has covariance 1/12 along every direction, so the width is ``w^2 = sigma^2 + 1/12``; what is
left is the fourth cumulant, (cos^4 + sin^4) / 120 px^4 of the rotated square, which is corrected across the trail.
"""

import math
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

PIXEL_VARIANCE_PX2: Final = 1.0 / 12.0
"""Second moment of a unit square along any direction."""

N_PARAMETERS: Final = 9
"""As many as the names below."""
DENSITY, END0, END1, V_MID, SLOPE, SAGITTA, Q1, Q2, LN_WIDTH = range(N_PARAMETERS)
"""Order of the parameter vector: e-/px along the trail, px, px, px, px per half length, px, -, -, ln px."""

LN_PIXEL_WIDTH: Final = 0.5 * math.log(1.02 * PIXEL_VARIANCE_PX2)
"""Narrowest width: light of no width of its own still fills a pixel."""

REACH_WIDTHS: Final = 4.5
"""Pixels farther from the trail than this many widths hold nothing of it (1e-5 of its light) and are left out."""

CHUNK: Final = 256
"""Pixels that go through `accumulate` together: their working arrays fit the processor's cache."""

TOLERANCE_SIGMA: Final = 0.02
"""Fisher scoring ends when no parameter moves by more than this part of its standard error."""

Scale = tuple[float, float, float, float]
"""Half of the reference length, extra width of the first and of the last end (px), fourth cumulant of a pixel (px^4)."""

_SQRT_HALF: Final = math.sqrt(0.5)
_INV_SQRT_2PI: Final = 1.0 / math.sqrt(2.0 * math.pi)


def quartic_px4(angle_rad: float) -> float:
    """Fourth cumulant of a unit square projected on an axis at this angle to a pixel row (px^4)."""
    return -(math.cos(angle_rad) ** 4 + math.sin(angle_rad) ** 4) / 120.0


@njit(cache=True, error_model="numpy")
def edge(u: float, end: float, width: float) -> float:
    """Phi((u - end) / width); an end at -inf or +inf gives 1 or 0."""
    t = (u - end) / width
    if t > 6.0:
        return 1.0
    if t < -6.0:
        return 0.0
    return 0.5 * math.erfc(-t * _SQRT_HALF)


@njit(cache=True, error_model="numpy")
def gaussian(t2: float) -> float:
    """exp(-t2 / 2) for t2 from 0 to `REACH_WIDTHS`^2, to 1e-7: Taylor's series of its 16th root, which compilers vectorise."""
    z = t2 * (1.0 / 32.0)
    series = 1.0 - z * (1.0 / 6.0) * (1.0 - z * (1.0 / 7.0) * (1.0 - z * (1.0 / 8.0) * (1.0 - z * (1.0 / 9.0))))
    series = 1.0 - z * (1.0 / 3.0) * (1.0 - z * (1.0 / 4.0) * (1.0 - z * (1.0 / 5.0) * series))
    root = 1.0 - z * (1.0 - z * (1.0 / 2.0) * series)
    root *= root
    root *= root
    root *= root
    return root * root


@njit(cache=True, error_model="numpy")
def accumulate(
    parameters: NDArray[np.float64],
    u: NDArray[np.float64],
    v: NDArray[np.float64],
    value_e: NDArray[np.float64],
    variance_e2: NDArray[np.float64],
    scale: Scale,
    index: NDArray[np.int64],
    gradient: NDArray[np.float64],
    fisher: NDArray[np.float64],
) -> tuple[float, float, int]:
    """Score vector and Fisher matrix (filled in place) of the parameters `index`; chi2, S/N^2 and pixels used.

    Weights are 1 / (variance + model): the object's own Poisson noise, from the model and not from the data, so that
    the estimate is not biased. Derivatives are analytic; the fourth-cumulant term is left out of them (0.2 %). Pixels go
    through in chunks, each sum in as many parts: short loops without branches or sums are what compilers vectorise.
    """
    half, blur0, blur1, quartic = scale
    width = math.exp(parameters[LN_WIDTH])
    width0, width1 = math.hypot(width, blur0), math.hypot(width, blur1)
    density, end0, end1 = parameters[DENSITY], parameters[END0], parameters[END1]
    v_mid, slope, sagitta = parameters[V_MID], parameters[SLOPE], parameters[SAGITTA]
    q1, q2 = parameters[Q1], parameters[Q2]
    first, last = end0 - REACH_WIDTHS * width0, end1 + REACH_WIDTHS * width1
    inner0, inner1 = end0 + 6.0 * width0, end1 - 6.0 * width1
    inv_half, inv_width, inv_width0, inv_width1 = 1.0 / half, 1.0 / width, 1.0 / width0, 1.0 / width1
    norm, kurtosis = _INV_SQRT_2PI / width, quartic / (24.0 * width**4)
    reach2 = REACH_WIDTHS**2
    n = index.size
    chunk = min(CHUNK, u.size)
    share, d0, d1 = np.empty(chunk), np.empty(chunk), np.empty(chunk)
    weight, weighted, residual = np.empty(chunk), np.empty(chunk), np.empty(chunk)
    x, offset, brightness, across, mean = np.empty(chunk), np.empty(chunk), np.empty(chunk), np.empty(chunk), np.empty(chunk)
    derivative = np.empty((N_PARAMETERS, chunk))
    total = np.zeros((3 + n * (n + 3) // 2, chunk))
    for start in range(0, u.size, CHUNK):
        count = min(CHUNK, u.size - start)
        near = 0
        for i in range(count):
            near += 1 if (u[start + i] >= first) & (u[start + i] <= last) else 0
        if near == 0:
            continue
        for i in range(count):
            share[i], d0[i], d1[i] = 1.0, 0.0, 0.0
        # most pixels are far from both ends
        for i in range(count):
            along = u[start + i]
            if first <= along < inner0:
                share[i] = edge(along, end0, width0)
                d0[i] = _INV_SQRT_2PI * inv_width0 * math.exp(-0.5 * ((along - end0) * inv_width0) ** 2)
            if inner1 < along <= last:
                share[i] -= edge(along, end1, width1)
                d1[i] = _INV_SQRT_2PI * inv_width1 * math.exp(-0.5 * ((along - end1) * inv_width1) ** 2)
        for i in range(count):
            x[i] = u[start + i] * inv_half
            x2 = x[i] * x[i] - 1.0 / 3.0
            offset[i] = (v[start + i] - (v_mid + slope * x[i] - sagitta * x2)) * inv_width
            brightness[i] = 1.0 + q1 * x[i] + q2 * x2
        for i in range(count):
            v2 = offset[i] * offset[i]
            inside = v2 < reach2
            v2 = v2 if inside else reach2
            correction = 1.0 + kurtosis * (v2 * v2 - 6.0 * v2 + 3.0)
            across[i] = norm * gaussian(v2) * (correction if (correction > 0.0) & inside else 0.0)
        for i in range(count):
            mu = density * brightness[i] * share[i] * across[i]
            variance = variance_e2[start + i]
            used = 1.0 if (across[i] > 0.0) & (u[start + i] >= first) & (u[start + i] <= last) & (variance < np.inf) else 0.0
            mean[i] = mu
            residual[i] = value_e[start + i] - mu
            weight[i] = used / (variance + (mu if mu > 0.0 else 0.0))
            total[1, i] += used * mu * mu / variance
        for i in range(count):
            total[0, i] += residual[i] * residual[i] * weight[i]
            total[2, i] += 1.0 if weight[i] > 0.0 else 0.0
        for i in range(count):
            lit = share[i] * across[i]
            derivative[DENSITY, i] = brightness[i] * lit
            derivative[Q1, i] = density * lit * x[i]
            derivative[Q2, i] = density * lit * (x[i] * x[i] - 1.0 / 3.0)
        for i in range(count):
            slope_v = mean[i] * offset[i] * inv_width
            derivative[V_MID, i] = slope_v
            derivative[SLOPE, i] = slope_v * x[i]
            derivative[SAGITTA, i] = slope_v * (1.0 / 3.0 - x[i] * x[i])
            derivative[LN_WIDTH, i] = mean[i] * (offset[i] * offset[i] - 1.0)
        for i in range(count):
            amplitude = density * brightness[i] * across[i]
            derivative[END0, i] = -amplitude * d0[i]
            derivative[END1, i] = amplitude * d1[i]
            spread = d1[i] * (u[start + i] - end1) * (inv_width1 * inv_width1)
            spread -= d0[i] * (u[start + i] - end0) * (inv_width0 * inv_width0)
            derivative[LN_WIDTH, i] += amplitude * width * width * spread
        row = 3
        for j in range(n):
            slopes, score_sum = derivative[index[j]], total[row]
            for i in range(count):
                weighted[i] = weight[i] * slopes[i]
                score_sum[i] += weighted[i] * residual[i]
            for k in range(j + 1):
                others, fisher_sum = derivative[index[k]], total[row + 1 + k]
                for i in range(count):
                    fisher_sum[i] += weighted[i] * others[i]
            row += j + 2
    row = 3
    for j in range(n):
        gradient[j] = total[row].sum()
        for k in range(j + 1):
            fisher[j, k] = fisher[k, j] = total[row + 1 + k].sum()
        row += j + 2
    return total[0].sum(), total[1].sum(), int(total[2].sum())


@njit(cache=True, error_model="numpy")
def fisher_scoring(
    parameters: NDArray[np.float64],
    free: NDArray[np.bool_],
    limits: NDArray[np.float64],
    u: NDArray[np.float64],
    v: NDArray[np.float64],
    value_e: NDArray[np.float64],
    variance_e2: NDArray[np.float64],
    scale: Scale,
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
        chi2, snr2, used = accumulate(p, u, v, value_e, variance_e2, scale, index, gradient, fisher)
        matrix = np.empty((n, n))
        right = np.empty(n)
        for a in range(n):
            right[a] = gradient[a]
            for b in range(n):
                matrix[a, b] = fisher[a, b]
            matrix[a, a] = matrix[a, a] * (1.0 + 1e-9) + 1e-30
        unit = np.sqrt(np.diag(matrix))
        for a in range(n):
            right[a] /= unit[a]
            for b in range(n):
                matrix[a, b] /= unit[a] * unit[b]
        inverse = np.linalg.pinv(matrix, 1e-10)
        for a in range(n):
            for b in range(n):
                covariance[index[a], index[b]] = inverse[a, b] / (unit[a] * unit[b])
        if iteration == max_iterations:
            break
        step = inverse @ right
        worst = 0.0
        shrink = 1.0
        for a in range(n):
            step[a] /= unit[a]
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


@njit(cache=True, error_model="numpy")
def mean_all(
    parameters: NDArray[np.float64],
    u: NDArray[np.float64],
    v: NDArray[np.float64],
    scale: Scale,
) -> NDArray[np.float64]:
    """Expected electrons of many pixels, shape (n,), as in `accumulate`; zero beyond `REACH_WIDTHS`."""
    half, blur0, blur1, quartic = scale
    density, end0, end1 = parameters[DENSITY], parameters[END0], parameters[END1]
    v_mid, slope, sagitta = parameters[V_MID], parameters[SLOPE], parameters[SAGITTA]
    q1, q2 = parameters[Q1], parameters[Q2]
    width = math.exp(parameters[LN_WIDTH])
    width0, width1 = math.hypot(width, blur0), math.hypot(width, blur1)
    inner0, inner1 = end0 + 6.0 * width0, end1 - 6.0 * width1
    inv_half, inv_width, norm = 1.0 / half, 1.0 / width, _INV_SQRT_2PI / width
    kurtosis, reach2 = quartic / (24.0 * width**4), REACH_WIDTHS**2
    out = np.empty(u.size)
    for i in range(u.size):
        x = u[i] * inv_half
        x2 = x * x - 1.0 / 3.0
        offset = (v[i] - v_mid - slope * x + sagitta * x2) * inv_width
        v2 = offset * offset
        near = 1.0 if v2 < reach2 else 0.0
        v2 = v2 if v2 < reach2 else reach2
        correction = 1.0 + kurtosis * (v2 * v2 - 6.0 * v2 + 3.0)
        across = near * norm * gaussian(v2) * (correction if correction > 0.0 else 0.0)
        out[i] = density * (1.0 + q1 * x + q2 * x2) * across
    for i in range(u.size):
        if u[i] < inner0 or u[i] > inner1:
            out[i] *= edge(u[i], end0, width0) - edge(u[i], end1, width1)
    return out


@njit(cache=True, error_model="numpy")
def line_scores(
    parameters: NDArray[np.float64],
    u: NDArray[np.float64],
    v: NDArray[np.float64],
    value_e: NDArray[np.float64],
    variance_e2: NDArray[np.float64],
    half: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Score and information, each (n,), of every pixel for a shift of the centre line where it lies."""
    inv_width2 = math.exp(-2.0 * parameters[LN_WIDTH])
    mean = mean_all(parameters, u, v, (half, 0.0, 0.0, 0.0))
    slope = np.empty(u.size)
    information = np.empty(u.size)
    for i in range(u.size):
        x = u[i] / half
        offset = v[i] - parameters[V_MID] - parameters[SLOPE] * x - parameters[SAGITTA] * (1.0 / 3.0 - x * x)
        weight = 1.0 / (variance_e2[i] + max(mean[i], 0.0))
        derivative = mean[i] * offset * inv_width2
        slope[i] = weight * derivative * (value_e[i] - mean[i])
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
