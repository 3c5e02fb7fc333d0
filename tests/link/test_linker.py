"""The motion linker on streaks of an independent little simulation."""

import numpy as np
import pytest

from ground.link import MotionLinker, apply_links
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.steps import Linker
from tests.link.sky_scene import T0_NS, Camera, Mover, mover_somewhere, observe


def movers_of(camera: Camera, rng: np.random.Generator, n: int, span_s: float) -> list[Mover]:
    """Objects that cross the field at random: 100 to 4,000 px/s, ranges of 20 to 1,000 km."""
    movers = []
    for _ in range(n):
        speed, angle, range_km = 10 ** rng.uniform(2.0, 3.6), rng.random() * 2 * np.pi, 10 ** rng.uniform(1.3, 3.0)
        closing = float(np.clip(3.0 * rng.normal(), -range_km / 30, range_km / 30))
        movers.append(mover_somewhere(camera, rng, span_s, (speed * np.sin(angle), speed * np.cos(angle)), range_km, closing))
    return movers


@pytest.mark.parametrize("sky", [True, False])
@pytest.mark.slow
def test_links_all_objects_among_false_streaks(sky: bool) -> None:
    """60 objects, 90 % seen per frame, 50 false streaks per frame: complete, pure, unfragmented, directions right."""
    camera = Camera()
    movers = movers_of(camera, np.random.default_rng(1), 60, 15.0)
    headers, streaks, truth = observe(camera, movers, 60, np.random.default_rng(5), false_per_frame=50, p_seen=0.9, sky=sky)
    linker = MotionLinker()
    assert isinstance(linker, Linker)
    tracklets = linker.link(headers, streaks)
    at = {(s.frame, s.streak_id): k for k, s in enumerate(streaks)}
    owner = np.array(truth.owner)
    detected = np.bincount(owner[owner >= 0], minlength=len(movers))
    found = np.zeros(len(movers), dtype=int)
    for tracklet in tracklets:
        owners = owner[[at[key] for key in zip(tracklet.frames.tolist(), tracklet.streak_ids.tolist(), strict=True)]]
        assert (owners == owners[0]).all()
        assert owners[0] >= 0
        found[owners[0]] += 1
    findable = detected >= 3
    assert (found[findable] == 1).mean() >= 0.98

    linked = apply_links(streaks, tracklets, headers)
    for k, (before, after) in enumerate(zip(streaks, linked, strict=True)):
        if after.tracklet_id < 0:
            assert after.flags & StreakFlag.SINGLE_FRAME
            continue
        assert (before.fit.col0 == after.fit.col0) == truth.end0_first[k]
        if not after.flags & (StreakFlag.EDGE0 | StreakFlag.EDGE1):
            # 0.5 px of end error is 5 us of row epoch
            np.testing.assert_allclose((after.t_tai_ns[[0, 2]] - T0_NS) * 1e-9, truth.epochs_s[k], atol=4e-5)
