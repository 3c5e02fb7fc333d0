"""Slow objects that no frame shows: what noise reaches, what is found among stars, where a window ends, what is reported."""

import math
from dataclasses import replace

import numpy as np
import pytest

from onboard.track.false_alarms import expected_above, half_point_sigma, independent_stacks, threshold_sigma
from onboard.track.joint_and_stack import JointAndStackTracker
from onboard.track.stack import WARM_UP
from onboard.track.stack_search import CODED_UNIT, OUTER_PX, VALUES, filter_sigma_px, group_image, lattice, stack
from onboard.track.static_model import BRIGHT, READING_PX, SUM_CODES, UNIT, add_moving, static_snr, update_model
from sboc_e2e.icd.errors import UserError
from sboc_e2e.icd.results import check_tracks
from sboc_e2e.icd.signals import Searched, Track, TrackerView
from tests.benchmarks.bench_stacks import GEO, PERIOD_S, STARS, PieceStack, Truth, draw, near, run_cube
from tests.benchmarks.detection_frames import SIGMA, Scene, Streak, add_streak, bare_view

SIZE = 256
WINDOW = PieceStack(frames=32, box=GEO, false_per_window=0.1)


@pytest.mark.parametrize(("n", "per_frame"), [(32, 1.10), (128, 0.59)])
def test_thresholds_are_those_of_the_theory(n: int, per_frame: float) -> None:
    """True S/N per frame of which half are found, 4096 x 4096 px, 0.1 false, 0.44 x 0.2 px per frame (Adler & Taylor 2007)."""
    volume = independent_stacks(np.arange(n, dtype=np.float64), area_px=4096.0**2, box_px2_s2=0.44 * 0.2, psf_sigma_px=0.849)
    assert half_point_sigma(threshold_sigma(volume, 0.1)) / math.sqrt(n) == pytest.approx(per_frame, abs=0.01)


@pytest.mark.parametrize("stars", [0, STARS])
def test_points_that_no_frame_shows_are_found_and_nothing_else(stars: int) -> None:
    """S/N 1.3 to 2.3 in each of 32 frames, the mean well above 1.10 of theory; stars jitter by 0.4 px and hide some."""
    rng = np.random.default_rng((3, stars))
    seconds = PERIOD_S * (WINDOW.frames + WARM_UP)
    truth = draw(10, SIZE, seconds, 1.3, 2.3, rng)
    found, _, _ = run_cube(WINDOW, truth, SIZE, rng, stars)
    pairs = [(f, t) for t in truth for f in found if near(f, t, seconds)]
    assert len(pairs) >= 8
    assert len(found) == len(pairs)
    for f, t in pairs:
        assert np.hypot(*(f.at(f.middle_s) - t.start - t.rate * f.middle_s)) < 5.0 * 1.2 / f.snr
    if not stars:
        assert np.mean([f.snr / (t.snr * math.sqrt(32)) for f, t in pairs]) == pytest.approx(1.0, abs=0.12)


def test_noise_is_above_a_level_as_often_as_theory_says() -> None:
    """Eight windows above S/N 5, 3.5 standard deviations either way."""
    stack = replace(WINDOW, least_snr=5.0)
    n = sum(len(run_cube(stack, [], SIZE, np.random.default_rng((5, c)))[0]) for c in range(8))
    volume = independent_stacks(
        PERIOD_S * np.arange(32, dtype=np.float64), area_px=float(SIZE**2), box_px2_s2=GEO.area_px2_s2, psf_sigma_px=0.849
    )
    expected = 8 * expected_above(5.0, volume)
    assert abs(n - expected) < 3.5 * math.sqrt(expected)


def test_the_static_light_under_a_point_is_a_star_of_that_snr() -> None:
    """A Gaussian star of S/N 3 (sqrt of the sum of squares over the pixels' noise), on it, 2 px beside it, and where none is."""
    row, col = np.indices((60, 60))
    width = math.hypot(0.849, READING_PX)
    star = np.exp(-0.5 * ((row - 30.3) ** 2 + (col - 29.8) ** 2) / width**2)
    model = np.rint(3.0 * star / np.sqrt((star**2).sum()) * UNIT).astype(np.int8)
    assert static_snr(model, np.array([30.3, 29.8]), 0.849) == pytest.approx(3.0, abs=0.02)
    assert static_snr(model, np.array([32.3, 29.8]), 0.849) == pytest.approx(3.0 * math.exp(-1.0 / width**2), abs=0.02)
    assert static_snr(model, np.array([10.0, 50.0]), 0.849) == pytest.approx(0.0, abs=0.01)
    assert static_snr(model, np.array([1.0, 1.0]), 0.849) == 0.0


def test_a_star_that_stands_still_leaves_nothing_and_a_bright_one_is_left_out() -> None:
    codes = np.zeros((40, 40), np.int8)
    codes[10, 10], codes[30, 30] = 40, BRIGHT + 10
    model, total = np.zeros((40, 40), np.int8), np.zeros((40, 40), np.int8)
    for share in range(1, 9):
        update_model(codes, np.eye(2, 3), share, model)
    assert model[10, 10] == 40
    codes[30, 30] = 0  # whatever a bright star leaves is not counted
    add_moving(codes, np.eye(2, 3), model, 0.0, 0.0, total)
    assert not total.any()
    moved = np.roll(codes, 3, axis=1)  # the same light elsewhere is: three pixels on
    add_moving(moved, np.eye(2, 3), model, 0.0, 3.0, total)
    assert total[10, 10] == 40 // SUM_CODES


def test_a_frame_that_has_mostly_moved_out_keeps_its_noise() -> None:
    """After 30 s at 9 px/s more than half of a small frame holds nothing; the rest is in units of its own noise."""
    total = np.zeros((256, 256), np.int8)
    total[:, :100] = np.random.default_rng(4).normal(0.0, 18.0, (256, 100))
    words = group_image(total, 0.849)[:, 1:-1]
    image = VALUES[(words[..., None] >> (4 * np.arange(16, dtype=np.uint64))) & 15].reshape(256, 256) / CODED_UNIT
    assert image[8:-8, 8:90].std() == pytest.approx(1.0, abs=0.05)
    assert not image[:, 110:].any()


@pytest.mark.parametrize("half", [(0.4, 0.88), (3.0, 4.0)])
def test_tracks_of_the_lattice_lie_as_far_apart_as_its_text_says(half: tuple[float, float]) -> None:
    epochs = np.linspace(-3.9, 3.9, 32)
    rates = lattice(*half, epochs)
    for axis, side in enumerate(half):
        values = np.unique(rates[:, axis])
        assert (values[0], values[-1]) == pytest.approx((-side, side))
        apart = np.diff(values) * 3.9
        assert (apart <= OUTER_PX + 1e-9).all()
        assert len(values) == 2 or (len(values) - 1) * OUTER_PX < 2.0 * side * 3.9 + OUTER_PX, "no closer than is needed"


@pytest.mark.parametrize(("n", "expected"), [(4, 0.32), (8, 0.26), (32, 0.23)])
def test_the_lattice_loses_at_the_worst_velocity_what_its_text_says(n: int, expected: float) -> None:
    """Filtered stars of variance v at u (1.2, 1.2) px, u from -1 to 1: 1 - mean exp(-u^2 1.2^2 / v)."""
    v = 0.849**2 + 1.0 / 6.0 + filter_sigma_px(0.849) ** 2
    u = np.linspace(-1.0, 1.0, n)
    off = 0.5 * OUTER_PX
    closed = 1.0 - float(np.exp(-((u * off) ** 2) / v).mean())
    assert closed == pytest.approx(expected, abs=0.005)
    rng, lost = np.random.default_rng(1), []
    for _ in range(40):
        # an object of any place and velocity, and the four tracks about it, each half of the distance away along both axes
        place, rate = rng.uniform(-0.5, 0.5, 2), rng.uniform(-2.0, 2.0, 2)
        stars = np.stack([gaussian(place + rate * k, v) for k in u])
        shifts = np.rint([[(rate + np.array([s, t])) * k for k in u] for s in (-off, off) for t in (-off, off)]).astype(np.int64)
        best, which = np.empty((31, 41), np.int16), np.empty((31, 41), np.int16)
        stack(np.rint(120.0 * stars).astype(np.int8), 5, shifts, best, which)
        lost.append(1.0 - float(best.max()) / (120.0 * n))
    assert closed - 0.04 < np.mean(lost) < closed + 0.06


def gaussian(place: np.ndarray, variance: float) -> np.ndarray:
    """A star of height 1 in 41 x 41 px, at a place from the middle."""
    row, col = np.indices((41, 41)) - 20.0
    return np.asarray(np.exp(-0.5 * ((row - place[0]) ** 2 + (col - place[1]) ** 2) / variance))


def run_tracker(
    tracker: JointAndStackTracker, n_frames: int, truth: Truth, breaks: tuple[int, ...] = ()
) -> list[tuple[int, Track]]:
    """Tracks by the frame that they were reported with; frames before which nothing is linked."""
    rng, state, found = np.random.default_rng(9), tracker.initial_state(), []
    for k in range(n_frames):
        scene = Scene(image=rng.standard_normal((SIZE, SIZE), dtype=np.float32) * np.float32(SIGMA))
        (row0, col0), (row1, col1) = (truth.start + truth.rate * (0.25 * k + s) for s in (-0.1, 0.1))
        add_streak(scene, Streak(row0=row0, col0=col0, row1=row1, col1=col1, snr=truth.snr), rng)
        view = bare_view(scene, frame=k)
        seen = TrackerView(
            view=view, detections=(), searched=Searched.empty((SIZE, SIZE)), transform=None if k in (0, *breaks) else np.eye(2, 3)
        )
        state, tracks = tracker.track(state, seen)
        check_tracks(tracks, dict.fromkeys(range(k - tracker.window_frames + 1, k + 1), (SIZE, SIZE)))
        found += [(k, t) for t in tracks]
    return found


SLOW = Truth(start=np.array([100.0, 30.0]), rate=np.array([0.2, 9.0]), snr=2.6)


def test_an_object_is_reported_with_its_places_in_the_newest_frames_and_keeps_its_number() -> None:
    tracker = JointAndStackTracker(stack_frames=16)
    reported = run_tracker(tracker, WARM_UP + 32, SLOW)
    assert [k for k, _ in reported] == [WARM_UP + 15, WARM_UP + 31]
    assert {t.number for _, t in reported} == {0}
    for k, track in reported:
        assert [m.frame for m in track.members] == list(range(k - tracker.window_frames + 1, k + 1))
        for m in track.members:
            d = m.detection
            middle = np.array([d.row0 + d.row1, d.col0 + d.col1]) / 2
            assert np.hypot(*(middle - SLOW.start - SLOW.rate * 0.25 * m.frame)) < 1.5
            assert d.length_px == pytest.approx(1.8, abs=0.3)


def test_a_window_ends_at_a_break() -> None:
    """Gap, slew, other exposure: the chain gives no transform. Twelve and sixteen frames are no window of sixteen each."""
    tracker = JointAndStackTracker(stack_frames=16)
    reported = run_tracker(tracker, 2 * WARM_UP + 12 + 15, SLOW, breaks=(WARM_UP + 12,))
    assert reported == []


def test_a_box_of_velocities_that_is_too_large_is_refused() -> None:
    with pytest.raises(UserError, match=r"onboard\.tracker: the box of velocities needs some \d+ sums, 4000 are allowed"):
        JointAndStackTracker(half_row_px_s=12.0, half_col_px_s=12.0)
    with pytest.raises(UserError, match="must be above 0"):
        JointAndStackTracker(half_row_px_s=0.0)
    assert JointAndStackTracker(box="geo", half_row_px_s=0.0).box == "geo", "the size of the given box is not used there"
