"""Facts about the default detector: what it finds, what it refuses, and that its statistic is honest."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from onboard.detect import LineIntegralDetector, whiten
from onboard.detect.cross_profile import cross_profile
from onboard.detect.line_integral import corridor, refine, sharpness, strip
from onboard.detect.line_integral.dyadic import line_sums, work_size
from onboard.detect.line_integral.star_removal import star_light
from sboc_e2e.icd.flags import MaskBit, StreakFlag
from sboc_e2e.icd.signals import UNKNOWN, Detection, DetectorView
from sboc_e2e.icd.steps import Detector
from tests.benchmarks.bench_detection import clip, score
from tests.benchmarks.detection_frames import (
    PSF_SIGMA_PX,
    SIGMA,
    Scene,
    StarTruth,
    Streak,
    add_streak,
    bare_view,
    exposure,
    random_stars,
    streak_template,
    view_of,
)

NO_STARS = StarTruth(row=np.zeros(0), col=np.zeros(0), snr=np.zeros(0))


def noise_scene(size: int, seed: int) -> tuple[Scene, np.random.Generator]:
    """Noise alone, and the generator that made it."""
    rng = np.random.default_rng(seed)
    return exposure(size, NO_STARS, rng), rng


def found_in(scene: Scene, history: tuple[DetectorView, ...] = ()) -> tuple[Detection, ...]:
    """Detections of the default detector."""
    return LineIntegralDetector().detect(view_of(scene, frame=1, history=history))


def test_matches_the_protocol() -> None:
    assert isinstance(LineIntegralDetector(), Detector)
    assert LineIntegralDetector().history_frames == 1


@pytest.mark.parametrize(("height", "shift"), [(4, 2), (16, 16 - 1), (32, 0), (64, 21)])
def test_dyadic_sum_of_a_drawn_line_is_its_number_of_pixels(height: int, shift: int) -> None:
    """A line drawn by the recursion's own rule (shift halves as s//2 + (s+1)//2) is summed completely."""

    def columns(rows: int, s: int) -> list[int]:
        if rows == 1:
            return [0]
        first = columns(rows // 2, s // 2)
        return first + [c + s - s // 2 for c in columns(rows // 2, s // 2)]

    image = np.zeros((64, 200), np.int16)
    for row, col in enumerate(columns(height, shift)):
        image[row, 60 + col] = 7
    store = np.empty(work_size(*image.shape), np.int16)
    table = line_sums(image, False, np.array([1.0, 1.0]), 2.0, height, 1000, store, np.zeros(1, np.int64))
    best = table[np.argmax(table[:, 4])]
    assert best[0] == 0
    assert best[1] == height
    assert best[2] == 60
    assert best[3] == shift
    assert best[4] * math.sqrt(height) == pytest.approx(7 * height, rel=0.02)  # sums of 64 rows and more are halved and rounded


def test_statistic_of_noise_is_standard_normal() -> None:
    scene, rng = noise_scene(1024, 3)
    image = whiten.quantise(scene.image, np.zeros(scene.image.shape, np.uint8), np.full((16, 16), SIGMA, np.float32), 64)
    blocked, level = np.zeros(image.shape, np.uint8), np.zeros((16, 16), np.float32)
    signal, weight = np.empty(1100), np.empty(1100)
    values = []
    for _ in range(1500):
        row, col, length = rng.uniform(60, 600), rng.uniform(250, 750), rng.uniform(20, 380)
        slope = rng.uniform(-0.6, 0.6)
        _, n = cross_profile(
            image, blocked, level, 64, row, col, row + length, col + slope * length, 0.0, 0, PSF_SIGMA_PX, signal, weight
        )
        values.append(refine.profile_snr(signal, weight, n))
    # lines overlap, so the standard error is about twice that of independent draws
    assert np.mean(values) == pytest.approx(0.0, abs=0.10)
    assert np.std(values) == pytest.approx(1.0, abs=0.05)


def test_noise_alone_gives_nothing() -> None:
    for seed in range(3):
        assert found_in(noise_scene(1024, 200 + seed)[0]) == ()


def test_stars_alone_give_nothing_when_the_frame_before_is_known() -> None:
    rng = np.random.default_rng(5)
    stars = random_stars(1024, 25_000, rng)
    before = view_of(exposure(1024, stars, rng, shift_px=(0.4, -0.7)))
    found = found_in(exposure(1024, stars, rng), (before,))
    assert [d for d in found if not d.flags & StreakFlag.COSMIC_LIKE] == []


def star_scene(seed: int, streaks: list[Streak], n_stars: int = 25_000) -> tuple[Scene, tuple[DetectorView, ...]]:
    """A 1024 px star field with streaks, and the frame before; n_stars above S/N 8 per 4096 x 4096 px."""
    rng = np.random.default_rng(seed)
    stars = random_stars(1024, n_stars, rng)
    before = view_of(exposure(1024, stars, rng, shift_px=(0.3, 0.2)))
    scene = exposure(1024, stars, rng)
    for streak in streaks:
        add_streak(scene, streak, rng)
    return scene, (before,)


@pytest.mark.parametrize("length_px", [20.0, 60.0, 200.0, 800.0])
@pytest.mark.slow
def test_mean_statistic_is_the_matched_filter_snr_within_5_percent(length_px: float) -> None:
    ratios = []
    for seed in range(12):
        rng = np.random.default_rng(100 + seed)
        truth = []
        for k in range(3):
            angle = rng.uniform(-0.25, 0.25)
            row, half = 250.0 + 250.0 * k, (0.5 * length_px * math.sin(angle), 0.5 * length_px * math.cos(angle))
            truth.append(Streak(row0=row - half[0], col0=512.0 - half[1], row1=row + half[0], col1=512.0 + half[1], snr=20.0))
        scene, history = star_scene(100 + seed, truth, n_stars=2_000)
        paired, fragments, false = score(found_in(scene, history), truth)
        assert fragments == 0
        assert false == 0
        ratios += [d.snr / 20.0 for d in paired if d is not None]
    assert len(ratios) == 36
    # the mean of 36 scatters by 1 %, from noise and the streaks' own Poisson noise; of 36 others it was 0.98 to 0.99
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.05)


def test_bright_streaks_are_not_eaten_by_the_star_mask() -> None:
    """Trails bright enough to fill the star list come out whole, each as one detection."""
    truth = [
        Streak(row0=100.0, col0=100.0, row1=115.0, col1=110.0, snr=60.0),
        Streak(row0=300.0, col0=200.0, row1=340.0, col1=600.0, snr=300.0),
        Streak(row0=900.0, col0=50.0, row1=500.0, col1=950.0, snr=1500.0),
    ]
    scene, history = star_scene(7, truth)
    paired, fragments, false = score(found_in(scene, history), scene.streaks)
    assert all(d is not None for d in paired)
    assert fragments == 0
    assert false == 0
    for detection, streak in zip(paired, truth, strict=True):
        assert detection is not None
        assert detection.snr == pytest.approx(streak.snr, rel=0.15)


def test_short_bright_lines_of_a_frame_that_stands_alone_are_found_where_they_are_asked_for() -> None:
    """Blends of stars are as short: the default leaves them out, and faint ones are never reported."""
    scene, rng = noise_scene(512, 11)
    bright = Streak(row0=100.0, col0=100.0, row1=107.0, col1=116.0, snr=45.0)
    add_streak(scene, bright, rng)
    add_streak(scene, Streak(row0=300.0, col0=300.0, row1=307.0, col1=316.0, snr=14.0), rng)
    long = Streak(row0=400.0, col0=100.0, row1=420.0, col1=300.0, snr=30.0)
    add_streak(scene, long, rng)
    view = view_of(scene, frame=1, history=())
    (only,) = LineIntegralDetector().detect(view)
    assert only.length_px == pytest.approx(long.length_px, abs=8.0)
    paired, _, false = score(LineIntegralDetector(blend_px=12.0).detect(view), [bright, long])
    assert all(found is not None for found in paired)
    assert false == 0


def test_point_like_mover_is_found_and_flagged() -> None:
    scene, history = star_scene(8, [Streak(row0=700.0, col0=300.0, row1=700.0, col1=300.5, snr=25.0)])
    found = [d for d in found_in(scene, history) if not d.flags & StreakFlag.COSMIC_LIKE]
    assert len(found) == 1
    assert math.hypot(0.5 * (found[0].row0 + found[0].row1) - 700.0, 0.5 * (found[0].col0 + found[0].col1) - 300.25) < 0.5
    assert found[0].flags & StreakFlag.POINT_LIKE


def test_two_judgements_of_one_search_give_what_each_gives_alone() -> None:
    """The first one marks the short trails that it finds, and the second one passed over them."""
    scene, history = star_scene(8, [Streak(row0=700.0, col0=300.0, row1=700.0, col1=308.0, snr=40.0)])
    found = found_in(scene, history)
    assert any(abs(d.row0 - 700.0) < 2.0 for d in found)
    in_white_noise, again = LineIntegralDetector().detect_in_white_noise(view_of(scene, frame=1, history=history))
    assert again == found
    assert set(again) <= set(in_white_noise)


@pytest.mark.parametrize("snr", [100.0, 300.0])
def test_bright_slow_mover_is_found_by_its_shift(snr: float) -> None:
    """One pixel per frame at S/N 100 and more: its light overlaps that of the frame before."""
    rng = np.random.default_rng(9)
    stars = random_stars(1024, 25_000, rng)
    before, now = exposure(1024, stars, rng, shift_px=(0.3, 0.2)), exposure(1024, stars, rng)
    for scene, col in ((before, 502.2), (now, 503.4)):
        row = 610.0 + (0.3 if scene is before else 0.0)
        add_streak(scene, Streak(row0=row, col0=col, row1=row, col1=col + 0.6, snr=snr), rng)
    found = found_in(now, (view_of(before),))
    near = [d for d in found if math.hypot(d.row0 - 610.0, 0.5 * (d.col0 + d.col1) - 503.7) < 1.0]
    assert len(near) == 1
    assert near[0].flags & StreakFlag.POINT_LIKE


def test_parallel_streaks_stay_two_and_crossing_ones_are_found() -> None:
    truth = [
        Streak(row0=200.0, col0=100.0, row1=260.0, col1=500.0, snr=16.0),
        Streak(row0=208.0, col0=100.0, row1=268.0, col1=500.0, snr=14.0),
        Streak(row0=600.0, col0=300.0, row1=900.0, col1=500.0, snr=16.0),
        Streak(row0=880.0, col0=280.0, row1=640.0, col1=520.0, snr=14.0),
    ]
    scene, rng = noise_scene(1024, 11)
    for streak in truth:
        add_streak(scene, streak, rng)
    paired, fragments, false = score(found_in(scene), truth)
    assert all(d is not None for d in paired)
    assert fragments == 0
    assert false == 0


def test_curved_and_varying_streaks_lose_less_than_5_percent() -> None:
    means = {}
    for name, change in (("straight", {}), ("curved", {"sagitta_px": 3.0}), ("varying", {"brightness_change": 0.4})):
        values = []
        for seed in range(2):
            scene, rng = noise_scene(1024, 300 + seed)
            truth = [
                replace(Streak(row0=r, col0=200.0, row1=r + 90.0, col1=600.0, snr=18.0), **change) for r in (150.0, 450.0, 750.0)
            ]
            for streak in truth:
                add_streak(scene, streak, rng)
            paired, _, _ = score(found_in(scene), truth)
            assert all(d is not None for d in paired)
            values += [d.snr for d in paired if d is not None]
        means[name] = float(np.mean(values))
    assert means["curved"] > 0.95 * means["straight"]
    assert means["varying"] > 0.95 * means["straight"]


def test_noise_does_not_bend_straight_streaks() -> None:
    """At S/N 9 the sagitta of a line is known to 0.45 px: half of them look bent by more than 0.3 px."""
    found = []
    for seed in range(2):
        scene, rng = noise_scene(1024, 310 + seed)
        truth = [Streak(row0=r, col0=150.0, row1=r + 60.0, col1=800.0, snr=9.0) for r in np.arange(60.0, 960.0, 90.0)]
        for streak in truth:
            add_streak(scene, streak, rng)
        found += [d for d in score(found_in(scene), truth)[0] if d is not None]
    assert len(found) >= 17
    assert sum(d.sagitta_px != 0.0 for d in found) <= 1


def test_search_over_all_parameters_sums_every_line_of_the_strip() -> None:
    """Where a segment turned far on its way, what the work arrays held before once came out as S/N."""
    rng = np.random.default_rng(41)
    image = np.clip(np.rint(16.0 * rng.standard_normal((400, 400))), -127, 127).astype(np.int8)
    blocked, level, space = np.zeros(image.shape, np.uint8), np.zeros((7, 7), np.float32), strip.work_space(400, PSF_SIGMA_PX)
    for _ in range(400):
        row, col, slope = rng.uniform(150.0, 230.0), rng.uniform(150.0, 230.0), rng.uniform(-1.0, 1.0)
        segment = np.array([row, col, row + 10.0, col + 10.0 * slope, 0.0])
        signal, weight = np.full(401, 1e6), np.ones(401)
        assert refine.polish(image, blocked, level, 64, segment, corridor.BENT_PX, PSF_SIGMA_PX, signal, weight, space) < 8.0


def test_bend_is_found_from_a_straight_start() -> None:
    """The fit from straight lines beside a bent trail comes as high as the fit from the truth."""
    blocked, level, space = np.zeros((260, 260), np.uint8), np.zeros((5, 5), np.float32), strip.work_space(260, PSF_SIGMA_PX)
    signal, weight = np.empty(261), np.empty(261)
    for seed in range(6):
        scene = exposure(260, NO_STARS, rng := np.random.default_rng((42, seed)))
        add_streak(scene, Streak(row0=30.0, col0=100.0, row1=230.0, col1=130.0, snr=12.0, sagitta_px=-3.0), rng)
        image = np.clip(np.rint(16.0 * scene.image / SIGMA), -127, 127).astype(np.int8)
        fits = []
        for offset, sagitta in ((0.0, 3.05), (0.0, 0.0), (2.0, 0.0), (3.0, 0.0)):
            segment = np.array([30.0, 100.0 + offset, 230.0, 130.0 + offset, sagitta])
            fits.append(refine.polish(image, blocked, level, 64, segment, corridor.BENT_PX, PSF_SIGMA_PX, signal, weight, space))
        assert min(fits[1:]) > 0.98 * fits[0]


def test_light_of_a_trail_over_noise_is_not_a_stars() -> None:
    """A place with S/N 3 now and 2.6 then keeps most of its light; one with 5 and 5 is a star; without stars nothing is one."""
    now, then = np.array([2.9, 5.0, 7.0, 2.1]), np.array([2.6, 5.0, 4.5, 7.0])
    light = star_light(now, then, 25_000 / 4096**2, PSF_SIGMA_PX)
    assert light[0] < 1.0
    assert light[1] > 4.0
    assert np.all((light >= 0.0) & (light <= then))
    assert not star_light(now, then, 0.0, PSF_SIGMA_PX).any()


def test_level_costs_a_trail_of_any_length_a_hundredth_of_its_light() -> None:
    profile = np.array([3, 24, 47, 24, 3], np.int8)
    image = np.zeros((1024, 1024), np.int8)
    image[:, 510:515] = profile
    level = whiten.local_level(image, np.zeros(image.shape, np.uint8), 64)
    template = profile / profile.sum()
    assert 0.0 < level[8, 8] < 0.01 * float(template @ profile)


def test_sagitta_has_the_sign_of_the_contract() -> None:
    """Positive towards (+drow, -dcol) turned from the chord: the bench draws with the normal (dcol, -drow) / length."""
    for sign in (1.0, -1.0):
        for ends in ((300.0, 200.0, 420.0, 700.0), (200.0, 300.0, 700.0, 420.0)):
            scene, rng = noise_scene(1024, 12)
            add_streak(
                scene, Streak(row0=ends[0], col0=ends[1], row1=ends[2], col1=ends[3], snr=60.0, sagitta_px=3.0 * sign), rng
            )
            found = found_in(scene)
            assert len(found) == 1
            assert found[0].flags & StreakFlag.CURVED
            forward = (found[0].row1 - found[0].row0) * (ends[2] - ends[0]) + (found[0].col1 - found[0].col0) * (
                ends[3] - ends[1]
            )
            assert found[0].sagitta_px * np.sign(forward) == pytest.approx(3.0 * sign, abs=1.0)


def test_streak_cut_by_the_edge_is_found_and_flagged() -> None:
    """At every edge, steep and flat: the cut end lies near the edge, both ends on the trail."""
    flagged = []
    for turns, across_deg in itertools.product(range(4), (-70.0, -20.0, 55.0)):
        scene, rng = noise_scene(512, 13)
        u_row, u_col = np.cos(np.radians(across_deg)), np.sin(np.radians(across_deg))
        row, col = np.array([-100.0 * u_row, 200.0 * u_row]), 250.0 + np.array([-100.0 * u_col, 200.0 * u_col])
        for _ in range(turns):
            row, col = col, 511.0 - row
        streak = Streak(row0=row[0], col0=col[0], row1=row[1], col1=col[1], snr=14.0)
        add_streak(scene, streak, rng)
        found = found_in(scene)
        inside = clip(streak, 512)
        paired, _, false = score(found, [inside])
        assert paired[0] is not None
        assert false == 0
        ends = np.array([[paired[0].row0, paired[0].col0], [paired[0].row1, paired[0].col1]])
        truth = np.array([[inside.row0, inside.col0], [inside.row1, inside.col1]])
        gap = np.hypot(*np.moveaxis(ends[:, None] - truth, -1, 0))
        cut = int(np.argmin(gap[:, 0]))  # which end is the one at the edge
        assert gap[cut, 0] < 16.0  # a faint end may stop short of it: 5.1 L / S^2 rms
        flagged.append(bool(paired[0].flags & (StreakFlag.EDGE0, StreakFlag.EDGE1)[cut]))
        assert not paired[0].flags & (StreakFlag.EDGE1, StreakFlag.EDGE0)[cut]
        along = (truth[1] - truth[0]) / np.hypot(*(truth[1] - truth[0]))
        assert np.abs((ends - truth[0]) @ (-along[1], along[0])).max() < 1.0
    assert sum(flagged) >= 8


def test_hot_column_and_aligned_stars_are_refused() -> None:
    """What the frame before shows at the same place of the sensor or of the sky is no mover."""
    rng = np.random.default_rng(14)
    chain = StarTruth(row=400.0 + 4.5 * np.arange(6), col=300.0 + 3.0 * np.arange(6), snr=np.full(6, 6.0))
    before, now = exposure(1024, chain, rng, shift_px=(1.0, 0.0)), exposure(1024, chain, rng)
    for scene in (before, now):
        scene.image[100:700, 800] += np.float32(3.0 * SIGMA)
    stars = random_stars(1024, 20_000, rng)
    for scene, shift in ((before, (1.0, 0.0)), (now, (0.0, 0.0))):
        scene.image += exposure(1024, stars, np.random.default_rng(1), shift_px=shift).image * np.float32(0.5)
    found = found_in(now, (view_of(before),))
    assert [d for d in found if d.snr > 8.5] == []


def test_particle_track_is_flagged_sharp() -> None:
    scene, _ = noise_scene(512, 15)
    for k in range(40):
        scene.image[100 + k, 200 + k // 4] += np.float32(12.0 * SIGMA)
    found = LineIntegralDetector().detect(view_of(scene))
    assert len(found) >= 1
    assert all(d.flags & StreakFlag.COSMIC_LIKE for d in found)


def track(scene: Scene, row: float, col: float, angle: float, length_px: float, e_px: float) -> None:
    """Charge of a straight track of no width, split by path length in steps of 0.02 px."""
    steps = np.arange(0.0, length_px, 0.02)
    rows = np.rint(row + steps * math.sin(angle)).astype(np.int64)
    cols = np.rint(col + steps * math.cos(angle)).astype(np.int64)
    inside = (rows >= 0) & (rows < scene.image.shape[0]) & (cols >= 0) & (cols < scene.image.shape[1])
    np.add.at(scene.image, (rows[inside], cols[inside]), np.float32(0.02 * e_px))


def sharpness_of(scene: Scene, streak: Streak) -> float:
    """Gain in squared S/N of a track over the PSF at a segment."""
    detection = Detection(row0=streak.row0, col0=streak.col0, row1=streak.row1, col1=streak.col1, snr=streak.snr)
    return sharpness.sharpness(detection, bare_view(scene), np.zeros((1, 1), np.float32), max(scene.image.shape))


@pytest.mark.parametrize("snr", [8.0, 20.0, 100.0])
@pytest.mark.parametrize("length_px", [4.0, 12.0, 60.0, 200.0])
@pytest.mark.slow
def test_trails_of_light_are_not_sharp_and_tracks_of_the_same_light_are(length_px: float, snr: float) -> None:
    """At most one trail of 60 looks like a track (measured: 0.06 % of 17,400), every track from S/N 20 on does."""
    rng = np.random.default_rng(int(10 * snr + length_px))
    light, tracks = [], []
    for _ in range(60):
        angle, centre = rng.uniform(0.0, math.pi), 120.0 + rng.uniform(-0.5, 0.5, 2)
        half = 0.5 * length_px * np.array([math.sin(angle), math.cos(angle)])
        streak = Streak(
            row0=centre[0] - half[0], col0=centre[1] - half[1], row1=centre[0] + half[0], col1=centre[1] + half[1], snr=snr
        )
        scene = exposure(240, NO_STARS, rng)
        add_streak(scene, streak, rng)
        light.append(sharpness_of(scene, streak))
        scene = exposure(240, NO_STARS, rng)
        # light per px of a trail of this S/N, F = S sigma sqrt(2 sqrt(pi) s L)
        e_px = snr * SIGMA * math.sqrt(2.0 * math.sqrt(math.pi) * PSF_SIGMA_PX / length_px)
        track(scene, streak.row0, streak.col0, angle, length_px, e_px)
        tracks.append(sharpness_of(scene, streak))
    assert np.count_nonzero(np.array(light) > sharpness.SHARP_EVIDENCE) <= 1
    # rho = 0.87: S^2 (rho^2 - 1) = -0.24 S^2 for light, less by the search for the best place of both shapes
    assert np.median(light) < -0.05 * snr**2
    if snr >= 20.0:
        assert np.min(tracks) > sharpness.SHARP_EVIDENCE


def test_bright_tracks_beside_their_path_are_tracks() -> None:
    """Paths 0.8 to 1.2 px off, or turned by as much at the ends: the narrow cross-section holds nothing there."""
    rng = np.random.default_rng(8)
    for k in range(40):
        scene = exposure(160, NO_STARS, rng)
        angle, length_px = rng.uniform(0.0, math.pi), rng.uniform(12.0, 60.0)
        along = np.array([math.sin(angle), math.cos(angle)])
        across = np.array([along[1], -along[0]])
        row, col = 80.0 - 0.5 * length_px * along
        track(scene, row, col, angle, length_px, rng.uniform(50.0, 200.0) * SIGMA)
        off = rng.uniform(0.8, 1.2) * rng.choice([-1.0, 1.0])
        start, stop = np.array([row, col]) + off * across, np.array([row, col]) + length_px * along + off * (-1) ** k * across
        path = Streak(row0=start[0], col0=start[1], row1=stop[0], col1=stop[1], snr=30.0)
        assert sharpness_of(scene, path) > sharpness.SHARP_EVIDENCE


def test_tracks_near_an_axis_are_tracks_although_their_step_is_found_as_a_bend() -> None:
    """Bright tracks of 45 to 80 px that change row or column about once: each is flagged (7 of 60 were not)."""
    rng = np.random.default_rng(1)
    for _ in range(60):
        scene = exposure(200, NO_STARS, rng)
        length_px, snr = rng.uniform(45, 80), 10 ** rng.uniform(2, 2.9)
        angle = math.atan(rng.uniform(0.5, 1.5) / length_px) * rng.choice([-1, 1]) + rng.choice([0.0, 0.5 * math.pi])
        row, col = 100.0 - 0.5 * length_px * np.array([math.sin(angle), math.cos(angle)]) + rng.uniform(-0.5, 0.5, 2)
        e_px = snr * SIGMA * math.sqrt(2.0 * math.sqrt(math.pi) * PSF_SIGMA_PX / length_px)
        track(scene, row, col, angle, length_px, e_px)
        found = found_in(scene)
        assert found
        assert all(d.flags & StreakFlag.COSMIC_LIKE for d in found)


def test_bent_trails_of_light_are_not_tracks() -> None:
    """Parabolas of light, sagitta 0.6 to 6 px either way, S/N 16 to 160: found, and none is flagged."""
    rng = np.random.default_rng(2)
    found = 0
    for _ in range(30):
        scene = exposure(240, NO_STARS, rng)
        length_px, angle, sagitta_px = rng.uniform(60, 180), rng.uniform(0, math.pi), rng.uniform(0.6, 6) * rng.choice([-1, 1])
        u = np.linspace(-1.0, 1.0, 81)
        along, across = 0.5 * length_px * u, sagitta_px * (1.0 - u**2)
        row = 120.0 + along * math.sin(angle) + across * math.cos(angle)
        col = 120.0 + along * math.cos(angle) - across * math.sin(angle)
        light = np.zeros(scene.image.shape)
        for k in range(80):
            piece = Streak(row0=row[k], col0=col[k], row1=row[k + 1], col1=col[k + 1], snr=1.0)
            rows, cols, share = streak_template(piece, scene.image.shape)
            np.add.at(light, (rows, cols), share)
        electrons = 10 ** rng.uniform(1.2, 2.2) * SIGMA / math.sqrt(float(np.sum(light**2))) * light
        scene.image += (electrons + np.sqrt(electrons) * rng.standard_normal(electrons.shape)).astype(np.float32)
        long = [d for d in found_in(scene) if d.length_px > 0.5 * length_px]
        found += len(long)
        assert not any(d.flags & StreakFlag.COSMIC_LIKE for d in long)
    assert found >= 27


def test_a_hit_or_a_star_under_a_faint_trail_does_not_make_it_a_track() -> None:
    rng = np.random.default_rng(32)
    flagged = 0
    for _ in range(60):
        streak = Streak(row0=60.0, col0=20.0, row1=60.0 + rng.uniform(0.0, 60.0), col1=220.0, snr=9.0)
        scene = exposure(240, NO_STARS, rng)
        add_streak(scene, streak, rng)
        share = rng.uniform(0.1, 0.9)
        row, col = streak.row0 + share * (streak.row1 - streak.row0), 20.0 + share * 200.0
        track(scene, row + rng.uniform(-1.5, 1.5), col, rng.uniform(0.0, math.pi), 3.0, 100.0 * SIGMA)
        flagged += sharpness_of(scene, streak) > sharpness.SHARP_EVIDENCE
    assert flagged <= 1


def test_trail_among_300_bright_tracks_is_sent_and_they_are_not() -> None:
    """Tracks brighter than what the working image holds, 4,800 per 4096 x 4096 px: S/N of hundreds against 12."""
    truth = [Streak(row0=200.0, col0=150.0, row1=330.0, col1=820.0, snr=12.0)]
    scene, history = star_scene(33, truth)
    rng = np.random.default_rng(34)
    for _ in range(300):
        row, col, angle = (*rng.uniform(0.0, 1024.0, 2), rng.uniform(0.0, math.pi))
        track(scene, row, col, angle, rng.uniform(3.0, 40.0), rng.uniform(10.0, 300.0) * SIGMA)
    found = LineIntegralDetector(max_detections=20).detect(view_of(scene, frame=1, history=history))
    paired, _, false = score([d for d in found if not d.flags & StreakFlag.COSMIC_LIKE], truth)
    assert paired[0] is not None
    # where tracks cross, their lines are no longer sharp
    assert false <= 0.05 * 300


def masked(view: DetectorView, mask: NDArray[np.uint8]) -> DetectorView:
    """The view with a mask; masked pixels hold 0 as the chain delivers them."""
    return replace(view, mask=mask, residual_adu=np.where(mask == 0, view.residual_adu, 0).astype(np.float32))


def test_streak_is_found_in_a_frame_masked_to_nine_tenths() -> None:
    scene, rng = noise_scene(1024, 16)
    add_streak(scene, Streak(row0=100.0, col0=100.0, row1=800.0, col1=900.0, snr=60.0), rng)
    mask = np.where(rng.random(scene.image.shape) < 0.9, np.uint8(MaskBit.DEAD), np.uint8(0))
    found = LineIntegralDetector().detect(masked(view_of(scene), mask))
    assert len(found) >= 1
    assert found[0].length_px == pytest.approx(1063.0, rel=0.05)
    assert found[0].snr == pytest.approx(60.0 * math.sqrt(0.1), rel=0.25)


@pytest.mark.parametrize("shape", [(64, 64), (100, 100), (65, 127), (20, 300), (7, 7), (1, 1)])
@pytest.mark.parametrize("content", ["zero", "constant", "noise"])
def test_small_and_empty_frames(shape: tuple[int, int], content: str) -> None:
    rng = np.random.default_rng(17)
    image = {"zero": np.zeros(shape), "constant": np.full(shape, 50.0 * SIGMA), "noise": SIGMA * rng.standard_normal(shape)}[
        content
    ]
    view = view_of(Scene(image=image.astype(np.float32)))
    for history in ((), (view,)):
        found = LineIntegralDetector().detect(replace(view, history=history))
        if content != "constant":
            assert found == ()
            continue
        # Light of 50 sigma everywhere holds lines. No sum of N pixels whose weights have norm 1 exceeds 50 sqrt(N).
        assert bool(found) == (min(shape) >= 20)
        for d in found:
            assert 0.0 < d.snr <= 50.0 * math.sqrt(image.size)
            assert 0.0 <= min(d.row0, d.row1) <= max(d.row0, d.row1) <= shape[0] - 1
            assert 0.0 <= min(d.col0, d.col1) <= max(d.col0, d.col1) <= shape[1] - 1


def test_saturated_frame_and_zero_noise_do_not_raise() -> None:
    view = view_of(Scene(image=np.zeros((128, 128), np.float32)))
    saturated = masked(view, np.full((128, 128), int(MaskBit.SATURATED), np.uint8))
    LineIntegralDetector().detect(saturated)
    no_noise = replace(view, background=replace(view.background, sigma_adu=np.zeros((2, 2), np.float32)))
    assert LineIntegralDetector().detect(no_noise) == ()


def test_input_is_untouched_and_result_deterministic_and_inside() -> None:
    scene, history = star_scene(18, [Streak(row0=5.0, col0=5.0, row1=1020.0, col1=1018.0, snr=40.0)])
    view = view_of(scene, frame=1, history=history)
    copies = view.residual_adu.copy(), view.mask.copy(), history[0].residual_adu.copy()
    first, second = LineIntegralDetector().detect(view), LineIntegralDetector().detect(view)
    assert first == second
    assert len(first) >= 1
    for before, after in zip(copies, (view.residual_adu, view.mask, history[0].residual_adu), strict=True):
        assert np.array_equal(before, after)
    for d in first:
        assert min(d.row0, d.row1) >= 0.0
        assert max(d.row0, d.row1) <= 1023.0
        assert min(d.col0, d.col1) >= 0.0
        assert max(d.col0, d.col1) <= 1023.0
    assert list(first) == sorted(first, key=lambda d: (bool(d.flags & StreakFlag.COSMIC_LIKE), -d.snr))


def test_transposed_frame_gives_the_transposed_detections() -> None:
    scene, rng = noise_scene(512, 19)
    # bright enough for the ends to be known to a fraction of a pixel: the level is sampled on every other row, not column
    add_streak(scene, Streak(row0=100.0, col0=60.0, row1=180.0, col1=420.0, snr=80.0), rng)
    upright = found_in(scene)
    turned = found_in(Scene(image=np.ascontiguousarray(scene.image.T)))
    assert len(upright) == len(turned) == 1
    ends = sorted([(upright[0].row0, upright[0].col0), (upright[0].row1, upright[0].col1)])
    other = sorted([(turned[0].col0, turned[0].row0), (turned[0].col1, turned[0].row1)])
    assert np.abs(np.array(ends) - np.array(other)).max() < 0.2


def test_particle_storm_neither_floods_nor_blinds() -> None:
    """313 hits per 1024 x 1024 px are 5,000 per frame: the SAA peak."""
    truth = [Streak(row0=100.0 + 150.0 * k, col0=150.0, row1=180.0 + 150.0 * k, col1=700.0, snr=14.0) for k in range(5)]
    scene, history = star_scene(20, truth)
    rng = np.random.default_rng(21)
    for _ in range(313):
        row, col, length, angle = (*rng.uniform(5.0, 1018.0, 2), rng.exponential(4.0), rng.uniform(0.0, math.pi))
        path = np.linspace(0.0, length, 2 + int(2 * length))
        rows = np.clip(np.rint(row + path * math.sin(angle)), 0, 1023).astype(np.int64)
        cols = np.clip(np.rint(col + path * math.cos(angle)), 0, 1023).astype(np.int64)
        np.add.at(scene.image, (rows, cols), np.float32(rng.lognormal(5.0, 0.6)))
    found = LineIntegralDetector().detect(view_of(scene, frame=1, history=history))
    paired, _, false = score(found, truth)
    assert sum(d is not None for d in paired) >= 4
    assert false <= 2
    assert sum(bool(d.flags & StreakFlag.COSMIC_LIKE) for d in found) >= 100
    assert len(found) <= LineIntegralDetector().max_detections


def test_what_a_tracker_gets_has_the_trails_that_were_taken_out_and_nothing_of_stars() -> None:
    rng = np.random.default_rng(12)
    image = rng.integers(-50, 50, (96, 140)).astype(np.int8)
    level, taps = rng.normal(0.0, 1.0, (2, 3)).astype(np.float32), whiten.odd_taps(PSF_SIGMA_PX)
    blocked = np.where(rng.random(image.shape) < 0.1, np.uint8(whiten.STAR_BIT), np.uint8(0))
    smooth = whiten.smooth(image, level, 64, taps, 7.0)
    before, stars = smooth.copy(), blocked != 0
    refine.blank_path(smooth, blocked, np.array([5.0, 20.0, 80.0, 100.0, 0.0]), 4.0)
    assert (smooth != before).sum() > 500
    whiten.known(smooth, image, blocked, level, 64, taps, 7.0)
    assert (smooth == np.where(stars, UNKNOWN, before)).all()
