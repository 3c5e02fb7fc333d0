"""Recovery of N(> d) from synthetic lists whose answer is known."""

import numpy as np
import pytest

from ground import population
from ground.population import NOT_DETECTED, Response, categories, n_categories, recover, response_of
from sboc_e2e.icd.errors import ContractError

EDGES_M = np.array([0.001, 0.003, 0.01, 0.03, 0.1, 0.3])
MAG_EDGES = np.array([8.0, 11.0, 14.0])
TRUE_SLOPE = 1.8


def sample(n: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """True sizes of a power law, and observed categories: detected with growing probability, size known to 40 % or not at all."""
    low, high = EDGES_M[0] ** -TRUE_SLOPE, EDGES_M[-1] ** -TRUE_SLOPE
    size = (low - rng.random(n) * (low - high)) ** (-1.0 / TRUE_SLOPE)
    seen = rng.random(n) < np.clip(0.25 + 0.25 * np.log10(size / 0.001), 0.0, 0.9)
    linked = rng.random(n) < 0.6
    estimate = np.where(seen & linked, size * np.exp(0.4 * rng.standard_normal(n)), np.nan)
    mag = np.where(seen, 14.0 - 5.0 * np.log10(size / 0.001) / 3.0 + rng.normal(0.0, 1.0, n), np.nan)
    return size, np.where(seen, categories(estimate, mag, EDGES_M, MAG_EDGES), NOT_DETECTED)


@pytest.mark.slow
def test_intervals_hold_the_truth() -> None:
    """60 runs of 400 objects among 40 false single-frame detections: 90 % intervals of classes and N(> d) hold the truth."""
    rng = np.random.default_rng(11)
    n_observed = n_categories(EDGES_M, MAG_EDGES)
    response = response_of(*sample(100_000, rng), EDGES_M, n_observed)
    false_mean = np.array([0.0] * (len(EDGES_M) - 1) + [10.0, 30.0, 0.0])
    low, high = EDGES_M[0] ** -TRUE_SLOPE, EDGES_M[-1] ** -TRUE_SLOPE
    truth = 400.0 * (EDGES_M[:-1] ** -TRUE_SLOPE - high) / (low - high)
    inside, total, slopes = 0, 0, []
    for _ in range(60):
        _, category = sample(int(rng.poisson(400.0)), rng)
        observed = population.observed_counts(category, n_observed) + rng.poisson(false_mean)
        got = recover(
            observed,
            response,
            EDGES_M,
            rng,
            false_counted=rng.poisson(5.0 * false_mean).astype(float),
            false_exposure_ratio=5.0,
            n_draws=600,
        )
        inside += int(((got.cumulative[:, 0] <= truth) & (truth <= got.cumulative[:, 2])).sum())
        total += len(truth)
        slopes.append(got.slope[1])
    # 300 intervals of 90 %, five a run that share its counts: two sigma are 0.035 if they were independent, 0.08 if they were one
    assert 0.84 <= inside / total <= 0.97
    assert abs(np.median(slopes) - TRUE_SLOPE) < 0.15


def test_no_detection_gives_an_upper_limit() -> None:
    """Zero counts at efficiency one half: the 95 % limit of a Jeffreys prior is 1.92 over the efficiency."""
    response = Response(detected=np.array([[50_000.0]]), missed=np.array([50_000.0]))
    got = recover(np.array([0]), response, np.array([0.001, 0.01]), np.random.default_rng(0), n_draws=20_000)
    assert got.objects[0, 0] < 0.02
    assert got.objects[0, 2] == pytest.approx(1.92 / 0.5, rel=0.05)
    assert np.isnan(got.slope).all()


def test_rates_per_day_and_area() -> None:
    """100 objects in an hour at a hundredfold density are 24 a day; through a km^2-year they follow from the cone's area."""
    response = Response(detected=np.array([[1e6]]), missed=np.array([0.0]))
    got = recover(np.array([100]), response, np.array([0.001, 0.01]), np.random.default_rng(1), n_draws=4000)
    area = population.cone_cross_section_km2(5.28, np.array([10.0]))
    exposure = population.Exposure(duration_s=3600.0, boost=np.array([100.0]), area_km2=area)
    assert got.per(exposure.days()).objects[0, 1] == pytest.approx(24.0, rel=0.02)
    assert got.per(exposure.km2_years()).objects[0, 1] == pytest.approx(100.0 / (100.0 * 3600.0 / 31557600.0 * area[0]), rel=0.02)
    # flat disc limit of Cauchy's formula: a cone opened to a half-space shows half of its base from each side
    assert population.cone_cross_section_km2(180.0, np.array([1.0]))[0] == pytest.approx(np.pi / 2)


def test_lengths_are_checked() -> None:
    """Counts that do not fit the response are refused by name."""
    response = Response(detected=np.ones((2, 1)), missed=np.zeros(1))
    with pytest.raises(ContractError, match=r"population\.observed"):
        recover(np.array([1]), response, np.array([0.1, 1.0]), np.random.default_rng(0))
