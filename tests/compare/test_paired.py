"""Paired statistics against closed forms and known answers."""

import itertools

import numpy as np
import pytest
from scipy import stats

from sboc_e2e.compare.pages import pair_rows, verdict
from sboc_e2e.compare.paired import Outcomes, difference, froc, mcnemar, sign_flip_p


def test_mcnemar_is_the_exact_binomial() -> None:
    """Ten found by one only, none by the other: two-sided probability 2 * 0.5^10."""
    one = np.array([True] * 10 + [True] * 5 + [False] * 5)
    other = np.array([False] * 10 + [True] * 5 + [False] * 5)
    result = mcnemar(one, other, np.arange(20))
    assert (result["both"], result["only_first"], result["only_second"]) == (5, 10, 0)
    assert result["p_value"] == pytest.approx(2 * 0.5**10)


@pytest.mark.parametrize("pairs", [(3, 1), (12, 4), (30, 31), (0, 6), (100, 60)])
def test_one_streak_for_each_object_is_mcnemars_binomial(pairs: tuple[int, int]) -> None:
    one = np.repeat([True, False], pairs)
    p = mcnemar(one, ~one, np.arange(sum(pairs)))["p_value"]
    assert p == pytest.approx(stats.binomtest(pairs[0], sum(pairs), 0.5).pvalue, rel=1e-9)


def test_signs_are_counted_as_by_trying_all_of_them() -> None:
    rng = np.random.default_rng(4)
    for _ in range(20):
        surplus = rng.integers(-6, 7, 9)
        signs = np.array(list(itertools.product((-1, 1), repeat=9)))
        share = float((np.abs(signs @ np.abs(surplus)) >= abs(surplus.sum())).mean())
        assert sign_flip_p(surplus) == pytest.approx(share)


def test_one_object_is_no_evidence() -> None:
    """Twenty streaks of a single object: as a coin each they would give p = 2e-6."""
    one, other = np.ones(20, bool), np.zeros(20, bool)
    assert mcnemar(one, other, np.zeros(20, np.int64))["p_value"] == 1.0


def correlated(rng: np.random.Generator, objects: int, gain: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Streaks of objects, each of which suits one of two choices more than the other; `gain` is the second's on the average."""
    counts = rng.integers(1, 13, objects)
    cluster = np.repeat(np.arange(objects), counts)
    easy, taste = rng.normal(0.0, 1.0, objects)[cluster], rng.normal(0.0, 1.5, objects)[cluster]
    one = easy + taste + rng.normal(0.0, 0.5, len(cluster)) > 0
    return one, easy - taste + gain + rng.normal(0.0, 0.5, len(cluster)) > 0, cluster


@pytest.mark.slow
def test_equal_choices_are_called_different_in_a_twentieth_of_trials() -> None:
    """Trials of 40 objects with one to twelve streaks; streaks as coins of their own would find a difference in half of them."""
    rng = np.random.default_rng(7)
    trials = 1000
    by_object = by_streak = 0
    for _ in range(trials):
        one, other, cluster = correlated(rng, 40, 0.0)
        by_object += mcnemar(one, other, cluster)["p_value"] < 0.05
        by_streak += mcnemar(one, other, np.arange(len(one)))["p_value"] < 0.05
    low, high = stats.binom.ppf([0.005, 0.995], trials, 0.05)
    assert low <= by_object <= high
    assert by_streak > 0.4 * trials


def test_a_true_difference_is_found() -> None:
    rng = np.random.default_rng(8)
    found = sum(mcnemar(*correlated(rng, 40, 2.5))["p_value"] < 0.05 for _ in range(100))
    assert found > 80


def test_words_say_who_found_what() -> None:
    pair = {
        "first": "line_integral", "second": "difference", "difference": {"value": -0.12, "n": 90, "low": -0.2, "high": -0.05},
        "mcnemar": {"both": 20, "only_first": 51, "only_second": 9, "objects_disagreeing": 14, "p_value": 0.003},
    }  # fmt: skip
    none = {"value": 0.5, "n": 4, "low": 0.5, "high": 0.5}
    choices = {name: {"median_cpu_ms_per_frame": none, "false_per_frame": none} for name in ("line_integral", "difference")}
    (row,) = pair_rows({"pairs": [pair]})
    assert row[0] == "difference against line_integral"
    assert row[2] == "9 found by difference only, 51 by line_integral only"
    (sentence,) = verdict({"pairs": [pair], "choices": choices})
    assert sentence.startswith("line_integral finds 12 of 100 streaks with S/N >= 5 more than difference: more than chance")


def test_equal_choices_do_not_differ() -> None:
    found = np.random.default_rng(1).random(50) < 0.5
    assert mcnemar(found, found, np.repeat(np.arange(10), 5))["p_value"] == 1.0


def test_interval_counts_objects_not_streaks() -> None:
    """Streaks of one object stand or fall together: the interval of 10 objects x 20 frames is that of 10, not of 200."""
    rng = np.random.default_rng(2)
    gained = np.repeat(rng.random(10) < 0.5, 20)
    outcomes = Outcomes(
        snr=np.full(200, 10.0), length_px=np.full(200, 50.0), cluster=np.repeat(np.arange(10), 20),
        found={"a": np.zeros(200, bool), "b": gained},
    )  # fmt: skip
    f = difference(outcomes, "a", "b")
    share = gained.mean()
    assert f["value"] == pytest.approx(share)
    assert f["high"] - f["low"] == pytest.approx(2 * 1.645 * np.sqrt(share * (1 - share) / 10), rel=0.3)


def test_free_response_curve_rises_to_what_was_found() -> None:
    curve = froc(np.array([10.0, 8.0, 6.0]), np.array([9.0, 5.0]), n_truth=4, n_frames=2)
    assert curve[0] == [0.0, 0.25]
    assert curve[-1] == [1.0, 0.75]
    false, found = zip(*curve, strict=True)
    assert list(false) == sorted(false)
    assert list(found) == sorted(found)
