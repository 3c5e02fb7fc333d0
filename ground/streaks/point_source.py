"""Fit of a source that does not trail: flux, position and width of a pixel-integrated Gaussian."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, kw_only=True, eq=False)
class PointFit:
    """Position (row, col), flux and width with covariance (4, 4) of (flux_e, row, col, ln width) as fitted."""

    flux_e: float
    row: float
    col: float
    width_px: float
    covariance: NDArray[np.float64]
    chi2: float
    snr: float
    n_pixels: int


def fit_point(
    row: NDArray[np.float64],
    col: NDArray[np.float64],
    value_e: NDArray[np.float64],
    variance_e2: NDArray[np.float64],
    *,
    start: tuple[float, float],
    width_px: float,
    free_width: bool,
    iterations: int = 30,
) -> PointFit | None:
    """Fisher scoring from a Gaussian of `width_px`; None where the pixels hold no source.

    width_px : pixel included. The object's own Poisson noise comes from the model.
    """
    width = width_px
    row0, col0, flux = start[0], start[1], 0.0
    n = 4 if free_width else 3
    covariance = np.zeros((4, 4))
    for iteration in range(iterations + 1):
        use = (np.hypot(row - row0, col - col0) < 5.0 * width) & np.isfinite(variance_e2)
        if np.count_nonzero(use) < n + 1:
            return None
        dr, dc = row[use] - row0, col[use] - col0
        unit = np.exp(-0.5 * (dr**2 + dc**2) / width**2) / (2.0 * math.pi * width**2)
        if iteration == 0:
            flux = float(np.sum(unit * value_e[use] / variance_e2[use]) / np.sum(unit**2 / variance_e2[use]))
        mean = flux * unit
        weight = 1.0 / (variance_e2[use] + np.maximum(mean, 0.0))
        residual = value_e[use] - mean
        shape = (dr**2 + dc**2) / width**2 - 2.0
        derivatives = np.array([unit, mean * dr / width**2, mean * dc / width**2, mean * shape])[:n]
        fisher = (derivatives * weight) @ derivatives.T
        scale = np.sqrt(np.maximum(np.diag(fisher), 1e-300))
        inverse = np.linalg.pinv(fisher / np.outer(scale, scale), rcond=1e-10) / np.outer(scale, scale)
        covariance[:n, :n] = inverse
        if iteration == iterations:
            break
        step = inverse @ (derivatives @ (weight * residual))
        step[1:3] = np.clip(step[1:3], -0.5 * width, 0.5 * width)
        flux, row0, col0 = flux + step[0], row0 + step[1], col0 + step[2]
        if free_width:
            width = min(max(width * math.exp(min(max(step[3], -0.3), 0.3)), 0.3), 20.0)
        if np.hypot(row0 - start[0], col0 - start[1]) > 6.0 * width + 3.0:
            return None
        if np.all(np.abs(step) < 1e-3 * np.sqrt(np.diag(inverse))):
            break
    if not flux > 0.0:
        return None
    return PointFit(
        flux_e=float(flux),
        row=float(row0),
        col=float(col0),
        width_px=width,
        covariance=covariance,
        chi2=float(np.sum(weight * residual**2)),
        snr=float(np.sqrt(np.sum(mean**2 / variance_e2[use]))),
        n_pixels=int(np.count_nonzero(use)),
    )
