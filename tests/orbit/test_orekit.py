"""Orekit's Gooding and Gauss beside the posterior, where the extra `orekit` and Java are installed."""

import pytest

from tests.benchmarks.bench_peers_orbit import ABSENT, orekit, side_by_side
from tests.orbit.encounters import PIXEL_ARCSEC

pytest.importorskip("orekit_jpype", reason=ABSENT)


@pytest.mark.slow
def test_short_arcs_collapse_without_a_prior_and_not_with_it() -> None:
    """30 catalogued orbits at 1 arcsec: Gooding, started 30 % off, often falls back to the camera's own orbit; ours never."""
    methods = orekit()
    if methods is None:
        pytest.skip(ABSENT)
    found = side_by_side(methods, 30, 22, population="volume", error_px=1.0 / PIXEL_ARCSEC)
    assert found["posterior_median"]["trivial_root_rate"]["value"] == 0.0
    assert found["posterior_median"]["range_error_median"]["value"] < 0.1
    assert found["gooding"]["no_orbit"]["value"] < 0.5
    assert found["gooding"]["range_error_median"]["value"] > found["posterior_median"]["range_error_median"]["value"]
