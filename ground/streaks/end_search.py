"""Approximate ends of a trail: change points of the running log-likelihood ratio along its line.

The PSF's soft edge is neglected here; `end_posterior` does the rest. Whether an end is an end at all, or the trail runs
out of the image, is decided here too.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ground.streaks.no_trail import NoTrailError, Reason

DROP: Final = 16.0
"""Natural-log drop from the best segment beyond which an end is not looked for."""

KEEP_EDGE_PROBABILITY: Final = 0.01
"""Probability of the edge below which the detector's word is not taken; see `SET_EDGE_PROBABILITY`. Chosen, not measured."""
SET_EDGE_PROBABILITY: Final = 0.5
"""A trail that the detector says leaves the image is believed unless the pixels say otherwise, and the reverse."""

COVERED_PX: Final = 3.0
"""Largest distance of the pixels from the image's edge at which they can show whether the trail leaves the image."""


@dataclass(frozen=True, kw_only=True)
class CoarseEnds:
    """Ends along the line (px) with their spread, the density, and whether each end is the image's edge.

    range0, range1 : (low, high) within which each end lies. limits : u where the pixels or the image end.
    """

    end0: float
    end1: float
    sigma0_px: float
    sigma1_px: float
    range0: tuple[float, float]
    range1: tuple[float, float]
    limits: tuple[float, float]
    edges: tuple[bool, bool]
    density_e_px: float
    density_err_e_px: float

    @property
    def length_px(self) -> float:
        """Distance of the ends."""
        return max(self.end1 - self.end0, 1.0)

    @property
    def snr2(self) -> float:
        """Square of density over its error."""
        return (self.density_e_px / self.density_err_e_px) ** 2


@njit(cache=True, error_model="numpy")
def pixel_ratio(value_e: float, variance_e2: float, lit: float, noise_density: float) -> tuple[float, float, float]:
    """ln p(value | lit) - ln p(value | dark) of one pixel: coefficients for `at_density`; lit : electrons per unit density."""
    quiet, square, c1, c2 = pixel_parts(value_e, variance_e2, lit, noise_density)
    return square + 0.5 * math.log(quiet), c1, c2


@njit(cache=True, error_model="numpy")
def pixel_parts(value_e: float, variance_e2: float, lit: float, noise_density: float) -> tuple[float, float, float, float]:
    """The same with the constant in two parts: a ratio of variances, half of whose logarithm is to be added, and the rest."""
    light = noise_density * lit
    inverse = 1.0 / (variance_e2 + light)
    return (
        variance_e2 * inverse,
        0.5 * value_e * value_e * light * inverse / variance_e2,
        value_e * lit * inverse,
        lit * lit * inverse,
    )


@njit(cache=True, error_model="numpy")
def running_ratio(
    template: NDArray[np.float64], value_e: NDArray[np.float64], variance_e2: NDArray[np.float64], noise_density: float
) -> NDArray[np.float64]:
    """Running sums of ln p(value | lit) - ln p(value | dark) of pixels in order of u: (3, n + 1) coefficients for `at_density`.

    The variance of a lit pixel is taken at `noise_density` for all densities: that a lit pixel is noisier helps to tell
    it from a dark one, but scatter that no model explains (tumbling, misfit) must not pass for brightness.
    """
    n = value_e.size
    total = np.zeros((3, n + 1))
    for i in range(n):
        c0, c1, c2 = pixel_ratio(value_e[i], variance_e2[i], template[i], noise_density)
        total[0, i + 1] = total[0, i] + c0
        total[1, i + 1] = total[1, i] + c1
        total[2, i + 1] = total[2, i] + c2
    return total


def at_density(coefficients: NDArray[np.float64], density_e_px: NDArray[np.float64] | float) -> NDArray[np.float64]:
    """Log ratio c0 + c1 d - c2 d^2 / 2 at the density d, which broadcasts against the coefficients' (3, ...) last axes."""
    density = np.asarray(density_e_px)
    ratio: NDArray[np.float64] = coefficients[0] + density * (coefficients[1] - 0.5 * density * coefficients[2])
    return ratio


@njit(cache=True, error_model="numpy")
def best_segment(running: NDArray[np.float64]) -> tuple[int, int]:
    """Indices (start, stop) of the segment with the largest sum (Kadane's scan on running sums)."""
    lowest = 0
    best = -np.inf
    start, stop = 0, running.size - 1
    for j in range(1, running.size):
        if running[j] - running[lowest] > best:
            best = running[j] - running[lowest]
            start, stop = lowest, j
        if running[j] < running[lowest]:
            lowest = j
    return start, stop


def lit_density(
    template: NDArray[np.float64], value_e: NDArray[np.float64], variance_e2: NDArray[np.float64], guess: float
) -> tuple[float, float]:
    """Density and its sigma from fully lit pixels; the object's own noise at the density `guess`.

    Raises `NoTrailError` where no pixel says anything about it.
    """
    weight = 1.0 / (variance_e2 + max(guess, 0.0) * template)
    information = float(np.sum(weight * template * template))
    if not information > 0.0:
        raise NoTrailError(Reason.TOO_FEW_PIXELS)
    return float(np.sum(weight * template * value_e)) / information, 1.0 / math.sqrt(information)


def coarse_ends(
    u: NDArray[np.float64],
    template: NDArray[np.float64],
    value_e: NDArray[np.float64],
    variance_e2: NDArray[np.float64],
    *,
    guess: tuple[float, float, float],
    edges: tuple[bool, bool],
    image_limits: tuple[float, float],
) -> CoarseEnds | None:
    """Ends by their posterior with hard edges at one density; None where no trail is lit.

    u : (n,) ascending. template : (n,) electrons per unit density of a fully lit pixel. guess : (end0, end1, density).
    edges : which ends the detector says lie on the image's edge, at u = image_limits.
    """
    if u.size < 5:
        return None
    start, stop = (int(i) for i in np.searchsorted(u, guess[:2]))
    if stop - start < 3:
        start, stop = 0, u.size
    density = guess[2]
    running = np.zeros(1)
    for _ in range(2):
        for _ in range(2):
            density, sigma = lit_density(template[start:stop], value_e[start:stop], variance_e2[start:stop], density)
            density = max(density, sigma)
        running = at_density(running_ratio(template, value_e, variance_e2, density), density)
        start, stop = best_segment(running)
        start, stop = 0 if edges[0] else start, u.size if edges[1] else stop
        if stop - start < 3:
            return None
    density, sigma = lit_density(template[start:stop], value_e[start:stop], variance_e2[start:stop], density)
    if not density > 0.0 or not np.isfinite(running).all():
        return None
    split = (start + stop) // 2
    length = max(u[stop - 1] - u[start], 1.0)
    covered = (max(image_limits[0], u[0] - 1.0), min(image_limits[1], u[-1] + 1.0))
    steps = np.gradient(np.append(u, u[-1] + (u[-1] - u[0]) / u.size))
    log0, log1 = running[split] - running[: split + 1], running[split:] - running[split]
    end0 = _one_side(np.append(u, covered[1])[: split + 1], log0, steps[: split + 1])
    end1 = _one_side(np.append(u, covered[1])[split:], log1, steps[split:])
    on_edge = [False, False]
    for side, (log_beyond, evidence, gap) in enumerate(
        ((log0[0], end0[4], u[0] - image_limits[0]), (log1[-1], end1[4], image_limits[1] - u[-1]))
    ):
        if gap > COVERED_PX:
            on_edge[side] = edges[side]
            continue
        beyond = log_beyond + math.log(0.5 * length)
        probability = 1.0 / (1.0 + math.exp(min(max(evidence - beyond, -50.0), 50.0)))
        on_edge[side] = probability > (KEEP_EDGE_PROBABILITY if edges[side] else SET_EDGE_PROBABILITY)
    return CoarseEnds(
        end0=image_limits[0] if on_edge[0] else end0[0],
        end1=image_limits[1] if on_edge[1] else end1[0],
        sigma0_px=0.0 if on_edge[0] else end0[1],
        sigma1_px=0.0 if on_edge[1] else end1[1],
        range0=end0[2:4],
        range1=end1[2:4],
        limits=covered,
        edges=(on_edge[0], on_edge[1]),
        density_e_px=density,
        density_err_e_px=sigma,
    )


def _one_side(
    u: NDArray[np.float64], log_likelihood: NDArray[np.float64], steps: NDArray[np.float64]
) -> tuple[float, float, float, float, float]:
    """Mean, sigma, range (low, high) and log evidence of one end."""
    top = float(log_likelihood.max())
    # far below the top the exponential would underflow into slow denormal numbers
    mass = np.exp(np.maximum(log_likelihood - top, -200.0)) * np.maximum(steps, 0.0)
    total = float(mass.sum())
    mean = float(mass @ u) / total
    sigma = math.sqrt(max(float(mass @ (u - mean) ** 2) / total, 0.0))
    near = np.flatnonzero(log_likelihood >= top - DROP)
    return mean, sigma, float(u[near[0]]), float(u[near[-1]]), top + math.log(total)
