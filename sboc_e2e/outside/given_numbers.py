"""Numbers, arrays and tables that users hand over in Python: masks are heeded, and what is no number is told in one line."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from astropy.table import Table
from numpy.typing import NDArray

from sboc_e2e.icd.errors import UserError


def number(name: str, value: Any) -> float:
    """A number that the user gave, of any type that is one."""
    try:
        if isinstance(value, str | bytes) or np.ndim(value) > 0:
            raise TypeError(value)
        return float(value)
    except (TypeError, ValueError, OverflowError) as error:
        raise UserError(f"{name}: expected a number, got {value!r:.40}") from error


def plain(values: Any, expected: str) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    """Values as an array without unit or mask, and where a mask hides them: that of numpy's arrays, of their rows in a list,
    of a CCDData or of astropy's columns. Raises `UserError` that says what is expected where they are no array.
    """
    try:
        # numpy's way of masked arrays looks for masks at each value: a list needs it, an array has one mask
        given = np.ma.asanyarray(values) if isinstance(values, list | tuple) else np.asanyarray(values)
        data = np.asarray(given)
        hidden = np.broadcast_to(np.asarray(getattr(given, "mask", False), dtype=np.bool_), data.shape)
    except (TypeError, ValueError, OverflowError) as error:
        raise UserError(f"{expected} ({error})") from error
    return data, hidden


def columns(table: Table, names: Sequence[str], where: str) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Columns of a table as numbers (columns, rows), and where masks hide them; raises `UserError` where it has no such ones."""
    missing = [name for name in names if name not in table.colnames]
    if missing:
        raise UserError(f"{where} has no {', '.join(missing)}")
    values, hidden = np.zeros((len(names), len(table))), np.zeros((len(names), len(table)), dtype=np.bool_)
    for k, name in enumerate(names):
        expected = f"{where}: expected one number a row in {name}"
        data, hidden_here = plain(table[name], expected)
        if data.ndim != 1 or data.dtype.kind not in "uif":
            raise UserError(f"{expected}, got {data.ndim} dimensions of {data.dtype}")
        values[k], hidden[k] = data, hidden_here
    return values, hidden
