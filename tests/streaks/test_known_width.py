"""What an uncertain PSF width does to fluxes; block means of pixels."""

import math
from dataclasses import replace

import numpy as np
import pytest

from ground.streaks import TrailedPsfFitter, known_width
from ground.streaks.centre_line import effective_width_px
from ground.streaks.psf_field import SCATTER
from ground.streaks.trail_frame import TrailFrame
from ground.streaks.trail_pixels import usable_pixels
from tests.streaks.trail_rendering import PSF_SIGMA_PX, VARIANCE_E2, expose, trail_at


def test_flux_follows_half_the_width_in_sky_noise_and_not_at_all_in_photon_noise() -> None:
    assert known_width.flux_slope(1e-3, 9.0, 0.9) == pytest.approx(0.5, abs=0.01)
    assert known_width.flux_slope(1e7, 9.0, 0.9) == pytest.approx(0.0, abs=0.01)


def test_the_width_moves_as_far_as_the_pixels_can_tell() -> None:
    assert known_width.posterior(0.04, 1.0)[0] == pytest.approx(0.0, abs=1e-4)
    assert known_width.posterior(0.04, 1e-4) == pytest.approx((0.04, 1e-4), rel=1e-3)
    assert known_width.posterior(0.04, SCATTER)[0] == pytest.approx(0.02)
    assert known_width.posterior(0.0, math.inf) == (0.0, SCATTER)


def test_a_bright_trail_takes_back_half_of_what_a_wrong_width_does_to_its_flux() -> None:
    rng = np.random.default_rng(7)
    fitter, shift, expected = TrailedPsfFitter(), [], []
    for _ in range(6):
        exposure = expose(rng, trail_at(rng, 150.0), 90.0)
        right = fitter.fit(exposure.pixels, exposure.detection)
        wide = fitter.fit(replace(exposure.pixels, psf_sigma_px=1.05 * PSF_SIGMA_PX), exposure.detection)
        shift.append(math.log(wide.flux_e / right.flux_e))
        width = effective_width_px(PSF_SIGMA_PX)
        slope = known_width.flux_slope(exposure.trail.flux_e / 150.0, VARIANCE_E2, width)
        expected.append(slope * math.log(effective_width_px(1.05 * PSF_SIGMA_PX) / width))
    assert 0.25 < np.mean(shift) / np.mean(expected) < 0.75


def test_block_means_hold_all_light_and_all_weight() -> None:
    rng = np.random.default_rng(3)
    exposure = expose(rng, trail_at(rng, 300.0), 30.0)
    trail = exposure.trail
    frame = TrailFrame.of_chord(trail.row0, trail.col0, trail.row1, trail.col1)
    pixels = usable_pixels(exposure.pixels, frame, 7.0)
    blocks = pixels.in_blocks(6.0, 0.5)
    assert blocks.u.size < 0.5 * pixels.u.size
    for name in ("u", "v", "value_e"):
        whole = np.sum(getattr(pixels, name) / pixels.variance_e2)
        assert np.sum(getattr(blocks, name) / blocks.variance_e2) == pytest.approx(whole, rel=1e-9, abs=1e-6)
