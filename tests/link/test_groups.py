"""Streaks that came down as one track: the linker starts from them, and gives each streak to one tracklet."""

from collections import Counter
from dataclasses import replace

import numpy as np

from ground.link import MotionLinker
from sboc_e2e.icd.flags import StreakFlag
from tests.link.sky_scene import Camera, observe, pixel_mover


def test_a_track_of_streaks_too_poor_to_support_each_other_is_one_tracklet() -> None:
    """Ends good to 25 px of 60 among 400 false streaks a frame: chance explains them as well, unless they came as a track."""
    camera = Camera()
    mover = pixel_mover(camera, 1000.0, 1000.0, 100.0, 280.0, t_s=0.3)
    headers, streaks, truth = observe(
        camera, [mover], 3, np.random.default_rng(2), false_per_frame=400, sigma_along=25.0, sigma_cross=2.0
    )
    owner = np.array(truth.owner)
    assert (owner == 0).sum() == 3
    poor = [replace(s, flags=s.flags | StreakFlag.VETOED) for s in streaks]
    tracked = [replace(s, track=4) if o == 0 else s for s, o in zip(poor, owner, strict=True)]
    wanted = sorted(s.streak_id for s, o in zip(streaks, owner, strict=True) if o == 0)
    before = [sorted(t.streak_ids.tolist()) for t in MotionLinker().link(headers, poor)]
    after = [sorted(t.streak_ids.tolist()) for t in MotionLinker().link(headers, tracked)]
    assert wanted not in before
    assert wanted in after


def test_no_streak_is_in_two_tracklets_where_one_track_could_grow_into_another() -> None:
    """One object that came down under two numbers, and alone in between."""
    camera = Camera()
    mover = pixel_mover(camera, 500.0, 300.0, 90.0, 400.0, t_s=0.0)
    headers, streaks, truth = observe(camera, [mover], 10, np.random.default_rng(3), false_per_frame=5)
    number_of = {h.frame: k for k, h in enumerate(headers)}
    owner = [3 if number_of[s.frame] < 4 else 8 if number_of[s.frame] > 5 else -1 for s in streaks]
    tracked = [replace(s, track=owner[k]) if truth.owner[k] == 0 else s for k, s in enumerate(streaks)]
    tracklets = MotionLinker().link(headers, tracked)
    often = Counter(i for t in tracklets for i in t.streak_ids.tolist())
    assert set(often.values()) == {1}
    assert max(len(t.frames) for t in tracklets) == 10


def test_light_that_came_down_under_two_numbers_is_one_tracklet() -> None:
    """Two tracks of one object, the second of which also has the frames after the first: all of them are one tracklet's."""
    camera = Camera()
    mover = pixel_mover(camera, 500.0, 300.0, 90.0, 400.0, t_s=0.0)
    headers, streaks, truth = observe(camera, [mover], 8, np.random.default_rng(4), false_per_frame=5)
    number_of = {h.frame: k for k, h in enumerate(headers)}
    first = [replace(s, track=2) if o == 0 and number_of[s.frame] < 6 else s for s, o in zip(streaks, truth.owner, strict=True)]
    again = [
        replace(s, track=7, streak_id=s.streak_id + 50_000)
        for s, o in zip(streaks, truth.owner, strict=True)
        if o == 0 and number_of[s.frame] >= 3
    ]
    alone = MotionLinker().link(headers, first)
    both = MotionLinker().link(headers, first + again)
    of_object = {s.streak_id for s, o in zip(streaks, truth.owner, strict=True) if o == 0} | {s.streak_id for s in again}
    mine = [t for t in both if of_object & set(t.streak_ids.tolist())]
    assert len(mine) == 1
    assert len(mine[0].frames) == len(set(mine[0].frames.tolist())) == 8
    assert len(both) == len(alone)
