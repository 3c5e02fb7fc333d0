"""Debris by size recovered from synthetic detections whose population is known."""

from collections.abc import Callable

import numpy as np
import pytest
from astropy.table import Table

from ground.population import NOT_DETECTED
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.score.recovery import MAG_EDGES, SIZE_EDGES_M, Counted, counted, field_deg, recovery, together
from sboc_e2e.score.score_run import score_evaluation
from tests.score.conftest import Synthetic

SPAN_S = 3600.0
EXPECTED = np.array([0.0, 60.0, 50.0, 40.0, 30.0, 20.0, 0.0])
"""Objects that cross the field in the span, by class of SIZE_EDGES_M; each stands for a class's weight of natural ones."""
WEIGHT = np.array([1.0, 0.01, 0.03, 0.1, 0.3, 1.0, 1.0])
N_SIZE, N_MAG = len(SIZE_EDGES_M) - 1, len(MAG_EDGES) - 1


def draw(rng: np.random.Generator) -> Counted:
    """One run: 40 % to 80 % are detected, half of these in tracklets with a size good to a factor of 1.5."""
    of_class = np.repeat(np.arange(N_SIZE), rng.poisson(EXPECTED))
    n = len(of_class)
    size = np.exp(rng.uniform(np.log(SIZE_EDGES_M)[of_class], np.log(SIZE_EDGES_M)[of_class + 1]))
    guess = np.searchsorted(SIZE_EDGES_M, size * np.exp(0.4 * rng.standard_normal(n))) - 1
    linked, dark = rng.random(n) < 0.5, rng.random(n) < 0.3
    kind = np.where(linked, guess.clip(0, N_SIZE - 1), np.where(dark, N_SIZE + N_MAG, N_SIZE + rng.integers(1, N_MAG, n)))
    false = rng.integers(N_SIZE, N_SIZE + N_MAG + 1, rng.poisson(20.0))
    return Counted(
        size_m=size,
        weight=WEIGHT[of_class],
        range_km=rng.uniform(100.0, 1000.0, n),
        category=np.where(rng.random(n) < 0.4 + 0.08 * of_class, kind, NOT_DETECTED),
        surplus=false,
        surplus_frame=rng.integers(0, 1000, len(false)),
        n_frames=1000,
    )


def shares_held(injected: Counted | None, n_runs: int) -> tuple[float, float]:
    """Share of 90 % intervals of classes and of N(> d) that hold the expected numbers, and the median of N over the truth."""
    rng = np.random.default_rng(5)
    inside, ratio = [], []
    per_day = EXPECTED * WEIGHT * 86_400.0 / SPAN_S
    for _ in range(n_runs):
        got = recovery(draw(rng), SPAN_S, 5.0, injected)
        for k, row in enumerate(got["size_classes"]):
            if EXPECTED[k] > 0.0:
                f = row["recovered_per_day"]
                inside.append(f["low"] <= per_day[k] <= f["high"])
        for row in got["larger_than"]:
            true = per_day[SIZE_EDGES_M.index(row["larger_than_m"]) :].sum()
            inside.append(row["recovered_per_day"]["low"] <= true <= row["recovered_per_day"]["high"])
        ratio.append(got["larger_than"][0]["recovered_per_day"]["value"] / per_day.sum())
    return float(np.mean(inside)), float(np.median(ratio))


@pytest.mark.slow
def test_intervals_hold_the_known_population() -> None:
    """Efficiency from 20 other runs: intervals hold what they say, within the scatter of 40 runs of ten correlated figures."""
    rng = np.random.default_rng(15)
    held, ratio = shares_held(together([draw(rng) for _ in range(20)]), 40)
    assert 0.84 <= held <= 0.96
    assert ratio == pytest.approx(1.0, abs=0.1)


@pytest.mark.slow
def test_halves_of_one_run_are_on_the_safe_side() -> None:
    """Errors of the two efficiencies cancel in the sum of both halves, so that intervals hold more than 90 %."""
    held, ratio = shares_held(None, 20)
    assert held >= 0.9
    assert ratio == pytest.approx(1.0, abs=0.2)


def test_empty_list_gives_upper_limits() -> None:
    """Nothing detected in a run, efficiency from another: the limit is that of no event (1.92 at 95 %) over the efficiency."""
    rng = np.random.default_rng(6)
    others = together([draw(rng) for _ in range(20)])
    nothing = Counted.from_lists({name: [] for name in others.as_lists()} | {"n_frames": 1000})
    got = recovery(nothing, SPAN_S, 5.0, others)
    for k, row in enumerate(got["size_classes"]):
        if EXPECTED[k] > 0.0:
            limit = 1.92 / (0.4 + 0.08 * k) * WEIGHT[k] * 86_400.0 / SPAN_S
            assert row["recovered_per_day"]["low"] < 0.05 * limit
            assert row["recovered_per_day"]["high"] == pytest.approx(limit, rel=0.2)
    assert recovery(nothing, SPAN_S, 5.0)["size_classes"][1]["recovered_per_day"]["value"] is None


def test_missed_classes_are_not_invented() -> None:
    """Objects are never counted with the efficiency they show themselves: none without detections in both halves."""
    rng = np.random.default_rng(7)
    run = draw(rng)
    small = run.size_m < SIZE_EDGES_M[2]
    first_half = np.arange(len(small)) % 2 == 0
    lists = run.as_lists() | {"category": np.where(small & first_half, NOT_DETECTED, run.category).tolist()}
    rows = recovery(Counted.from_lists(lists), SPAN_S, 5.0)["size_classes"]
    assert rows[1]["recovered_per_day"]["value"] is None
    assert "efficiency" in rows[1]["recovered_per_day"]["reason"]
    assert rows[2]["recovered_per_day"]["value"] is not None


def test_lists_and_joined_runs_keep_every_object() -> None:
    rng = np.random.default_rng(8)
    runs = [draw(rng), draw(rng)]
    again = [Counted.from_lists(run.as_lists()) for run in runs]
    both = together(again)
    assert both.n_frames == 2000
    assert len(both.size_m) == sum(len(run.size_m) for run in runs)
    assert (both.surplus_frame[len(runs[0].surplus) :] >= 1000).all()
    halves = both.halves()
    assert sorted(np.concatenate([h.size_m for h in halves])) == sorted(both.size_m)


def test_categories_of_a_run(synthetic: Callable[..., Synthetic]) -> None:
    """Three objects in four frames: a tracklet with a size, one that is vetoed, one seen singly; one false streak."""
    run = synthetic(4)
    streaks = run.perfect_streaks()
    target = np.array(streaks["tracklet_id"])
    streaks["flags"][target == 1] |= int(StreakFlag.VETOED)
    streaks["tracklet_id"][target > 0] = -1
    streaks["mag"][(target == 2) & (np.asarray(streaks["frame"]) == 3)] = np.nan
    e = run.evaluation(streaks)
    pairs = {row: truth for row, truth in e.pairs.items() if not (truth.object_id == 2 and truth.frame > 1)}
    orbits = Table({"tracklet_id": [0], "size_m": [0.05]})
    got = counted(run.tables["objects"], streaks, orbits, pairs, {0: 0}, 4)
    # V 11.0 is the third class of magnitude
    assert got.category.tolist() == [3, NOT_DETECTED, N_SIZE + 2]
    # the second sight of object 2, the two of its streaks that were declared false, one of them without a magnitude
    assert got.surplus.tolist() == [N_SIZE + 2, N_SIZE + 2, N_SIZE + N_MAG]
    assert got.surplus_frame.tolist() == [1, 2, 3]


def test_score_holds_injected_and_recovered(synthetic: Callable[..., Synthetic]) -> None:
    run = synthetic(4)
    section = score_evaluation(run.evaluation(run.perfect_streaks()))["population"]
    row = section["size_classes"][3]
    assert (row["from_m"], row["to_m"]) == (0.03, 0.1)
    # three objects of 0.01 natural ones each in one second, all seen: 2,592 a day
    assert row["injected_per_day"]["value"] == pytest.approx(2592.0)
    assert row["recovered_per_day"]["low"] < 2592.0 < row["recovered_per_day"]["high"]
    assert section["larger_than"][0]["larger_than_m"] == 0.03


def test_field_of_a_square_grid() -> None:
    """A grid of 4 x 4 deg has the solid angle of a cone of 4.514 deg."""
    step = np.linspace(-2.0, 2.0, 9)
    dec, ra = (g.ravel() for g in np.meshgrid(step, step, indexing="ij"))
    frames = Table({"grid_ra_app_deg": [ra + 100.0], "grid_dec_app_deg": [dec]})
    assert field_deg(frames) == pytest.approx(4.0 * 2.0 / np.sqrt(np.pi), rel=2e-3)
