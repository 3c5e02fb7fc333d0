"""The benchmark's frames of spikes, columns and halos hold what they say, and the detector does not take them for trails."""

import numpy as np

from onboard.detect import LineIntegralDetector
from sboc_e2e.icd.flags import StreakFlag
from tests.benchmarks.bench_detection import score
from tests.benchmarks.detection_frames import (
    FULL_WELL,
    Artefact,
    Scene,
    StarTruth,
    Streak,
    add_artefacts,
    add_streak,
    bleed,
    exposure,
    random_stars,
    random_streak,
    view_of,
)

SIZE = 768
MIDDLE = 0.5 * SIZE


def test_bleeding_keeps_the_charge_and_fills_the_column_evenly() -> None:
    charge = np.zeros((200, 3), np.float32)
    charge[100, 1] = 2.0 * FULL_WELL  # too little for a tail
    bleed(charge)
    assert charge.max() == FULL_WELL
    assert charge.sum() == 2.0 * FULL_WELL
    assert charge[99, 1] == charge[101, 1] == 0.5 * FULL_WELL
    assert not charge[:, (0, 2)].any()


def frame_with(artefact: Artefact, rng: np.random.Generator, stars: StarTruth, shift_px: tuple[float, float]) -> Scene:
    """Stars and one bright one."""
    scene = exposure(SIZE, stars, rng, shift_px=shift_px)
    add_artefacts(scene, [artefact], rng, shift_px=shift_px)
    return scene


def test_bleeding_column_is_no_trail_and_hides_none_beside_it() -> None:
    """Four fields of stars, two trails in each: one may be lost to the stars on its path."""
    column = Artefact(kind="column", row=MIDDLE, col=MIDDLE, reach_px=150.0, flux_e=8e6)
    trails = [
        Streak(row0=MIDDLE - 90.0, col0=MIDDLE + side * 60.0, row1=MIDDLE + 90.0, col1=MIDDLE + side * 70.0, snr=12.0)
        for side in (-1.0, 1.0)
    ]
    detector = LineIntegralDetector()
    n_found = 0
    for seed in (5, 7, 8, 9):
        rng = np.random.default_rng(seed)
        stars = random_stars(SIZE, 25_000, rng)
        before, scene = (frame_with(column, rng, stars, shift) for shift in ((0.3, -0.4), (0.0, 0.0)))
        history = (view_of(before),)
        assert (history[0].mask != 0).sum() > 150
        assert not detector.detect(view_of(scene, frame=1, history=history))
        for trail in trails:
            add_streak(scene, trail, rng)
        paired, _, false = score(detector.detect(view_of(scene, frame=1, history=history)), trails)
        n_found += sum(found is not None for found in paired)
        assert false == 0
    assert n_found >= 7


def test_spikes_of_a_first_frame_are_named() -> None:
    rng = np.random.default_rng(6)
    star = Artefact(kind="spikes", row=MIDDLE, col=MIDDLE, reach_px=300.0, flux_e=1e6, turn=0.4)
    scene = frame_with(star, rng, random_stars(SIZE, 25_000, rng), (0.0, 0.0))
    found = LineIntegralDetector().detect(view_of(scene))
    assert found
    assert all(d.flags & StreakFlag.SPIKE_LIKE for d in found)


def test_pointing_that_moved_hides_no_trails() -> None:
    """Stars of the preceding frame stood on other pixels: each trail of these has some of theirs under it."""
    rng = np.random.default_rng(11)
    stars = random_stars(SIZE, 25_000, rng)
    history = (view_of(exposure(SIZE, stars, rng, shift_px=(20.3, -13.7))),)
    scene = exposure(SIZE, stars, rng)
    for _ in range(12):
        add_streak(scene, random_streak(SIZE, 200.0, 12.0, rng), rng)
    paired, _, false = score(LineIntegralDetector().detect(view_of(scene, frame=1, history=history)), scene.streaks)
    assert sum(found is not None for found in paired) >= 11
    assert false == 0
