"""The camera's shared parameters over frames of the same stars: with and without thermal drift, errors mean what they say."""

from collections.abc import Callable

import numpy as np
import pytest

from ground.astrometry.camera import Camera
from ground.astrometry.camera_drift import FrameEvidence, SharedKnowledge

TRUE = Camera(focal_px=44450.0, center_row=2047.5, center_col=2047.5, k1=-1.02, k2=0.0, p1=3e-5, p2=-1e-5)
PRIOR = np.array([1e-3, 1.1, 1e3, 2e-2, 2e-2])
WHITE_PX, CATALOGUE_PX = 0.012, 0.013
SPAN_S, N_FRAMES = 150.0, 40
"""600 frames at 4 frames/s, every fifteenth of them."""


def at_rest(share: float) -> float:
    return 0.0


def warming(share: float) -> float:
    """20 ppm over the span."""
    return 20e-6 * share


def run(seed: int, drift: Callable[[float], float], *, new_field: bool = False, drift_s: float = 1e-7) -> SharedKnowledge:
    """Knowledge after the span, from 250 stars with known linear model; the truth starts at `TRUE`."""
    rng = np.random.default_rng(seed)
    known = SharedKnowledge.prior(TRUE.shared() + PRIOR * np.array([0.2, 0.02, 0.0, 1e-3, 1e-3]), PRIOR, drift_s)
    values = TRUE.shared()
    for k in range(N_FRAMES):
        if k == 0 or new_field:
            row, col = rng.uniform(0.0, 4095.0, (2, 250))
            _, by_rotation, by_shared = TRUE.derivatives(TRUE.unproject(row, col))
            turn, shared = by_rotation.reshape(-1, 3), by_shared.reshape(-1, 5)
            free = shared - turn @ np.linalg.lstsq(turn, shared, rcond=None)[0]
            by_catalogue = rng.normal(0.0, CATALOGUE_PX, len(free))
        variance = WHITE_PX**2 + CATALOGUE_PX**2
        noise = rng.normal(0.0, WHITE_PX, len(free)) + by_catalogue
        values = TRUE.shared() + np.array([drift(k / N_FRAMES), 0.0, 0.0, 0.0, 0.0])
        known = known if k == 0 else known.after(SPAN_S / N_FRAMES)
        known = known.seen(
            FrameEvidence(
                values=values,
                gradient=free.T @ noise / variance,
                information=free.T @ free / variance,
                catalogue=free.T @ free * CATALOGUE_PX**2 / variance**2,
                new_field=1.0 if k == 0 or new_field else 0.0,
            )
        )
    return known


def focal_errors(drift: Callable[[float], float], n: int = 100, **options: bool) -> tuple[np.ndarray, np.ndarray]:
    """Relative error of the focal length at the end of runs, and what they say it is."""
    runs = [run(seed, drift, **options) for seed in range(n)]
    true = np.log(TRUE.focal_px) + drift((N_FRAMES - 1) / N_FRAMES)
    return np.array([k.values[0] - true for k in runs]), np.array([np.sqrt(k.errors[0, 0]) for k in runs])


@pytest.mark.parametrize("drift", [at_rest, warming])
def test_pulls_of_the_focal_length_hold_with_and_without_drift(drift):
    """Of 100 runs of one star field each; the rms of as many pulls scatters by 0.07."""
    error, sigma = focal_errors(drift)
    assert np.sqrt(np.mean((error / sigma) ** 2)) == pytest.approx(1.0, abs=0.1)
    assert sigma.mean() < 4e-6
