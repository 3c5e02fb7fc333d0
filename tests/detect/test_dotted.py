"""Trails that come in dots: rows of entries of the star list, drawn here."""

import numpy as np
import pytest
from scipy.stats import poisson

from onboard.detect.dotted import BY_CHANCE, dots_in_rows, dots_needed

SIDE = 600


def strewn(n: int, seed: int) -> np.ndarray:
    """Places (n, 2) of evenly strewn entries."""
    return np.random.default_rng(seed).uniform(0.0, SIDE, (n, 2))


@pytest.mark.parametrize("angle_deg", [0.0, 33.0, 90.0, 140.0])
def test_dots_of_a_chopped_meteor_are_told_among_stars(angle_deg: float) -> None:
    """Twenty-five dots, 6 px apart, each off by 0.3 px, among 600 stars; behind a shutter one was listed as thirty stars."""
    rng = np.random.default_rng(4)
    way = np.array([np.sin(np.radians(angle_deg)), np.cos(np.radians(angle_deg))])
    dots = 300.0 + np.arange(-12, 13)[:, None] * 6.0 * way + rng.normal(0.0, 0.3, (25, 2))
    places = np.concatenate([dots, strewn(600, 5)])
    told = dots_in_rows(*places.T.copy(), SIDE**2)
    assert told[:25].mean() > 0.9
    assert told[25:].sum() <= 3  # stars that happen to stand in the row


@pytest.mark.parametrize("n", [300, 1000, 3000])
def test_stars_make_no_rows_by_chance(n: int) -> None:
    told = [dots_in_rows(*strewn(n, seed).T.copy(), SIDE**2).any() for seed in range(20)]
    # the estimate is good to a factor of ten: the next entry may be any of those ahead
    assert sum(told) <= poisson.ppf(0.999, 10.0 * BY_CHANCE * len(told))


def test_the_denser_the_list_the_longer_the_row_must_be_and_a_full_one_tells_nothing() -> None:
    needed = [dots_needed(n, SIDE**2) for n in (100, 1000, 3000, 8000)]
    assert needed == sorted(needed)
    assert needed[0] < needed[-1]
    assert dots_needed(0, SIDE**2) == needed[0]
    assert not dots_in_rows(*strewn(20_000, 1).T.copy(), SIDE**2).any()
    assert not dots_in_rows(np.array([3.0]), np.array([4.0]), SIDE**2).any()
