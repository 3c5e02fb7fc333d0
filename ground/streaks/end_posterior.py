"""Posterior of both ends and the brightness of a trail along a known centre line.

Below S^2 ~ 7.3 L / sigma the ends of a trail are change points: the likelihood is a random walk with drift around each
of them, maximum likelihood scatters by sqrt(26) L / S^2 and biases the flux upwards; the posterior mean scatters by
sqrt(16 zeta(3)) L / S^2 (Ibragimov & Khasminskii 1981; Rubin & Song 1995). So both ends and the density are integrated,
not maximised. Given the density, the two ends are independent as long as their PSFs do not overlap, because each
pixel between them counts as lit whatever the other end does: the joint posterior is a short sum over densities of
products of two one-dimensional posteriors, each made from cumulative sums of the pixels' log-likelihood ratios.

The noise of a lit pixel is ``variance + mean`` (Gaussian with the object's own Poisson noise), so the variance itself
tells lit from unlit.
"""

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ground.streaks.trail_model import edge

ZONE_SIGMAS = 3.6
"""Half width of the PSF's edge in which a pixel counts as partly lit."""

COARSE_DROP = 16.0
"""Natural-log drop from the best segment beyond which an end is not looked for."""

DENSITY_STEPS_SIGMA = 1.1 * np.arange(-4, 4)
"""Nodes of the density in conditional sigmas: the trapezoid rule on a Gaussian is exact to 1e-6 at this spacing."""


@dataclass(frozen=True, kw_only=True, eq=False)
class EndPosterior:
    """Moments of the joint posterior of (end0, end1, density), u along the trail in px.

    grid0, mass0 : nodes and probabilities of end 0 (likewise 1); one node for an end fixed at the frame's edge.
    """

    end0: float
    end1: float
    covariance_px2: NDArray[np.float64]
    density_e_px: float
    flux_e: float
    flux_err_e: float
    flux_end_covariance: NDArray[np.float64]
    grid0: NDArray[np.float64]
    mass0: NDArray[np.float64]
    grid1: NDArray[np.float64]
    mass1: NDArray[np.float64]


@njit(cache=True)
def log_ratio(value_e: float, variance_e2: float, mean_e: float) -> float:
    """ln p(value | lit with this mean) - ln p(value | dark)."""
    lit = variance_e2 + mean_e
    residual = value_e - mean_e
    return 0.5 * (value_e * value_e / variance_e2 - residual * residual / lit - math.log(lit / variance_e2))


@njit(cache=True)
def cumulative_ratio(
    template: NDArray[np.float64], value_e: NDArray[np.float64], variance_e2: NDArray[np.float64], densities: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Running sums, shape (densities, n + 1), of the log ratio of fully lit pixels in order of u."""
    n = value_e.size
    total = np.zeros((densities.size, n + 1))
    for k in range(densities.size):
        running = 0.0
        for i in range(n):
            running += log_ratio(value_e[i], variance_e2[i], densities[k] * template[i])
            total[k, i + 1] = running
    return total


@njit(cache=True)
def best_segment(running: NDArray[np.float64]) -> tuple[int, int, float]:
    """Indices (start, stop) of the segment with the largest sum, and that sum (Kadane's scan on running sums)."""
    lowest = 0
    best = -np.inf
    start, stop = 0, running.size - 1
    for j in range(1, running.size):
        if running[j] - running[lowest] > best:
            best = running[j] - running[lowest]
            start, stop = lowest, j
        if running[j] < running[lowest]:
            lowest = j
    return start, stop, best


@njit(cache=True)
def one_end(
    grid: NDArray[np.float64],
    sign: float,
    u: NDArray[np.float64],
    template: NDArray[np.float64],
    value_e: NDArray[np.float64],
    variance_e2: NDArray[np.float64],
    densities: NDArray[np.float64],
    cumulative: NDArray[np.float64],
    split: int,
    width: float,
) -> NDArray[np.float64]:
    """Log likelihood, shape (densities, grid), of one end over the pixels on its side of `split`.

    sign : +1 for end 0 (lit where u > end), -1 for end 1. u is ascending.
    """
    k_n = densities.size
    out = np.zeros((k_n, grid.size))
    reach = ZONE_SIGMAS * width
    for g in range(grid.size):
        low = np.searchsorted(u, grid[g] - reach)
        high = np.searchsorted(u, grid[g] + reach)
        if sign > 0.0:
            high = min(high, split)
            low = min(low, split)
            for k in range(k_n):
                out[k, g] = cumulative[k, split] - cumulative[k, high]
        else:
            low = max(low, split)
            high = max(high, split)
            for k in range(k_n):
                out[k, g] = cumulative[k, low] - cumulative[k, split]
        for i in range(low, high):
            share = edge(u[i], grid[g], width)
            lit = template[i] * (share if sign > 0.0 else 1.0 - share)
            for k in range(k_n):
                out[k, g] += log_ratio(value_e[i], variance_e2[i], densities[k] * lit)
    return out


@njit(cache=True)
def both_ends(
    grid0: NDArray[np.float64],
    grid1: NDArray[np.float64],
    u: NDArray[np.float64],
    template: NDArray[np.float64],
    value_e: NDArray[np.float64],
    variance_e2: NDArray[np.float64],
    densities: NDArray[np.float64],
    width: float,
) -> NDArray[np.float64]:
    """Log likelihood, shape (densities, grid0, grid1), when the edges overlap; -inf where end 1 is before end 0."""
    n = u.size
    share0 = np.empty((grid0.size, n))
    share1 = np.empty((grid1.size, n))
    for a in range(grid0.size):
        for i in range(n):
            share0[a, i] = edge(u[i], grid0[a], width)
    for b in range(grid1.size):
        for i in range(n):
            share1[b, i] = edge(u[i], grid1[b], width)
    out = np.zeros((densities.size, grid0.size, grid1.size))
    for a in range(grid0.size):
        for b in range(grid1.size):
            if grid1[b] < grid0[a]:
                out[:, a, b] = -np.inf
                continue
            for i in range(n):
                lit = template[i] * (share0[a, i] - share1[b, i])
                if lit < 1e-4 * template[i]:
                    continue
                for k in range(densities.size):
                    out[k, a, b] += log_ratio(value_e[i], variance_e2[i], densities[k] * lit)
    return out


def _grid(low: float, high: float, step: float) -> NDArray[np.float64]:
    """Nodes from low to high, at least three."""
    return np.linspace(low, high, max(3, int(math.ceil((high - low) / step)) + 1))


def _density_nodes(
    template: NDArray[np.float64], value_e: NDArray[np.float64], variance_e2: NDArray[np.float64], guess: float
) -> tuple[float, float]:
    """Density and its conditional sigma from fully lit pixels, weights with the object's noise at `guess`."""
    weight = 1.0 / (variance_e2 + max(guess, 0.0) * template)
    information = float(np.sum(weight * template * template))
    return float(np.sum(weight * template * value_e)) / information, 1.0 / math.sqrt(information)


def end_posterior(
    u: NDArray[np.float64],
    template: NDArray[np.float64],
    value_e: NDArray[np.float64],
    variance_e2: NDArray[np.float64],
    *,
    width_px: float,
    guess: tuple[float, float, float],
    fixed: tuple[float | None, float | None],
    line_parameters: int,
) -> EndPosterior | None:
    """Posterior of the ends along the trail; None where the pixels hold no trail.

    u : (n,) ascending; template : (n,) electrons per unit density of a fully lit pixel; value_e, variance_e2 : (n,).
    guess : (end0, end1, density). fixed : known ends (the frame's edge), None where free.
    line_parameters : how many parameters of the centre line were maximised over; each lifts the flux by 1 / (2 S^2),
    which the prior density**(-1/2) of each takes back.
    """
    if u.size < 5:
        return None
    end0, end1, density = guess
    lit = slice(*np.searchsorted(u, (end0, end1)))
    if lit.stop - lit.start < 3:
        lit = slice(0, u.size)
    sigma = density
    for _ in range(2):
        density, sigma = _density_nodes(template[lit], value_e[lit], variance_e2[lit], density)
        density = max(density, sigma)
    middle = np.array([density])
    coarse = cumulative_ratio(template, value_e, variance_e2, middle)[0]
    start, stop, _ = best_segment(coarse)
    if fixed[0] is not None:
        start = 0
    if fixed[1] is not None:
        stop = u.size
    if stop - start < 3:
        return None
    density, sigma = _density_nodes(template[start:stop], value_e[start:stop], variance_e2[start:stop], density)
    if density <= 0.0:
        return None
    split = (start + stop) // 2
    snr2 = (density / sigma) ** 2
    length = max(u[stop - 1] - u[start], 1.0)
    scale = max(length / snr2, 0.15 * width_px)
    drop0 = coarse[split] - coarse[: split + 1]
    drop1 = coarse[split:] - coarse[split]
    near0 = np.flatnonzero(drop0 > drop0.max() - COARSE_DROP)
    near1 = np.flatnonzero(drop1 > drop1.max() - COARSE_DROP) + split
    pad = 2.0 * width_px + scale
    last = u.size - 1
    low0, high0 = u[min(near0[0], last)] - pad, u[min(near0[-1], last)] + pad
    low1, high1 = u[min(near1[0], last)] - pad, u[min(near1[-1], last)] + pad
    step = max(scale / 12.0, 0.02)
    densities = density + sigma * DENSITY_STEPS_SIGMA
    densities = densities[densities > 0.05 * density]
    reach = 2.0 * ZONE_SIGMAS * width_px
    overlap = fixed[0] is None and fixed[1] is None and (u[stop - 1] - u[start] < 1.6 * reach or low1 - high0 < 0.5 * reach and length < 2.5 * reach)
    if overlap:
        spread = 4.0 * max(scale, 0.5 * width_px * 10.0 / math.sqrt(snr2), math.sqrt(3.5 * width_px * length / snr2))
        grid0 = np.linspace(u[start] - spread, u[start] + spread, 33)
        grid1 = np.linspace(u[stop - 1] - spread, u[stop - 1] + spread, 33)
        log_joint = both_ends(grid0, grid1, u, template, value_e, variance_e2, densities, width_px)
    else:
        center = 0.5 * (u[start] + u[stop - 1])
        grid0 = np.array([fixed[0]]) if fixed[0] is not None else _grid(low0, min(high0, center - 0.25 * reach), step)
        grid1 = np.array([fixed[1]]) if fixed[1] is not None else _grid(max(low1, center + 0.25 * reach), high1, step)
        cumulative = cumulative_ratio(template, value_e, variance_e2, densities)
        arrays = (u, template, value_e, variance_e2, densities, cumulative, split, width_px)
        log0 = one_end(grid0, 1.0, *arrays) if fixed[0] is None else (cumulative[:, split] - cumulative[:, 0])[:, None]
        log1 = one_end(grid1, -1.0, *arrays) if fixed[1] is None else (cumulative[:, -1] - cumulative[:, split])[:, None]
        return _moments_separable(grid0, grid1, log0, log1, densities, line_parameters)
    return _moments_joint(grid0, grid1, log_joint, densities, line_parameters)


def _moments_separable(
    grid0: NDArray[np.float64],
    grid1: NDArray[np.float64],
    log0: NDArray[np.float64],
    log1: NDArray[np.float64],
    densities: NDArray[np.float64],
    line_parameters: int,
) -> EndPosterior:
    """Moments of sum_k w_k p0(e0 | k) p1(e1 | k)."""
    top0, top1 = log0.max(axis=1), log1.max(axis=1)
    p0, p1 = np.exp(log0 - top0[:, None]), np.exp(log1 - top1[:, None])
    z0, z1 = p0.sum(axis=1), p1.sum(axis=1)
    log_weight = top0 + top1 + np.log(z0) + np.log(z1) - 0.5 * line_parameters * np.log(densities)
    weight = np.exp(log_weight - log_weight.max())
    weight /= weight.sum()
    p0 /= z0[:, None]
    p1 /= z1[:, None]
    m0, m1 = p0 @ grid0, p1 @ grid1
    s0, s1 = p0 @ grid0**2, p1 @ grid1**2
    return _assemble(grid0, grid1, weight @ p0, weight @ p1, weight, densities, m0, m1, s0, s1, m0 * m1)


def _moments_joint(
    grid0: NDArray[np.float64],
    grid1: NDArray[np.float64],
    log_joint: NDArray[np.float64],
    densities: NDArray[np.float64],
    line_parameters: int,
) -> EndPosterior:
    """Moments of the full grid (densities, grid0, grid1)."""
    log_joint = log_joint - 0.5 * line_parameters * np.log(densities)[:, None, None]
    joint = np.exp(log_joint - log_joint.max())
    joint /= joint.sum()
    weight = joint.sum(axis=(1, 2))
    conditional = joint / np.maximum(weight, 1e-300)[:, None, None]
    p0, p1 = conditional.sum(axis=2), conditional.sum(axis=1)
    product = np.einsum("kab,a,b->k", conditional, grid0, grid1)
    moments = (p0 @ grid0, p1 @ grid1, p0 @ grid0**2, p1 @ grid1**2, product)
    return _assemble(grid0, grid1, weight @ p0, weight @ p1, weight, densities, *moments)


def _assemble(
    grid0: NDArray[np.float64],
    grid1: NDArray[np.float64],
    mass0: NDArray[np.float64],
    mass1: NDArray[np.float64],
    weight: NDArray[np.float64],
    densities: NDArray[np.float64],
    m0: NDArray[np.float64],
    m1: NDArray[np.float64],
    s0: NDArray[np.float64],
    s1: NDArray[np.float64],
    m01: NDArray[np.float64],
) -> EndPosterior:
    """Means and covariances from the conditional moments of each density node."""
    end0, end1 = float(weight @ m0), float(weight @ m1)
    var0, var1 = float(weight @ s0) - end0**2, float(weight @ s1) - end1**2
    cov = float(weight @ m01) - end0 * end1
    length = m1 - m0
    flux = float(weight @ (densities * length))
    flux2 = float(weight @ (densities**2 * (s1 + s0 - 2.0 * m01)))
    flux_end = np.array(
        [
            float(weight @ (densities * (m01 - s0))) - flux * end0,
            float(weight @ (densities * (s1 - m01))) - flux * end1,
        ]
    )
    return EndPosterior(
        end0=end0,
        end1=end1,
        covariance_px2=np.array([[var0, cov], [cov, var1]]),
        density_e_px=float(weight @ densities),
        flux_e=flux,
        flux_err_e=math.sqrt(max(flux2 - flux * flux, 0.0)),
        flux_end_covariance=flux_end,
        grid0=grid0,
        mass0=mass0,
        grid1=grid1,
        mass1=mass1,
    )


def interval_68(grid: NDArray[np.float64], mass: NDArray[np.float64], mean: float) -> tuple[float, float]:
    """Central 68.27 % interval relative to `mean`, (low, high), from node probabilities."""
    if grid.size == 1:
        return 0.0, 0.0
    step = grid[1] - grid[0]
    borders = np.append(grid - 0.5 * step, grid[-1] + 0.5 * step)
    total = np.append(0.0, np.cumsum(mass))
    low, high = np.interp((0.158655, 0.841345), total / total[-1], borders)
    return float(low - mean), float(high - mean)
