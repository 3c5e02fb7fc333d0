"""Distances against closed forms."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import norm

from sboc_e2e.validation import distances

QUANTILES = norm.ppf((np.arange(20_000) + 0.5) / 20_000)
"""A normal sample without sampling noise."""


@given(st.floats(-5, 5), st.floats(0.2, 5))
def test_wasserstein_of_a_shift_is_the_shift(shift, scale):
    sample = scale * QUANTILES
    assert distances.wasserstein(sample, sample + shift) == pytest.approx(abs(shift), abs=1e-9)


def test_wasserstein_of_two_widths():
    # W1 of N(0, 1) and N(0, s): |s - 1| E|x| = |s - 1| sqrt(2 / pi)
    assert distances.wasserstein(QUANTILES, 1.5 * QUANTILES) == pytest.approx(0.5 * math.sqrt(2 / math.pi), rel=1e-3)


def test_kolmogorov_smirnov_of_shifted_normals():
    # the largest difference of Phi(x) and Phi(x - d) is 2 Phi(d / 2) - 1
    statistic, probability = distances.kolmogorov_smirnov(QUANTILES, QUANTILES + 0.4)
    assert statistic == pytest.approx(2 * norm.cdf(0.2) - 1, abs=2e-4)
    assert probability < 1e-10
    assert distances.kolmogorov_smirnov(QUANTILES, QUANTILES)[0] == 0.0


@pytest.mark.parametrize(("shift", "width"), [(0.0, 1.0), (0.7, 1.0), (0.0, 1.6), (0.5, 1.3)])
def test_bhattacharyya_of_normals(shift, width):
    edges = np.linspace(-9, 9, 721)
    p = np.diff(norm.cdf(edges))
    q = np.diff(norm.cdf(edges, shift, width))
    expected = 0.25 * shift**2 / (1 + width**2) + 0.5 * math.log((1 + width**2) / (2 * width))
    assert distances.bhattacharyya(p, q) == pytest.approx(expected, abs=1e-4)


def test_bhattacharyya_without_overlap_and_on_other_bins():
    assert distances.bhattacharyya([1, 0], [0, 1]) == math.inf
    with pytest.raises(ValueError, match="same bins"):
        distances.bhattacharyya([1, 2], [1, 2, 3])


def test_histogram_counts_every_value():
    values = np.append(QUANTILES, [-100.0, 100.0])
    edges = distances.shared_bins(values, values)
    assert distances.histogram(values, edges).sum() == len(values)
    assert edges[0] > -4.0
    assert edges[-1] < 4.0
