"""Star fields with known positions, rendered independently of the simulator: pixel integrals of a Gaussian."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

SKY_E, READ_NOISE_E, GAIN_E_ADU, PEDESTAL_ADU = 2.8, 2.3, 1.2, 256


def axis_weights(centre_px: float, first: int, count: int, sigma_px: float) -> NDArray[np.float64]:
    """Share of a unit Gaussian in each of `count` pixels from `first` on."""
    borders = (np.arange(count + 1) + first - 0.5 - centre_px) / (sigma_px * np.sqrt(2.0))
    return 0.5 * np.diff(erf(borders))


@dataclass(frozen=True, kw_only=True, eq=False)
class StarField:
    """Noise-free electrons, and the stars in them."""

    electrons: NDArray[np.float64]
    row: NDArray[np.float64]
    col: NDArray[np.float64]
    flux_e: NDArray[np.float64]

    def exposed(self, rng: np.random.Generator) -> NDArray[np.uint16]:
        """ADU with photon and read noise on a pedestal."""
        noisy = rng.poisson(self.electrons) + rng.normal(0.0, READ_NOISE_E, self.electrons.shape)
        return np.clip(np.rint(noisy / GAIN_E_ADU + PEDESTAL_ADU), 0, 65535).astype(np.uint16)


def star_grid(
    rng: np.random.Generator, *, side: int, pitch: int, flux_e: tuple[float, float], sigma_px: float, trail_px: float = 0.0
) -> StarField:
    """Stars near the nodes of a grid, at random fractions of a pixel; log-uniform flux; trailed along rows if wanted."""
    nodes = np.arange(pitch // 2, side - pitch // 2, pitch)
    row, col = (a.ravel().astype(float) + rng.uniform(-0.5, 0.5, a.size) for a in np.meshgrid(nodes, nodes, indexing="ij"))
    flux = np.exp(rng.uniform(*np.log(flux_e), row.size))
    electrons = np.full((side, side), SKY_E)
    reach = 8
    n_steps = max(1, int(8 * trail_px))
    steps = ((np.arange(n_steps) + 0.5) / n_steps - 0.5) * trail_px
    for r, c, f in zip(row, col, flux, strict=True):
        i, j, count = int(r) - reach, int(c) - reach, 2 * reach + 1
        across = axis_weights(c, j, count, sigma_px)
        along = np.mean([axis_weights(r + step, i, count, sigma_px) for step in steps], axis=0)
        electrons[i : i + count, j : j + count] += f * np.outer(along, across)
    return StarField(electrons=electrons, row=row, col=col, flux_e=flux)


def centroid_bound_px(flux_e: float, sigma_px: float) -> float:
    """Cramer-Rao bound of one coordinate of a star in the middle of a pixel, flux and position free, sky known."""
    step = 1e-4
    profile = axis_weights(0.0, -8, 17, sigma_px)
    slope = (axis_weights(step, -8, 17, sigma_px) - axis_weights(-step, -8, 17, sigma_px)) / (2.0 * step)
    star = flux_e * np.outer(profile, profile)
    variance = star + SKY_E + READ_NOISE_E**2 + GAIN_E_ADU**2 / 12.0
    return float(1.0 / np.sqrt(np.sum((flux_e * np.outer(slope, profile)) ** 2 / variance)))


def matched_snr(flux_e: float, sigma_px: float) -> float:
    """Matched-filter S/N of a star, noise without the star."""
    profile = axis_weights(0.0, -8, 17, sigma_px)
    return float(flux_e * np.sum(profile**2) / np.sqrt(SKY_E + READ_NOISE_E**2 + GAIN_E_ADU**2 / 12.0))
