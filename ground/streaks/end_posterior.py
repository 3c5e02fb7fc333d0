"""Posterior of both ends and the brightness of a trail along a known centre line.

Below S^2 ~ 7.3 L / sigma the ends of a trail are change points: the likelihood is a random walk with drift around each
of them, maximum likelihood scatters by sqrt(26) L / S^2 and biases the flux upwards; the posterior mean scatters by
sqrt(16 zeta(3)) L / S^2 (Ibragimov & Khasminskii 1981; Rubin & Song 1995). So both ends and the density are integrated,
not maximised. Given the density, the two ends are independent as long as their PSFs do not overlap, because each
pixel between them counts as lit for any place of the other end. The joint posterior is a short sum over densities of
products of two one-dimensional posteriors, each made from cumulative sums of the pixels' log-likelihood ratios.

The noise of a lit pixel is ``variance + mean`` (Gaussian with the object's own Poisson noise), so the variance itself
tells lit from unlit.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ground.streaks.end_search import CoarseEnds, at_density, pixel_parts, running_ratio
from ground.streaks.trail_model import edge

ZONE_SIGMAS: Final = 3.4
"""Half width of the PSF's edge in which a pixel counts as partly lit."""

DENSITY_STEPS_SIGMA: Final[NDArray[np.float64]] = 1.2 * np.arange(-4.0, 5.0)
"""Nodes of the density in conditional sigmas: the trapezoid rule on a Gaussian is exact to 1e-5 at this spacing."""

SHORT_NODES: Final = 25
"""Nodes of each end of a short trail."""

SMALLEST_PRODUCT: Final = 1e-200
"""Ratios of variances are multiplied to here, and one logarithm is taken of all: doubles hold one more factor."""

EDGE_STEPS: Final = 256
"""Values of the PSF's edge to a sigma, 4 sigma to both sides: straight lines between err by 0.242 / 8 / 256^2 = 5e-7 at most."""
EDGE_TABLE: Final = np.array(
    [0.5 * math.erfc(-k / (EDGE_STEPS * math.sqrt(2.0))) for k in range(-4 * EDGE_STEPS, 4 * EDGE_STEPS + 2)]
)


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
    grid0: NDArray[np.float64]
    mass0: NDArray[np.float64]
    grid1: NDArray[np.float64]
    mass1: NDArray[np.float64]


@njit(cache=True, error_model="numpy")
def tabulated_edge(t: float) -> float:
    """Phi(t) for t within `ZONE_SIGMAS`."""
    at = (t + 4.0) * EDGE_STEPS
    k = int(at)
    return EDGE_TABLE[k] + (at - k) * (EDGE_TABLE[k + 1] - EDGE_TABLE[k])


@njit(cache=True, error_model="numpy")
def one_end(
    grid: NDArray[np.float64],
    sign: float,
    u: NDArray[np.float64],
    template: NDArray[np.float64],
    value_e: NDArray[np.float64],
    variance_e2: NDArray[np.float64],
    noise_density: float,
    running: NDArray[np.float64],
    split: int,
    width: float,
) -> NDArray[np.float64]:
    """Log likelihood of one end over the pixels on its side of `split`: (3, grid) coefficients for `at_density`.

    sign : +1 for end 0 (lit where u > end), -1 for end 1. u is ascending. running : of `running_ratio`.
    """
    out = np.zeros((3, grid.size))
    reach = ZONE_SIGMAS * width
    for g in range(grid.size):
        low = np.searchsorted(u, grid[g] - reach)
        high = np.searchsorted(u, grid[g] + reach)
        if sign > 0.0:
            high = min(high, split)
            low = min(low, split)
            for c in range(3):
                out[c, g] = running[c, split] - running[c, high]
        else:
            low = max(low, split)
            high = max(high, split)
            for c in range(3):
                out[c, g] = running[c, low] - running[c, split]
        s0 = s1 = s2 = 0.0
        product = 1.0
        for i in range(low, high):
            lit = template[i] * tabulated_edge(sign * (u[i] - grid[g]) / width)
            quiet, c0, c1, c2 = pixel_parts(value_e[i], variance_e2[i], lit, noise_density)
            s0, s1, s2, product = s0 + c0, s1 + c1, s2 + c2, product * quiet
            if product < SMALLEST_PRODUCT:
                s0, product = s0 + 0.5 * math.log(product), 1.0
        out[0, g] += s0 + 0.5 * math.log(product)
        out[1, g] += s1
        out[2, g] += s2
    return out


@njit(cache=True, error_model="numpy")
def both_ends(
    grid0: NDArray[np.float64],
    grid1: NDArray[np.float64],
    u: NDArray[np.float64],
    template: NDArray[np.float64],
    value_e: NDArray[np.float64],
    variance_e2: NDArray[np.float64],
    noise_density: float,
    width: float,
) -> NDArray[np.float64]:
    """Log likelihood when the edges overlap: (3, grid0, grid1) coefficients for `at_density`; -inf where end 1 is first."""
    n = u.size
    share0 = np.empty((grid0.size, n))
    share1 = np.empty((grid1.size, n))
    for a in range(grid0.size):
        for i in range(n):
            share0[a, i] = edge(u[i], grid0[a], width)
    for b in range(grid1.size):
        for i in range(n):
            share1[b, i] = edge(u[i], grid1[b], width)
    out = np.zeros((3, grid0.size, grid1.size))
    for a in range(grid0.size):
        for b in range(grid1.size):
            if grid1[b] < grid0[a]:
                out[0, a, b] = -np.inf
                continue
            s0 = s1 = s2 = 0.0
            product = 1.0
            for i in range(n):
                share = share0[a, i] - share1[b, i]
                if share < 1e-4:
                    continue
                quiet, c0, c1, c2 = pixel_parts(value_e[i], variance_e2[i], template[i] * share, noise_density)
                s0, s1, s2, product = s0 + c0, s1 + c1, s2 + c2, product * quiet
                if product < SMALLEST_PRODUCT:
                    s0, product = s0 + 0.5 * math.log(product), 1.0
            out[0, a, b] = s0 + 0.5 * math.log(product)
            out[1, a, b] = s1
            out[2, a, b] = s2
    return out


def _grid(low: float, high: float, step: float) -> NDArray[np.float64]:
    """Nodes from low to high, at least three."""
    return np.linspace(low, high, max(3, math.ceil((high - low) / step) + 1))


@dataclass(frozen=True, kw_only=True, eq=False)
class EndTables:
    """Log likelihoods of each end given the density: log0 (K, G0) on grid0, log1 (K, G1) on grid1, densities (K,).

    The joint one of (density, end 0, end 1) is their sum. An end at the image's edge has one node. open0, open1 : the grid
    reaches to the last pixel, and the end may lie beyond it. snr2_per_px (K,) : square of the S/N of a pixel's length of trail.
    """

    grid0: NDArray[np.float64]
    grid1: NDArray[np.float64]
    log0: NDArray[np.float64]
    log1: NDArray[np.float64]
    densities: NDArray[np.float64]
    open0: bool
    open1: bool
    snr2_per_px: NDArray[np.float64]


def end_tables(
    u: NDArray[np.float64],
    template: NDArray[np.float64],
    value_e: NDArray[np.float64],
    variance_e2: NDArray[np.float64],
    *,
    width_px: float,
    coarse: CoarseEnds,
) -> EndTables:
    """Likelihood of both ends of a trail whose two edges do not overlap.

    u : (n,) ascending; template : (n,) electrons per unit density of a fully lit pixel; value_e, variance_e2 : (n,).
    coarse : where the ends were found, and which are the frame's edge.
    """
    split = int(np.searchsorted(u, 0.5 * (coarse.end0 + coarse.end1)))
    scale = max(coarse.length_px / coarse.snr2, 0.15 * width_px)
    step = max(scale / 8.0, 0.02)
    pad = 2.0 * width_px + 0.5 * scale
    center = u[min(split, u.size - 1)]
    nodes = coarse.density_e_px + coarse.density_err_e_px * DENSITY_STEPS_SIGMA
    densities: NDArray[np.float64] = nodes[nodes > 0.05 * coarse.density_e_px]
    grid0 = _grid(max(coarse.range0[0] - pad, coarse.limits[0]), min(coarse.range0[1] + pad, center - width_px), step)
    grid1 = _grid(max(coarse.range1[0] - pad, center + width_px), min(coarse.range1[1] + pad, coarse.limits[1]), step)
    if coarse.edges[0]:
        grid0 = np.array([coarse.end0])
    if coarse.edges[1]:
        grid1 = np.array([coarse.end1])
    running = running_ratio(template, value_e, variance_e2, coarse.density_e_px)
    arrays = (u, template, value_e, variance_e2, coarse.density_e_px, running, split, width_px)
    # an end on the image's edge: all pixels on its side are lit
    side0 = (running[:, split] - running[:, 0])[:, None] if coarse.edges[0] else one_end(grid0, 1.0, *arrays)
    side1 = (running[:, -1] - running[:, split])[:, None] if coarse.edges[1] else one_end(grid1, -1.0, *arrays)
    return EndTables(
        grid0=grid0,
        grid1=grid1,
        log0=at_density(side0[:, None], densities[:, None]),
        log1=at_density(side1[:, None], densities[:, None]),
        densities=densities,
        open0=bool(grid0[0] <= coarse.limits[0]),
        open1=bool(grid1[-1] >= coarse.limits[1]),
        snr2_per_px=(densities / coarse.density_err_e_px) ** 2 / coarse.length_px,
    )


def end_posterior(tables: EndTables, *, brightness: tuple[float, float, float], line_parameters: int) -> EndPosterior:
    """Posterior moments with flat priors on place, density and logarithm of length.

    Flat priors on both ends instead would count every longer trail as another possibility: ends of faint short trails then lie
    0.1 to 0.4 of their rms outside.
    brightness : (half_px, q1, q2) of `trail_model`, for the flux between two ends. line_parameters : how many
    parameters of the centre line were maximised over: each lifts the S/N found by 1 / (2 S), which a prior S^(-1/2) of
    each takes back.
    """
    middle0, middle1 = float(tables.grid0.mean()), float(tables.grid1.mean())
    tilt = (1.0 + 0.25 * line_parameters) / max(middle1 - middle0, 1.0)
    log0 = tables.log0 + tilt * (tables.grid0 - middle0)
    log1 = tables.log1 - tilt * (tables.grid1 - middle1)
    return _moments_separable(tables.grid0, tables.grid1, log0, log1, tables.densities, brightness, line_parameters)


def short_trail_posterior(
    u: NDArray[np.float64],
    template: NDArray[np.float64],
    value_e: NDArray[np.float64],
    variance_e2: NDArray[np.float64],
    *,
    width_px: float,
    center: NDArray[np.float64],
    covariance: NDArray[np.float64],
    line_parameters: int,
) -> EndPosterior:
    """The same for a uniform trail so short that its edges overlap: the full grid of (density, end 0, end 1).

    center, covariance : (3,), (3, 3) of (density, end 0, end 1) from Fisher scoring; the grid spans several sigmas of it.
    """
    sigma = np.sqrt(np.diag(covariance))
    given_ends = math.sqrt(1.0 / np.linalg.inv(covariance)[0, 0])
    snr = center[0] / given_ends
    spread = 4.2 + 12.0 / snr
    count = min(max(int(2.0 * spread * sigma[0] / given_ends), 9), 24)
    densities = np.linspace(max(center[0] - spread * sigma[0], 0.1 * center[0]), center[0] + spread * sigma[0], count)
    grid0 = center[1] + sigma[1] * np.linspace(-spread, spread, SHORT_NODES)
    grid1 = center[2] + sigma[2] * np.linspace(-spread, spread, SHORT_NODES)
    coefficients = both_ends(grid0, grid1, u, template, value_e, variance_e2, float(center[0]), width_px)
    log_joint = at_density(coefficients[:, None], densities[:, None, None])
    length = np.maximum(grid1[None, :] - grid0[:, None], 0.25 * width_px)
    log_joint -= 0.5 * line_parameters * np.log(densities)[:, None, None] + (1.0 + 0.25 * line_parameters) * np.log(length)
    return _moments_joint(grid0, grid1, log_joint, densities)


def _moments_separable(
    grid0: NDArray[np.float64],
    grid1: NDArray[np.float64],
    log0: NDArray[np.float64],
    log1: NDArray[np.float64],
    densities: NDArray[np.float64],
    brightness: tuple[float, float, float],
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
    weight0, weight1 = weight @ p0, weight @ p1
    end0, end1 = float(weight0 @ grid0), float(weight1 @ grid1)
    d0, d1 = grid0 - end0, grid1 - end1
    m0, m1 = p0 @ d0, p1 @ d1
    covariance = np.array([[weight0 @ d0**2, weight @ (m0 * m1)], [weight @ (m0 * m1), weight1 @ d1**2]])
    lit0, lit1 = lit_length(grid0, brightness), lit_length(grid1, brightness)
    f0, f1 = p0 @ lit0, p1 @ lit1
    flux = float(weight @ (densities * (f1 - f0)))
    square = float(weight @ (densities**2 * (p1 @ lit1**2 - 2.0 * f0 * f1 + p0 @ lit0**2)))
    return EndPosterior(
        end0=end0,
        end1=end1,
        covariance_px2=covariance,
        density_e_px=float(weight @ densities),
        flux_e=flux,
        flux_err_e=math.sqrt(max(square - flux * flux, 0.0)),
        grid0=grid0,
        mass0=weight0,
        grid1=grid1,
        mass1=weight1,
    )


def _moments_joint(
    grid0: NDArray[np.float64], grid1: NDArray[np.float64], log_joint: NDArray[np.float64], densities: NDArray[np.float64]
) -> EndPosterior:
    """Moments of the full grid (densities, grid0, grid1)."""
    joint = np.exp(log_joint - log_joint.max())
    joint /= joint.sum()
    ends = joint.sum(axis=0)
    mass0, mass1 = ends.sum(axis=1), ends.sum(axis=0)
    end0, end1 = float(mass0 @ grid0), float(mass1 @ grid1)
    d0, d1 = grid0 - end0, grid1 - end1
    cross = float(d0 @ ends @ d1)
    length = grid1[None, :] - grid0[:, None]
    first = np.tensordot(densities, joint, axes=1) * length
    second = np.tensordot(densities**2, joint, axes=1) * length**2
    flux = float(first.sum())
    return EndPosterior(
        end0=end0,
        end1=end1,
        covariance_px2=np.array([[mass0 @ d0**2, cross], [cross, mass1 @ d1**2]]),
        density_e_px=float(densities @ joint.sum(axis=(1, 2))),
        flux_e=flux,
        flux_err_e=math.sqrt(max(float(second.sum()) - flux * flux, 0.0)),
        grid0=grid0,
        mass0=mass0,
        grid1=grid1,
        mass1=mass1,
    )


def lit_length(u: NDArray[np.float64], brightness: tuple[float, float, float]) -> NDArray[np.float64]:
    """Integral of the brightness b(x) from 0 to u (px): the length of a uniform trail of the same flux."""
    half, q1, q2 = brightness
    x = u / half
    return half * (x + 0.5 * q1 * x * x + q2 * (x**3 - x) / 3.0)


def interval_68(grid: NDArray[np.float64], mass: NDArray[np.float64], mean: float) -> tuple[float, float]:
    """Central 68.27 % interval relative to `mean`, (low, high), from node probabilities."""
    if grid.size == 1:
        return 0.0, 0.0
    step = grid[1] - grid[0]
    borders = np.append(grid - 0.5 * step, grid[-1] + 0.5 * step)
    total = np.append(0.0, np.cumsum(mass))
    low, high = np.interp((0.158655, 0.841345), total / total[-1], borders)
    return float(low - mean), float(high - mean)
