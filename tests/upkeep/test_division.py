"""Objects whose tracklets are of two real ones are split in a night; a single object is not, whatever its errors."""

from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from sqlalchemy import text

from ground.association.clusters import AssociationOptions
from ground.determination.forces import ForceModel
from ground.store import schema
from ground.store.store import Association, ObjectStore, StoredOrbit
from ground.upkeep import sequential
from ground.upkeep.division import Division, division_of
from ground.upkeep.night import update
from ground.upkeep.sightings import KnownOrbit
from ground.upkeep.view import MADE_BY
from simulator.platform.all_forces import DAY_S, STEP_S, Sky, between, true_orbits
from tests.association import list_simulator
from tests.association.list_simulator import Seen, Survey, light, population, survey
from tests.association.lists import directions
from tests.upkeep.test_night import DAY_NS, killed_twenty_times, owners, put

FORCES = ForceModel(gravity_degree=8, radiation=0.02)


def divided(one: Survey, chosen: list[int], owner: int) -> Division | None:
    """What some tracklets say, from the true orbit of an owner at the start."""
    start = StoredOrbit(
        object_id=1, epoch_tai_ns=one.sky.t0_tai_ns, state=one.truth[owner, 0], covariance=np.eye(6),
        made_tai_ns=0, made_by="t", chi2_nu=1.0,
    )  # fmt: skip
    known = KnownOrbit(orbit=start, forces=FORCES, covariance=start.covariance)
    return division_of({k: directions(one, one.seen[k]) for k in chosen}, known, AssociationOptions())


def of(one: Survey, *wanted: int) -> list[int]:
    return [k for k, s in enumerate(one.seen) if s.owner in wanted]


def true_error_chi2(one: Survey, orbit: StoredOrbit, owner: int) -> float:
    """Chi2 of an orbit's state against the truth, six degrees of freedom."""
    truth = between(one.truth[owner], np.array([(orbit.epoch_tai_ns - one.sky.t0_tai_ns) * 1e-9]))[0]
    sigma = np.sqrt(np.diag(orbit.state_covariance))
    left = (orbit.state - truth) / sigma
    return float(left @ np.linalg.solve(orbit.state_covariance / np.outer(sigma, sigma), left))


@pytest.fixture(scope="module")
def one() -> Survey:
    return survey(21, objects=4, clutter=0, days=5.0, a_day=1.0)


def test_two_objects_merged_by_mistake_are_split_in_the_night(one: Survey, tmp_path: Path) -> None:
    store = ObjectStore(str(tmp_path / "store.db"))
    start = one.sky.t0_tai_ns
    owner_of = put(store, one, 0.0, 3.0)
    assert update(store, start + 3 * DAY_NS).made == 4
    kept, other = sorted(owners(store, owner_of))[:2]
    both = {owners(store, owner_of)[k][0] for k in (kept, other)}
    with store.transaction() as writer:
        writer.merge(kept, other, by="operator", at_tai_ns=start + 3 * DAY_NS, why="a mistake")
    assert store.unproven("merge") == [kept]
    owner_of |= put(store, one, 3.0, 4.0)
    night = update(store, start + 4 * DAY_NS)
    # the halves are there before the night's tracklets are correlated
    assert (night.split, night.correlated, night.made, night.ambiguous) == (1, 4, 0, 0)
    (decision,) = [d for d in store.decisions() if d["kind"] == "split"]
    assert decision["decided_by"] == MADE_BY
    assert "merged before; no one orbit meets its tracklets" in decision["detail"]["why"]
    halves = decision["detail"]["from"], decision["detail"]["new"]
    found = owners(store, owner_of)
    assert [len(found[k]) for k in halves] == [4, 4]
    assert {frozenset(found[k]) for k in halves} == {frozenset([k]) for k in both}
    for half in halves:
        (orbit,) = store.orbits(half)
        # one in a million is beyond 38
        assert true_error_chi2(one, orbit, found[half][0]) < 38.0
        # fitted to its own, then renewed by the night's tracklet
        assert [o.made_by for o in store.orbits(half, current=False)][-2:] == [MADE_BY] * 2
    # the next night correlates with both, and the same night again changes nothing
    owner_of |= put(store, one, 4.0, 5.0)
    assert (update(store, start + 5 * DAY_NS).correlated, store.unproven("merge")) == (4, [])
    before = store.counts()
    update(store, start + 5 * DAY_NS)
    assert store.counts() == before
    assert all(len(set(of_one)) <= 1 for of_one in owners(store, owner_of).values())


def test_a_true_merge_is_kept_and_gets_an_orbit_of_all_its_tracklets(one: Survey, tmp_path: Path) -> None:
    store = ObjectStore(str(tmp_path / "store.db"))
    start = one.sky.t0_tai_ns
    owner_of = put(store, one, 0.0, 2.0)
    update(store, start + 2 * DAY_NS)
    # the second two days as objects of their own
    alone = ObjectStore(str(tmp_path / "alone.db"))
    later = put(alone, one, 2.0, 4.0)
    update(alone, start + 4 * DAY_NS)
    first = owners(store, owner_of)
    with store.transaction() as writer:
        for number, mine in owners(alone, later).items():
            kept = next(k for k, of_one in first.items() if of_one[0] == mine[0])
            (copy,) = writer.add_objects([f"again {number}"], start)
            moved = list(alone.tracklets_of(number).values())
            links = [
                Association(tracklet_id=t, object_id=copy, probability=1.0, state="accepted", decided_by="t", decided_tai_ns=0)
                for t in writer.add_tracklets(moved)
            ]
            owner_of |= {link.tracklet_id: mine[0] for link in links}
            writer.associate(links)
            writer.add_orbits([replace(alone.orbits(number)[0], object_id=copy)])
            writer.merge(kept, copy, by="operator", at_tai_ns=start + 4 * DAY_NS, why="one object")
    night = update(store, start + 4 * DAY_NS)
    assert (night.split, night.released) == (0, 0)
    assert [d["kind"] for d in store.decisions()].count("one orbit") == 4
    assert store.unproven("merge") == []
    for number, mine in owners(store, owner_of).items():
        if mine:
            assert mine == [mine[0]] * 4
            assert true_error_chi2(one, store.orbits(number)[0], mine[0]) < 38.0


def test_an_object_that_loses_a_tracklet_in_an_upgrade_is_looked_at_again(one: Survey, tmp_path: Path) -> None:
    """Version 3 let a tracklet be two objects'; the second one's orbit was fitted with it."""
    url, start = str(tmp_path / "store.db"), one.sky.t0_tai_ns
    store = ObjectStore(url)
    owner_of = put(store, one, 0.0, 3.0)
    now = start + 3 * DAY_NS
    assert update(store, now).made == 4
    whose, other = (row["object_id"] for row in store.objects()[:2])
    with store.engine.begin() as connection:
        schema.ONE_OBJECT.drop(connection)
        connection.execute(text("UPDATE store_version SET version = 3"))
    (good,) = store.orbits(whose)
    spoilt = replace(good, state=good.state + 30.0 * np.sqrt(np.diag(good.state_covariance)), made_tai_ns=now - 1)
    stolen = next(iter(store.tracklets_of(other)))
    link = Association(tracklet_id=stolen, object_id=whose, probability=1.0, state="accepted", decided_by="t", decided_tai_ns=now)
    with store.transaction() as writer:
        writer.add_orbits([spoilt])
        writer.associate([link])
    store.close()
    again = ObjectStore(url)
    (decision,) = again.decisions()
    assert (decision["kind"], decision["decided_by"], decision["decided_tai_ns"]) == ("accepted once", "store upgrade", now)
    assert (decision["detail"]["object_id"], decision["detail"]["tracklets"]) == (whose, [stolen])
    assert again.unproven("accepted once") == [whose]
    update(again, now)
    assert again.unproven("accepted once") == []
    why = again.decisions()[-1]["detail"]["why"]
    assert why.startswith("tracklets of it were another object's; one orbit meets its tracklets")
    (mended,) = again.orbits(whose)
    assert true_error_chi2(one, spoilt, owners(again, owner_of)[whose][0]) > 38.0
    assert true_error_chi2(one, mended, owners(again, owner_of)[whose][0]) < 38.0
    again.close()


def a_quarter_turn_off(one: Survey, owner: int, object_id: int) -> StoredOrbit:
    """An orbit of somebody else's that is wrong by a quarter turn and knows it: no tracklet is near enough to be correlated."""
    r, v = one.truth[owner, 0, :3], one.truth[owner, 0, 3:]
    sigma = np.array([20_000.0] * 3 + [2.0] * 3)
    turned = np.concatenate([v * np.linalg.norm(r) / np.linalg.norm(v), -r * np.linalg.norm(v) / np.linalg.norm(r)])
    return StoredOrbit(
        object_id=object_id, epoch_tai_ns=one.sky.t0_tai_ns, state=turned, covariance=np.diag(sigma**2),
        made_tai_ns=one.sky.t0_tai_ns, made_by="t", chi2_nu=1.0, n_used=0,
    )  # fmt: skip


@pytest.mark.slow
def test_a_night_that_divides_and_merges_killed_at_twenty_points_loses_nothing(one: Survey, tmp_path: Path) -> None:
    """An operator's merge is undone, and a new object's orbit is that of a known one: step 5 merges them and proves it."""
    path = tmp_path / "store.db"
    store = ObjectStore(str(path))
    start = one.sky.t0_tai_ns
    two = frozenset([0, 1])
    owner_of = put(store, one, 0.0, 3.0, two)
    update(store, start + 3 * DAY_NS)
    kept, other = sorted(owners(store, owner_of))[:2]
    with store.transaction() as writer:
        writer.merge(kept, other, by="operator", at_tai_ns=start + 3 * DAY_NS, why="a mistake")
        (known,) = writer.add_objects(["known"], start)
        writer.add_orbits([a_quarter_turn_off(one, 2, known)])
        writer.set_status(known, "lost", by="t", at_tai_ns=start, why="nobody knows where it is")
    owner_of |= put(store, one, 3.0, 4.0, two) | put(store, one, 0.0, 4.0, frozenset([2]))
    store.close()
    # a covariance that is carried on a straight line says nothing of a quarter turn: chi2 is near 1,000
    # before the night, after the division, after the rest with its merge, after the proof of the merge
    assert len(killed_twenty_times(path, start + 4 * DAY_NS, 1e4)) == 4
    store = ObjectStore(str(path))
    found = owners(store, owner_of)
    assert sorted(mine for mine in found.values() if mine) == [[k] * 4 for k in range(3)]
    assert found[known] == [2] * 4
    assert true_error_chi2(one, store.orbits(known)[0], 2) < 38.0
    assert [row["status"] for row in store.objects() if row["object_id"] == known] == ["active"]
    decisions = [(d["kind"], d["decided_by"]) for d in store.decisions()]
    assert decisions[:2] == [("merge", "operator"), ("status", "t")]
    assert decisions[2:] == [(kind, MADE_BY) for kind in ("split", "merge", "status", "one orbit")]


@pytest.mark.slow
def test_a_foreign_tracklet_is_released_when_the_next_fit_is_refused(
    one: Survey, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = ObjectStore(str(tmp_path / "store.db"))
    start = one.sky.t0_tai_ns
    owner_of = put(store, one, 0.0, 3.0)
    update(store, start + 3 * DAY_NS)
    extra = put(store, one, 3.0, 4.0)
    kept = min(owners(store, owner_of))
    mine = owners(store, owner_of)[kept][0]
    foreign = next(t for t, owner in extra.items() if owner != mine)
    own = next(t for t, owner in extra.items() if owner == mine)
    # no step is short enough, as after a long gap: the tracklets are fitted anew
    monkeypatch.setattr(sequential, "MOST_CURVED", 0.0)
    link = Association(tracklet_id=foreign, object_id=kept, probability=1.0, state="accepted", decided_by="t", decided_tai_ns=0)
    with store.transaction() as writer:
        writer.associate([link])
    night = update(store, start + 4 * DAY_NS)
    owner_of |= extra
    assert (night.released, night.split) == (1, 0)
    found = owners(store, owner_of)
    assert set(found[kept]) == {mine}
    assert own in store.tracklets_of(kept)
    # what was released is its owner's in the same night
    assert all(len(set(of_one)) == 1 for of_one in found.values())
    assert sum(map(len, found.values())) == 16
    before = store.counts()
    update(store, start + 4 * DAY_NS)
    assert store.counts() == before
    assert "release" in [d["kind"] for d in store.decisions()]


def test_an_object_without_an_orbit_gets_one_from_pairs_of_directions(tmp_path: Path) -> None:
    one = survey(51, objects=2, clutter=0, days=3.0, a_day=1.0)
    # two directions make no arc: nothing but three directions of three tracklets gives an orbit
    short = replace(one, seen=[replace(s, t_s=s.t_s[[0, 14]], observer=s.observer[[0, 14]], direction=s.direction[[0, 14]])
                               for s in one.seen])  # fmt: skip
    store = ObjectStore(str(tmp_path / "store.db"))
    start = one.sky.t0_tai_ns
    owner_of = put(store, short, 0.0, 3.0)
    with store.transaction() as writer:
        numbers = writer.add_objects(["zero", "one"], start)
        writer.associate(
            [
                Association(
                    tracklet_id=t, object_id=numbers[k], probability=1.0, state="accepted", decided_by="t", decided_tai_ns=0
                )
                for t, k in owner_of.items()
            ]
        )
    assert store.without_orbit() == numbers
    update(store, start + 3 * DAY_NS)
    assert store.without_orbit() == []
    for number, mine in owners(store, owner_of).items():
        assert true_error_chi2(one, store.orbits(number)[0], mine[0]) < 38.0
    assert [d["kind"] for d in store.decisions()] == ["one orbit"] * 2
    assert "no orbit before" in store.decisions()[0]["detail"]["why"]


def test_the_report_counts_what_is_split_from_objects_without_an_orbit(one: Survey, tmp_path: Path) -> None:
    """Tracklets of two objects that somebody gave one number, which never had an orbit."""
    store = ObjectStore(str(tmp_path / "store.db"))
    start = one.sky.t0_tai_ns
    owner_of = put(store, one, 0.0, 3.0)
    with store.transaction() as writer:
        (number,) = writer.add_objects(["two in one"], start)
        mine = [t for t, owner in owner_of.items() if owner in (0, 1)]
        writer.associate(
            [
                Association(tracklet_id=t, object_id=number, probability=1.0, state="accepted", decided_by="t", decided_tai_ns=0)
                for t in mine
            ]
        )
    night = update(store, start + 3 * DAY_NS)
    assert [d["kind"] for d in store.decisions()] == ["split"]
    assert night.split == 1


@pytest.mark.parametrize("seed", [100, pytest.param(101, marks=pytest.mark.slow)])
@pytest.mark.slow
def test_every_two_of_some_objects_are_told_apart(seed: int) -> None:
    one = survey(seed, objects=3, clutter=0, days=4.0, a_day=1.0)
    for a, b in combinations(range(3), 2):
        found = divided(one, of(one, a, b), a)
        assert found is not None
        assert {frozenset(p.tracklets) for p in found.parts} == {frozenset(of(one, a)), frozenset(of(one, b))}


@pytest.mark.slow
def test_neighbours_in_one_slot_are_told_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    def slot(rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray]:
        """One geostationary slot: 0.03 to 0.1 deg from each other."""
        states, areas = population(rng, n)
        for k in range(n):
            states[k] = list_simulator.kepler(42_165.0, 2e-4 * k, 1e-3 + 5e-4 * k, 1.0, 0.5, 2.0 + 1e-3 * k)
        return states, areas

    monkeypatch.setattr(list_simulator, "population", slot)
    one = survey(31, objects=3, clutter=0, days=5.0, a_day=1.0)
    for a, b in combinations(range(3), 2):
        found = divided(one, of(one, a, b), a)
        assert found is not None
        assert {frozenset(p.tracklets) for p in found.parts} == {frozenset(of(one, a)), frozenset(of(one, b))}


def biased(one: Survey, rng: np.random.Generator, arcsec: float) -> Survey:
    """Each tracklet as a whole off by so much along each axis."""
    seen = []
    for s in one.seen:
        moved = s.direction + np.radians(arcsec / 3600.0) * rng.normal(size=3)
        seen.append(replace(s, direction=moved / np.linalg.norm(moved, axis=1, keepdims=True)))
    return replace(one, seen=seen)


@pytest.mark.parametrize("seed", [100, 101, *(pytest.param(k, marks=pytest.mark.slow) for k in range(102, 110))])
@pytest.mark.slow
def test_a_single_object_is_never_split(seed: int) -> None:
    one = survey(seed, objects=3, clutter=0, days=4.0, a_day=1.0)
    rng = np.random.default_rng(seed)
    for k in range(3):
        found = divided(one, of(one, k), k)
        assert found is not None
        assert found.whole
        # errors twice those that are stated, or three sigma that a tracklet's directions share
        for wrong in (replace(one, sigma_rad=0.5 * one.sigma_rad), biased(one, rng, 1.5)):
            found = divided(wrong, of(wrong, k), k)
            assert found is None or found.whole


def burnt(one: Survey, owner: int, day: float, push_km_s: np.ndarray) -> Survey:
    """The same lists with an impulse on one object; its later directions are where it is then, without noise."""
    step = round(day * DAY_S / STEP_S)
    rest = Sky(t0_tai_ns=0, sun=one.sky.sun[2 * step :], moon=one.sky.moon[2 * step :], fixed=one.sky.fixed[2 * step :])
    start = one.truth[owner, step] + np.append(np.zeros(3), push_km_s)
    days = (one.truth.shape[1] - 1 - step) * STEP_S / DAY_S
    after = true_orbits(start[None], one.area_m2_kg[owner : owner + 1], rest, days)[0]

    def moved(s: Seen) -> Seen:
        if s.owner != owner or s.t_s[0] < step * STEP_S:
            return s
        return replace(s, direction=light(between(after, s.t_s - step * STEP_S), s.observer))

    return replace(one, seen=[moved(s) for s in one.seen])


@pytest.mark.parametrize("seed", [41, *(pytest.param(k, marks=pytest.mark.slow) for k in (42, 43))])
@pytest.mark.slow
def test_a_manoeuvre_is_no_second_object(seed: int) -> None:
    one = survey(seed, objects=2, clutter=0, days=6.0, a_day=1.0)
    rng = np.random.default_rng(seed)
    for k in range(2):
        push = rng.normal(size=3)
        turned = burnt(one, k, 3.0, 2e-3 * push / np.linalg.norm(push))
        assert divided(turned, of(turned, k), k) is None
