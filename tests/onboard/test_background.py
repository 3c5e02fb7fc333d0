"""Background mesh: level and noise, with stars, gradients and masks; edge cases."""

import numpy as np
import pytest
from numpy.typing import NDArray

from onboard.image.background import MeshBackground, continued, fill_gaps
from onboard.image.calibrate import LANES, LineSums, residual_pass, runs_of, write_runs
from onboard.image.dark_map import DarkMap
from onboard.image.star_free_sky import line_offsets, without_stars
from onboard.stars.matched import MatchedStars
from sboc_e2e.icd.signals import BackgroundModel, StarList
from tests.benchmarks.other_skies import chain, frame
from tests.onboard.star_fields import GAIN_E_ADU, PEDESTAL_ADU, READ_NOISE_E, SKY_E, star_grid
from tests.onboard.test_stars import view_of

NOISE_ADU = np.sqrt(SKY_E + READ_NOISE_E**2 + GAIN_E_ADU**2 / 12.0) / GAIN_E_ADU


def mesh_of(pixels: NDArray[np.uint16], mask: NDArray[np.uint8] | None = None) -> BackgroundModel:
    """Mesh of a frame on the pedestal."""
    dark = np.full(pixels.shape, PEDESTAL_ADU, dtype=np.int16)
    return MeshBackground().estimate(pixels, dark, np.zeros(pixels.shape, np.uint8) if mask is None else mask)


def noisy(level_adu: NDArray[np.float64] | float, shape: tuple[int, int], seed: int, sigma: float = 2.4) -> NDArray[np.uint16]:
    """Gaussian noise on a level above the pedestal."""
    rng = np.random.default_rng(seed)
    return np.clip(np.rint(level_adu + PEDESTAL_ADU + rng.normal(0.0, sigma, shape)), 0, 65535).astype(np.uint16)


@pytest.mark.parametrize("sigma", [0.6, 2.4, 40.0, 900.0])
def test_level_and_noise_of_plain_sky(sigma: float) -> None:
    """Level to 0.02 sigma and noise to 2 % on the mean, whatever the scale."""
    mesh = mesh_of(noisy(20000.0, (512, 512), 1, sigma))
    assert mesh.level_adu.mean() == pytest.approx(20000.0, abs=0.02 * sigma)
    assert mesh.sigma_adu.mean() == pytest.approx(np.hypot(sigma, 0.2887), rel=0.02)


def test_level_follows_a_gradient() -> None:
    """A slope of 40 ADU over the frame is followed to 0.15 sigma at the inner nodes."""
    slope = np.linspace(0.0, 40.0, 512)[None, :] * np.ones((512, 1))
    mesh = mesh_of(noisy(slope, (512, 512), 2))
    nodes = 40.0 * (np.arange(8) * 64 + 31.5) / 511.0
    assert np.abs(mesh.level_adu - nodes)[:, 1:-1].max() < 0.15 * 2.4


def _residual_of(level_adu: NDArray[np.float64], seed: int) -> NDArray[np.float32]:
    """What is left of sky at a level once its background is out, in units of the noise."""
    pixels = noisy(level_adu, level_adu.shape, seed)
    run = chain(len(pixels))
    return run.prepare(run.initial_state(), frame(0, pixels)).view.residual_adu / np.float32(2.4)


@pytest.mark.parametrize("side", [512, 540])
def test_a_slope_is_followed_to_the_edge_of_the_frame(side: int) -> None:
    """Two sigma from tile to tile both ways: held at the outer nodes the level was wrong by a sigma at the edge."""
    row, col = np.indices((side, side))
    left = _residual_of(100.0 + 2.4 * 2.0 / 64.0 * (row + col), 12)
    for rim in (left[:16], left[-16:], left[:, :16], left[:, -16:]):
        assert abs(float(rim.mean())) < 0.05


def test_a_bend_is_followed_to_the_edge_of_the_frame() -> None:
    """Half a sigma of second difference from tile to tile, as where the glow of the Moon leaves the frame."""
    row = np.arange(1024.0)[:, None] * np.ones((1, 1024))
    left = _residual_of(100.0 + 2.4 * 0.25 * (row / 64.0) ** 2, 13)
    rims = (left[:16], left[-16:], left[:, :16], left[:, -16:])
    assert np.sqrt(np.mean([float(rim.mean()) ** 2 for rim in rims])) < 0.02


def test_a_mesh_goes_on_straight_beyond_its_outer_nodes_but_not_from_a_step() -> None:
    row, col = np.indices((3, 5)).astype(np.float32)
    wide = np.indices((5, 7)).astype(np.float32) - 1.0
    assert np.array_equal(continued(2.0 * row - col, 0.1), 2.0 * wide[0] - wide[1])
    assert (continued(np.full((1, 1), 7.0, np.float32), 1.0) == np.full((3, 3), 7.0)).all()
    step = np.array([[0.0, 900.0, 901.0, 902.0]], np.float32)
    assert continued(step, 1.0)[1, [0, -1]].tolist() == [-2.0, 903.0]
    assert continued(step, 100.0)[1, [0, -1]].tolist() == [-50.0, 903.0]


def test_stars_do_not_lift_the_level_seen_by_the_detector() -> None:
    """With a star on every 24 x 24 px, level within 0.01 sigma and noise within 1 % once the list is known."""
    rng = np.random.default_rng(3)
    field = star_grid(rng, side=1024, pitch=24, flux_e=(60.0, 20000.0), sigma_px=0.849)
    view = view_of(field.exposed(rng))
    stars = MatchedStars().extract(view)
    residual = view.residual_adu.copy()
    sums = LineSums(rows=sums_of(residual / NOISE_ADU, 1), cols=sums_of(residual / NOISE_ADU, 0))
    sky = without_stars(residual, view.mask, sums, stars, view.background, gain_e_adu=GAIN_E_ADU, psf_sigma_px=0.849)
    assert sky.level_adu.mean() == pytest.approx(SKY_E / GAIN_E_ADU, abs=0.01 * NOISE_ADU)
    assert sky.sigma_adu.mean() == pytest.approx(NOISE_ADU, rel=0.01)
    far = field.electrons < SKY_E + 0.01
    assert residual[far].mean() == pytest.approx(0.0, abs=0.01 * NOISE_ADU)


def test_masked_tiles_are_filled_from_neighbours() -> None:
    """A masked quarter takes its level from the rest."""
    pixels = noisy(100.0, (512, 512), 4)
    mask = np.zeros(pixels.shape, dtype=np.uint8)
    mask[:256, :256] = 1
    pixels[:256, :256] = 60000
    mesh = mesh_of(pixels, mask)
    assert np.abs(mesh.level_adu - 100.0).max() < 1.0


def test_nothing_usable_gives_a_finite_mesh() -> None:
    """All masked: level 0, noise 1."""
    mesh = mesh_of(noisy(0.0, (100, 130), 5), np.ones((100, 130), dtype=np.uint8))
    assert mesh.level_adu.shape == (2, 3)
    assert (mesh.level_adu == 0.0).all()
    assert (mesh.sigma_adu == 1.0).all()


def test_constant_frame_has_the_noise_of_its_quantisation() -> None:
    """Equal pixels: exact level, noise not below 1/sqrt(12)."""
    mesh = mesh_of(np.full((128, 128), PEDESTAL_ADU + 7, dtype=np.uint16))
    assert (mesh.level_adu == 7.0).all()
    assert mesh.sigma_adu.min() >= 0.28


def test_gaps_are_filled_outwards() -> None:
    """Known nodes stay; unknown ones become means of neighbours; nothing known becomes the default."""
    mesh = np.full((3, 4), np.nan, dtype=np.float32)
    mesh[0, 0] = 2.0
    assert (fill_gaps(mesh, 9.0) == 2.0).all()
    assert (fill_gaps(np.full((2, 2), np.nan, dtype=np.float32), 9.0) == 9.0).all()


def test_residual_is_raw_minus_dark_minus_level() -> None:
    """Against plain numpy with scipy's interpolation of the mesh and of a node beyond each edge, to float32."""
    from scipy.interpolate import RegularGridInterpolator

    rng = np.random.default_rng(6)
    shape, tile = (150, 200), 32
    pixels = rng.integers(200, 400, shape).astype(np.uint16)
    dark, fraction = rng.integers(90, 110, shape).astype(np.int16), rng.integers(-64, 64, shape).astype(np.int8)
    defects = (rng.random(shape) < 0.02).astype(np.uint8)
    pixels[10, 20] = 5000
    nodes = rng.normal(100.0, 5.0, (5, 7)).astype(np.float32)
    residual, mask = np.empty(shape, np.float32), defects.copy()
    row_sums, col_sums = np.empty((2, 150), np.float32), np.empty((2, 200), np.float32)
    dark_map = DarkMap.of((dark + fraction / 128.0).astype(np.float32))
    number = residual_pass(
        pixels, dark_map.codes, mask, continued(nodes, 1.0), tile, 4000, 1.0, 60.0, residual, row_sums, col_sums
    )
    middles = [np.append(np.arange(n // tile) * tile + 15.5, 0.5 * (n // tile * tile + n - 1)) for n in shape]
    middles = [np.concatenate(([2 * m[0] - m[1]], m, [2 * m[-1] - m[-2]])) for m in middles]
    level = RegularGridInterpolator(middles, continued(nodes, 1.0).astype(np.float64))(tuple(np.indices(shape)))
    expected = pixels.astype(np.float64) - dark - fraction / 128.0 - level
    expected[(defects != 0) | (pixels >= 4000)] = 0.0
    assert np.abs(residual - expected).max() < 1e-3
    assert mask[10, 20] & 4
    assert number == np.count_nonzero(mask)
    # the sum of a row in the order that is written down, to the last bit: no choice is left to the compiler
    kept = np.where((mask == 0) & (np.abs(residual) < np.float32(60.0)), residual, np.float32(0.0))
    padded = np.pad(kept, ((0, 0), (0, -kept.shape[1] % LANES))).reshape(len(kept), -1, LANES)
    lanes = np.zeros((len(kept), LANES), np.float32)
    for step in range(padded.shape[1]):
        lanes += padded[:, step]
    total = np.zeros(len(kept), np.float32)
    for lane in range(LANES):
        total += lanes[:, lane]
    assert np.array_equal(row_sums[1], total)
    within = (mask == 0) & (np.abs(expected) < 60.0)
    for sums, axis in ((row_sums, 1), (col_sums, 0)):
        assert (np.abs(sums[0] - within.sum(axis=axis)) <= 1).all()  # float32 may decide otherwise on the limit itself
        assert np.abs(sums[1] - (expected * within).sum(axis=axis)).max() < 61.0


def with_line_noise(seed: int, offsets: NDArray[np.float64]) -> NDArray[np.float32]:
    """A calibrated image of unit noise, 2,000 px wide, with offsets of whole rows."""
    return (np.random.default_rng(seed).normal(0.0, 1.0, (len(offsets), 2000)) + offsets[:, None]).astype(np.float32)


def sums_of(image: NDArray[np.float32], axis: int) -> NDArray[np.float32]:
    """Number and sum of the values within 2.5 sigma of each row (axis 1) or column (axis 0)."""
    within = np.abs(image) < 2.5
    return np.stack((within.sum(axis=axis), (image * within).sum(axis=axis))).astype(np.float32)


def white(seed: int, sigma: float) -> NDArray[np.float64]:
    """Offsets of 600 lines that know nothing of each other."""
    return np.random.default_rng(seed).normal(0.0, sigma, 600)


def test_offsets_of_lines_are_found_where_there_are_any() -> None:
    """Offsets of 0.1 sigma are known to the noise of a line's mean; without such noise nothing is taken away."""
    offsets = white(7, 0.1)
    image = with_line_noise(7, offsets)
    for sums in (sums_of(image, 1), sums_of(np.ascontiguousarray(image.T), 0)):
        found = line_offsets(sums, 2000, 1.0)
        assert (found - (offsets - np.median(offsets))).std() < 1.6 / np.sqrt(image.shape[1])
    assert np.abs(line_offsets(sums_of(with_line_noise(8, np.zeros(600)), 1), 2000, 1.0)).max() < 0.03


def test_slow_offsets_of_lines_are_found_too() -> None:
    """A wave of 150 lines, which a mesh of 64 px does not follow, beside white offsets: 0.004 sigma of either is left."""
    offsets = white(10, 0.05) + 0.05 * np.sin(2.0 * np.pi * np.arange(600) / 150.0)
    found = line_offsets(sums_of(with_line_noise(10, offsets), 1), 2000, 1.0)
    left = found - (offsets - np.median(offsets))
    waves = np.abs(np.fft.rfft(left))[[3, 4, 5]] / len(left)
    assert waves.max() < 0.004
    assert left.std() < 1.6 / np.sqrt(2000)


def test_rows_columns_and_level_are_taken_out_together() -> None:
    """What `without_stars` leaves of offsets of rows and columns over a sloping sky: the noise of single lines, no slope."""
    rng = np.random.default_rng(12)
    row, col = rng.normal(0.0, 0.1, 512), rng.normal(0.0, 0.1, 512)
    slope = np.linspace(-0.2, 0.2, 512)
    residual = (rng.normal(0.0, 1.0, (512, 512)) + row[:, None] + col + slope[:, None]).astype(np.float32)
    sums = LineSums(rows=sums_of(residual, 1), cols=sums_of(residual, 0))
    flat = BackgroundModel(tile_px=64, level_adu=np.zeros((8, 8), np.float32), sigma_adu=np.ones((8, 8), np.float32))
    mask = np.zeros(residual.shape, np.uint8)
    without_stars(residual, mask, sums, StarList.empty(), flat, gain_e_adu=1.0, psf_sigma_px=0.85)
    for axis in (0, 1):
        assert residual.mean(axis=axis).std() < 1.3 / np.sqrt(512)
    assert abs(np.polyfit(np.arange(512), residual.mean(axis=1), 1)[0]) * 512 < 0.02


def test_a_bright_trail_along_a_line_survives() -> None:
    """A trail of one sigma per pixel along a whole row keeps 70 % or more of its light."""
    image = with_line_noise(9, white(9, 0.05))
    image[300] += 1.0
    assert line_offsets(sums_of(image, 1), 2000, 1.0)[300] < 0.3


@pytest.mark.parametrize("density", [0.0, 0.003, 0.5, 1.0])
def test_a_map_of_defects_survives_as_runs(density: float) -> None:
    """The map and every window of it, also one that reaches beyond it."""
    rng = np.random.default_rng(11)
    defects = np.where(rng.random((150, 70)) < density, rng.integers(1, 64, (150, 70)), 0).astype(np.uint8)
    defects[140:] = defects[140, 0]
    runs, out = runs_of(defects), np.full((150, 70), 255, np.uint8)
    write_runs(runs, out)
    assert np.array_equal(out, defects)
    window = np.full((30, 90), 255, np.uint8)
    write_runs(runs - np.array((120, 10, 10, 0), np.int32), window)
    assert np.array_equal(window[:, :60], defects[120:, 10:])
    assert not window[:, 60:].any()
