"""Nights of simulated tracklets into the store: objects appear, are kept, lost, found again; a kill changes nothing."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ground.products.epochs import utc_text
from ground.sky.sphere import spherical_deg
from ground.store.store import ObjectStore, StoredOrbit, StoredTracklet
from ground.upkeep.new_objects import merges_of
from ground.upkeep.night import update
from ground.upkeep.view import UpkeepOptions, directions_of, position_error_km
from sboc_e2e.cli.main import run
from sboc_e2e.icd.errors import UserError
from simulator.platform.all_forces import DAY_S, between
from tests.association.list_simulator import Survey, survey
from tests.association.lists import directions
from tests.browser import SCHEMES, WIDTHS, excess_and_errors
from tests.processes import Ended, nursery, points
from tests.upkeep.killed_nights import content

DAY_NS = 86400 * 10**9


def stored(one: Survey, place: int) -> StoredTracklet:
    """A tracklet as the store has it: equal errors, so that any motion angle will do."""
    seen = one.seen[place]
    n = len(seen.t_s)
    sigma = np.full((n, 1), one.sigma_rad)
    rows = np.hstack([seen.direction, sigma, sigma, np.full((n, 1), 0.7), seen.observer])
    return StoredTracklet(sensor="list", t_tai_ns=directions(one, seen).t_tai_ns, rows=rows)


@pytest.fixture(scope="module")
def one() -> Survey:
    return survey(11, objects=4, clutter=2, days=4.0, a_day=1.0)


def put(store: ObjectStore, one: Survey, first_day: float, last_day: float, of: frozenset[int] | None = None) -> dict[int, int]:
    """Put the tracklets of some days, of some owners or all, into a store; their owners by number."""
    days = (s.t_s[0] / DAY_S for s in one.seen)
    chosen = [k for k, day in enumerate(days) if first_day <= day < last_day and (of is None or one.seen[k].owner in of)]
    with store.transaction() as writer:
        numbers = writer.add_tracklets([stored(one, k) for k in chosen])
    return {number: one.seen[k].owner for number, k in zip(numbers, chosen, strict=True)}


def owners(store: ObjectStore, owner_of: dict[int, int]) -> dict[int, list[int]]:
    """Owners of the accepted tracklets of every object."""
    return {row["object_id"]: [owner_of[t] for t in store.tracklets_of(row["object_id"])] for row in store.objects()}


def test_objects_appear_and_are_kept(one: Survey, tmp_path: Path) -> None:
    store = ObjectStore(str(tmp_path / "store.db"))
    start = one.sky.t0_tai_ns
    owner_of = put(store, one, 0.0, 2.0)
    first = update(store, start + 2 * DAY_NS)
    assert (first.made, first.correlated) == (4, 0)
    owner_of |= put(store, one, 2.0, 3.0)
    second = update(store, start + 3 * DAY_NS)
    assert (second.made, second.correlated, second.renewed, second.ambiguous) == (0, 4, 4, 0)
    found = owners(store, owner_of)
    assert sorted(found.values()) == [[k] * 3 for k in range(4)]
    # the same night again changes nothing
    before = store.counts()
    update(store, start + 3 * DAY_NS)
    assert store.counts() == before
    # nobody sees them for a day: the error they say they have is the error they have
    for orbit in store.orbits():
        truth = between(one.truth[found[orbit.object_id][0]], np.array([(orbit.epoch_tai_ns - start) * 1e-9]))[0]
        sigma = np.sqrt(np.diag(orbit.state_covariance))
        left = (orbit.state - truth) / sigma
        scaled = orbit.state_covariance / np.outer(sigma, sigma)
        # chi2 of six: one in a million is beyond 38
        assert left @ np.linalg.solve(scaled, left) < 38.0


def test_what_is_not_seen_is_lost_retired_and_found_again(one: Survey, tmp_path: Path) -> None:
    store = ObjectStore(str(tmp_path / "store.db"))
    start = one.sky.t0_tai_ns
    put(store, one, 0.0, 2.0)
    update(store, start + 2 * DAY_NS)
    rules = UpkeepOptions(lost_km=min(position_error_km(o, start + 5 * DAY_NS) for o in store.orbits()) * 0.9)
    put(store, one, 4.0, 5.0)
    assert update(store, start + 5 * DAY_NS, rules).lost == 4
    put(store, one, 3.0, 4.0)
    assert update(store, start + 5 * DAY_NS, rules).reacquired == 4
    assert {row["status"] for row in store.objects()} == {"active"}
    strict = UpkeepOptions(lost_km=0.5)
    assert update(store, start + 40 * DAY_NS, strict).lost == 4
    assert update(store, start + 100 * DAY_NS, strict).retired == 4
    assert [d["kind"] for d in store.decisions()] == ["status"] * 16


def test_a_tracklet_that_comes_late_makes_no_orbit_older_or_worse(one: Survey, tmp_path: Path) -> None:
    """The third night's tracklets arrive after the fourth's."""
    store, now = ObjectStore(str(tmp_path / "store.db")), one.sky.t0_tai_ns + 4 * DAY_NS
    put(store, one, 0.0, 2.0)
    assert update(store, now - 2 * DAY_NS).made == 4
    put(store, one, 3.0, 4.0)
    assert update(store, now).renewed == 4
    before = {o.object_id: o for o in store.orbits()}
    put(store, one, 2.0, 3.0)
    assert update(store, now).correlated == 4
    for after in store.orbits():
        old = before[after.object_id]
        assert after.epoch_tai_ns >= old.epoch_tai_ns
        assert position_error_km(after, now) <= position_error_km(old, now)


def test_what_is_lost_and_long_unseen_is_retired_in_the_same_night(one: Survey, tmp_path: Path) -> None:
    store = ObjectStore(str(tmp_path / "store.db"))
    start = one.sky.t0_tai_ns
    put(store, one, 0.0, 2.0)
    # orbits of this night stand, however wide: the same night again calls none of them lost
    strict = UpkeepOptions(lost_km=1e-3)
    assert (update(store, start + 2 * DAY_NS, strict).made, update(store, start + 2 * DAY_NS, strict).lost) == (4, 0)
    late = update(store, start + 100 * DAY_NS, strict)
    assert (late.lost, late.retired) == (4, 4)
    before = store.counts()
    update(store, start + 100 * DAY_NS, strict)
    assert store.counts() == before


def test_a_name_that_is_taken_stops_no_night(one: Survey, tmp_path: Path) -> None:
    start = one.sky.t0_tai_ns
    names: list[str] = []
    for expected in ("", "-2"):
        store = ObjectStore(str(tmp_path / f"store{expected}.db"))
        put(store, one, 0.0, 2.0)
        with store.transaction() as writer:
            writer.add_objects([*names, "OTHER"], start)
        assert update(store, start + 2 * DAY_NS).made == 4
        found = [row["name"] for row in store.objects()][len(names) + 1 :]
        assert [name[8:] for name in found] == [expected] * 4
        names = found
        store.close()


def test_of_two_updates_at_a_time_one_is_refused(one: Survey, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The second one reads, and the first one writes before the second does."""
    path = str(tmp_path / "store.db")
    store = ObjectStore(path)
    start = one.sky.t0_tai_ns
    put(store, one, 0.0, 2.0)
    update(store, start + 2 * DAY_NS)
    put(store, one, 2.0, 3.0)
    after: list[dict[str, int]] = []

    def overtaken(*arguments: Any) -> Any:
        if not after:
            after.append({})
            other = ObjectStore(path)
            assert update(other, start + 3 * DAY_NS).correlated == 4
            after[0] = other.counts()
            other.close()
        return merges_of(*arguments)

    monkeypatch.setattr("ground.upkeep.night.merges_of", overtaken)
    with pytest.raises(UserError, match="another update has accepted tracklet"):
        update(store, start + 3 * DAY_NS)
    assert store.counts() == after[0]


def unreachable(one: Survey, object_id: int, days_before: float) -> StoredOrbit:
    """An orbit in the plane of owner 0, of an epoch that is further from the night than propagation goes."""
    epoch = one.sky.t0_tai_ns - round(days_before * DAY_NS)
    return StoredOrbit(
        object_id=object_id, epoch_tai_ns=epoch, state=one.truth[0, 0], covariance=np.diag([1e-2] * 3 + [1e-10] * 3),
        made_tai_ns=epoch, made_by="t", chi2_nu=1.0,
    )  # fmt: skip


def test_an_orbit_that_cannot_be_propagated_stops_no_night(
    one: Survey, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "store.db"
    store = ObjectStore(str(path))
    start = one.sky.t0_tai_ns
    put(store, one, 0.0, 2.0)
    with store.transaction() as writer:
        numbers = writer.add_objects(["ANCIENT", "OLD"], start)
        writer.add_orbits([unreachable(one, number, 500.0) for number in numbers])
        writer.set_status(numbers[1], "lost", by="t", at_tai_ns=start, why="not seen")
    store.close()
    assert run(["objects", "update", "--store", str(path), "--at", utc_text(np.array([start + 2 * DAY_NS]))[0]]) == 0
    first, *rest = capsys.readouterr().out.splitlines()
    assert "made 4" in first
    assert "lost 1, retired 2" in first
    # one is called lost; a new object near the plane of both was held against neither
    reason = "propagation: over more than 400 days from the epoch of the state"
    assert rest == [f"cannot be propagated: {name}: {reason}" for name in ("ANCIENT", "OLD")]
    store = ObjectStore(str(path))
    assert [d["detail"]["why"] for d in store.decisions() if d["detail"]["status"] == "lost"] == ["not seen", reason]
    assert [row["status"] for row in store.objects()][:2] == ["retired", "retired"]
    store.close()


def test_tracklets_of_the_store_are_the_same_measurements(one: Survey) -> None:
    given, back = directions(one, one.seen[0]), directions_of(stored(one, 0))
    for axis in (0, 1):
        assert np.allclose(np.einsum("ni,ni->n", back.axes[:, axis], given.direction), 0.0, atol=1e-12)
    assert np.allclose(back.covariance_rad2, given.covariance_rad2)


def tdm(one: Survey, place: int) -> str:
    """A tracklet as a message; the frame bias of EME2000 (0.02 arcsec) is below what is tested."""
    tracklet = stored(one, place)
    meta = (
        "CCSDS_TDM_VERS = 2.0", "CREATION_DATE = 2026-01-01T00:00:00", "ORIGINATOR = TEST", "META_START", f"TRACK_ID = {place}",
        "TIME_SYSTEM = UTC", "PARTICIPANT_1 = S", f"PARTICIPANT_2 = O{place}", "MODE = SEQUENTIAL", "PATH = 2,1",
        "ANGLE_TYPE = RADEC", "REFERENCE_FRAME = EME2000", "TIMETAG_REF = RECEIVE", "META_STOP", "DATA_START",
    )  # fmt: skip
    ra, dec = spherical_deg(tracklet.rows[:, :3])
    rows = [
        f"ANGLE_{k} = {t} {x:.8f}"
        for t, a, d in zip(utc_text(tracklet.t_tai_ns, 6), ra, dec, strict=True)
        for k, x in ((1, a), (2, d))
    ]
    return "\n".join([*meta, *rows, "DATA_STOP"]) + "\n"


def test_the_commands_take_messages_and_bring_the_store_up(
    one: Survey, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    message, store = tmp_path / "night.tdm", str(tmp_path / "store.db")
    message.write_text(tdm(one, 0))
    arguments = ["objects", "observe", str(message), "--store", store]
    for expected in ("1 tracklets read, 1 of them new, 1 in the store", "1 tracklets read, 0 of them new, 1 in the store"):
        assert run([*arguments, "--site", "28.3,-16.5,2390"]) == 0
        assert expected in capsys.readouterr().out
    assert run(["objects", "update", "--store", store, "--at", "2026-06-14T00:00:00"]) == 0
    assert "made 0" in capsys.readouterr().out
    for wrong, words in (
        (arguments, "give either --observer"),
        ([*arguments, "--site", "28.3,-16.5,2390", "--sigma", "-1"], "--sigma: expected arcsec above 0"),
        (["objects", "update", "--store", str(tmp_path / "none.db"), "--at", "2026-06-14T00:00:00"], "no such store"),
        (
            ["objects", "update", "--store", store, "--at", "2026-06-14T00:00:00", "--window", "99"],
            "--window: expected more than 0",
        ),
        (["objects", "update", "--store", store, "--at", "yesterday"], "yesterday"),
    ):
        assert run(wrong) == 2
        assert words in capsys.readouterr().err


@pytest.mark.slow
def test_a_page_shows_each_object_with_its_error(
    one: Survey, tmp_path: Path, chromium: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "store.db"
    store = ObjectStore(str(path))
    start = one.sky.t0_tai_ns
    put(store, one, 0.0, 3.0)
    update(store, start + 3 * DAY_NS)
    errors = [position_error_km(orbit, start + 3 * DAY_NS) for orbit in store.orbits()]
    store.close()
    out, at = tmp_path / "objects.html", utc_text(np.array([start + 3 * DAY_NS]))[0]
    assert run(["objects", "page", "--store", str(path), "--at", at, "--out", str(out)]) == 0
    page = out.read_text()
    assert all(f"<td>{error:.3g}</td>" in page for error in errors)
    assert page.count("<svg") == 3
    for width in WIDTHS:
        for scheme in SCHEMES:
            assert excess_and_errors(chromium, out, width, scheme) == (0, [])
    assert run(["objects", "page", "--store", str(tmp_path / "none.db"), "--at", at]) == 2
    assert "no such store" in capsys.readouterr().err


def killed_twenty_times(path: Path, now_tai_ns: int, merge_chi2: float) -> list[str]:
    """Kill a night of a store at twenty of its changes; contents that it goes through, before it and after each transaction."""
    given, states = path.read_bytes(), path.with_name("states")
    update_it = "tests.upkeep.killed_nights:updated", str(path), now_tai_ns, merge_chi2
    states.mkdir()
    with nursery() as processes:
        processes.call("tests.upkeep.killed_nights:undisturbed", str(path), now_tai_ns, merge_chi2, str(states), fork=False)
        allowed = [(states / f"{k}.sql").read_text() for k in range(len(list(states.iterdir())))]
        assert content(path) == allowed[-1]

        def again(kill_at: int | None) -> Ended:
            for old in path.parent.glob(f"{path.name}*"):
                old.unlink()
            path.write_bytes(given)
            return processes.call(*update_it, kill_at=kill_at)

        for point in points(again(None).changes, 20, seed=8):
            assert again(point).killed
            # a transaction is there whole or not at all
            assert content(path) in allowed
            processes.call(*update_it)
            assert content(path) == allowed[-1]
    return allowed


@pytest.mark.slow
def test_an_update_killed_at_twenty_points_loses_nothing(one: Survey, tmp_path: Path) -> None:
    path = tmp_path / "store.db"
    store = ObjectStore(str(path))
    owner_of = put(store, one, 0.0, 2.0)
    store.close()
    allowed = killed_twenty_times(path, one.sky.t0_tai_ns + 2 * DAY_NS, UpkeepOptions().merge_chi2)
    assert len(allowed) == 2
    assert sorted(owners(ObjectStore(str(path)), owner_of).values()) == [[k] * 2 for k in range(4)]
