"""Background, noise spectrum, star widths and star places on images whose answers are known."""

import numpy as np
import pytest

from sboc_e2e.validation.background import match, measure_background
from sboc_e2e.validation.figures import compare, slope
from sboc_e2e.validation.noise import noise_spectrum
from sboc_e2e.validation.sources import SIGMA_TO_FWHM, find_sources, gaussian_fit, star_widths
from sboc_e2e.validation.star_places import match_known
from sboc_e2e.validation.subjects import KnownStars, Picture

SIZE = 384


def star_frame(seed=1, n_stars=60, level=300.0, noise=5.0, sigma=(1.9, 1.3), angle_deg=30.0):
    """Elliptical Gaussian stars on white noise, and their rows, cols and fluxes."""
    rng = np.random.default_rng(seed)
    image = rng.normal(level, noise, (SIZE, SIZE))
    row, col = rng.uniform(15, SIZE - 15, (2, n_stars))
    flux = 40.0 * noise * 4 * np.pi * sigma[0] * sigma[1] / 4 * rng.random(n_stars) ** -0.8
    y, x = np.mgrid[:SIZE, :SIZE]
    cos, sin = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    for r, c, f in zip(row, col, flux, strict=True):
        part = np.s_[max(0, int(r) - 14) : int(r) + 15, max(0, int(c) - 14) : int(c) + 15]
        u = (x[part] - c) * cos + (y[part] - r) * sin
        v = -(x[part] - c) * sin + (y[part] - r) * cos
        light = np.exp(-0.5 * ((u / sigma[0]) ** 2 + (v / sigma[1]) ** 2))
        image[part] += f / (2 * np.pi * sigma[0] * sigma[1]) * light
    return image.astype(np.float32), row, col, flux


def test_background_is_found_among_stars():
    image, *_ = star_frame()
    background = measure_background(image)
    assert background.level == pytest.approx(300.0, abs=0.15)
    assert background.noise == pytest.approx(5.0, rel=0.02)
    assert 0.7 < background.free.mean() < 0.99


def test_match_is_the_linear_map():
    image, *_ = star_frame()
    linear = match(measure_background(image), measure_background(2.5 * image - 40.0))
    assert linear.gain == pytest.approx(2.5, rel=0.01)
    assert linear.bias == pytest.approx(-40.0, abs=5.0)


def test_white_noise_has_a_flat_spectrum():
    image = np.random.default_rng(3).normal(100.0, 4.0, (SIZE, SIZE)).astype(np.float32)
    spectrum = noise_spectrum(measure_background(image))
    assert spectrum is not None
    assert np.abs(spectrum.radial - 1.0).max() < 0.12
    assert spectrum.row_structure == pytest.approx(1.0, abs=0.3)
    assert spectrum.col_structure == pytest.approx(1.0, abs=0.3)


def test_row_noise_shows_along_columns_of_the_spectrum():
    rng = np.random.default_rng(4)
    image = rng.normal(100.0, 4.0, (SIZE, SIZE)) + rng.normal(0.0, 1.0, (SIZE, 1))
    spectrum = noise_spectrum(measure_background(image.astype(np.float32)))
    assert spectrum is not None
    # row means have variance 1 + 16 / SIZE where white noise would have 17 / SIZE
    assert spectrum.row_structure == pytest.approx((1 + 16 / SIZE) / (17 / SIZE), rel=0.35)
    assert spectrum.col_structure < 1.5
    assert spectrum.along_cols.mean() > 3.0 * spectrum.along_rows.mean()


def test_smoothed_noise_falls_with_frequency():
    noise = np.random.default_rng(5).normal(0.0, 4.0, (SIZE, SIZE + 1))
    image = (100.0 + 0.5 * (noise[:, 1:] + noise[:, :-1])).astype(np.float32)
    spectrum = noise_spectrum(measure_background(image))
    assert spectrum is not None
    # the mean of two neighbours has power 2 cos^2(pi f) along rows
    f = np.arange(1, 32) / 64
    assert spectrum.along_rows == pytest.approx(2 * np.cos(np.pi * f) ** 2, abs=0.9)
    assert np.mean(spectrum.along_rows / (2 * np.cos(np.pi * f) ** 2 + 0.05)) == pytest.approx(1.0, abs=0.2)


@pytest.mark.parametrize("angle_deg", [0.0, 30.0, 75.0, 140.0])
def test_gaussian_fit_gives_widths_and_angle(angle_deg):
    y, x = np.mgrid[-9:10, -9:10] - 0.3
    cos, sin = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    stamp = 50.0 * np.exp(-0.5 * (((x * cos + y * sin) / 2.1) ** 2 + ((-x * sin + y * cos) / 1.4) ** 2)) + 3.0
    fitted = gaussian_fit(stamp)
    assert fitted is not None
    assert fitted[0] == pytest.approx(2.1 * SIGMA_TO_FWHM, rel=1e-4)
    assert fitted[1] == pytest.approx(1.4 * SIGMA_TO_FWHM, rel=1e-4)
    assert min(abs(fitted[2] - angle_deg), 180 - abs(fitted[2] - angle_deg)) < 0.05


def test_widths_of_isolated_stars():
    image, *_ = star_frame()
    background = measure_background(image)
    widths = star_widths(background, find_sources(background, 4.0), np.inf)
    assert len(widths) > 15
    assert np.median(widths.major) == pytest.approx(1.9 * SIGMA_TO_FWHM, rel=0.03)
    assert np.median(widths.minor) == pytest.approx(1.3 * SIGMA_TO_FWHM, rel=0.03)
    assert np.median(widths.angle_deg) == pytest.approx(30.0, abs=4.0)


def test_catalogue_stars_are_matched_through_a_wrong_offset():
    image, row, col, flux = star_frame()
    known = KnownStars(
        star_id=np.arange(len(row)), row=row - 17.0, col=col + 9.0, v_mag=-2.5 * np.log10(flux), origin="these stars"
    )
    background = measure_background(image)
    stars = match_known(find_sources(background, 4.0), known)
    assert len(stars) > 40
    assert (stars.offset_row, stars.offset_col) == pytest.approx((17.0, -9.0), abs=0.1)
    assert 1.4826 * np.median(np.abs(stars.row)) < 0.15
    assert 1.4826 * np.median(np.abs(stars.magnitude - np.median(stars.magnitude))) < 0.1


def test_chance_pairs_do_not_make_an_offset():
    image, row, col, _ = star_frame(n_stars=30)
    rng = np.random.default_rng(9)
    places = rng.uniform(30, SIZE - 30, (200, 2))
    apart = np.hypot(places[:, :1] - row, places[:, 1:] - col)
    # near enough for a wrong shift to be found, too far for a star at its own place
    empty = places[(apart.min(axis=1) > 8.0) & (apart.min(axis=1) < 30.0)][:2]
    known = KnownStars(star_id=np.arange(2), row=empty[:, 0], col=empty[:, 1], v_mag=np.zeros(2), origin="nothing is there")
    stars = match_known(find_sources(measure_background(image), 4.0), known)
    assert (stars.offset_row, stars.offset_col, len(stars)) == (0.0, 0.0, 0)


def test_slope_of_a_power_law():
    flux = ((np.arange(4000) + 0.5) / 4000) ** (-1 / 0.9)
    assert slope(flux) == pytest.approx(0.9, rel=0.01)


def test_two_draws_of_the_same_camera_agree():
    first, second = (Picture(name=str(s), image=np.rint(star_frame(seed=s, n_stars=90)[0])) for s in (1, 2))
    figures = compare(first, second).figures
    assert figures["match"]["gain"] == pytest.approx(1.0, abs=0.02)
    background = figures["histogram"]["background"]
    assert background["wasserstein_sigma"] < 0.02
    assert background["bhattacharyya"] < 1e-3
    assert figures["noise"]["rms_log_ratio"] < 0.1
    assert figures["stars"]["flux_ks_probability"] > 0.01
    assert figures["psf"]["wasserstein_px"] < 0.1


def test_another_camera_is_told_apart():
    first, second = (
        Picture(name="narrow", image=star_frame(seed=1)[0]),
        Picture(name="wide", image=star_frame(seed=2, sigma=(2.6, 2.0))[0]),
    )
    figures = compare(first, second).figures
    assert figures["psf"]["ks"]["value"] > 0.8
    assert figures["psf"]["wasserstein_px"] == pytest.approx(((2.6 * 2.0) ** 0.5 - (1.9 * 1.3) ** 0.5) * SIGMA_TO_FWHM, rel=0.1)
