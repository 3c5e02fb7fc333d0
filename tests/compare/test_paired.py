"""Paired statistics against closed forms and known answers."""

import numpy as np
import pytest

from sboc_e2e.compare.paired import Outcomes, difference, froc, mcnemar


def test_mcnemar_is_the_exact_binomial() -> None:
    """Ten found by one only, none by the other: two-sided probability 2 * 0.5^10."""
    one = np.array([True] * 10 + [True] * 5 + [False] * 5)
    other = np.array([False] * 10 + [True] * 5 + [False] * 5)
    result = mcnemar(one, other)
    assert (result["both"], result["only_first"], result["only_second"]) == (5, 10, 0)
    assert result["p_value"] == pytest.approx(2 * 0.5**10)


def test_equal_choices_do_not_differ() -> None:
    found = np.random.default_rng(1).random(50) < 0.5
    assert mcnemar(found, found)["p_value"] == 1.0


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
