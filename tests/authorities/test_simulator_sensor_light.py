"""Light on pixels against numerical integration: pixel-integrated stars, trails, the defocus disc, the blur angle."""

import math

import numpy as np
import pytest
from scipy import integrate, signal

from simulator.camera import Camera
from simulator.exposure import render_stars, render_trail
from simulator.optics.defocus import disc_profile
from simulator.optics.psf import PsfOptions, sigma_at
from simulator.optics.vignetting import (
    IlluminationGrid,
    VignettingOptions,
    grid_step_px,
    illumination_of_row,
    node_places,
    relative_illumination,
)
from simulator.options import SimulatorOptions


def centroid(image):
    total = image.sum(dtype=float)
    rows, cols = np.indices(image.shape)
    return float((image * rows).sum() / total), float((image * cols).sum() / total), float(total)


@pytest.mark.parametrize("sigma_px", [0.6, 0.85, 1.7])
@pytest.mark.parametrize(("row", "col"), [(12.0, 12.0), (12.37, 11.81), (11.5, 12.5)])
def test_a_star_is_its_gaussian_integrated_over_pixels(sigma_px, row, col):
    image = np.zeros((25, 25), dtype=np.float32)
    render_stars(image, [row], [col], [1e6], sigma_px)

    def gaussian(x, y):
        return math.exp(-0.5 * ((x - col) ** 2 + (y - row) ** 2) / sigma_px**2) / (2.0 * math.pi * sigma_px**2)

    for r, c in ((12, 12), (11, 13), (14, 12), (10, 10)):
        share, _ = integrate.dblquad(gaussian, r - 0.5, r + 0.5, c - 0.5, c + 0.5, epsabs=1e-10)
        assert image[r, c] / 1e6 == pytest.approx(share, abs=1e-7)
    mean_row, mean_col, total = centroid(image)
    assert total == pytest.approx(1e6, rel=1e-4)
    assert (mean_row, mean_col) == pytest.approx((row, col), abs=1e-3)


def test_the_stamp_of_any_star_loses_less_than_stated():
    rng = np.random.default_rng(2)
    for flux in 10.0 ** np.arange(0.0, 8.0):
        image = np.zeros((61, 61), dtype=np.float64).astype(np.float32)
        render_stars(image, [30.0 + rng.uniform(-0.5, 0.5)], [30.0 + rng.uniform(-0.5, 0.5)], [flux], 1.5)
        rounding = 3e-7 * flux
        assert abs(image.sum(dtype=float) - flux) < min(0.02, 1e-4 * flux) + rounding


def test_stars_at_the_edge_are_cut_not_wrapped():
    image = np.zeros((20, 30), dtype=np.float32)
    render_stars(image, [-0.5, 10.0, 25.0], [15.0, 29.5, -40.0], [1000.0, 1000.0, 1000.0], 1.0)
    assert image.sum() == pytest.approx(1000.0, rel=1e-4)
    assert image[10:, :10].sum() == 0.0
    assert image[16:, :].sum() < 1e-3


@pytest.mark.parametrize(("defocus_px", "obstruction"), [(0.0, 0.0), (1.5, 0.0), (8.0, 0.0), (8.0, 0.4), (30.0, 0.3)])
def test_flux_and_centroid_of_a_trail_are_exact(defocus_px, obstruction):
    image = np.zeros((140, 260), dtype=np.float32)
    t = (np.arange(400) + 0.5) / 400
    row, col = 60.2 + 15.0 * t, 70.7 + 121.3 * t
    flux = 30.0 * (1.0 + 0.4 * t)
    render_trail(image, row, col, flux, 0.85, defocus_px, obstruction)
    mean_row, mean_col, total = centroid(image)
    assert total == pytest.approx(flux.sum(), rel=1e-4)
    assert (mean_row, mean_col) == pytest.approx((np.average(row, weights=flux), np.average(col, weights=flux)), abs=1e-3)


def test_a_long_faint_trail_keeps_its_flux():
    image = np.zeros((64, 4096), dtype=np.float32)
    t = (np.arange(8000) + 0.5) / 8000
    render_trail(image, 30.0 + 4.0 * t, 50.0 + 4000.0 * t, np.full(8000, 0.01), 0.85)
    assert image.sum(dtype=float) == pytest.approx(80.0, rel=1e-4)


def test_half_pixel_bins_equal_a_continuous_trail():
    coarse, fine = (np.zeros((40, 120), dtype=np.float32) for _ in range(2))
    for image, n in ((coarse, 160), (fine, 8000)):
        t = (np.arange(n) + 0.5) / n
        render_trail(image, 15.3 + 8.0 * t, 20.0 + 79.0 * t, np.full(n, 1e5 / n), 0.85)
    inside = np.s_[:, 26:94]
    assert np.abs(coarse - fine)[inside].max() < 1e-4 * fine.max()
    # The two ends are half a bin apart in the second moment of the last bin only.
    assert np.abs(coarse - fine).max() < 5e-3 * fine.max()


@pytest.mark.parametrize(("diameter_px", "obstruction", "sigma_px"), [(4.0, 0.0, 0.85), (8.8, 0.35, 0.85), (20.0, 0.5, 1.2)])
def test_defocus_is_the_annulus_convolved_with_the_psf_and_the_pixel(diameter_px, obstruction, sigma_px):
    over, half = 16, 30
    nodes = np.arange(-half * over, half * over + 1)
    radius = np.hypot(nodes[:, None], nodes[None, :]) / over
    # Share of each fine cell inside the annulus, to first order across its border.
    annulus = np.clip((0.5 * diameter_px - radius) * over + 0.5, 0.0, 1.0)
    annulus -= np.clip((0.5 * obstruction * diameter_px - radius) * over + 0.5, 0.0, 1.0) if obstruction > 0.0 else 0.0
    gaussian = np.exp(-0.5 * (nodes / over / sigma_px) ** 2)
    blurred = signal.fftconvolve(annulus, gaussian[:, None] * gaussian[None, :], mode="same")
    pixel = np.ones(over + 1)
    pixel[[0, -1]] = 0.5
    in_pixel = signal.fftconvolve(blurred, pixel[:, None] * pixel[None, :], mode="same")
    in_pixel *= over**2 / in_pixel.sum()
    # A point at (30 + 5/16, 30 - 3/16): the pixel centres lie on nodes of the fine grid.
    image = np.zeros((61, 61), dtype=np.float32)
    render_trail(image, np.array([30.0 + 5 / 16]), np.array([30.0 - 3 / 16]), np.array([1e6]), sigma_px, diameter_px, obstruction)
    reference = 1e6 * in_pixel[half * over - 5 - 25 * over :: over, half * over + 3 - 25 * over :: over][:51, :51]
    assert np.abs(image[5:56, 5:56] - reference).max() < 2e-3 * reference.max()
    assert image.sum(dtype=float) == pytest.approx(1e6, rel=1e-4)


def test_the_disc_profile_has_unit_flux_and_is_flat_inside():
    radius = np.linspace(0.0, 20.0, 20001)
    profile = disc_profile(radius, 12.0, 0.3, 0.85)
    assert integrate.trapezoid(profile * 2.0 * np.pi * radius, radius) == pytest.approx(1.0, abs=1e-5)
    area = np.pi * (6.0**2 - 1.8**2)
    assert np.interp(4.0, radius, profile) * area == pytest.approx(1.0, abs=0.02)
    assert np.interp(6.0, radius, profile) * area == pytest.approx(0.5, abs=0.06)


def test_the_camera_blurs_a_point_at_1_km_into_41_arcsec():
    """The blur disc that the default camera draws has the angle aperture / range."""
    options = SimulatorOptions()
    camera = Camera(options.instrument, options.psf, options.vignetting, options.sensor, exposure_s=0.2, seed=1)
    arcsec = np.degrees(camera.defocus_px(np.array([1.0, 3.0, 10.0])) / camera.projection.focal_px) * 3600.0
    assert arcsec == pytest.approx([41.25, 13.75, 4.125], abs=0.01)


def test_width_and_illumination_over_the_field():
    options = PsfOptions(fwhm_px=2.0, corner_growth=0.15)
    corner = math.hypot(2047.5, 2047.5)
    sigma = sigma_at(options, [2047.5, 0.0], [2047.5, 0.0], center_row=2047.5, center_col=2047.5, corner_radius_px=corner)
    assert sigma == pytest.approx([0.8493, 0.8493 * 1.15], rel=1e-4)
    kwargs = {"center_row": 2047.5, "center_col": 2047.5, "corner_radius_px": corner, "focal_px": 44444.0}
    only_cosine = VignettingOptions(corner_loss=0.0)
    # cos^4 of 3.728 deg, the corner of a 5.28 deg field.
    assert relative_illumination(only_cosine, 0.0, 0.0, **kwargs) == pytest.approx(
        math.cos(math.atan(corner / 44444.0)) ** 4, rel=1e-12
    )
    both = relative_illumination(VignettingOptions(corner_loss=0.2), [2047.5, 0.0], [2047.5, 0.0], **kwargs)
    assert both[0] == 1.0
    assert both[1] == pytest.approx(0.8 * 0.99154, rel=1e-4)


@pytest.mark.parametrize(
    ("shape", "options"),
    [
        ((4096, 4096), VignettingOptions()),
        ((1500, 2049), VignettingOptions(corner_loss=0.5, start=0.0)),
        ((511, 512), VignettingOptions()),
        ((300, 301), VignettingOptions(corner_loss=1.0, start=0.9)),
    ],
)
def test_illumination_between_the_nodes_is_that_of_each_pixel(shape, options):
    radius = 0.5 * math.hypot(*shape)
    kwargs = {
        "center_row": 0.5 * shape[0] + 3.3,
        "center_col": 0.5 * shape[1],
        "corner_radius_px": radius,
        "focal_px": 11 * radius,
    }
    step_px = grid_step_px(options, radius)
    grid = IlluminationGrid(relative_illumination(options, *node_places(shape, step_px), **kwargs).astype(np.float32), step_px)
    assert grid.nodes.nbytes < 2e6
    ends, line, col = np.empty((2, shape[1]), np.float32), np.empty(shape[1], np.float32), np.arange(shape[1])
    for row in range(shape[0]):
        illumination_of_row(*grid, row, ends, line)
        if row % 7 == 0 or row == shape[0] - 1:
            expected = relative_illumination(options, float(row), col, **kwargs)
            assert np.abs(line - expected).max() < 1e-4
