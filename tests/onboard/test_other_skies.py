"""Facts about the chain under skies that are not the simulator's: drawn by `sky_frames`."""

import math
from dataclasses import replace

import numpy as np
import pytest

from onboard.detect import whiten
from onboard.detect.line_integral import point_movers
from onboard.image.background import MeshBackground
from onboard.image.fine_sky import bent_tiles, continued_on_parabolas, fine_nodes, followed, structured_tiles
from sboc_e2e.icd.flags import StreakFlag
from tests.benchmarks import sky_frames
from tests.benchmarks.bench_detection import score
from tests.benchmarks.other_skies import STREAKS, chain, frame, second_of
from tests.onboard.test_background import noisy


def test_short_movers_under_a_sharper_psf_are_no_particle_tracks() -> None:
    """FWHM 1.2 px with a nominal 2 px: the width that the stars show tells light from tracks."""
    lengths = [(length, 25.0) for length in (14.0, 16.0, 18.0, 20.0, 24.0, 30.0)]
    found = light = 0
    for seed in range(2):
        drawn = sky_frames.scene(sky_frames.Row(name="sharp", fwhm_px=1.2), 1024, lengths, seed)
        result, _ = second_of(drawn.earlier, drawn.later)
        regardless = [replace(d, flags=d.flags & ~StreakFlag.COSMIC_LIKE) for d in result.detections]
        found += sum(d is not None for d in score(regardless, drawn.streaks)[0])
        light += sum(d is not None for d in score(result.detections, drawn.streaks)[0])
    assert found == light == 12


def test_a_short_trail_fitted_on_an_even_bright_area_does_not_grow_without_end() -> None:
    """Pixels at the clip on all sides: every longer trail has a higher S/N, and its price grows as the square of its length."""
    image = np.full((600, 1200), 7 * whiten.UNIT, np.int8)
    blocked = np.zeros(image.shape, np.uint8)
    *_, length = point_movers.fit_short_trail(image, blocked, 0, (50.0, 300.0, 600.0, 0.0, 40.0), 0.85)
    assert length <= point_movers.LONGEST_FIT_PX


def _figures(name: str, seed: int) -> tuple[int, int, int]:
    """Streaks found and sent of eight of S/N 10 to 13, and false detections, of one scene of 2048 x 2048 px."""
    row = next(row for row in sky_frames.ROWS if row.name == name)
    wanted = [(length, snr) for length in (100.0, 300.0) for snr in (10.0, 11.0, 12.0, 13.0)]
    drawn = sky_frames.scene(row, 2048, wanted, seed)
    result, _ = second_of(drawn.earlier, drawn.later)
    paired, _, false = score(result.detections, drawn.streaks)
    sent, _, _ = score([group.detection for group in result.rois], drawn.streaks)
    return sum(d is not None for d in paired), sum(d is not None for d in sent), false


def test_a_ripple_of_a_third_of_the_noise_makes_no_trails_and_hides_none() -> None:
    """0.3 sigma over 200 px gave 170 false detections in a frame and 1 of 14 trails on the ground."""
    found, sent, false = _figures("ripple", 7)
    assert false <= 1
    assert found >= 7
    assert sent == found


def test_trails_beside_the_moon_are_found_and_all_of_them_sent() -> None:
    """The rim of a saturated disc and its glow gave 13 false detections, which took the place of good ones."""
    found, sent, false = _figures("moon", 7)
    assert false <= 3
    assert found >= 7
    assert sent == found


def test_only_skies_with_structure_are_measured_on_the_finer_mesh() -> None:
    """Means of pure noise are left alone; a wave of 0.3 sigma is not."""
    rng = np.random.default_rng(1)
    noise = (rng.standard_normal((32, 32)) / np.sqrt(512.0)).astype(np.float32)
    wave = 0.3 * np.sin(2.0 * np.pi * 64.0 / 200.0 * np.arange(32.0)).astype(np.float32)
    sigma = np.ones((32, 32), np.float32)
    assert not structured_tiles(noise, sigma, 512).any()
    assert structured_tiles(noise + wave, sigma, 512).all()


def test_a_fine_mesh_keeps_the_means_of_its_tiles() -> None:
    """Linear interpolation between the nodes has the measured mean over each tile, but for terms of fourth order."""
    k = np.arange(40.0)
    mean = np.tile(np.sin(2.0 * np.pi * k * 32.0 / 200.0), (40, 1)).astype(np.float32)
    nodes = fine_nodes(mean, np.full(mean.shape, 1e-6, np.float32), np.ones(mean.shape, bool))
    wide = continued_on_parabolas(nodes, 10.0)[21]
    over = 0.75 * wide[1:-1] + 0.125 * (wide[:-2] + wide[2:])
    assert np.abs(over - mean[20])[2:-2].max() < 0.02
    # the parabola at the edge is off by the third derivative: a tenth of a wave's height, where a straight line leaves a half
    assert np.abs(over - mean[20]).max() < 0.1


def test_a_wave_leaves_nothing_along_the_edge() -> None:
    """A ripple beside the Moon left 0.2 sigma in the outermost columns: trails of 1,400 px and S/N 12 that did not exist."""
    row = next(r for r in sky_frames.ROWS if r.name == "all")
    drawn = sky_frames.scene(row, 2048, STREAKS, 23012)
    run = chain(2048)
    view = run.prepare(run.initial_state(), frame(0, drawn.later)).view
    sigma = float(np.median(view.background.sigma_adu))
    clean = np.where((view.mask == 0) & (np.abs(view.residual_adu) < 4.0 * sigma), view.residual_adu, np.nan) / sigma
    assert abs(np.nanmean(clean[566:1916, :4])) < 0.07


def test_a_fine_mesh_follows_waves_and_leaves_trails_their_light() -> None:
    """A wave of 200 px loses 7 % of its height; a faint trail along a row of tiles half as much light as to the tiles alone."""
    k = np.arange(40.0)
    noise = np.full((40, 40), 1.0 / 32.0)
    wave = 0.05 * np.tile(np.sin(2.0 * np.pi * k * 32.0 / 200.0), (40, 1))
    assert np.abs(followed(wave, noise) - wave)[:, 2:-2].max() < 0.08 * 0.05
    trail = np.zeros((40, 40))
    trail[17] = 0.05
    assert followed(trail, noise)[17].max() < 0.5 * 0.05
    # light that is no parabola's stays where it is: the aureole of one star, the limb of a bright body
    limb = np.where(np.hypot(*(np.indices((40, 40)) - 12.0)) < 5.0, 1.0, 0.0)
    assert np.abs(followed(limb, noise) - limb).max() < 0.2
    assert np.abs(followed(limb, noise) - limb)[np.hypot(*(np.indices((40, 40)) - 12.0)) > 8.0].max() < 0.02


def test_noise_is_that_within_tiles_of_a_wave() -> None:
    """A wave of 0.6 sigma raised the noise by 8 %, and every S/N fell by as much."""
    rng = np.random.default_rng(6)
    light = np.full((512, 512), sky_frames.SKY_E) + sky_frames.ripple_light(512, 0.6 * sky_frames.SIGMA_E, rng)
    run = chain(512)
    view = run.prepare(run.initial_state(), frame(0, sky_frames.digitised(sky_frames.exposed(light, rng)))).view
    assert float(np.median(view.background.sigma_adu)) == pytest.approx(
        math.hypot(sky_frames.SIGMA_E, 1.0 / math.sqrt(12.0)), rel=0.02
    )


def test_only_a_mesh_that_bends_is_measured_on_the_finer_one() -> None:
    """A slope with noise does not bend; a glow that falls as r^-3 does, near its source."""
    pixel_row, pixel_col = np.indices((1024, 1024))
    pixels = noisy(200.0 + 0.05 * pixel_row - 0.03 * pixel_col, (1024, 1024), 3)
    mesh = MeshBackground().estimate(pixels, np.zeros(pixels.shape, np.int16), np.zeros(pixels.shape, np.uint8))
    assert not bent_tiles(mesh.level_adu, mesh.sigma_adu).any()
    row, col = np.indices((32, 32)).astype(np.float64)
    sigma = np.ones((32, 32), np.float32)
    glow = (300.0 / np.maximum(np.hypot(row - 10.0, col - 21.0) / 2.2, 1.0) ** 3).astype(np.float32)
    bent = bent_tiles(glow, sigma)
    assert bent[np.hypot(row - 10.0, col - 21.0) < 9.0].all()
    assert not bent[np.hypot(row - 10.0, col - 21.0) > 20.0].any()
