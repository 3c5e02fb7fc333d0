"""Intervals and fits of the scores against closed forms."""

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


def test_logistic_centre_is_the_maximum_of_its_likelihood() -> None:
    """Against a general minimiser without derivatives, on weighted samples that overlap and that are separable."""
    rng = np.random.default_rng(5)
    for sharpness in (2.0, 200.0):
        x = rng.normal(2.0, 0.7, 60)
        y = rng.random(60) < 1 / (1 + np.exp(-sharpness * (x - 2.1)))
        weight = rng.integers(0, 4, 60).astype(float)

        def loss(p: np.ndarray, y: np.ndarray = y, x: np.ndarray = x, weight: np.ndarray = weight) -> float:
            margin = np.exp(p[1]) * (x - p[0]) * np.where(y, 1, -1)
            return float(weight @ np.logaddexp(0, -margin) + 0.5 * (p[1] - np.log(10)) ** 2)

        best = optimize.minimize(loss, [2.0, np.log(10)], method="Nelder-Mead", options={"xatol": 1e-7, "fatol": 1e-10})
        assert figures.logistic_centres(x, y, weight[None])[0] == pytest.approx(best.x[0], abs=1e-5)
