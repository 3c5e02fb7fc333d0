"""The store: what is written is there, all of it or nothing, for SQLite and for a PostgreSQL server."""

import hashlib
import os
import random
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("sqlalchemy", reason="the store is on SQLAlchemy (extra `objects`)")

from sqlalchemy import text

from ground.store import schema
from ground.store.store import Association, ObjectStore, StoredOrbit, StoredTracklet
from sboc_e2e.icd.errors import UserError

T0 = 2_000_000_000_000_000_000


def tracklet(seed: int, n: int = 3) -> StoredTracklet:
    rng = np.random.default_rng(seed)
    unit = rng.standard_normal((n, 3))
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    rows = np.hstack([unit, np.full((n, 2), 1e-6), np.zeros((n, 1)), 7000.0 * rng.standard_normal((n, 3))])
    t = T0 + seed * 10**9 + np.arange(n, dtype=np.int64) * 10**8
    return StoredTracklet(sensor="telescope", t_tai_ns=t, rows=rows, mag=14.0 + seed % 3)


def orbit(object_id: int, shift: float = 0.0) -> StoredOrbit:
    return StoredOrbit(
        object_id=object_id, epoch_tai_ns=T0, state=np.array([42164.0 + shift, 0, 0, 0, 3.07, 0]), covariance=np.eye(6),
        made_tai_ns=T0, made_by="batch", parameters={"radiation": 0.02}, chi2_nu=1.0, n_used=20,
    )  # fmt: skip


def accepted(tracklet_id: int, object_id: int) -> Association:
    return Association(
        tracklet_id=tracklet_id, object_id=object_id, probability=0.9, state="accepted", decided_by="test", decided_tai_ns=T0
    )


@pytest.fixture(scope="module")
def server() -> Iterator[str]:
    """URL of an empty PostgreSQL of its own, started as an ordinary user."""
    pytest.importorskip("pg8000", reason="pg8000 speaks to PostgreSQL (extra `postgresql`)")
    folders = sorted(Path("/usr/lib/postgresql").glob("*/bin")) if Path("/usr/lib/postgresql").is_dir() else []
    if not folders:
        pytest.skip("no PostgreSQL server in /usr/lib/postgresql (Debian: apt-get install postgresql)")
    as_user = ["runuser", "-u", "postgres", "--"] if os.geteuid() == 0 else []
    if as_user and (shutil.which("runuser") is None or subprocess.run(["id", "postgres"], capture_output=True).returncode):
        pytest.skip("PostgreSQL does not run as root, and there is no user postgres")
    home = Path(tempfile.mkdtemp(prefix="sboc-pg-"))
    home.chmod(0o777)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    binaries, data = folders[-1], home / "data"
    make = [*as_user, str(binaries / "initdb"), "-D", str(data), "-A", "trust", "-U", "tester", "--no-sync"]
    subprocess.run(make, check=True, capture_output=True, cwd="/")
    settings = f"-p {port} -k {home} -c listen_addresses=127.0.0.1 -c fsync=off"
    control = [*as_user, str(binaries / "pg_ctl"), "-D", str(data), "-w", "-l", str(home / "log")]
    subprocess.run([*control, "-o", settings, "start"], check=True, capture_output=True, cwd="/")
    yield f"postgresql+pg8000://tester@127.0.0.1:{port}/postgres"
    subprocess.run([*control, "-m", "immediate", "stop"], check=False, capture_output=True, cwd="/")
    shutil.rmtree(home, ignore_errors=True)


@pytest.fixture(params=["sqlite", "postgresql"])
def store(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[ObjectStore]:
    url = str(tmp_path / "store.db") if request.param == "sqlite" else request.getfixturevalue("server")
    made = ObjectStore(url)
    yield made
    with made.engine.begin() as connection:
        schema.METADATA.drop_all(connection)
    made.close()


def test_everything_comes_back_as_it_was(store: ObjectStore) -> None:
    items = [tracklet(k) for k in range(5)]
    with store.transaction() as writer:
        numbers = writer.add_tracklets(items)
        one, two = writer.add_objects(["A", "B"], T0)
        writer.associate([accepted(numbers[0], one), accepted(numbers[1], one), accepted(numbers[2], two)])
        writer.add_orbits([orbit(one), orbit(two, 1.0)])
    with store.transaction() as writer:
        assert writer.add_tracklets([*items[:2], tracklet(9)])[:2] == numbers[:2]
        writer.add_orbits([orbit(one, 5.0)])
    assert store.counts() == {"objects": 2, "tracklets": 6, "orbits": 3, "associations": 3, "decisions": 0}
    back = store.tracklets_of(one)
    np.testing.assert_array_equal(back[numbers[0]].rows, items[0].rows)
    np.testing.assert_array_equal(back[numbers[0]].t_tai_ns, items[0].t_tai_ns)
    assert [o.state[0] for o in store.orbits(one, current=False)] == [42164.0, 42169.0]
    assert [o.state[0] for o in store.orbits(one)] == [42169.0]
    assert store.orbits(one)[0].parameters == {"radiation": 0.02}
    assert len(store.tracklets(T0, T0 + 3 * 10**9)) == 3


def test_merge_and_split_keep_the_history(store: ObjectStore) -> None:
    with store.transaction() as writer:
        numbers = writer.add_tracklets([tracklet(k) for k in range(4)])
        one, two = writer.add_objects(["A", "B"], T0)
        writer.associate([accepted(n, one) for n in numbers[:2]] + [accepted(n, two) for n in numbers[2:]])
        writer.merge(one, two, by="operator", at_tai_ns=T0, why="same orbit")
    assert sorted(store.tracklets_of(one)) == numbers
    assert store.objects("merged")[0]["merged_into"] == one
    with store.transaction() as writer:
        writer.add_orbits([orbit(one)])
        halves = orbit(one, 3.0), orbit(one, 4.0)
        three = writer.split(one, numbers[3:], "C", halves, by="operator", at_tai_ns=T0, why="outlier")
        writer.set_status(three, "lost", by="operator", at_tai_ns=T0, why="not seen")
    assert sorted(store.tracklets_of(three)) == numbers[3:]
    # both have the orbit of their own tracklets, the one with the moved tracklets is history
    assert [[o.state[0] for o in store.orbits(k)] for k in (one, three)] == [[42167.0], [42168.0]]
    assert [o.state[0] for o in store.orbits(one, current=False)] == [42164.0, 42167.0]
    with store.transaction() as writer:
        writer.release(one, numbers[2:3], orbit(one, 5.0), by="operator", at_tai_ns=T0, why="of nobody")
    assert sorted(store.tracklets_of(one)) == numbers[:2]
    assert list(store.uncorrelated(T0, 2 * T0)) == numbers[2:3]
    with pytest.raises(UserError, match="release: tracklets"), store.transaction() as writer:
        writer.release(one, numbers[2:3], orbit(one, 5.0), by="operator", at_tai_ns=T0, why="twice")
    assert [d["kind"] for d in store.decisions()] == ["merge", "split", "status", "release"]
    assert len(store.associations()) == 4 + 2 + 1


def half_done(store: ObjectStore) -> None:
    with store.transaction() as writer:
        writer.add_objects(["A"], T0)
        writer.set_status(77, "lost", by="x", at_tai_ns=T0, why="y")


def test_what_fails_leaves_nothing(store: ObjectStore) -> None:
    with pytest.raises(UserError, match="no object 77"):
        half_done(store)
    with pytest.raises(UserError, match=r"store .*(UNIQUE|unique)"), store.transaction() as writer:
        writer.add_objects(["A", "A"], T0)
    assert store.counts()["objects"] == 0


def test_a_name_that_is_taken_gets_a_number(store: ObjectStore) -> None:
    with store.transaction() as writer:
        writer.add_objects(["A", "A-2", "L" * 64], T0)
        assert writer.free_names(["A", "B", "A", "L" * 64]) == ["A-3", "B", "A-4", "L" * 62 + "-2"]
        (one,) = writer.add_objects(["C"], T0)
        numbers = writer.add_tracklets([tracklet(k) for k in range(4)])
        writer.associate([accepted(n, one) for n in numbers])
        halves = orbit(one, 1.0), orbit(one, 2.0)
        writer.split(one, numbers[:2], "A", halves, by="t", at_tai_ns=T0, why="two")
    assert [row["name"] for row in store.objects()] == ["A", "A-2", "L" * 64, "C", "A-3"]


def test_a_tracklet_is_accepted_once(store: ObjectStore) -> None:
    with store.transaction() as writer:
        numbers = writer.add_tracklets([tracklet(k) for k in range(2)])
        one, two = writer.add_objects(["A", "B"], T0)
        writer.require_free(numbers)
        writer.associate([accepted(numbers[0], one)])
        writer.require_free(numbers[1:])
    words = f"another update has accepted tracklet {numbers[0]} as object {one}'s"
    with pytest.raises(UserError, match=words), store.transaction() as writer:
        writer.require_free(numbers)
    with pytest.raises(UserError, match=r"store .*(UNIQUE|unique)"), store.transaction() as writer:
        writer.associate([accepted(numbers[0], two)])
    assert store.with_few_tracklets(2) == {one}


def test_tracklets_that_an_older_store_accepted_twice_are_the_first_objects(tmp_path: Path) -> None:
    url = str(tmp_path / "store.db")
    store = ObjectStore(url)
    with store.engine.begin() as connection:
        schema.ONE_OBJECT.drop(connection)
        connection.execute(text("UPDATE store_version SET version = 3"))
    with store.transaction() as writer:
        numbers = writer.add_tracklets([tracklet(k) for k in range(2)])
        one, two = writer.add_objects(["A", "B"], T0)
        writer.associate([accepted(numbers[0], k) for k in (one, one, two)] + [accepted(numbers[1], two)])
    # rows are not tracklets
    assert store.with_few_tracklets(2) == {one}
    store.close()
    again = ObjectStore(url)
    assert [list(again.tracklets_of(k)) for k in (one, two)] == [numbers[:1], numbers[1:]]
    assert [a.state for a in again.associations()] == ["accepted", "rejected", "rejected", "accepted"]
    # the object that accepted it twice has lost nothing
    (decision,) = again.decisions()
    assert (decision["detail"]["object_id"], decision["detail"]["tracklets"]) == (two, numbers[:1])
    assert again.unproven("accepted once") == [two]
    again.close()


def test_readers_pass_a_writer_and_a_second_writer_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ground.store.store._BUSY_S", 0.1)
    url = str(tmp_path / "store.db")
    first = ObjectStore(url)
    with first.transaction() as writer:
        writer.add_objects(["A"], T0)
        second = ObjectStore(url)
        assert (second.objects(), second.counts()["objects"]) == ([], 0)
        with pytest.raises(UserError, match=r"store .*store\.db: database is locked"), second.transaction() as other:
            other.add_objects(["B"], T0)
        second.close()
    first.close()


def test_a_damaged_store_is_named(tmp_path: Path) -> None:
    path = tmp_path / "store.db"
    store = ObjectStore(str(path))
    with store.transaction() as writer:
        writer.add_tracklets([tracklet(k) for k in range(200)])
    store.close()
    whole = path.read_bytes()
    # the first page, with the tables' names, is whole; the version's own page too
    path.write_bytes(whole[: 4096 * 12] + b"\xff" * (len(whole) - 4096 * 12))
    again = ObjectStore(str(path))
    with pytest.raises(UserError, match=r"store .*store\.db: database disk image is malformed"):
        again.tracklets(0, 2 * T0)
    again.close()


WRITER = """
import sys
sys.path.insert(0, sys.argv[3])
from tests.store.test_store import orbit, accepted, tracklet, T0
from ground.store.store import ObjectStore
store = ObjectStore(sys.argv[1])
first = int(sys.argv[2])
for night in range(first, first + 10_000):
    with store.transaction() as writer:
        numbers = writer.add_tracklets([tracklet(1000 * night + k) for k in range(20)])
        objects = writer.add_objects([f"{night}-{k}" for k in range(5)], T0)
        writer.associate([accepted(n, objects[k % 5]) for k, n in enumerate(numbers)])
        writer.add_orbits([orbit(o) for o in objects])
    print(night, flush=True)
"""
ROOT = Path(__file__).resolve().parents[2]


def nights_whole(store: ObjectStore) -> set[int]:
    """Nights in a store, each of which has to be complete."""
    counts = store.counts()
    nights = {int(row["name"].partition("-")[0]) for row in store.objects()}
    n = len(nights)
    assert counts == {"objects": 5 * n, "tracklets": 20 * n, "orbits": 5 * n, "associations": 20 * n, "decisions": 0}
    return nights


def killed_writers(url: str, kills: int) -> None:
    rng = random.Random(4)  # noqa: S311 - moments of a test
    reported: set[int] = set()
    for k in range(kills):
        command = [sys.executable, "-c", WRITER, url, str(100 * k), str(ROOT)]
        writer = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert writer.stdout is not None
        reported.add(int(writer.stdout.readline()))
        time.sleep(rng.uniform(0.0, 0.15))
        writer.send_signal(signal.SIGKILL)
        reported |= {int(line) for line in writer.stdout.read().split() if line.strip().isdigit()}
        writer.wait()
        writer.stdout.close()
    store = ObjectStore(url)
    found = nights_whole(store)
    assert reported <= found
    # at most the night whose report was cut off is more
    assert len(found) <= len(reported) + kills
    store.close()


@pytest.mark.slow
def test_a_killed_writer_loses_nothing(tmp_path: Path) -> None:
    killed_writers(str(tmp_path / "store.db"), 3)


@pytest.mark.slow
def test_a_writer_killed_at_twenty_points_loses_nothing(tmp_path: Path) -> None:
    killed_writers(str(tmp_path / "store.db"), 20)


def test_two_writers_wait_for_each_other(tmp_path: Path) -> None:
    url = str(tmp_path / "store.db")
    ObjectStore(url).close()
    script = WRITER.replace("10_000", "8")
    writers = [
        subprocess.Popen([sys.executable, "-c", script, url, str(100 * k), str(ROOT)], stdout=subprocess.PIPE) for k in (0, 1)
    ]
    assert [w.wait() for w in writers] == [0, 0]
    for writer in writers:
        if writer.stdout is not None:
            writer.stdout.close()
    store = ObjectStore(url)
    assert nights_whole(store) == {*range(8), *range(100, 108)}
    store.close()


def test_an_older_store_is_upgraded_and_a_later_one_refused(tmp_path: Path) -> None:
    url = str(tmp_path / "store.db")
    store = ObjectStore(url)
    with store.transaction() as writer:
        writer.add_objects(["A"], T0)
        writer.add_tracklets([tracklet(1)])
    with store.engine.begin() as connection:
        # as version 1 was
        connection.execute(text("ALTER TABLE tracklets DROP COLUMN mag"))
        connection.execute(text("UPDATE store_version SET version = 1"))
    store.close()
    again = ObjectStore(url)
    assert again.had_version == 1
    assert len(again.tracklets(0, 2 * T0)) == 1
    with again.engine.begin() as connection:
        connection.execute(text("UPDATE store_version SET version = 99"))
    again.close()
    with pytest.raises(UserError, match="version 99 is of a later program"):
        ObjectStore(url)


def test_tracklets_of_an_older_store_are_not_stored_again(tmp_path: Path) -> None:
    """Their uid held their errors as well; two of one sensor, epochs and directions stay two."""
    url, one, other = str(tmp_path / "store.db"), tracklet(1), tracklet(2)
    wider = one.rows * np.where(np.isin(np.arange(9), (3, 4)), 2.0, 1.0)

    def older(rows: np.ndarray) -> StoredTracklet:
        uid = hashlib.sha256(b"telescope" + one.t_tai_ns.tobytes() + rows.tobytes()).hexdigest()
        return StoredTracklet(sensor="telescope", t_tai_ns=one.t_tai_ns, rows=rows, uid=uid)

    given = StoredTracklet(sensor="telescope", t_tai_ns=other.t_tai_ns, rows=other.rows, uid="of an operator")
    store = ObjectStore(url)
    with store.transaction() as writer:
        first, _, third = writer.add_tracklets([older(one.rows), older(wider), given])
    with store.engine.begin() as connection:
        connection.execute(text("UPDATE store_version SET version = 2"))
    store.close()
    again = ObjectStore(url)
    with again.transaction() as writer:
        assert writer.add_tracklets([one, replace(one, rows=wider, uid=""), given]) == [first, first, third]
    assert again.counts()["tracklets"] == 3
    again.close()


@pytest.mark.parametrize(
    ("url", "words"),
    [
        ("mysql://x@y/z", "mysql is not supported"),
        ("/nonexistent/folder/store.db", "unable to open database file"),
        ("postgresql+pg8000://u:secret@127.0.0.1:1/none", "store postgresql"),
    ],
)
def test_stores_that_cannot_be_opened(url: str, words: str) -> None:
    with pytest.raises(UserError, match=words) as caught:
        ObjectStore(url)
    assert "secret" not in str(caught.value)


def test_a_file_that_is_no_store(tmp_path: Path) -> None:
    path = tmp_path / "x.db"
    path.write_text("no database at all, but long enough to look like a page of one " * 40)
    with pytest.raises(UserError, match="not a database"):
        ObjectStore(str(path))


def test_bad_records_are_refused_by_name() -> None:
    good = tracklet(1)
    with pytest.raises(UserError, match="sigmas"):
        StoredTracklet(sensor="s", t_tai_ns=good.t_tai_ns, rows=np.where(np.arange(9) == 3, 0.0, good.rows))
    with pytest.raises(UserError, match="covariance: not positive"):
        StoredOrbit(
            object_id=1, epoch_tai_ns=T0, state=np.ones(6), covariance=np.eye(6) - 2.0 * np.ones((6, 6)) / 6.0 * 1.5,
            made_tai_ns=T0, made_by="x", chi2_nu=1.0,
        )  # fmt: skip
    # SQLite takes NaN for NULL, which its table refuses
    with pytest.raises(UserError, match=r"orbit\.chi2_nu: expected a finite number"):
        replace(orbit(1), chi2_nu=float("nan"))
    with pytest.raises(TypeError, match="chi2_nu"):
        StoredOrbit(object_id=1, epoch_tai_ns=T0, state=np.ones(6), covariance=np.eye(6), made_tai_ns=T0, made_by="x")  # type: ignore[call-arg]
    with pytest.raises(UserError, match="association: probability 2"):
        Association(tracklet_id=1, object_id=1, probability=2.0, state="accepted", decided_by="x", decided_tai_ns=T0)


@pytest.mark.slow
def test_a_night_into_a_hundred_thousand_tracklets(tmp_path: Path) -> None:
    store = ObjectStore(str(tmp_path / "store.db"))
    base = tracklet(0)

    def many(first: int, n: int) -> list[StoredTracklet]:
        return [
            StoredTracklet(sensor="s", t_tai_ns=base.t_tai_ns + (first + k) * 10**9, rows=base.rows, uid=f"{first + k:064d}")
            for k in range(n)
        ]

    with store.transaction() as writer:
        objects = writer.add_objects([f"o{k}" for k in range(10_000)], T0)
        writer.add_orbits([orbit(o) for o in objects])
    for start in range(0, 100_000, 50_000):
        with store.transaction() as writer:
            numbers = writer.add_tracklets(many(start, 50_000))
            writer.associate([accepted(n, objects[k % 10_000]) for k, n in enumerate(numbers)])
    with store.transaction() as writer:
        numbers = writer.add_tracklets(many(100_000, 20_000))
        writer.associate([accepted(n, objects[k % 10_000]) for k, n in enumerate(numbers)])
        writer.add_orbits([orbit(o, 1.0) for o in objects])
    current = store.orbits()
    assert len(current) == 10_000
    assert len(store.tracklets_of(objects[0])) == 12
    store.close()
