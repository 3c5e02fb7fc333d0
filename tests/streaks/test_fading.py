"""Ends of trails that fade: followed to where light is last seen, with intervals that reach the border; steps stay."""

import math
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import erf, ndtr

from ground.streaks.fading import _best_step, with_fading_ends
from ground.streaks.fitter import TrailedPsfFitter
from ground.streaks.light_blocks import LEAST_BESIDE, MEDIAN_VARIANCE, Blocks, _running_medians, blocks_of
from ground.streaks.trail_frame import TrailFrame
from ground.streaks.trail_pixels import usable_pixels
from sboc_e2e import scenario as scenarios
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.products import StreakFit, StreakPixels
from sboc_e2e.icd.signals import Detection
from sboc_e2e.outside.process import base_document
from sboc_e2e.registry import Registry

COLS, ROWS, MIDDLE = 300, 60, 30.2
SIGMA_PX, NOISE_E = 1.3, 20.0
FIRST, REACH = 40.0, 12


def strip(seed: int, stop: float, brightness: NDArray[np.float64] | float = 1.0, *, density: float = 300.0) -> StreakPixels:
    """Pixels about a trail along a row from column `FIRST` to `stop`: light times `brightness` of each column, and noise."""
    row, col = np.mgrid[30 - REACH : 31 + REACH, :COLS]
    root = math.sqrt(2.0) * SIGMA_PX
    across = 0.5 * (erf((row + 0.5 - MIDDLE) / root) - erf((row - 0.5 - MIDDLE) / root))
    along = 0.5 * (erf((col - FIRST) / root) - erf((col - stop) / root))
    light = density * across * along * np.broadcast_to(brightness, (COLS,))
    noise = np.random.default_rng(seed).normal(0.0, NOISE_E, light.shape)
    return StreakPixels(
        row=row.ravel().astype(np.int32),
        col=col.ravel().astype(np.int32),
        value_e=(light + noise).ravel().astype(np.float32),
        variance_e2=np.full(light.size, NOISE_E**2, np.float32),
        psf_sigma_px=SIGMA_PX,
        frame_shape=(ROWS, COLS),
    )


def seen(stop: float) -> Detection:
    return Detection(row0=MIDDLE, col0=FIRST, row1=MIDDLE, col1=stop, snr=60.0)


def both(pixels: StreakPixels, stop: float) -> tuple[StreakFit, StreakFit]:
    """The fit of one brightness, and with ends followed."""
    return TrailedPsfFitter().fit(pixels, seen(stop)), TrailedPsfFitter(fading_ends=True).fit(pixels, seen(stop))


@pytest.mark.parametrize("fold_px", [40.0, 70.0])
def test_an_end_that_fades_stays_on_the_arc_of_a_bent_trail(fold_px: float) -> None:
    """A parabola of 14 px over 500 px whose light falls exponentially from column 500 on, drawn column by column.

    The end, the middle of the chord and the height over it are held against that parabola. An end that was moved along the
    chord lay 4 to 24 px beside it.
    """
    rows, cols, height_px, half_px = 160, 700, 14.0, 250.0

    def line(at_col: NDArray[np.float64] | float) -> NDArray[np.float64] | float:
        return 60.0 + height_px * (1.0 - ((at_col - 300.0) / half_px) ** 2)

    col, root = np.arange(cols, dtype=float), math.sqrt(2.0) * SIGMA_PX
    row = np.arange(rows, dtype=float)[:, None] - line(col)
    across = 0.5 * (erf((row + 0.5) / root) - erf((row - 0.5) / root))
    light = 3000.0 * across * (col >= 50.0) * np.exp(-np.maximum(col - 500.0, 0.0) / fold_px)
    light += np.random.default_rng(4).normal(0.0, NOISE_E, light.shape)
    near = np.abs(row) < 30.0
    places = np.nonzero(near)
    pixels = StreakPixels(
        row=places[0].astype(np.int32), col=places[1].astype(np.int32), value_e=light[near].astype(np.float32),
        variance_e2=np.full(int(near.sum()), NOISE_E**2, np.float32), psf_sigma_px=SIGMA_PX, frame_shape=(rows, cols),
    )  # fmt: skip
    found = Detection(
        row0=float(line(50.0)), col0=50.0, row1=float(line(540.0)), col1=540.0, snr=900.0,
        sagitta_px=height_px * (490.0 / 500.0) ** 2, flags=StreakFlag.CURVED,
    )  # fmt: skip
    before, after = TrailedPsfFitter().fit(pixels, found), TrailedPsfFitter(fading_ends=True).fit(pixels, found)
    assert after.col1 > before.col1 + 20.0
    for fit in (before, after):
        assert fit.row1 == pytest.approx(line(fit.col1), abs=0.5)
        middle = TrailFrame.of_chord(fit.row0, fit.col0, fit.row1, fit.col1).to_pixel(0.0, fit.sagitta_px)
        assert middle[0] == pytest.approx(line(middle[1]), abs=0.5)


def test_a_trail_that_fades_to_the_border_is_followed_and_its_interval_holds_the_border() -> None:
    """Light that falls exponentially (17 px) from column 200 on. The fits of one brightness stop more than 30 px before the
    border, and none of their intervals says so."""
    col = np.arange(COLS)
    fade = np.exp(-np.maximum(col - 200, 0) / 17.0)
    # S/N in 12 px of a light of d e-/px: d sqrt(12) / (noise sqrt(2 sqrt(pi) sigma)); it is 4 where d is 49.6, at column 230.6
    least = 4.0 * NOISE_E * math.sqrt(2.0 * math.sqrt(math.pi) * SIGMA_PX / 12.0)
    lost_col = 200.0 + 17.0 * math.log(300.0 / least)
    held, stated, moved, seen_there = 0, 0, 0, 0
    for seed in range(8):
        before, after = both(strip(seed, 400.0, fade), 260.0)
        gap = COLS - 0.5 - before.col1
        assert gap > 30.0
        stated += gap <= before.end_interval_px[1, 1]
        moved += after.col1 > before.col1
        low, high = after.light_ends_px[1]
        seen_there += after.col1 + low - 2.0 <= lost_col <= after.col1 + high + 2.0
        assert high - low < 45.0 < 55.0 < after.end_interval_px[1, 1], "the light's end is known, that of the object is not"
        assert after.flags & StreakFlag.ENDS_NOT_GAUSSIAN
        held += COLS - 0.5 - after.col1 <= max(2.0, after.end_interval_px[1, 1])
        assert (after.row0, after.col0) == pytest.approx((before.row0, before.col0), abs=1e-9)
        assert after.light_curve_e_px.size == after.light_curve_err_e_px.size
        longer = after.light_curve_e_px.size > before.light_curve_e_px.size, after.flux_e > before.flux_e
        assert longer == (after.col1 > before.col1,) * 2
        sigma = math.sqrt(after.covariance_px2[3, 3])
        assert sigma == pytest.approx(0.5 * (after.end_interval_px[1, 1] - after.end_interval_px[1, 0]), abs=1e-3)
    assert stated == 0
    assert held == 8
    assert seen_there == 8
    assert moved >= 4, "where too little is left to be seen, only the intervals change"


def test_stars_beyond_an_end_are_no_light_of_the_trail_where_lines_beside_it_have_as_many() -> None:
    """A meteor of 80 px in a field with a faint star every 60 px^2. Of 24 trails that stop a third were followed by more than 6
    px, over stars, and every fourth interval did not hold its end."""
    stop, far, held = FIRST + 80.0, 0, 0
    row, col = np.mgrid[30 - REACH : 31 + REACH, :COLS]
    for seed in range(24):
        rng = np.random.default_rng(1000 + seed)
        number = row.size // 60
        at = rng.uniform((30 - REACH, 0.0), (30 + REACH, COLS), (number, 2))
        light = rng.exponential(700.0, number)
        stars = np.zeros(row.shape)
        for (r, c), e in zip(at, light, strict=True):
            stars += e / (2.0 * math.pi * SIGMA_PX**2) * np.exp(-0.5 * ((row - r) ** 2 + (col - c) ** 2) / SIGMA_PX**2)
        pixels = strip(seed, stop, density=600.0)
        crowded = replace(pixels, value_e=(pixels.value_e + (stars - np.median(stars)).ravel()).astype(np.float32))
        before, after = both(crowded, stop)
        far += max(after.col1 - before.col1, before.col0 - after.col0) > 6.0
        for outwards, (low, high) in zip((FIRST - after.col0, after.col1 - stop), after.end_interval_px, strict=True):
            held += low - 2.0 <= -outwards <= high + 2.0
    assert far <= 3
    assert held >= 42


def test_light_that_is_seen_to_the_border_is_on_the_border() -> None:
    """A straight fall to a tenth of the light at the border, S/N of the last pixels 3 to 5 a block."""
    fall = np.linspace(1.0, 0.1, COLS)
    for seed in range(6):
        _, after = both(strip(seed, 400.0, fall, density=600.0), 270.0)
        assert after.flags & StreakFlag.EDGE1
        assert after.col1 == pytest.approx(COLS - 0.5, abs=0.01)


def test_trails_that_stop_keep_their_ends() -> None:
    """Uniform trails of S/N 35 to 150, 5 seeds each: no end leaves its interval, and those doubted do not contradict 7 %.

    7 % of 60 other ends were doubted (`ground.streaks.fading.DOUBT`); 6 of 30 or more would have a chance of 2 %.
    """
    doubted = 0
    for density in (90.0, 200.0, 400.0):
        for seed in range(5):
            before, after = both(strip(int(density) + seed, 190.3, density=density), 190.0)
            for end in (0, 1):
                shift = math.hypot(*np.subtract(after_ends(after)[end], after_ends(before)[end]))
                low, high = after.end_interval_px[end]
                assert shift <= max(-low, high)
                doubted += bool((after.end_interval_px[end] != before.end_interval_px[end]).any())
    assert doubted < 6


def test_faint_light_beyond_a_bright_end_moves_no_end_but_its_interval_holds_it() -> None:
    """A meteor of S/N 840 with a tenth of its light for 10 px more. Other sources may shine so: the end stays. Where the light
    stops with a step, the interval stays too."""
    for seed in range(4):
        step = strip(seed, 190.0, density=3_000.0)
        beyond = strip(99, 200.0, density=300.0).value_e - strip(99, 190.0, density=300.0).value_e
        before, after = both(replace(step, value_e=step.value_e + beyond), 190.0)
        assert (after.row1, after.col1) == (before.row1, before.col1)
        assert 200.0 - after.col1 - 2.0 < after.end_interval_px[1, 1] < 15.0
        assert before.end_interval_px[1, 1] < 1.0
        assert after.flags & StreakFlag.ENDS_NOT_GAUSSIAN
        before, after = both(step, 190.0)
        assert after.end_interval_px[1].tolist() == before.end_interval_px[1].tolist()


def after_ends(fit: StreakFit) -> tuple[tuple[float, float], tuple[float, float]]:
    return (fit.row0, fit.col0), (fit.row1, fit.col1)


def test_a_level_that_bends_beside_the_trail_is_no_light_of_it() -> None:
    """The sky of the last 60 columns is 15 e- off, as where a mesh of 64 px ends at a vignetted border. No block sees it."""
    flat = strip(3, 190.3)
    bent = replace(flat, value_e=flat.value_e + np.where(flat.col > COLS - 60, 15.0, 0.0).astype(np.float32))
    frame = TrailFrame.of_chord(MIDDLE, FIRST, MIDDLE, 190.0)
    first, second = (blocks_of(usable_pixels(p, frame, math.inf), SIGMA_PX, COLS - 115.5) for p in (flat, bent))
    whole = (first.place < 115.0) | (first.place > 135.0)
    assert np.abs(second.density - first.density)[whole].max() < 1e-3
    assert both(bent, 190.0)[1].col1 == pytest.approx(190.3, abs=2.0)


def test_a_star_beyond_the_end_does_not_lengthen_a_trail() -> None:
    """A point of S/N 40 lies 12 px beyond the end: the interval, if anything, holds the true end."""
    for seed in range(5):
        pixels = strip(seed, 190.3)
        star = 1500.0 * np.exp(-0.5 * ((pixels.row - MIDDLE) ** 2 + (pixels.col - 202.0) ** 2) / SIGMA_PX**2)
        _, after = both(replace(pixels, value_e=pixels.value_e + (star / 2.0).astype(np.float32)), 190.0)
        low, high = after.end_interval_px[1]
        assert after.col1 + min(low, -2.0) <= 190.3 <= after.col1 + max(high, 2.0)


def test_stars_beside_and_on_the_line_leave_their_blocks_unknown_and_the_last_lit_one_known() -> None:
    """Light beside the line raises its sky: that block is too dark. Where a trail stops, its last block is the brighter one."""
    frame = TrailFrame.of_chord(MIDDLE, FIRST, MIDDLE, 190.0)
    whole = blocks_of(usable_pixels(strip(2, 190.3), frame, math.inf), SIGMA_PX, COLS - 115.5)
    place = whole.place + 0.5 * (FIRST + 190.0)
    last = int(np.flatnonzero(place < 187.0)[-1])
    assert np.isfinite(whole.sigma).all()
    dark, on = last - 4, last - 9
    pixels = strip(2, 190.3)
    from_line, from_dark, from_on = np.abs(pixels.row - MIDDLE), np.abs(pixels.col - place[dark]), np.abs(pixels.col - place[on])
    light = np.where((from_line > 4.5) & (from_dark < 5.0), 90.0, 0.0) + np.where((from_line < 2.0) & (from_on < 1.5), 300.0, 0.0)
    starry = replace(pixels, value_e=(pixels.value_e + light).astype(np.float32))
    blocks = blocks_of(usable_pixels(starry, frame, math.inf), SIGMA_PX, COLS - 115.5)
    assert not np.isfinite(blocks.sigma[[dark, on]]).any()
    assert np.isfinite(blocks.sigma[last])
    assert np.isfinite(blocks.sigma).sum() >= blocks.sigma.size - 4
    assert blocks.density[dark] < 0.6 * whole.density[dark]


def test_only_frames_from_outside_are_followed() -> None:
    outside = scenarios.bare("process", base_document("none"), registry=Registry())
    orbit = scenarios.bare("orbit", {}, registry=Registry())
    assert outside.step("ground.streak_fitter").fading_ends
    assert not orbit.step("ground.streak_fitter").fading_ends
    failed = TrailedPsfFitter().fit(strip(1, 0.0, 0.0), seen(190.0))
    assert with_fading_ends(failed, strip(1, 0.0, 0.0)) is failed


def test_an_end_at_a_mask_reaches_through_it_and_one_in_the_sky_does_not() -> None:
    """A uniform trail runs on to column 230, below columns that are masked from 201 on. One without a mask ends at 200."""
    masked = strip(3, 230.0)
    unknown = masked.col > 200
    covered = replace(masked, variance_e2=np.where(unknown, np.inf, masked.variance_e2).astype(np.float32))
    _, through = both(covered, 200.0)
    assert through.col1 + through.end_interval_px[1, 1] == pytest.approx(COLS - 0.5, abs=0.1)
    assert through.flags & StreakFlag.ENDS_NOT_GAUSSIAN
    _, free = both(strip(3, 200.0), 200.0)
    assert free.end_interval_px[1, 1] < 3.0


def drawn_blocks(n: int, seed: int) -> Blocks:
    """Light of one density that stops after three quarters of the blocks, one in ten of which is unknown."""
    rng = np.random.default_rng(seed)
    sigma = np.where(rng.random(n) < 0.1, math.inf, rng.uniform(0.5, 2.0, n))
    density = np.where(np.isfinite(sigma), 0.6 * (np.arange(n) < 0.75 * n) + rng.standard_normal(n), 0.0)
    length = 4.0 * SIGMA_PX
    return Blocks(place=(np.arange(n) + 0.5) * length, density=density, sigma=sigma, length_px=length)


def test_the_best_step_is_that_of_all_blocks_at_all_stops() -> None:
    """The whole table of shares, stops by blocks, as the likelihood is written down."""
    blocks, first = drawn_blocks(90, 3), 4
    edges = blocks.place[first:, None] + 0.5 * blocks.length_px * np.array([-1.0, 1.0])
    stops = np.arange(edges[0, 0] + 0.1 * SIGMA_PX, edges[-1, 1] + 0.05 * SIGMA_PX, 0.1 * SIGMA_PX)
    u = (stops[:, None, None] - edges) / SIGMA_PX
    ramp = u * ndtr(u) + np.exp(-0.5 * u**2) / math.sqrt(2.0 * math.pi)
    lit = SIGMA_PX / blocks.length_px * (ramp[..., 0] - ramp[..., 1])
    weight = blocks.sigma[first:] ** -2.0
    gains = 0.5 * np.maximum((lit * weight) @ blocks.density[first:], 0.0) ** 2 / (lit**2 @ weight)
    assert _best_step(blocks, blocks.sigma, SIGMA_PX, first) == pytest.approx(gains.max(), rel=1e-9)


def test_a_line_of_five_thousand_blocks_needs_memory_for_its_stops_alone() -> None:
    """A photograph of 2592 x 3872 px had one 0.1 px wide: 212,680 stops by 5,317 blocks took 24 GB, and the run was killed."""
    tracemalloc.start()
    assert _best_step(drawn_blocks(5_317, 4), drawn_blocks(5_317, 4).sigma, SIGMA_PX, 0) > 0.0
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 100e6


def test_the_sky_beside_a_block_is_the_median_of_three_groups_and_nothing_where_they_are_few() -> None:
    rng = np.random.default_rng(8)
    first = np.concatenate(([0], np.cumsum(rng.integers(0, 15, 60))))
    value, variance = rng.normal(size=first[-1]), rng.uniform(1.0, 2.0, first[-1])
    level, level_variance = _running_medians(value, variance, first)
    for k in range(first.size - 3):
        near = slice(first[k], first[k + 3])
        if (count := near.stop - near.start) < LEAST_BESIDE:
            assert (level[k], level_variance[k]) == (0.0, 0.0)
        else:
            assert level[k] == np.median(value[near])
            assert level_variance[k] == MEDIAN_VARIANCE * np.median(variance[near]) / count


@pytest.mark.parametrize("seed", range(3))
def test_a_meteor_beside_other_light_is_fitted_without_its_shape(seed: int) -> None:
    """A rise and fall to nothing, 90 px long, and a star 15 to 60 px behind its end. With the shape of its light the model is
    dark there and its end open: 31 of these 36 fits ran away and gave the detection's values."""
    col = np.arange(COLS)
    place = (col - FIRST - 45.0) / 45.0
    for gap in (15.0, 30.0, 60.0):
        star = 0.3 * np.exp(-0.5 * ((col - 130.0 - gap) / 3.0) ** 2)
        for shape in (1.0 - place**2, 1.0 - np.abs(place)):
            for density in (300.0, 900.0):
                pixels = strip(seed, float(COLS), 1.5 * np.maximum(shape, 0.0) + star, density=density)
                fit = TrailedPsfFitter().fit(pixels, seen(130.0))
                assert not fit.flags & StreakFlag.FIT_FAILED
                assert 30.0 < fit.col0 < 62.0
                assert 108.0 < fit.col1 < 150.0 + gap
