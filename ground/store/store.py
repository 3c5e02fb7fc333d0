"""Writing and reading the store: every change is one transaction, every change says who made it."""

import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import Connection, Engine, and_, create_engine, event, exists, func, insert, select, update
from sqlalchemy.engine import make_url
from sqlalchemy.exc import ArgumentError, DBAPIError, NoSuchModuleError

from ground.store import schema
from sboc_e2e.icd import validate
from sboc_e2e.icd.errors import UserError

Array = NDArray[np.float64]
_T = TypeVar("_T")

COLUMNS: Final = ("x", "y", "z", "sigma_along", "sigma_cross", "motion_angle", "observer_x", "observer_y", "observer_z")
"""Of a row of a tracklet: direction (GCRS), one sigma along and across the motion and its position angle (rad), observer (km)."""
STATUS: Final = ("active", "lost", "retired", "merged")
STATES: Final = ("accepted", "ambiguous", "rejected")
_LONGEST_NAME: Final = 64
"""Characters of an object's name, as the table has it."""
_CHUNK: Final = 400
"""Values of an IN clause: SQLite allows 999."""
_WRITES: Final = {"sboc_writes": True}
"""Option of connections that change the store: readers never wait for the lock."""
_BUSY_S: Final = 60  # how long a writer waits for another before the user is told. Chosen, not measured


@dataclass(frozen=True, kw_only=True, eq=False)
class StoredTracklet:
    """Directions (n, 9) of `COLUMNS` at epochs (n,) TAI ns by a sensor. mag : NaN when not known.

    uid : two with the same are one tracklet; that of sensor, epochs and directions where none is given.
    """

    sensor: str
    t_tai_ns: NDArray[np.int64]
    rows: Array
    mag: float = float("nan")
    uid: str = field(default="")

    def __post_init__(self) -> None:
        n = len(self.t_tai_ns)
        object.__setattr__(self, "t_tai_ns", validate.array("tracklet.t_tai_ns", self.t_tai_ns, np.int64, (None,)))
        object.__setattr__(self, "rows", validate.finite_array("tracklet.rows", self.rows, (n, len(COLUMNS))))
        if n < 1 or (np.diff(self.t_tai_ns) < 0).any():
            raise UserError("store: a tracklet without directions, or whose epochs fall")
        if (self.rows[:, 3:5] <= 0.0).any() or np.abs(np.linalg.norm(self.rows[:, :3], axis=1) - 1.0).max() > 1e-6:
            raise UserError("store: a tracklet whose sigmas are not above 0, or whose directions are no unit vectors")
        if not self.uid:
            object.__setattr__(self, "uid", schema.uid_of(self.sensor, self.t_tai_ns, self.rows[:, :3]))


@dataclass(frozen=True, kw_only=True, eq=False)
class StoredOrbit:
    """An orbit of an object: state (6,) km, km/s and covariance at an epoch, and how it was made.

    covariance : (6, 6) of the state, or (6 + k, 6 + k) of the state and the k parameters in their order.
    """

    object_id: int
    epoch_tai_ns: int
    state: Array
    covariance: Array
    made_tai_ns: int
    made_by: str
    chi2_nu: float
    parameters: Mapping[str, float] = field(default_factory=dict)
    n_used: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "state", validate.finite_array("orbit.state", self.state, (6,)))
        validate.finite("orbit.chi2_nu", self.chi2_nu)
        size = 6 + len(self.parameters) if len(self.covariance) != 6 else 6
        object.__setattr__(self, "covariance", validate.finite_array("orbit.covariance", self.covariance, (size, size)))
        scale = np.sqrt(np.abs(np.diag(self.covariance)))
        if not (scale > 0.0).all():
            raise UserError("store: orbit.covariance: not positive: a variance of 0")
        value = np.linalg.eigvalsh(self.covariance / np.outer(scale, scale))
        if value[0] < -1e-9 * value[-1]:
            raise UserError(f"store: orbit.covariance: not positive: smallest eigenvalue {value[0]:.2g} of the scaled matrix")

    @property
    def state_covariance(self) -> Array:
        """(6, 6) of the state alone."""
        return self.covariance[:6, :6]


@dataclass(frozen=True, kw_only=True)
class Association:
    """A tracklet as one of an object's: its probability, whether that was accepted, and by what."""

    tracklet_id: int
    object_id: int
    probability: float
    state: str
    decided_by: str
    decided_tai_ns: int

    def __post_init__(self) -> None:
        if not 0.0 <= self.probability <= 1.0 or self.state not in STATES:
            raise UserError(f"store: association: probability {self.probability:g}, state {self.state[:20]}")


class ObjectStore:
    """A store in SQLite (a path or ``sqlite:///``) or PostgreSQL (``postgresql+pg8000://``); made or upgraded when opened."""

    def __init__(self, url: str) -> None:
        self.engine = _engine(url)
        self._name = _shown(url)
        with self._told():
            with self.engine.connect() as connection:
                self.had_version = schema.version_of(connection)
            if self.had_version < len(schema.STEPS):
                with self.engine.connect().execution_options(**_WRITES) as connection, connection.begin():
                    self.had_version = schema.upgrade(connection)

    @contextmanager
    def _told(self) -> Iterator[None]:
        """A database's complaint (locked, damaged, no connection, a name that is taken) as a UserError with the store's name."""
        try:
            yield
        except DBAPIError as error:
            reason = (str(error.orig).splitlines() or [type(error.orig).__name__])[0]
            raise UserError(f"store {self._name}: {reason[:160]}") from error

    def close(self) -> None:
        """Give connections back."""
        self.engine.dispose()

    @contextmanager
    def transaction(self) -> Iterator["Writer"]:
        """Changes that become visible together, at the end, or not at all. UserError for what the database refuses."""
        with self._told(), self.engine.connect().execution_options(**_WRITES) as connection, connection.begin():
            yield Writer(connection)

    def counts(self) -> dict[str, int]:
        """How many rows each table has."""
        tables = (schema.OBJECTS, schema.TRACKLETS, schema.ORBITS, schema.ASSOCIATIONS, schema.DECISIONS)
        with self._told(), self.engine.connect() as connection:
            return {t.name: int(connection.execute(select(func.count()).select_from(t)).scalar_one()) for t in tables}

    def objects(self, status: str | None = None) -> list[dict[str, Any]]:
        """Objects in order of their number, as rows by column name."""
        query = select(schema.OBJECTS).order_by(schema.OBJECTS.c.object_id)
        return self._rows(query if status is None else query.where(schema.OBJECTS.c.status == status))

    def orbits(self, object_id: int | None = None, *, current: bool = True) -> list[StoredOrbit]:
        """Orbits, of one object or all: the current ones, or the whole history in order of making."""
        table = schema.ORBITS
        query = select(table).order_by(table.c.object_id, table.c.orbit_id)
        if object_id is not None:
            query = query.where(table.c.object_id == object_id)
        if current:
            query = query.where(table.c.current.is_(True))
        return [_orbit(row) for row in self._rows(query)]

    def tracklets(self, after_tai_ns: int, before_tai_ns: int) -> dict[int, StoredTracklet]:
        """Tracklets that begin in an interval, by their number."""
        table = schema.TRACKLETS
        inside = and_(table.c.t_first_tai_ns >= after_tai_ns, table.c.t_first_tai_ns < before_tai_ns)
        return {row["tracklet_id"]: _tracklet(row) for row in self._rows(select(table).where(inside))}

    def uncorrelated(self, after_tai_ns: int, before_tai_ns: int) -> dict[int, StoredTracklet]:
        """Tracklets that begin in an interval and were accepted as no object's, by their number."""
        t, a = schema.TRACKLETS, schema.ASSOCIATIONS
        taken = exists().where(and_(a.c.tracklet_id == t.c.tracklet_id, a.c.state == "accepted"))
        inside = and_(t.c.t_first_tai_ns >= after_tai_ns, t.c.t_first_tai_ns < before_tai_ns)
        query = select(t).where(inside, ~taken).order_by(t.c.tracklet_id)
        return {row["tracklet_id"]: _tracklet(row) for row in self._rows(query)}

    def tracklets_of(self, object_id: int) -> dict[int, StoredTracklet]:
        """Accepted tracklets of an object, by their number."""
        t, a = schema.TRACKLETS, schema.ASSOCIATIONS
        chosen = and_(a.c.object_id == object_id, a.c.state == "accepted")
        query = select(t).join(a, a.c.tracklet_id == t.c.tracklet_id).where(chosen).order_by(t.c.t_first_tai_ns)
        return {row["tracklet_id"]: _tracklet(row) for row in self._rows(query)}

    def associations(self, object_id: int | None = None, state: str | None = None) -> list[Association]:
        """All that was ever decided about tracklets, of one object or all, in any state or one."""
        a = schema.ASSOCIATIONS
        query = select(a).order_by(a.c.association_id)
        if object_id is not None:
            query = query.where(a.c.object_id == object_id)
        if state is not None:
            query = query.where(a.c.state == state)
        rows = self._rows(query)
        return [Association(**{k: v for k, v in row.items() if k != "association_id"}) for row in rows]

    def decisions(self) -> list[dict[str, Any]]:
        """What was decided, in order; `detail` as it was given."""
        rows = self._rows(select(schema.DECISIONS).order_by(schema.DECISIONS.c.decision_id))
        return [{**row, "detail": json.loads(row["detail"])} for row in rows]

    def without_orbit(self) -> list[int]:
        """Active and lost objects that no orbit was ever stored for, by number."""
        o, b = schema.OBJECTS, schema.ORBITS
        there = exists().where(b.c.object_id == o.c.object_id)
        query = select(o.c.object_id).where(o.c.status.in_(("active", "lost")), ~there).order_by(o.c.object_id)
        return [int(row["object_id"]) for row in self._rows(query)]

    def with_few_tracklets(self, fewer_than: int) -> set[int]:
        """Numbers of objects with some accepted tracklets, but fewer than a number."""
        a = schema.ASSOCIATIONS
        few = func.count(a.c.tracklet_id.distinct()) < fewer_than
        query = select(a.c.object_id).where(a.c.state == "accepted").group_by(a.c.object_id).having(few)
        return {int(row["object_id"]) for row in self._rows(query)}

    def unproven(self, kind: str) -> list[int]:
        """Objects with a decision of a kind after their tracklets were last found to be of one orbit, by number.

        kind : merge (of the kept objects), or accepted once (tracklets were taken from them in an upgrade).
        """
        table = schema.DECISIONS
        kinds = (kind, "merge", "split", "release", "one orbit")
        found: dict[int, bool] = {}
        for row in self._rows(select(table).where(table.c.kind.in_(kinds)).order_by(table.c.decision_id)):
            detail = json.loads(row["detail"])
            object_id = next(detail[key] for key in ("kept", "from", "object_id") if key in detail)
            if row["kind"] == "merge":
                found.pop(detail["merged"], None)
            if row["kind"] in (kind, "merge"):
                found[object_id] = found.get(object_id, False) or row["kind"] == kind
            else:
                found[object_id] = False
        return sorted(k for k, is_unproven in found.items() if is_unproven)

    def _rows(self, query: Any) -> list[dict[str, Any]]:
        with self._told(), self.engine.connect() as connection:
            return [dict(row) for row in connection.execute(query).mappings()]


class Writer:
    """Changes within one transaction."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    def add_tracklets(self, tracklets: Sequence[StoredTracklet]) -> list[int]:
        """Numbers of tracklets in their order; one that is there already (the same content) keeps its number."""
        table = schema.TRACKLETS
        known = self._known({t.uid for t in tracklets})
        new = {t.uid: t for t in tracklets if t.uid not in known}
        if new:
            self._connection.execute(
                insert(table),
                [
                    {
                        "uid": t.uid,
                        "sensor": t.sensor,
                        "t_first_tai_ns": int(t.t_tai_ns[0]),
                        "t_last_tai_ns": int(t.t_tai_ns[-1]),
                        "mag": None if np.isnan(t.mag) else t.mag,
                        "epochs": t.t_tai_ns.astype("<i8").tobytes(),
                        "rows": t.rows.astype("<f8").tobytes(),
                    }
                    for t in new.values()
                ],
            )
            known |= self._known(set(new))
        return [known[t.uid] for t in tracklets]

    def _known(self, uids: set[str]) -> dict[str, int]:
        table, ordered = schema.TRACKLETS, sorted(uids)
        found: dict[str, int] = {}
        for start in range(0, len(ordered), _CHUNK):
            query = select(table.c.uid, table.c.tracklet_id).where(table.c.uid.in_(ordered[start : start + _CHUNK]))
            found.update((str(uid), int(number)) for uid, number in self._connection.execute(query))
        return found

    def add_objects(self, names: Sequence[str], created_tai_ns: int) -> list[int]:
        """Numbers of new objects. UserError for a name that is taken."""
        table = schema.OBJECTS
        self._connection.execute(
            insert(table), [{"name": n, "status": "active", "created_tai_ns": created_tai_ns} for n in names]
        )
        found: dict[str, int] = {}
        for start in range(0, len(names), _CHUNK):
            query = select(table.c.name, table.c.object_id).where(table.c.name.in_(names[start : start + _CHUNK]))
            found.update((str(name), int(number)) for name, number in self._connection.execute(query))
        return [found[n] for n in names]

    def free_names(self, names: Sequence[str]) -> list[str]:
        """Names for new objects, in their order: a name that is taken gets -2, -3 and so on."""
        o, out = schema.OBJECTS, list[str]()
        taken = set[str]()
        for some in _chunks(names):
            taken |= {str(name) for name in self._connection.execute(select(o.c.name).where(o.c.name.in_(some))).scalars()}
        for name in names:
            free, number = name, 1
            while free in taken or (number > 1 and self._has_name(free)):
                number += 1
                free = f"{name[: _LONGEST_NAME - len(str(number)) - 1]}-{number}"
            taken.add(free)
            out.append(free)
        return out

    def _has_name(self, name: str) -> bool:
        o = schema.OBJECTS
        return self._connection.execute(select(o.c.object_id).where(o.c.name == name)).first() is not None

    def add_orbits(self, orbits: Sequence[StoredOrbit]) -> None:
        """New current orbits; earlier ones of the same objects stay as history."""
        table = schema.ORBITS
        for numbers in _chunks(sorted({o.object_id for o in orbits})):
            old = and_(table.c.object_id.in_(numbers), table.c.current.is_(True))
            self._connection.execute(update(table).where(old).values(current=False))
        last = {o.object_id: k for k, o in enumerate(orbits)}
        rows = [
            {
                "object_id": o.object_id,
                "made_tai_ns": o.made_tai_ns,
                "epoch_tai_ns": o.epoch_tai_ns,
                "state": o.state.astype("<f8").tobytes(),
                "covariance": o.covariance.astype("<f8").tobytes(),
                "parameters": json.dumps(dict(o.parameters)),
                "chi2_nu": o.chi2_nu,
                "n_used": o.n_used,
                "made_by": o.made_by,
                "current": last[o.object_id] == k,
            }
            for k, o in enumerate(orbits)
        ]
        if rows:
            self._connection.execute(insert(table), rows)

    def require_free(self, tracklet_ids: Iterable[int]) -> None:
        """UserError for tracklets that are accepted as an object's: another update has been here since they were read."""
        a = schema.ASSOCIATIONS
        for numbers in _chunks(sorted(set(tracklet_ids))):
            taken = and_(a.c.tracklet_id.in_(numbers), a.c.state == "accepted")
            query = select(a.c.tracklet_id, a.c.object_id).where(taken).order_by(a.c.tracklet_id)
            row = self._connection.execute(query).first()
            if row is not None:
                raise UserError(
                    f"store: another update has accepted tracklet {row.tracklet_id} as object {row.object_id}'s meanwhile; "
                    "nothing of this one is written, run it again"
                )

    def associate(self, associations: Sequence[Association]) -> None:
        """Record what was decided about tracklets; earlier decisions stay."""
        rows = [
            {
                "tracklet_id": a.tracklet_id,
                "object_id": a.object_id,
                "probability": a.probability,
                "state": a.state,
                "decided_by": a.decided_by,
                "decided_tai_ns": a.decided_tai_ns,
            }
            for a in associations
        ]
        if rows:
            self._connection.execute(insert(schema.ASSOCIATIONS), rows)

    def set_status(self, object_id: int, status: str, *, by: str, at_tai_ns: int, why: str) -> None:
        """Retire, lose or find an object again."""
        if status not in STATUS:
            raise UserError(f"store: status {status[:20]}; known: {', '.join(STATUS)}")
        self._require(object_id)
        table = schema.OBJECTS
        self._connection.execute(update(table).where(table.c.object_id == object_id).values(status=status))
        self._decide("status", by, at_tai_ns, {"object_id": object_id, "status": status, "why": why})

    def merge(self, kept: int, other: int, *, by: str, at_tai_ns: int, why: str) -> None:
        """Merge two objects: the kept object takes the other's accepted tracklets."""
        for object_id in (kept, other):
            self._require(object_id)
        if kept == other:
            raise UserError(f"store: object {kept} cannot be merged with itself")
        a, o = schema.ASSOCIATIONS, schema.OBJECTS
        accepted = and_(a.c.object_id == other, a.c.state == "accepted")
        rows = [dict(row) for row in self._connection.execute(select(a).where(accepted)).mappings()]
        self._connection.execute(update(a).where(accepted).values(state="rejected"))
        self.associate([_reassigned(row, kept, by, at_tai_ns) for row in rows])
        self._connection.execute(update(o).where(o.c.object_id == other).values(status="merged", merged_into=kept))
        self._decide("merge", by, at_tai_ns, {"kept": kept, "merged": other, "tracklets": len(rows), "why": why})

    def split(
        self,
        object_id: int,
        tracklet_ids: Iterable[int],
        name: str,
        orbits: tuple[StoredOrbit, StoredOrbit],
        *,
        by: str,
        at_tai_ns: int,
        why: str,
    ) -> int:
        """Split an object: some of its tracklets go to a new object. Returns the number of the new object.

        name : of the new object; where it is taken it gets a number.
        orbits : of the tracklets that stay and of those that go, each fitted to its own; they become current. The number of the
        object in them is not looked at.
        """
        rows = self._taken_from(object_id, tracklet_ids, "split")
        (new,) = self.add_objects(self.free_names([name]), at_tai_ns)
        self.associate([_reassigned(row, new, by, at_tai_ns) for row in rows])
        self.add_orbits([replace(o, object_id=k) for o, k in zip(orbits, (object_id, new), strict=True)])
        moved = sorted(row["tracklet_id"] for row in rows)
        self._decide("split", by, at_tai_ns, {"from": object_id, "new": new, "tracklets": moved, "why": why})
        return new

    def release(
        self, object_id: int, tracklet_ids: Iterable[int], orbit: StoredOrbit, *, by: str, at_tai_ns: int, why: str
    ) -> None:
        """Take tracklets from an object; they are no object's then. orbit : fitted to those that stay, becomes current."""
        rows = self._taken_from(object_id, tracklet_ids, "release")
        self.add_orbits([replace(orbit, object_id=object_id)])
        freed = sorted(row["tracklet_id"] for row in rows)
        self._decide("release", by, at_tai_ns, {"from": object_id, "tracklets": freed, "why": why})

    def hold(self, object_id: int, orbit: StoredOrbit, *, by: str, at_tai_ns: int, why: str) -> None:
        """Record that one orbit meets all tracklets of an object; it becomes current."""
        self._require(object_id)
        self.add_orbits([replace(orbit, object_id=object_id)])
        self._decide("one orbit", by, at_tai_ns, {"object_id": object_id, "why": why})

    def _taken_from(self, object_id: int, tracklet_ids: Iterable[int], what: str) -> list[dict[str, Any]]:
        """Accepted associations of some tracklets with an object, as they were; they are rejected from here on."""
        self._require(object_id)
        wanted = sorted(set(tracklet_ids))
        a = schema.ASSOCIATIONS
        rows: list[dict[str, Any]] = []
        for numbers in _chunks(wanted):
            there = and_(a.c.object_id == object_id, a.c.state == "accepted", a.c.tracklet_id.in_(numbers))
            rows += [dict(row) for row in self._connection.execute(select(a).where(there)).mappings()]
            self._connection.execute(update(a).where(there).values(state="rejected"))
        missing = set(wanted) - {row["tracklet_id"] for row in rows}
        if missing or not wanted:
            raise UserError(f"store: {what}: tracklets {sorted(missing)[:5]} are not accepted as object {object_id}'s")
        return rows

    def _require(self, object_id: int) -> None:
        table = schema.OBJECTS
        if self._connection.execute(select(table.c.object_id).where(table.c.object_id == object_id)).first() is None:
            raise UserError(f"store: no object {object_id}")

    def _decide(self, kind: str, by: str, at_tai_ns: int, detail: Mapping[str, Any]) -> None:
        row = {"decided_tai_ns": at_tai_ns, "decided_by": by, "kind": kind, "detail": json.dumps(detail, sort_keys=True)}
        self._connection.execute(insert(schema.DECISIONS), [row])


def _reassigned(row: Mapping[str, Any], object_id: int, by: str, at_tai_ns: int) -> Association:
    return Association(
        tracklet_id=row["tracklet_id"], object_id=object_id, probability=row["probability"],
        state="accepted", decided_by=by, decided_tai_ns=at_tai_ns,
    )  # fmt: skip


def _chunks(values: Sequence[_T]) -> Iterator[Sequence[_T]]:
    for start in range(0, len(values), _CHUNK):
        yield values[start : start + _CHUNK]


def _tracklet(row: Mapping[str, Any]) -> StoredTracklet:
    return StoredTracklet(
        sensor=row["sensor"],
        t_tai_ns=np.frombuffer(row["epochs"], dtype="<i8").astype(np.int64),
        rows=np.frombuffer(row["rows"], dtype="<f8").reshape(-1, len(COLUMNS)).astype(np.float64),
        mag=float("nan") if row["mag"] is None else float(row["mag"]),
        uid=row["uid"],
    )


def _square(values: Array) -> Array:
    side = math.isqrt(len(values))
    return values.reshape(side, side).astype(np.float64)


def _orbit(row: Mapping[str, Any]) -> StoredOrbit:
    return StoredOrbit(
        object_id=row["object_id"],
        epoch_tai_ns=row["epoch_tai_ns"],
        state=np.frombuffer(row["state"], dtype="<f8").astype(np.float64),
        covariance=_square(np.frombuffer(row["covariance"], dtype="<f8")),
        made_tai_ns=row["made_tai_ns"],
        made_by=row["made_by"],
        parameters=json.loads(row["parameters"]),
        chi2_nu=row["chi2_nu"],
        n_used=row["n_used"],
    )


def _engine(url: str) -> Engine:
    """An engine whose SQLite connections log ahead and wait for each other; those that write take the lock when they begin."""
    full = url if "://" in url else f"sqlite:///{url}"
    try:
        kind = make_url(full).get_backend_name()
        if kind not in ("sqlite", "postgresql"):
            raise UserError(f"store {_shown(url)}: {kind} is not supported; sqlite and postgresql are")
        arguments = {"timeout": _BUSY_S} if kind == "sqlite" else {}
        engine = create_engine(full, connect_args=arguments)
    except (ArgumentError, NoSuchModuleError, ModuleNotFoundError) as error:
        raise UserError(f"store {_shown(url)}: {str(error).splitlines()[0][:120]}") from error
    if kind == "sqlite":

        @event.listens_for(engine, "connect")
        def _prepare(connection: Any, _record: Any) -> None:
            connection.isolation_level = None
            cursor = connection.cursor()
            for pragma in ("journal_mode=WAL", "synchronous=FULL", "foreign_keys=ON"):
                cursor.execute(f"PRAGMA {pragma}")
            cursor.close()

        @event.listens_for(engine, "begin")
        def _begin(connection: Connection) -> None:
            # a transaction that reads first and writes then would find the lock taken in between
            writes = connection.get_execution_options().get("sboc_writes", False)
            connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")

    return engine


def _shown(url: str) -> str:
    """A URL without its password."""
    head, at, tail = url.rpartition("@")
    return f"{head.partition('://')[0]}://...@{tail}" if at else url[:100]
