"""Intervals and fits of the scores against closed forms."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy import optimize, stats

from sboc_e2e.score import figures


def test_wilson_interval_holds_the_truth_as_often_as_it_says() -> None:
    """Coverage averaged over the success probability is the nominal 90 %, within the binomial noise of 4,000 trials."""
    rng = np.random.default_rng(1)
    p = rng.uniform(0.05, 0.95, 4000)
    hits = rng.binomial(40, p)
    inside = [f["low"] <= q <= f["high"] for q, f in ((q, figures.proportion(int(k), 40)) for q, k in zip(p, hits, strict=True))]
    assert np.mean(inside) == pytest.approx(0.90, abs=0.02)


def test_no_event_still_has_an_upper_limit() -> None:
    f = figures.rate(0, 100.0, 100)
    assert f["value"] == 0.0
    assert f["low"] == 0.0
    assert f["high"] == pytest.approx(-np.log(0.05) / 100.0)


def test_half_point_is_found() -> None:
    rng = np.random.default_rng(2)
    snr = np.exp(rng.uniform(np.log(3), np.log(30), 4000))
    detected = rng.random(4000) < stats.norm.cdf(snr - 7.0)
    f = figures.half_point(snr, detected)
    assert f["value"] == pytest.approx(7.0, abs=0.15)
    assert f["low"] < 7.05
    assert f["high"] > 6.95


def test_half_point_of_all_or_nothing_has_a_reason() -> None:
    snr = np.linspace(5, 10, 20)
    assert figures.half_point(snr, np.ones(20, bool))["reason"] == "all detected"
    assert figures.half_point(snr, np.zeros(20, bool))["reason"] == "none detected"


def test_pull_width_of_a_unit_normal_is_one() -> None:
    z = np.random.default_rng(3).normal(size=200_000)
    assert figures.pull_width(z) == pytest.approx(1.0, abs=0.005)


def test_half_point_and_its_interval_are_those_of_the_likelihood() -> None:
    """Against a general minimiser without derivatives, on samples that overlap, are separable, or have misses far above."""
    rng = np.random.default_rng(5)
    for sharpness, lapse in ((2.0, 0.0), (200.0, 0.0), (10.0, 0.08)):
        x = np.round(rng.normal(2.0, 0.7, 60), 3)
        y = rng.random(60) < (1 - lapse) / (1 + np.exp(-sharpness * (x - 2.1)))

        def loss(half: float, q: float, lapse: float, y: np.ndarray = y, x: np.ndarray = x) -> float:
            share = (1 - lapse) / (1 + np.exp(np.clip(-np.exp(q) * (x - half) + np.log(1 - 2 * lapse), -500, 500)))
            chance = np.where(y, share, 1 - share)
            return float(-np.log(np.maximum(chance, 1e-200)).sum() + 0.5 * (q - np.log(10)) ** 2 - 19 * np.log(1 - lapse))

        def profile(half: float, loss: Callable[[float, float, float], float] = loss) -> float:
            return min(
                optimize.minimize_scalar(lambda q, lapse=lapse: loss(half, q, lapse), bounds=(-2.0, 8.0), method="bounded").fun
                for lapse in figures.LAPSES
            )

        starts = np.linspace(1.5, 2.7, 121)
        start = starts[np.argmin([profile(c) for c in starts])]
        best = optimize.minimize_scalar(profile, bounds=(start - 0.02, start + 0.02), method="bounded")
        limit = float(best.fun) + 2.7055 / 2
        ends = [
            optimize.brentq(lambda c, limit=limit: profile(c) - limit, *sorted((best.x, best.x + way))) for way in (-1.5, 1.5)
        ]
        assert figures.logistic_half(x, y) == pytest.approx((best.x, *ends), abs=1e-3)


@pytest.mark.slow
def test_interval_of_the_half_point_holds_the_truth_as_often_as_it_says() -> None:
    """200 samples of 40 streaks around S/N 7, unit noise: 90 % within three standard deviations of the count."""
    rng = np.random.default_rng(7)
    inside = []
    for _ in range(200):
        snr = rng.uniform(4.0, 11.0, 40)
        f = figures.half_point(snr, rng.random(40) < stats.norm.cdf(snr - 7.0))
        inside.append(f["low"] <= 7.0 <= f["high"])
    assert np.mean(inside) == pytest.approx(0.90, abs=3 * np.sqrt(0.09 / 200))


def test_half_point_in_a_gap_without_streaks_has_no_value() -> None:
    f = figures.half_point(np.concatenate([np.linspace(4, 6, 10), np.linspace(25, 40, 10)]), np.arange(20) >= 10)
    assert f["value"] is None
    low, high = (float(word) for word in f["reason"].rpartition("S/N ")[2].split(" and "))
    assert 5.0 < low < 6.5
    assert 22.0 < high < 26.0


def test_errors_that_objects_share_widen_the_interval() -> None:
    """12 objects with 30 items each, of one error and none of their own: intervals hold the true 0 as those of 12 numbers do."""
    rng = np.random.default_rng(5)
    owner = np.repeat(np.arange(12), 30)
    inside, alone = [], []
    for _ in range(150):
        items = rng.normal(size=12)[owner]
        f, g = figures.bootstrap_by_owner(items, owner, np.mean), figures.bootstrap(items, np.mean)
        assert f["n"] == 360
        inside.append(f["low"] <= 0.0 <= f["high"])
        alone.append(g["low"] <= 0.0 <= g["high"])
    assert np.mean(inside) == pytest.approx(0.87, abs=0.08)  # percentile intervals of 12 numbers are a little short
    assert np.mean(alone) < 0.4


def test_two_objects_have_no_interval() -> None:
    f = figures.bootstrap_by_owner(np.arange(20.0), np.arange(20) % 2, np.mean)
    assert (f["value"], f["n"]) == (None, 20)
    assert "fewer than three objects" in f["reason"]
