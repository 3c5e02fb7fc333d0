"""Orbit figures of tables whose answers are plain."""

import json

import pytest
from astropy.table import Table

from sboc_e2e.score.orbit import orbit


def one_orbit(low_km: float, median_km: float, high_km: float) -> Table:
    return Table(
        {
            "tracklet_id": [7],
            "t_ref_tai_ns": [10**18],
            "range_low_km": [low_km],
            "range_km": [median_km],
            "range_high_km": [high_km],
            "a_km": [42_000.0],
            "i_deg": [3.0],
            "modes": [json.dumps([[median_km, 1.0]])],
        }
    )


@pytest.mark.parametrize(
    ("interval", "trivial", "covered"),
    [((1.0, 2.0, 4.0), 1.0, 0.0), ((400.0, 1_500.0, 55_000.0), 0.0, 1.0), ((400.0, 900.0, 1_500.0), 1.0, 0.0)],
    ids=["beside the camera", "two modes", "far too near"],
)
def test_collapsed_intervals_are_trivial_roots(interval: tuple[float, float, float], trivial: float, covered: float) -> None:
    truth = Table({"object_id": [3], "path_t_tai_ns": [[10**18]], "range_km": [33_000.0]})
    objects = Table({"object_id": [3], "a_km": [42_164.0], "i_deg": [5.0]})
    found = orbit(one_orbit(*interval), {7: 3}, truth, objects)
    assert found["trivial_root_rate"]["value"] == trivial
    assert found["interval_coverage_90"]["value"] == covered
