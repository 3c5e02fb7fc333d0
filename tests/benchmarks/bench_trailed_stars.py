"""Star lists of frames whose pointing follows something else (nadir, an object): stars as trails, against the Cramer-Rao bound.

Trails are drawn as sums of pixel-integrated Gaussians, independently of the simulator and of the extractor. The bound of a
trail's centre, along and across, has flux and both coordinates free, sky and trail vector known.
"""

import json
import math
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from onboard.stars.matched import MatchedStars
from sboc_e2e.icd.flags import StarFlag
from tests.benchmarks.bench_codecs import figure
from tests.onboard.star_fields import GAIN_E_ADU, READ_NOISE_E, SKY_E, StarField, axis_weights
from tests.onboard.test_stars import SIGMA_PX, view_of

LENGTHS_PX: Final = (0.0, 3.0, 6.0, 12.0, 25.0, 50.0)
ANGLE_DEG: Final = 25.0
FLUX_E: Final = (300.0, 40000.0)
LEAST_SNR: Final = 10.0


def trail(row: float, col: float, vector: tuple[float, float], first: tuple[int, int], side: int) -> NDArray[np.float64]:
    """A trail of unit flux centred at (row, col), integrated over the pixels of a square window."""
    n = max(1, math.ceil(6.0 * math.hypot(*vector)))
    steps = (np.arange(n) + 0.5) / n - 0.5
    spots = [
        np.outer(
            axis_weights(row + s * vector[0], first[0], side, SIGMA_PX),
            axis_weights(col + s * vector[1], first[1], side, SIGMA_PX),
        )
        for s in steps
    ]
    return np.asarray(np.mean(spots, axis=0))


def bounds_px(flux_e: float, vector: tuple[float, float]) -> tuple[float, float, float]:
    """Cramer-Rao bounds of the centre along and across the trail, px, and the matched-filter S/N."""
    half = 8 + math.ceil(0.5 * math.hypot(*vector))
    first, side, step = (-half, -half), 2 * half + 1, 1e-3
    length = math.hypot(*vector)
    along = (vector[0] / length, vector[1] / length) if length > 0.0 else (1.0, 0.0)
    shape = trail(0.0, 0.0, vector, first, side)
    slopes = [shape.ravel()]
    for u in (along, (-along[1], along[0])):
        ahead, behind = (
            trail(step * u[0], step * u[1], vector, first, side),
            trail(-step * u[0], -step * u[1], vector, first, side),
        )
        slopes.append(flux_e * (ahead - behind).ravel() / (2.0 * step))
    sky = SKY_E + READ_NOISE_E**2 + GAIN_E_ADU**2 / 12.0
    design = np.stack(slopes)
    covariance = np.linalg.inv((design / (sky + flux_e * shape.ravel())) @ design.T)
    return math.sqrt(covariance[1, 1]), math.sqrt(covariance[2, 2]), flux_e * math.sqrt(float(np.sum(shape**2)) / sky)


def field_of(rng: np.random.Generator, vector: tuple[float, float], side: int = 1024) -> StarField:
    """Stars trailed by `vector` on a grid with room between them, at random fractions of a pixel."""
    pitch = 32 + math.ceil(math.hypot(*vector))
    nodes = np.arange(pitch, side - pitch, pitch)
    row, col = (a.ravel() + rng.uniform(-0.5, 0.5, a.size) for a in np.meshgrid(nodes, nodes, indexing="ij"))
    flux = np.exp(rng.uniform(*np.log(FLUX_E), row.size))
    electrons, half = np.full((side, side), SKY_E), 8 + math.ceil(0.5 * math.hypot(*vector))
    for r, c, f in zip(row, col, flux, strict=True):
        i, j = int(r) - half, int(c) - half
        electrons[i : i + 2 * half + 1, j : j + 2 * half + 1] += f * trail(r, c, vector, (i, j), 2 * half + 1)
    return StarField(electrons=electrons, row=row, col=col, flux_e=flux)


def one_length(length_px: float, frames: int) -> dict[str, Any]:
    """Completeness, centroids along and across over their bounds, and flux, of stars above S/N 10."""
    angle = math.radians(ANGLE_DEG)
    vector = (length_px * math.sin(angle), length_px * math.cos(angle))
    unit = np.array([math.sin(angle), math.cos(angle)])
    fluxes = np.geomspace(*FLUX_E, 25)
    table = np.log([bounds_px(float(f), vector) for f in fluxes])
    ratios: list[NDArray[np.float64]] = []
    relative, n_found, n_all, n_flagged = [], 0, 0, 0
    for seed in range(frames):
        rng = np.random.default_rng(seed)
        field = field_of(rng, vector)
        stars = MatchedStars().extract(view_of(field.exposed(rng)))
        along, across, snr = (np.exp(np.interp(np.log(field.flux_e), np.log(fluxes), table[:, k])) for k in range(3))
        distance, index = cKDTree(np.column_stack((stars.row, stars.col))).query(np.column_stack((field.row, field.col)))
        seen = snr > LEAST_SNR
        found = seen & (distance < 2.0)
        n_all, n_found = n_all + int(seen.sum()), n_found + int(found.sum())
        n_flagged += int(((stars.flags[index[found]] & StarFlag.TRAILED) != 0).sum())
        apart = np.column_stack((stars.row[index] - field.row, stars.col[index] - field.col))[found]
        ratios.append(np.column_stack((apart @ unit / along[found], apart @ np.array([-unit[1], unit[0]]) / across[found])))
        relative.append(float(np.median(stars.flux_e[index[found]] / field.flux_e[found])) - 1.0)
    ratio = np.concatenate(ratios)
    out = {
        "completeness_snr10": {"value": n_found / n_all, "n": n_all},
        "flagged_trailed_fraction": {"value": n_flagged / max(n_found, 1), "n": n_found},
        "relative_flux_bias": figure(relative),
    }
    for k, axis in enumerate(("along", "across")):
        value = float(np.sqrt(np.median(ratio[:, k] ** 2) / 0.4549))
        half = 1.645 * value / math.sqrt(2.0 * 0.37 * len(ratio))  # a median of squares is 37 % as efficient as their mean
        out[f"{axis}_crlb_ratio"] = {"value": value, "n": len(ratio), "low": value - half, "high": value + half}
    return out


def main(quick: bool = False) -> dict[str, Any]:
    """Every length of trail."""
    return {f"trail_{length:.0f}_px": one_length(length, 1 if quick else 6) for length in LENGTHS_PX}


if __name__ == "__main__":
    print(json.dumps(main(), indent=2))  # noqa: T201 - the script's result
