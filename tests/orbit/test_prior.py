"""The orbit prior: its phase-space measure, its stored draws, its shape."""

import numpy as np
import pytest

from ground.orbit.breakup import breakup_counts, draw_breakup, draw_catalogue, state_of_elements
from ground.orbit.prior import PriorShares, breakup_density, catalogue_counts, phase_space_density, prior_table
from tests.orbit.encounters import MU, breakup_orbits, catalogue_orbits


@pytest.mark.parametrize(("a_km", "e", "i_rad"), [(7100.0, 0.01, 1.7), (8200.0, 0.2, 0.4), (26000.0, 0.7, 1.1)])
def test_phase_space_measure_is_the_jacobian(a_km: float, e: float, i_rad: float) -> None:
    """d3r d3v over da de di and three angles is mu^1.5 a^0.5 e sin(i) / 2: against differences of Kepler's formulae."""
    point = np.array([a_km, e, i_rad, 0.3, 1.2, 2.0])
    step = np.array([1e-3, 1e-6, 1e-6, 1e-6, 1e-6, 1e-6])
    columns = []
    for k in range(6):
        up, down = point.copy(), point.copy()
        up[k] += step[k]
        down[k] -= step[k]
        states = [state_of_elements(x[None, :3], x[None, 3:])[0] for x in (up, down)]
        columns.append((states[0] - states[1]) / (2 * step[k]))
    jacobian = abs(np.linalg.det(np.array(columns).T))
    assert jacobian == pytest.approx(0.5 * MU**1.5 * np.sqrt(a_km) * e * np.sin(i_rad), rel=1e-5)


def test_density_of_catalogued_orbits() -> None:
    """In a cell of the histogram the density is its share over volume and Jacobian; outside only the tail is left."""
    table = prior_table(PriorShares(catalogue=1.0, breakup=0.0, tail=1e-12, ring=0.0))
    counts, a_edges, e_edges, i_edges = catalogue_counts()
    a, e, i = np.unravel_index(int(np.argmax(counts)), counts.shape)
    middle = [0.5 * (edges[k] + edges[k + 1]) for edges, k in zip((a_edges, e_edges, i_edges), (a, e, i), strict=True)]
    volume = np.prod([edges[k + 1] - edges[k] for edges, k in zip((a_edges, e_edges, i_edges), (a, e, i), strict=True)])
    expected = counts[a, e, i] / counts.sum() / volume / (2 * np.pi) ** 3
    jacobian = 0.5 * MU**1.5 * np.sqrt(middle[0]) * middle[1] * np.sin(middle[2])
    assert phase_space_density(table, *middle) == pytest.approx(expected / jacobian, rel=1e-6)
    assert phase_space_density(table, 30000.0, 0.5, 1.0) < 1e-9 * expected / jacobian
    assert phase_space_density(table, 7000.0, 0.2, 1.0) == 0.0
    assert phase_space_density(table, -7000.0, 1.2, 1.0) == 0.0


def test_histogram_sums() -> None:
    """Sums that the histogram's page states."""
    counts, *_ = catalogue_counts()
    assert counts.sum() == 10196
    assert counts.sum(axis=(0, 2)).tolist() == [1362, 2359, 2316, 2329, 1249, 445, 136]


def test_mixture_is_normalised() -> None:
    """Catalogue and breakup parts keep their shares when they are put on one grid."""
    table = prior_table(PriorShares(catalogue=0.3, breakup=0.6, tail=0.05, ring=0.05))
    volume = (
        np.diff(table.a_edges_km)[:, None, None]
        * np.diff(table.e_edges)[None, :, None]
        * np.diff(table.i_edges_rad)[None, None, :]
    )
    assert (table.density * volume).sum() == pytest.approx(0.9, rel=1e-6)


def test_draws_agree_with_independent_ones_and_with_the_stored_counts() -> None:
    """Percentiles of both samplers within 1 %; a small rebuild of the stored breakup grid within counting noise."""
    rng = np.random.default_rng(5)
    for mine, other in ((draw_catalogue, catalogue_orbits), (draw_breakup, breakup_orbits)):
        one, two = mine(60_000, rng), other(90_000, rng)
        for column, scale in ((0, 7200.0), (1, 0.05), (2, 1.7)):
            difference = np.percentile(one[:, column], [10, 50, 90]) - np.percentile(two[:, column], [10, 50, 90])
            assert (np.abs(difference) < np.array([0.02, 0.02, 0.1]) * scale).all()
    rebuilt, a_edges, e_edges, _ = breakup_counts(100_000, rng)
    density, a_stored, e_stored, i_stored = breakup_density()
    np.testing.assert_allclose(a_edges, a_stored)
    np.testing.assert_allclose(e_edges, e_stored)
    volume = np.diff(a_stored)[:, None, None] * np.diff(e_stored)[None, :, None] * np.diff(i_stored)[None, None, :]
    share = (density * volume).sum(axis=(1, 2))
    expected = share * rebuilt.sum()
    large = expected > 50
    pull = (rebuilt.sum(axis=(1, 2)) - expected)[large] / np.sqrt(expected[large])
    assert np.sqrt(np.mean(pull**2)) < 1.6
