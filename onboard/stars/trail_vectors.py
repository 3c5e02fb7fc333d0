"""Bright trails fitted with everything free: place, vector, width and flux, by damped least squares (Levenberg, Marquardt).

A trail of flux F, half length h at angle a (from growing col to growing row) and width s is F A(v) E(u), with u along it and v
across, A a Gaussian and E the difference of two error functions over 4 h. All slopes are closed expressions.
"""

import math
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sboc_e2e.icd.signals import StarMotion

REFINED_STARS: Final = 12
"""Trails that are enough for the frame's motion."""

MOST_STEPS: Final = 20  # a fit that needs more is left out. Chosen, not measured
SETTLED: Final = 1e-4
"""Relative fall of the sum of squares at which a fit has come to its end."""

MOST_MISFIT: Final = 0.05
"""A trail is fitted when no more than this share of its light, in squares, is left."""

LEAST_WIDTH_PX: Final = 0.2  # keeps 1 / width finite; pixels alone have 0.29 px
LEAST_HALF_PX: Final = 0.5  # keeps the angle defined; shorter ones are points

STEP_WORK: Final = 100
"""Operations of a pixel in one step: two error functions, three exponentials, a normal matrix of six."""


@njit(cache=True)
def _shape(u: float, v: float, half: float, width: float) -> tuple[float, float, float, float, float]:
    """A(v) E(u) and its derivatives by u, v, half length and width."""
    scale = 1.0 / (width * math.sqrt(2.0))
    across = math.exp(-((v * scale) ** 2)) / (width * math.sqrt(2.0 * math.pi))
    ahead, behind = (u + half) * scale, (u - half) * scale
    along = (math.erf(ahead) - math.erf(behind)) / (4.0 * half)
    slope = 2.0 / math.sqrt(math.pi) / (4.0 * half)
    at_start, at_end = math.exp(-ahead * ahead), math.exp(-behind * behind)
    by_u = across * slope * scale * (at_start - at_end)
    by_half = across * (slope * scale * (at_start + at_end) - along / half)
    by_width = across * along * ((v / width) ** 2 - 1.0) / width - across * slope * (ahead * at_start - behind * at_end) / width
    return across * along, by_u, -across * along * v / (width * width), by_half, by_width


@njit(cache=True)
def _normal(
    values: NDArray[np.float64],
    places: NDArray[np.float64],
    parameters: NDArray[np.float64],
    matrix: NDArray[np.float64],
    gradient: NDArray[np.float64],
) -> float:
    """Normal matrix (6, 6) and gradient (6,) of pixels (n,) at places (n, 2) from the middle; the sum of squares left."""
    flux, row, col, half, angle, width = parameters
    sine, cosine = math.sin(angle), math.cos(angle)
    slopes = np.empty(6)
    matrix[:], gradient[:] = 0.0, 0.0
    squares = 0.0
    for k in range(values.size):
        y, x = places[k, 0] - row, places[k, 1] - col
        u, v = y * sine + x * cosine, y * cosine - x * sine
        t, by_u, by_v, by_half, by_width = _shape(u, v, half, width)
        slopes[0] = t
        slopes[1] = -flux * (by_u * sine + by_v * cosine)
        slopes[2] = -flux * (by_u * cosine - by_v * sine)
        slopes[3] = flux * by_half
        slopes[4] = flux * (by_u * v - by_v * u)
        slopes[5] = flux * by_width
        left = values[k] - flux * t
        squares += left * left
        for i in range(6):
            gradient[i] += left * slopes[i]
            for j in range(i + 1):
                matrix[i, j] += slopes[i] * slopes[j]
    for i in range(6):
        for j in range(i):
            matrix[j, i] = matrix[i, j]
    return squares


@njit(cache=True)
def _step(matrix: NDArray[np.float64], gradient: NDArray[np.float64], damping: float) -> NDArray[np.float64]:
    """Solution of the damped normal equations by elimination; all zero when there is none."""
    n = gradient.size
    left, right = matrix.copy(), gradient.copy()
    for i in range(n):
        left[i, i] *= 1.0 + damping
    for k in range(n):
        if not left[k, k] > 1e-12 * matrix[k, k]:
            return np.zeros(n)
        for i in range(k + 1, n):
            factor = left[i, k] / left[k, k]
            for j in range(k, n):
                left[i, j] -= factor * left[k, j]
            right[i] -= factor * right[k]
    for k in range(n - 1, -1, -1):
        for j in range(k + 1, n):
            right[k] -= left[k, j] * right[j]
        right[k] /= left[k, k]
    return right


@njit(cache=True)
def fit_vector(values: NDArray[np.float64], places: NDArray[np.float64], parameters: NDArray[np.float64]) -> tuple[float, int]:
    """Fit flux, row, col, half length, angle and width (6,), in place; the squares left (-1: not settled), and the steps."""
    matrix, gradient = np.empty((6, 6)), np.empty(6)
    new_matrix, new_gradient = np.empty((6, 6)), np.empty(6)
    squares, damping = _normal(values, places, parameters, matrix, gradient), 1e-2
    for step in range(MOST_STEPS):
        trial = parameters + _step(matrix, gradient, damping)
        trial[3], trial[5] = max(trial[3], LEAST_HALF_PX), max(abs(trial[5]), LEAST_WIDTH_PX)
        new = _normal(values, places, trial, new_matrix, new_gradient)
        if new < squares:
            settled = squares - new < SETTLED * squares
            parameters[:], matrix[:], gradient[:], squares = trial, new_matrix, new_gradient, new
            damping *= 0.2
            if settled:
                return squares, step + 2
        elif damping > 1e4:
            return squares, step + 2
        else:
            damping *= 10.0
    return -1.0, MOST_STEPS + 1


def fitted_vectors(
    residual: NDArray[np.float32],
    mask: NDArray[np.uint8],
    places: NDArray[np.float64],
    motion: StarMotion,
    psf_sigma_px: float,
    most_work: float = math.inf,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], int]:
    """Places (m, 2), vectors (m, 2) and PSF widths (m,) of usable trails near some places (n, 2), and the operations done.

    The first `REFINED_STARS` that can be fitted, as far as `most_work` operations go; those near the edge or with masked pixels
    are left out.
    """
    fitted, work = [], 0
    for row0, col0 in np.rint(places).astype(int):
        drow, dcol = (float(part[0]) for part in motion.at(np.array([float(row0)]), np.array([float(col0)])))
        half = 0.5 * math.hypot(drow, dcol)
        reach = [math.ceil(0.5 * abs(part) + 5.0 * psf_sigma_px) + 3 for part in (drow, dcol)]
        if min(row0 - reach[0], col0 - reach[1]) < 0 or row0 + reach[0] >= mask.shape[0] or col0 + reach[1] >= mask.shape[1]:
            continue
        row, col = np.indices((2 * reach[0] + 1, 2 * reach[1] + 1)).reshape(2, -1) - np.array(reach)[:, None]
        angle = math.atan2(drow, dcol)
        along, across = row * math.sin(angle) + col * math.cos(angle), row * math.cos(angle) - col * math.sin(angle)
        near = (np.abs(along) < half + 5.0 * psf_sigma_px + 3.0) & (np.abs(across) < 5.0 * psf_sigma_px + 2.0)
        row, col = row[near], col[near]
        if mask[row0 + row, col0 + col].any():
            continue
        values = residual[row0 + row, col0 + col].astype(np.float64)
        if not values.sum() > 0.0:  # a peak in a hole of the background is no star to learn from
            continue
        fit = np.array([values.sum(), 0.0, 0.0, max(half, LEAST_HALF_PX), angle, psf_sigma_px])
        left, steps = fit_vector(values, np.column_stack((row, col)).astype(np.float64), fit)
        work += STEP_WORK * steps * values.size
        if fit[0] > 0.0 and 0.0 <= left < MOST_MISFIT * float(np.sum(values**2)):
            vector = 2.0 * fit[3] * np.array((math.sin(fit[4]), math.cos(fit[4])))
            fitted.append((row0 + fit[1], col0 + fit[2], vector[0], vector[1], fit[5]))
        if len(fitted) == REFINED_STARS or work > most_work:
            break
    table = np.array(fitted).reshape(-1, 5)
    return table[:, :2], table[:, 2:4], table[:, 4], work
