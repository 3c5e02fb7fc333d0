"""What a run's flux says of detections that no second frame confirms."""

from typing import Any

import numpy as np
import pytest

from ground.products.population import _counted
from ground.records import GroundProducts
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.products import Tracklet
from tests.link.sky_scene import Camera, streak
from tests.population import worlds


def _tracklet(number: int, frames: list[int]) -> Tracklet:
    n = len(frames)
    return Tracklet(
        tracklet_id=number, streak_ids=np.arange(n), frames=np.array(frames), t_tai_ns=np.arange(n) * 250_000_000,
        ra_deg=np.full(n, 57.0), dec_deg=np.full(n, 20.0), sigma_along_arcsec=np.full(n, 0.5),
        sigma_cross_arcsec=np.full(n, 0.25), t_ref_tai_ns=0, ra_ref_deg=57.0, dec_ref_deg=20.0, rate_deg_s=2.0,
        rate_err_deg_s=0.01, position_angle_deg=10.0, mag=11.4, mag_err=0.1, chi2_nu=1.0, probability=0.9,
        direction_resolved=True, flags=StreakFlag(0),
    )  # fmt: skip


def test_every_streak_is_in_a_counted_tracklet_or_listed_as_of_one_frame_or_vetoed() -> None:
    """Two in a tracklet of two frames; two pieces in one frame's tracklet and one alone are of one frame; one is vetoed."""
    ends = np.array([[10.0, 10.0], [20.0, 40.0]])
    tracklet_of = [1, 1, 2, 2, -1, -1]
    flags = [StreakFlag(0)] * 5 + [StreakFlag.VETOED]
    probability = [0.9, 0.9, 0.75, 0.5, 0.25, 0.1]
    frames = [0, 1, 0, 0, 1, 1]
    made: list[Any] = [streak(Camera(), frames[k], k, ends, 0.1, 0.1, flags[k], probability=probability[k]) for k in range(6)]
    for one, number in zip(made, tracklet_of, strict=True):
        object.__setattr__(one, "tracklet_id", number)
    products = GroundProducts(
        headers=(), solutions=(), photometry=(), streaks=made, tracklets=(_tracklet(1, [0, 1]), _tracklet(2, [0, 0])),
        members=(made[:2], made[2:4]), orbits=(),
    )  # fmt: skip
    counted = _counted(products, worlds.efficiency(np.random.default_rng(0), trials=100))
    assert (len(counted.size_m), counted.n_single, counted.n_vetoed) == (1, 3, 1)
    assert counted.n_single_false == pytest.approx(0.25 + 0.5 + 0.75)
