"""The tests' own numerical Fisher matrix against the closed forms of a long uniform trail in white noise."""

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.streaks.trail_rendering import (
    PSF_SIGMA_PX,
    VARIANCE_E2,
    best_equivariant_end_px,
    fisher_covariance,
    render,
    strip,
    trail_at,
)


@pytest.mark.parametrize("length_px", [100.0, 300.0])
def test_numerical_bounds_match_the_closed_forms(length_px: float) -> None:
    """End sqrt(2 sqrt(pi) s L) / S, cross-track sqrt(2) s / S, flux sqrt(1 / S^2 + 2 end^2 / L^2); s holds the pixel too."""
    rng = np.random.default_rng(1)
    trail = trail_at(rng, length_px, angle_rad=0.4)
    row, col = strip(trail, margin_px=10.0, half_px=8.0)
    unit = render(trail, row, col)
    # so faint that the object's own Poisson noise does not count
    snr = 0.05
    trail = replace(trail, flux_e=snr / math.sqrt(float(np.sum(unit**2)) / VARIANCE_E2))
    covariance = fisher_covariance(trail, row, col)
    width = math.sqrt(PSF_SIGMA_PX**2 + 1.0 / 12.0)
    end = math.sqrt(2.0 * math.sqrt(math.pi) * width * length_px) / snr
    cross = math.sqrt(2.0) * width / snr
    flux = math.sqrt(1.0 / snr**2 + 2.0 * end**2 / length_px**2)
    measured_cross = 0.5 * math.sqrt(covariance[3, 3] + covariance[4, 4] + 2.0 * covariance[3, 4])
    assert math.sqrt(covariance[1, 1]) == pytest.approx(end, rel=0.03)
    assert measured_cross == pytest.approx(cross, rel=0.03)
    assert math.sqrt(covariance[0, 0]) / trail.flux_e == pytest.approx(flux, rel=0.03)


def test_best_equivariant_estimator_follows_the_change_point_law_when_faint() -> None:
    """Pitman's estimator of one end scatters by sqrt(16 zeta(3)) L / S^2 = 4.39 L / S^2 (Rubin & Song 1995), to a tenth."""
    rng = np.random.default_rng(2)
    length_px, snr = 300.0, 8.0
    trail = trail_at(rng, length_px)
    row, col = strip(trail, margin_px=10.0, half_px=8.0)
    unit = render(trail, row, col)
    trail = replace(trail, flux_e=snr / math.sqrt(float(np.sum(unit**2)) / VARIANCE_E2))
    measured = best_equivariant_end_px(trail, rng, draws=600)
    assert measured == pytest.approx(4.39 * length_px / snr**2, rel=0.15)
