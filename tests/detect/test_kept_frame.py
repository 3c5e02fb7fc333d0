"""What is kept of a frame says the same as the frame, in a quarter of its bytes."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from onboard.detect import LineIntegralDetector
from onboard.detect.line_integral import static_sky
from onboard.detect.line_integral.kept_frame import KeptFrame, in_sigmas, kept, quantised
from onboard.detect.whiten import quantise
from onboard.image import registration
from sboc_e2e.icd.flags import MaskBit
from sboc_e2e.icd.signals import DetectorView
from tests.benchmarks.detection_frames import PSF_SIGMA_PX, Scene, Streak, add_streak, exposure, random_stars, view_of

SIZE = 512


def starry_view(seed: int = 3) -> DetectorView:
    """A field of stars up to S/N 20,000 with masked and saturated pixels."""
    rng = np.random.default_rng(seed)
    view = view_of(exposure(SIZE, random_stars(SIZE, 60_000, rng), rng))
    mask, residual = view.mask.copy(), view.residual_adu.copy()
    mask[100:103, 50:400], mask[rng.integers(0, SIZE, 50), rng.integers(0, SIZE, 50)] = MaskBit.DEAD, MaskBit.SATURATED
    residual[mask != 0] = 0.0
    return replace(view, mask=mask, residual_adu=residual)


def test_every_pixel_is_known_to_a_thirty_second_of_sigma_and_bright_ones_exactly() -> None:
    view = starry_view()
    frame = kept(view)
    value = np.array([[in_sigmas(frame.pixels, i, j) for j in range(SIZE)] for i in range(SIZE)])
    sigma = np.kron(view.background.sigma_adu, np.ones((view.background.tile_px,) * 2))[:SIZE, :SIZE]
    expected = view.residual_adu / sigma
    good = view.mask == 0
    assert np.array_equal(np.isnan(value), ~good)
    bright = good & (np.abs(expected) > 8.0)
    assert bright.sum() > 1000
    assert np.abs(value / expected - 1.0)[bright].max() < 1e-5
    assert np.abs(value - expected)[good & ~bright].max() < 0.5 / 16 + 1e-3
    assert np.abs(value - expected)[good & ~bright].std() < 1.05 / 16 / np.sqrt(12.0)


def test_its_rows_are_those_of_the_quantised_image() -> None:
    view = starry_view()
    image = quantise(view.residual_adu, view.mask, view.background.sigma_adu, view.background.tile_px)
    assert np.array_equal(quantised(kept(view).pixels[0]), image)


def test_stars_are_as_bright_in_it_as_in_their_list() -> None:
    """The list's S/N is the maximum-likelihood fit's, with the measured shape of the PSF: a few per cent."""
    view = starry_view()
    stars = view.stars
    clean = (stars.flags == 0) & (stars.snr > 8.0)
    before = static_sky.point_snr_before(kept(view).pixels, registration.IDENTITY, stars.row, stars.col, PSF_SIGMA_PX)[clean]
    known = np.isfinite(before)  # those on masked pixels are not
    ratio = before[known] / stars.snr[clean][known]
    assert known.sum() > 200
    assert known.mean() > 0.95
    assert abs(float(np.median(ratio)) - 1.0) < 0.05
    assert np.quantile(ratio, 0.01) > 0.7


def test_a_frame_without_noise_figures_is_unknown() -> None:
    view = view_of(Scene(image=np.zeros((64, 64), np.float32)))
    silent = replace(view, background=replace(view.background, sigma_adu=np.zeros_like(view.background.sigma_adu)))
    assert np.isnan(in_sigmas(kept(silent).pixels, 5, 5))


@pytest.mark.parametrize("seed", [1, 2])
def test_the_detector_finds_the_same_with_whole_views_in_its_history(seed: int) -> None:
    rng = np.random.default_rng(seed)
    stars = random_stars(SIZE, 3_000, rng)
    earlier, scene = view_of(exposure(SIZE, stars, rng)), exposure(SIZE, stars, rng, shift_px=(3.4, -2.2))
    add_streak(scene, Streak(row0=100.0, col0=40.0, row1=300.0, col1=460.0, snr=15.0), rng)
    detector = LineIntegralDetector()
    frame = detector.remembered(earlier)
    assert isinstance(frame, KeptFrame)
    assert len(pickle.dumps(frame.pixels)) < 1.3 * SIZE * SIZE
    found = detector.detect(view_of(scene, frame=1, history=(earlier,)))
    assert found
    assert found == detector.detect(view_of(scene, frame=1, history=(frame,)))
