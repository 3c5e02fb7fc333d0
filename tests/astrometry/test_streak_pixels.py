"""ROI strips become electrons above the background: nothing lost, nothing twice, stars out, bad pixels out."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import erf

from ground.photometry.background import background_at
from ground.photometry.known_stars import FrameLight, KnownStars
from ground.photometry.streak_pixels import _without_numbers, streak_pixels
from ground.streaks.psf_field import PsfField
from sboc_e2e.icd.flags import MaskBit
from sboc_e2e.icd.frame import Calibration, FrameHeader, NominalCamera
from sboc_e2e.icd.signals import BackgroundModel, Detection, RoiGroup, Strip
from tests.downlink import bare_frame

SHAPE = (120, 160)
GAIN, PSF = 1.5, 0.9
DETECTION = Detection(row0=40.0, col0=30.0, row1=60.0, col1=110.0, snr=20.0)
WIDTH = PsfField.nominal(PSF, SHAPE)
NO_STARS = KnownStars(
    row=np.zeros(0), col=np.zeros(0), flux_e=np.zeros(0), unspoilt=np.zeros(0, dtype=bool), inverse_snr=np.zeros(0)
)


def _star_image(row: float, col: float, flux_e: float) -> np.ndarray:
    """A Gaussian star integrated over pixels."""
    root2 = np.sqrt(2.0) * PSF
    r, c = np.arange(SHAPE[0]), np.arange(SHAPE[1])
    by_row = 0.5 * (erf((r + 0.5 - row) / root2) - erf((r - 0.5 - row) / root2))
    by_col = 0.5 * (erf((c + 0.5 - col) / root2) - erf((c - 0.5 - col) / root2))
    return flux_e * np.outer(by_row, by_col)


def _strips(image_adu: np.ndarray) -> tuple[Strip, ...]:
    """Two overlapping strips along the columns that follow the detection."""
    strips = []
    for first, last in ((25, 75), (70, 118)):
        slope = (60.0 - 40.0) / 80.0
        minor0 = int((40.0 + (first - 30.0) * slope - 6.0) * 65536)
        strip = Strip(
            axis=1,
            major0=first,
            minor0_fp=minor0,
            slope_fp=int(slope * 65536),
            level_adu=0,
            values_adu=np.zeros((last - first, 13), dtype=np.int32),
        )
        row, col, inside = strip.pixel_coordinates(*SHAPE)
        assert inside.all()
        strips.append(replace(strip, values_adu=image_adu[row, col].astype(np.int32)))
    return tuple(strips)


def _calibration(rng: np.random.Generator) -> Calibration:
    camera = NominalCamera(
        name="t",
        rows=SHAPE[0],
        cols=SHAPE[1],
        focal_px=5000.0,
        center_row=59.5,
        center_col=79.5,
        psf_sigma_px=PSF,
        gain_e_adu=GAIN,
        read_noise_e=2.0,
        saturation_adu=30000.0,
        full_well_e=40000.0,
        zero_point_e_s=1e8,
        aperture_m=0.2,
    )
    defects = np.zeros(SHAPE, dtype=np.uint8)
    defects[50, 70] = MaskBit.HOT
    return Calibration(
        camera=camera,
        dark_adu=rng.uniform(95.0, 105.0, SHAPE).astype(np.float32),
        flat=(0.8 * rng.normal(1.0, 0.02, SHAPE)).astype(np.float32),
        defects=defects,
    )


@pytest.fixture
def scene():
    rng = np.random.default_rng(7)
    calibration = _calibration(rng)
    # a sky gradient, a trail-like constant, and a star on the trail, all in electrons; the flat acts on light
    gradient = 60.0 + 0.1 * np.arange(SHAPE[1])[None, :] + np.zeros(SHAPE)
    star = _star_image(46.0, 54.0, 4000.0)
    light_e = star * calibration.flat / 0.8 + gradient
    raw_adu = np.rint(light_e / GAIN + calibration.dark_adu)
    tile = 20
    background = BackgroundModel(
        tile_px=tile,
        level_adu=np.add.outer(np.zeros(6), (60.0 + 0.1 * (np.arange(8) * tile + 0.5 * (tile - 1))) / GAIN).astype(np.float32),
        sigma_adu=np.full((6, 8), 4.0, dtype=np.float32),
    )
    header = FrameHeader(
        frame=0, t_start_tai_ns=0, exposure_ns=10**8, line_time_ns=0, rows=SHAPE[0], cols=SHAPE[1], gain_e_adu=GAIN
    )
    frame = bare_frame(header, background=background)
    group = RoiGroup(roi_id=3, detection=DETECTION, strips=_strips(raw_adu - np.rint(calibration.dark_adu)), n_strips=2)
    stars = KnownStars(
        row=np.array([46.0]),
        col=np.array([54.0]),
        flux_e=np.array([4000.0]),
        unspoilt=np.array([True]),
        inverse_snr=np.zeros(1),
    )
    return frame, calibration, group, stars


def _pixels(scene, stars):
    frame, calibration, group, _ = scene
    return streak_pixels(group, frame, calibration, FrameLight(stars=stars, psf=WIDTH), star_model_error=0.05)


def test_background_dark_and_star_leave_nothing_but_rounding(scene):
    pixels, crossed = _pixels(scene, scene[3])
    assert crossed
    usable = np.isfinite(pixels.variance_e2)
    far = np.hypot(pixels.row - 46.0, pixels.col - 54.0) > 5.0
    # one ADU of rounding is 1.5 e-, uniform: never more than 0.75 e- over the relative flat
    assert np.abs(pixels.value_e[usable & far]).max() < 0.85
    assert np.abs(pixels.value_e[usable & ~far]).max() < 2.0


def test_pixels_come_once_and_bad_ones_have_no_weight(scene):
    pixels, _ = _pixels(scene, NO_STARS)
    keys = pixels.row.astype(np.int64) * SHAPE[1] + pixels.col
    assert len(np.unique(keys)) == len(keys)
    assert len(keys) == 13 * (118 - 25)
    hot = (pixels.row == 50) & (pixels.col == 70)
    assert hot.sum() == 1
    assert np.isinf(pixels.variance_e2[hot]).all()
    assert np.isfinite(pixels.variance_e2[~hot]).all()


def test_star_is_left_in_when_unknown_and_its_error_counts_when_known(scene):
    with_star, _ = _pixels(scene, NO_STARS)
    without, _ = _pixels(scene, scene[3])
    centre = (with_star.row == 46) & (with_star.col == 54)
    peak = _star_image(46.0, 54.0, 4000.0)[46, 54]
    assert abs(with_star.value_e[centre][0] - peak) < 3.0
    assert abs(without.value_e[centre][0]) < 3.0
    # its photon noise and 5 % of the model
    extra = without.variance_e2[centre][0] - with_star.variance_e2[centre][0]
    assert abs(extra - (peak + (0.05 * peak) ** 2)) < 0.02 * extra


def test_error_of_a_remembered_star_counts_by_its_signal_to_noise(scene):
    exact, _ = _pixels(scene, scene[3])
    vague, _ = _pixels(scene, replace(scene[3], inverse_snr=np.array([0.1])))
    centre = (exact.row == 46) & (exact.col == 54)
    peak = _star_image(46.0, 54.0, 4000.0)[46, 54]
    np.testing.assert_array_equal(vague.value_e, exact.value_e)
    assert vague.variance_e2[centre][0] - exact.variance_e2[centre][0] == pytest.approx((0.1 * peak) ** 2, rel=0.01)


def test_a_listed_star_on_the_trail_that_no_catalogue_knows_is_left_alone(scene):
    stars = replace(scene[3], unspoilt=np.array([False]))
    pixels, crossed = _pixels(scene, stars)
    plain, _ = _pixels(scene, NO_STARS)
    np.testing.assert_array_equal(pixels.value_e, plain.value_e)
    assert not crossed


def test_background_falls_back_to_what_is_known(scene):
    frame = scene[0]
    row, col = np.array([5, 60]), np.array([5, 80])
    level, sigma = background_at(replace(frame, background=None), row, col)
    assert not level.any()
    assert (sigma > 0.0).all()


def test_an_empty_group_gives_no_pixels(scene):
    frame, calibration, group, stars = scene
    pixels, _ = streak_pixels(
        replace(group, strips=()), frame, calibration, FrameLight(stars=stars, psf=WIDTH), star_model_error=0.05
    )
    assert len(pixels.row) == 0


def test_pixels_that_held_no_number_are_not_used_and_chance_zeros_are():
    """A masked border of three columns, two zeros of the noise, and three zeros over the end of a row."""
    row = np.repeat(np.arange(3), 6)
    col = np.tile(np.arange(6), 3)
    count = np.array([[5.0, 3.0, 7.0, 0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 4.0, 0.0, 0.0], [0.0, 2.0, 9.0, 1.0, -3.0, 6.0]]).ravel()
    unknown = _without_numbers(row, col, count).reshape(3, 6)
    assert unknown[0].tolist() == [False] * 3 + [True] * 3
    assert not unknown[1:].any()
    assert _without_numbers(row[:2], col[:2], count[:2]).tolist() == [False, False]
