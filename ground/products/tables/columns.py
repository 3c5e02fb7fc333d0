"""Columns with units and descriptions, as an astropy table; what all tables of a run share."""

from collections.abc import Iterator, Sequence
from typing import Any, Final

import numpy as np
from astropy.table import Column, Table
from numpy.typing import NDArray

from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.version import CONTRACT_VERSION

FRAMES_AT_ONCE: Final = 64
"""Rows in memory at once; a limit of memory."""

WHOLE_NUMBERS: Final = ("_id", "_ns", "frame", "frames", "flags", "rows", "cols", "dropped")
"""How the names of columns of integers end, besides those that begin with n_."""

Spec = tuple[str, Any, str | None, str]
"""Name, values, unit, description."""


def parts_of(n_frames: int) -> Iterator[range]:
    """Places of the frames of each piece; one empty piece where there is no frame."""
    for low in range(0, max(n_frames, 1), FRAMES_AT_ONCE):
        yield range(low, min(low + FRAMES_AT_ONCE, n_frames))


def table_of(columns: Sequence[Spec], name: str) -> Table:
    """An astropy table; empty lists become empty columns of the right kind."""
    made = []
    for title, values, unit, text in columns:
        array = np.asarray(values)
        if array.size == 0 and array.dtype.kind == "f" and isinstance(values, list):
            array = array.astype(np.int64 if title.startswith("n_") or title.endswith(WHOLE_NUMBERS) else np.float64)
        made.append(Column(array, name=title, unit=unit, description=text))
    return Table(made, meta={"table": name, "contract_version": CONTRACT_VERSION})


def directions_of(headers: Sequence[FrameHeader]) -> str:
    """What a run's published directions are, in words; without the observer's state nothing can be removed."""
    unknown = sum(header.observer is None for header in headers)
    if unknown == 0:
        removed = "aberration of the observer's geocentric velocity removed"
    elif unknown < len(headers):
        removed = "aberration of the observer's geocentric velocity removed, except in frames flagged NO_OBSERVER"
    else:
        removed = "observer state unknown: aberration of the observer's geocentric velocity not removed"
    return f"GCRS axes, observer-centred; {removed}, annual aberration not removed, light time not removed"


def texts(values: Sequence[str]) -> Any:
    """A text column, also when empty."""
    return np.array(list(values), dtype=str) if values else np.zeros(0, dtype="U1")


def floats(records: Sequence[object], name: str) -> NDArray[np.float64]:
    """A field of records as floats in every piece of a table, for any number type that a step returned."""
    return np.array([getattr(record, name) for record in records], dtype=np.float64)


def or_nan(value: float | None) -> float:
    """A number that may be lacking."""
    return float("nan") if value is None else value
