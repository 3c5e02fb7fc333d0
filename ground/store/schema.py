"""Tables of the store and the steps by which an older one becomes today's."""

import hashlib
import json
from collections.abc import Callable
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import (
    BigInteger,
    Boolean,
    Column,
    Connection,
    Float,
    ForeignKey,
    Index,
    Integer,
    LargeBinary,
    MetaData,
    String,
    Table,
    Text,
    bindparam,
    insert,
    inspect,
    select,
    text,
    update,
)

from sboc_e2e.icd.errors import UserError

METADATA: Final = MetaData()
_ROWS_AT_ONCE: Final = 10_000
"""Tracklets that an upgrade holds in memory, some 10 MB."""

VERSION: Final = Table("store_version", METADATA, Column("version", Integer, primary_key=True))

OBJECTS: Final = Table(
    "objects",
    METADATA,
    Column("object_id", Integer, primary_key=True, autoincrement=True),
    Column("name", String(64), nullable=False, unique=True),
    Column("status", String(16), nullable=False),
    Column("created_tai_ns", BigInteger, nullable=False),
    Column("merged_into", Integer, ForeignKey("objects.object_id"), nullable=True),
)

TRACKLETS: Final = Table(
    "tracklets",
    METADATA,
    Column("tracklet_id", Integer, primary_key=True, autoincrement=True),
    Column("uid", String(64), nullable=False, unique=True),
    Column("sensor", String(64), nullable=False),
    Column("t_first_tai_ns", BigInteger, nullable=False),
    Column("t_last_tai_ns", BigInteger, nullable=False),
    Column("mag", Float, nullable=True),
    Column("epochs", LargeBinary, nullable=False),
    Column("rows", LargeBinary, nullable=False),
    Index("tracklets_by_time", "t_first_tai_ns"),
)

ORBITS: Final = Table(
    "orbits",
    METADATA,
    Column("orbit_id", Integer, primary_key=True, autoincrement=True),
    Column("object_id", Integer, ForeignKey("objects.object_id"), nullable=False),
    Column("made_tai_ns", BigInteger, nullable=False),
    Column("epoch_tai_ns", BigInteger, nullable=False),
    Column("state", LargeBinary, nullable=False),
    Column("covariance", LargeBinary, nullable=False),
    Column("parameters", Text, nullable=False),
    Column("chi2_nu", Float, nullable=False),
    Column("n_used", Integer, nullable=False),
    Column("made_by", String(64), nullable=False),
    Column("current", Boolean, nullable=False),
    Index("orbits_by_object", "object_id", "current"),
)

ASSOCIATIONS: Final = Table(
    "associations",
    METADATA,
    Column("association_id", Integer, primary_key=True, autoincrement=True),
    Column("tracklet_id", Integer, ForeignKey("tracklets.tracklet_id"), nullable=False),
    Column("object_id", Integer, ForeignKey("objects.object_id"), nullable=False),
    Column("probability", Float, nullable=False),
    Column("state", String(16), nullable=False),
    Column("decided_by", String(64), nullable=False),
    Column("decided_tai_ns", BigInteger, nullable=False),
    Index("associations_by_tracklet", "tracklet_id"),
    Index("associations_by_object", "object_id"),
)
ONE_OBJECT: Final = Index(
    "associations_accepted_once", ASSOCIATIONS.c.tracklet_id, unique=True,
    sqlite_where=ASSOCIATIONS.c.state == "accepted", postgresql_where=ASSOCIATIONS.c.state == "accepted",
)  # fmt: skip
"""A tracklet is accepted as one object's at a time."""

DECISIONS: Final = Table(
    "decisions",
    METADATA,
    Column("decision_id", Integer, primary_key=True, autoincrement=True),
    Column("decided_tai_ns", BigInteger, nullable=False),
    Column("decided_by", String(64), nullable=False),
    Column("kind", String(32), nullable=False),
    Column("detail", Text, nullable=False),
)

ACCEPTED_ONCE: Final = "accepted once"
"""Kind of the decision about an object that lost tracklets because others had accepted them first."""


def _first(connection: Connection) -> None:
    """Version 1 had everything but magnitudes and what an object was merged into."""
    METADATA.create_all(connection)


def _magnitudes_and_merges(connection: Connection) -> None:
    columns = {c["name"] for c in inspect(connection).get_columns("tracklets")}
    if "mag" not in columns:
        connection.execute(text("ALTER TABLE tracklets ADD COLUMN mag FLOAT"))
    columns = {c["name"] for c in inspect(connection).get_columns("objects")}
    if "merged_into" not in columns:
        connection.execute(text("ALTER TABLE objects ADD COLUMN merged_into INTEGER"))


def uid_of(sensor: str, t_tai_ns: NDArray[np.int64], direction: NDArray[np.float64]) -> str:
    """What tells a tracklet from others: its sensor, epochs (n,) and directions (n, 3); not their errors, nor the observer."""
    content = t_tai_ns.astype("<i8").tobytes() + direction.astype("<f8").tobytes()
    return hashlib.sha256(sensor.encode() + content).hexdigest()


def _uids_of_directions(connection: Connection) -> None:
    """Version 2 had the errors and the observer in the uid. One that was given from outside stays."""
    t = TRACKLETS.c
    done: set[str] = set()
    last = 0
    while True:
        query = select(t.tracklet_id, t.uid, t.sensor, t.epochs, t.rows).where(t.tracklet_id > last)
        some = connection.execute(query.order_by(t.tracklet_id).limit(_ROWS_AT_ONCE)).all()
        if not some:
            return
        last = some[-1].tracklet_id
        changed = []
        for row in some:
            if row.uid == hashlib.sha256(row.sensor.encode() + row.epochs + row.rows).hexdigest():
                direction = np.frombuffer(row.rows, dtype="<f8").reshape(-1, 9)[:, :3]
                uid = uid_of(row.sensor, np.frombuffer(row.epochs, dtype="<i8"), direction)
                # the same directions were stored twice where their errors differed: the second keeps its uid
                if uid not in done:
                    changed.append({"number": row.tracklet_id, "new": uid})
                done.add(uid)
        if changed:
            connection.execute(
                update(TRACKLETS).where(t.tracklet_id == bindparam("number")).values(uid=bindparam("new")), changed
            )


def _accepted_once(connection: Connection) -> None:
    """Version 3 let two updates at a time accept a tracklet twice: the first decision stands, later ones are rejected.

    A decision names each object that loses a tracklet by it: what its orbit was fitted to is no longer its own.
    """
    a = ASSOCIATIONS.c
    rows = connection.execute(
        select(a.association_id, a.tracklet_id, a.object_id, a.decided_tai_ns)
        .where(a.state == "accepted")
        .order_by(a.association_id)
    ).all()
    first: dict[int, Any] = {}
    for row in rows:
        first.setdefault(row.tracklet_id, row)
    later = [row for row in rows if first[row.tracklet_id] is not row]
    if later:
        wanted = update(ASSOCIATIONS).where(a.association_id == bindparam("number")).values(state="rejected")
        connection.execute(wanted, [{"number": row.association_id} for row in later])
    lost: dict[int, list[Any]] = {}
    for row in later:
        # an object that accepted a tracklet twice keeps it
        if row.object_id != first[row.tracklet_id].object_id:
            lost.setdefault(row.object_id, []).append(row)
    why = "an earlier decision had accepted these tracklets as other objects'; its orbit was fitted with them"
    decisions = [
        {
            "decided_tai_ns": max(row.decided_tai_ns for row in some),
            "decided_by": "store upgrade",
            "kind": ACCEPTED_ONCE,
            "detail": json.dumps(
                {"object_id": object_id, "tracklets": sorted({row.tracklet_id for row in some}), "why": why}, sort_keys=True
            ),
        }
        for object_id, some in sorted(lost.items())
    ]
    if decisions:
        connection.execute(insert(DECISIONS), decisions)
    ONE_OBJECT.create(connection, checkfirst=True)


STEPS: Final[tuple[Callable[[Connection], None], ...]] = (
    _first, _magnitudes_and_merges, _uids_of_directions, _accepted_once,
)  # fmt: skip
"""Step k makes version k + 1 of version k; each runs in the transaction that records it."""


def version_of(connection: Connection) -> int:
    """The version of a store, 0 of an empty one. UserError for a store of a later program."""
    known = inspect(connection).has_table("store_version")
    had = int(connection.execute(select(VERSION.c.version)).scalar() or 0) if known else 0
    if had > len(STEPS):
        raise UserError(f"store: version {had} is of a later program; this one knows {len(STEPS)}")
    return had


def upgrade(connection: Connection) -> int:
    """Bring a store to today's version; the version that it had. UserError for a store of a later program."""
    had = version_of(connection)
    if not inspect(connection).has_table("store_version"):
        VERSION.create(connection)
        connection.execute(VERSION.insert().values(version=0))
    for step in STEPS[had:]:
        step(connection)
    connection.execute(update(VERSION).values(version=len(STEPS)))
    return had
