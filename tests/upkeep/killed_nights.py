"""Nights that are killed: what the nursery calls, and the whole content of a store."""

import pickle
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from functools import wraps
from pathlib import Path
from typing import Any

from ground.store.store import ObjectStore, Writer
from ground.upkeep import correlation, new_objects, night, review, sequential, view
from ground.upkeep.view import UpkeepOptions


def content(path: Path) -> str:
    """All rows of a store, as SQL."""
    with closing(sqlite3.connect(path)) as connection:
        return "\n".join(connection.iterdump())


def remembered(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function, each result worked out once: forks of a warm process spend their time on writing."""
    known: dict[bytes, Any] = {}

    @wraps(function)
    def found(*arguments: Any, **named: Any) -> Any:
        key = pickle.dumps((arguments, named))
        if key not in known:
            known[key] = function(*arguments, **named)
        return known[key]

    return found


def remember() -> None:
    """What a night works out without the store."""
    correlation.arc_orbits = remembered(correlation.arc_orbits)  # type: ignore[assignment]
    correlation.one_orbit_of = remembered(correlation.one_orbit_of)  # type: ignore[assignment]
    correlation.sightings = remembered(correlation.sightings)  # type: ignore[assignment]
    new_objects.associate = remembered(new_objects.associate)  # type: ignore[assignment]
    new_objects.carried = remembered(new_objects.carried)
    review.division_of = remembered(review.division_of)  # type: ignore[assignment]
    view.carried = remembered(view.carried)
    sequential.renewed = remembered(sequential.renewed)


def updated(path: str, now_tai_ns: int, merge_chi2: float) -> None:
    """A night of a store."""
    store = ObjectStore(path)
    night.update(store, now_tai_ns, UpkeepOptions(merge_chi2=merge_chi2))
    store.close()


def undisturbed(path: str, now_tai_ns: int, merge_chi2: float, states: str) -> None:
    """The same, and the store's content before it and after each of its transactions, one file each."""
    remember()
    folder, transaction = Path(states), ObjectStore.transaction

    @contextmanager
    def watched(store: ObjectStore) -> Iterator[Writer]:
        with transaction(store) as writer:
            yield writer
        (folder / f"{len(list(folder.iterdir()))}.sql").write_text(content(Path(path)))

    (folder / "0.sql").write_text(content(Path(path)))
    ObjectStore.transaction = watched  # type: ignore[method-assign]
    updated(path, now_tai_ns, merge_chi2)
    ObjectStore.transaction = transaction  # type: ignore[method-assign]
