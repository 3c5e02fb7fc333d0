"""Flashes on trails: a tumbler's glints are its own light, while stars and particle hits are not."""

from dataclasses import replace

import numpy as np
import pytest

from ground.streaks import TrailedPsfFitter
from ground.streaks.light_curve import light_curve
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.products import StreakFit
from tests.streaks.trail_rendering import Exposure, Trail, expose, render, strip, trail_at

FITTER = TrailedPsfFitter()
SNR = 300.0


def bright(rng: np.random.Generator) -> tuple[Trail, np.ndarray, np.ndarray]:
    """A trail of 290 px with its pixels, which do not depend on what is added."""
    trail = trail_at(rng, 290.0, angle_rad=0.3)
    return trail, *strip(trail, margin_px=30.0, half_px=8.0)


def point(trail: Trail, at: float, beside_px: float, half_px: float, light_e: float) -> Trail:
    """Light spread evenly over 2 half_px along the trail, at this share of it and this far beside."""
    cos, sin = trail.axes
    row = trail.row0 + at * (trail.row1 - trail.row0) + beside_px * cos
    col = trail.col0 + at * (trail.col1 - trail.col0) - beside_px * sin
    ends = {"row0": row - half_px * sin, "col0": col - half_px * cos, "row1": row + half_px * sin, "col1": col + half_px * cos}
    return replace(trail, flux_e=light_e, **ends)


def fitted(rng: np.random.Generator, trail: Trail, extra_e: np.ndarray) -> tuple[StreakFit, Exposure]:
    seen = expose(rng, trail, SNR, extra_e=extra_e, margin_px=30.0)
    return FITTER.fit(seen.pixels, seen.detection), seen


@pytest.mark.parametrize(("at", "half_px", "light_e"), [(0.06, 4.0, 6000.0), (0.4, 4.0, 6000.0), (0.4, 6.0, 12000.0)])
def test_light_of_a_flash_counts(at: float, half_px: float, light_e: float) -> None:
    """A flash of 30 to 40 ms in an exposure of 1 s that moves by 290 px: a seventh of the light or more, masked as a star.

    The mask reaches some widths beyond the light of the longest one.
    """
    rng = np.random.default_rng(11)
    trail, row, col = bright(rng)
    flash = point(trail, at, 0.0, half_px, light_e)
    fit, seen = fitted(rng, trail, render(flash, row, col))
    assert fit.flash_e == pytest.approx(light_e, rel=0.1)
    assert fit.flux_e == pytest.approx(seen.trail.flux_e + light_e, abs=4.0 * fit.flux_err_e)
    assert fit.flags & StreakFlag.VARIABLE
    assert abs(fit.row1 - trail.row1) + abs(fit.col1 - trail.col1) < 0.5


@pytest.mark.parametrize("beside_px", [0.0, 1.2, -2.0])
def test_an_unlisted_star_is_no_flash(beside_px: float) -> None:
    """Neither beside the line nor on it."""
    rng = np.random.default_rng(12)
    trail, row, col = bright(rng)
    star = point(trail, 0.4, beside_px, 0.05, 6000.0)
    fit, seen = fitted(rng, trail, render(star, row, col))
    assert fit.flash_e == 0.0
    assert fit.flux_e == pytest.approx(seen.trail.flux_e, rel=0.02)


def test_a_particle_hit_on_the_line_is_no_flash() -> None:
    rng = np.random.default_rng(13)
    trail, row, col = bright(rng)
    at = point(trail, 0.4, 0.0, 0.0, 1.0)
    place = np.argmin(np.hypot(row - at.row0, col - at.col0))
    hit = np.zeros(len(row))
    hit[place] = 6000.0
    fit, seen = fitted(rng, trail, hit)
    assert fit.flash_e == 0.0
    assert fit.flux_e == pytest.approx(seen.trail.flux_e, rel=0.02)


def test_bins_without_pixels_are_not_known() -> None:
    """A masked stretch holds the smooth model; its error was 1 e/px, a five-hundredth of the light."""
    u = np.arange(0.0, 300.0, 0.2)
    density = np.full(len(u), 500.0)
    kept = (u < 100.0) | (u > 120.0)
    profile = np.full(len(u), 0.4)
    curve = light_curve(
        u[kept], profile[kept], (density * profile)[kept], np.full(kept.sum(), 10.0), ends=(0.0, 300.0),
        smooth_density_e_px=density[kept], width_px=0.9, snr=1000.0,
    )  # fmt: skip
    middle = (np.arange(len(curve.density_e_px)) + 0.5) * 300.0 / len(curve.density_e_px)
    empty = (middle > 103.0) & (middle < 117.0)
    assert empty.any()
    assert (curve.sigma_e_px[empty] > 400.0).all()
    assert (curve.sigma_e_px[(middle < 95.0) | (middle > 125.0)] < 50.0).all()
