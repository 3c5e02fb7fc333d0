"""Globular clusters: Plummer's closed form, their light, and a field with one of them."""

import numpy as np
import pytest

from simulator.optics.instrument import InstrumentOptions
from simulator.scene.clusters import CLUSTERS, MEMBERS, clusters_around, members
from simulator.scene.stars import unit_vectors

M13 = unit_vectors(np.array([250.4235]), np.array([36.4613]))[0]  # 16h 41m 41.6s, +36 27' 41" (Goldsbury et al. 2010)


def test_members_lie_as_plummers_profile_has_them():
    """Half within the half-light radius, four fifths within twice it (r^2 / (r^2 + h^2)); to the noise of 3,000, 3 sigma."""
    half = 1e-3
    middle = np.array([0.48, -0.6, 0.64])
    seen = members(1, middle, half, 5)
    radius = np.arccos(np.clip(seen @ middle, -1.0, 1.0)) / half
    for within, share in ((1.0, 0.5), (2.0, 0.8)):
        expected = share * 65.0 / 64.0
        assert np.mean(radius < within) == pytest.approx(expected, abs=3.0 * (share * (1 - share) / MEMBERS) ** 0.5)
    assert radius.max() < 8.01
    assert np.array_equal(seen, members(1, middle, half, 5))


def test_the_great_cluster_in_hercules_stands_at_its_place_with_its_light():
    """V = 5.78 (Harris 1996, 2010), within 0.1 arcmin of Goldsbury's centre; none a few degrees aside."""
    instrument = InstrumentOptions()
    found = clusters_around(M13, 0.5, instrument, 1)
    assert len(found) == 1
    light = found[0].flux_e_s.sum() / instrument.true_zero_point_e_s / float(instrument.colour_factor(np.array([0.7]))[0])
    assert -2.5 * np.log10(light) == pytest.approx(5.78, abs=1e-6)
    middle = np.median(found[0].direction, axis=0)
    apart_arcmin = np.degrees(np.arccos(np.clip(middle @ M13 / np.linalg.norm(middle), -1.0, 1.0))) * 60.0
    assert apart_arcmin < 0.2  # the median of 3,000 members has 0.04
    aside = unit_vectors(np.array([255.0]), np.array([30.0]))[0]
    assert clusters_around(aside, 3.0, instrument, 1) == []


def test_the_list_is_that_of_clusters_brighter_than_v_8():
    numbers, ra, dec, v_mag, radius = np.array(CLUSTERS).T
    assert len(set(numbers)) == len(CLUSTERS) == 36
    assert ((ra >= 0.0) & (ra < 360.0) & (np.abs(dec) < 90.0)).all()
    assert v_mag.max() < 8.0
    assert ((radius > 0.4) & (radius < 6.0)).all()
