"""Companions that no catalogue lists, and stars that are not as bright as theirs says."""

import numpy as np
import pytest

from sboc_e2e.catalogue import StarCatalogue
from simulator.optics.instrument import InstrumentOptions
from simulator.scene.stars import StarOptions, StarSky, unit_vectors


def field(**options):
    sky = StarSky(
        StarOptions(catalogue_errors=0.0, **options), InstrumentOptions(), StarCatalogue.embedded(), seed=4, epoch_jyear=2027.0
    )
    return sky.around(unit_vectors(np.array([131.0]), np.array([18.0]))[0], 3.0)


def test_companions_follow_opiks_law_and_are_fainter_than_the_catalogue():
    plain, paired = field(), field(companion_share=0.4)
    n = len(plain.star_id)
    assert np.array_equal(paired.direction[:n], plain.direction)
    own = {int(k): i for i, k in enumerate(np.abs(plain.star_id))}
    first = np.array([own[int(abs(k) - (1 << 61))] for k in paired.star_id[n:]])
    assert len(first) == pytest.approx(0.4 * n, rel=0.05)
    apart = np.linalg.norm(paired.direction[n:] - plain.direction[first], axis=1) * 206265.0
    assert apart.min() > 1.99
    assert apart.max() < 60.1
    assert np.mean(np.log(apart)) == pytest.approx(0.5 * (np.log(2.0) + np.log(60.0)), abs=0.03)
    assert paired.v_mag[n:].min() > 11.0
    assert np.all(paired.star_id[n:] < 0)


def test_variables_scatter_about_their_catalogue_magnitude():
    plain, varied = field(), field(variable_share=0.3, variable_amplitude_mag=0.2)
    change = -2.5 * np.log10(varied.flux_e_s / plain.flux_e_s)
    moved = np.abs(change) > 1e-9
    assert moved.mean() == pytest.approx(0.3, abs=0.01)
    # half of the mean square amplitude, whose logarithm is normal with sigma 0.8
    assert np.sqrt(np.mean(change[moved] ** 2)) == pytest.approx(0.2 * np.exp(0.64) / np.sqrt(2.0), rel=0.12)
    assert np.array_equal(varied.v_mag, plain.v_mag)
