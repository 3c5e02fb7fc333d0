"""The epoch of a trail's middle against the closed form of a passage whose rate changes."""

import math
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from ground.straight_passage import StraightPassage
from ground.streaks.joint_evidence import TrackletFrame
from ground.trail_epochs import with_middle_epoch

ARCSEC = math.degrees(1.0) * 3600.0
LENGTH_PX = 200.0


@pytest.mark.parametrize("kappa_per_s", [-0.08, -0.02, 0.0, 0.02, 0.08])
@pytest.mark.parametrize("first_s", [-0.5, 0.4, -1.7])
def test_middle_of_a_trail_is_dated_when_the_motion_passes_it(kappa_per_s: float, first_s: float) -> None:
    """tan x = v t / (1 + kappa t): the middle X of the trail is passed at t = tan X / (v - kappa tan X).

    About the closest approach that is kappa / 4 s before half of a second when the object recedes, and after it when it comes.
    The rate of 0.5 deg/s makes the tangent plane visible; an end is 1 s after the other one.
    """
    speed = math.radians(0.5)

    def seen(t_s: float) -> float:
        return math.atan(speed * t_s / (1.0 + kappa_per_s * t_s))

    ends = seen(first_s), seen(first_s + 1.0)
    middle = math.tan(0.5 * sum(ends))
    passed_s = middle / (speed - kappa_per_s * middle)
    zero_ns = 2_180_000_000_000_000_000
    epochs = zero_ns + np.array([round(1e9 * first_s), 0, round(1e9 * (first_s + 1.0))], dtype=np.int64)
    frame = SimpleNamespace(
        t_open_s=first_s, t_close_s=first_s + 1.0, along0=ends[0] * ARCSEC, along1=ends[1] * ARCSEC,
        along_per_px=(ends[1] - ends[0]) * ARCSEC / LENGTH_PX, fit=SimpleNamespace(length_px=LENGTH_PX),
    )  # fmt: skip
    got = with_middle_epoch(epochs, cast(TrackletFrame, frame), StraightPassage(0.0, 0.0, kappa_per_s))
    assert got[[0, 2]].tolist() == epochs[[0, 2]].tolist()
    late_s = (got[1] - zero_ns) * 1e-9 - (first_s + 0.5)
    # to first order in how far the motion is ahead: 2 kappa of the shift remains
    assert late_s == pytest.approx(passed_s - (first_s + 0.5), rel=0.25, abs=1e-6)
    if first_s == -0.5 and kappa_per_s:
        assert late_s == pytest.approx(-kappa_per_s / 4.0, rel=0.02)
