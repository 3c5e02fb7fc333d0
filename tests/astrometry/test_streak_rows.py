"""Streaks packed into rows come back as they were; a run made on demand gives what one in memory gives."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from ground.on_demand import OnDemand
from ground.products.tables import streaks_tables
from ground.streak_rows import STREAKS_PER_FRAME, LinkedStreaks, RunStreaks, StreakRows
from sboc_e2e.files import checkpoint
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.products import StreakMeasurement
from tests.astrometry.star_fields import Field
from tests.astrometry.test_ground_chain import chain_of, fields
from tests.link.sky_scene import Camera, observe, pixel_mover

__all__ = ["fields"]


@pytest.fixture(scope="module")
def streaks() -> list[StreakMeasurement]:
    """One mover and chance streaks in six frames; light curves of different lengths, every other one with a period."""
    camera = Camera()
    mover = pixel_mover(camera, 2000.0, 500.0, 20.0, 2500.0, t_s=0.0, range_km=500.0, range_rate_km_s=0.0)
    _, made, _ = observe(camera, [mover], 6, np.random.default_rng(1), p_seen=1.0, false_per_frame=3.0)
    return [
        dataclasses.replace(
            s,
            streak_id=s.frame * STREAKS_PER_FRAME + k,
            fit=dataclasses.replace(
                s.fit,
                light_curve_e_px=np.arange(k % 4, dtype=np.float32),
                light_curve_err_e_px=np.linspace(0.1, 0.2, k % 4, dtype=np.float32),
                period_fraction=0.1 * k if k % 2 else None,
                light_interval_px=np.array([[-1.0, 2.0], [-0.5, 4.0 + k]])[: 2 * (k % 2)],
            ),
        )
        for k, s in enumerate(made)
    ]


def assert_same(one: Any, other: Any) -> None:
    """Records equal field by field, types included."""
    assert type(one) is type(other)
    for field in dataclasses.fields(one):
        a, b = getattr(one, field.name), getattr(other, field.name)
        if dataclasses.is_dataclass(a):
            assert_same(a, b)
        elif isinstance(a, np.ndarray):
            assert (a.dtype, a.shape) == (b.dtype, b.shape)
            np.testing.assert_array_equal(a, b)
        else:
            assert type(a) is type(b), field.name
            assert a == b or (np.isnan(a) and np.isnan(b)), field.name


def test_every_field_comes_back(streaks: list[StreakMeasurement]) -> None:
    packed = StreakRows.of(streaks)
    for rows in (packed, checkpoint.from_bytes(checkpoint.to_bytes(packed))):
        assert len(rows) == len(streaks)
        for before, after in zip(streaks, rows, strict=True):
            assert_same(before, after)
    assert_same(packed[-1], streaks[-1])
    assert [s.streak_id for s in packed[2:5]] == [s.streak_id for s in streaks[2:5]]
    assert list(StreakRows.of(())) == []
    with pytest.raises(IndexError):
        packed[len(streaks)]


def test_rows_cannot_be_written(streaks: list[StreakMeasurement]) -> None:
    packed = StreakRows.of(streaks)
    assert not packed[0].fit.covariance_px2.flags.writeable
    assert not packed[0].ra_deg.flags.writeable
    assert not packed[3].fit.light_curve_e_px.flags.writeable


def test_streaks_of_a_run_are_numbered_through() -> None:
    frames: list[list[Any]] = [[], ["a", "b"], [], ["c"], []]
    run = RunStreaks([len(frame) for frame in frames], frames.__getitem__)
    assert list(run) == [run[k] for k in range(len(run))] == run[:] == ["a", "b", "c"]
    assert run[-1] == "c"
    with pytest.raises(IndexError):
        run[3]


def test_linked_streaks_are_found_in_their_frames(streaks: list[StreakMeasurement]) -> None:
    """Two tracklets claim one streak: the later one has it. Frame numbers need not be positions."""
    place = {frame: 7 + frame for frame in range(6)}
    linked = LinkedStreaks(place, 2)
    first = [dataclasses.replace(s, tracklet_id=0) for s in streaks[:4]]
    second = [dataclasses.replace(s, tracklet_id=1) for s in streaks[3:6]]
    linked.put(1, second)
    linked.put(0, first)
    found = {s.streak_id: s for k in range(20) for s in linked.of_frame(k).values()}
    assert {i: s.tracklet_id for i, s in found.items()} == {s.streak_id: int(k >= 3) for k, s in enumerate(streaks[:6])}
    for number, streak in linked.of_frame(7 + streaks[0].frame).items():
        assert streak.streak_id == streak.frame * STREAKS_PER_FRAME + number
    assert [len(members) for members in linked.members] == [4, 3]


def test_on_demand_makes_again_what_it_did_not_keep() -> None:
    made: list[int] = []

    def square(k: int) -> int:
        made.append(k)
        return k * k

    items = OnDemand(4, square, keep=1)
    assert list(items) == [0, 1, 4, 9]
    assert (items[-1], items[1:3]) == (9, [1, 4])
    assert made == [0, 1, 2, 3, 1, 2]
    with pytest.raises(IndexError):
        items[4]


def test_a_run_on_demand_is_the_run_in_memory(fields: list[Field]) -> None:
    chain = chain_of(fields[0])
    state, products = chain.initial_state(), []
    frames = [field.frame for field in fields]
    for frame in frames:
        state, product = chain.process_frame(state, frame)
        products.append(product)
    held = chain.finish(frames, products)
    stored = [checkpoint.to_bytes(product) for product in products]
    lazy = chain.finish(
        OnDemand(len(frames), lambda k: dataclasses.replace(frames[k])),
        OnDemand(len(frames), lambda k: checkpoint.from_bytes(stored[k])),
    )
    for one, other in zip(held.streaks, lazy.streaks, strict=True):
        assert_same(one, other)
        assert one.flags & StreakFlag.REFIT
    assert_same(held.tracklets[0], lazy.tracklets[0])
    assert [s.streak_id for s in held.members[0]] == [s.streak_id for s in lazy.members[0]] == [s.streak_id for s in held.streaks]
    one, other = next(streaks_tables(held)), next(streaks_tables(lazy))
    assert one.as_array().tobytes() == other.as_array().tobytes()
