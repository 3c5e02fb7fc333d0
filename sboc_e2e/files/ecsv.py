"""Tables as ECSV (astropy enhanced CSV 1.0): typed columns with units and descriptions, written fast and streamed.

The writer gives files that ``astropy.table.Table.read(path, format="ascii.ecsv")`` reads; columns that hold an array in
each row are JSON lists, as the format prescribes.
"""

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import IO, Any, Final

import numpy as np
from astropy.table import Table
from numpy.typing import NDArray

from sboc_e2e.files.atomic import replacing
from sboc_e2e.icd.errors import UserError

_QUOTED: Final = frozenset(' "\t\r\n')


@dataclass(frozen=True, kw_only=True)
class TableColumn:
    """A column of a table: name, numpy type (with shape for array cells), unit ('' when dimensionless), meaning."""

    name: str
    dtype: np.dtype[Any]
    unit: str
    text: str


def column(name: str, dtype: Any, unit: str, text: str) -> TableColumn:
    """A column from anything numpy takes as a dtype."""
    return TableColumn(name=name, dtype=np.dtype(dtype), unit=unit, text=text)


def read(path: Path) -> Table:
    """A table of a run. Raises `UserError` where there is none, or a damaged one."""
    if not path.is_file():
        raise UserError(f"{path}: not found; run the stage that writes it first")
    try:
        return Table.read(path, format="ascii.ecsv")
    except (ValueError, TypeError) as error:
        raise UserError(
            f"{path}: damaged table ({str(error).strip().splitlines()[0]}); run the stage that writes it again"
        ) from error


def header(columns: Sequence[TableColumn], meta: Sequence[tuple[str, str]] = (), *, empty: bool = False) -> str:
    """ECSV header and the line of column names.

    empty : no rows will follow; array columns are then declared without their shape, because readers take an empty
    column of JSON lists for a shape mismatch.
    """
    lines = ["# %ECSV 1.0", "# ---", "# datatype:"]
    for item in columns:
        base, shape = item.dtype.subdtype if item.dtype.subdtype else (item.dtype, ())
        shape = () if empty else shape
        kind = "string" if base.kind == "U" or shape else base.name
        parts = [f"name: {item.name}"]
        if item.unit:
            parts.append(f"unit: {_yaml(item.unit)}")
        parts.append(f"datatype: {kind}")
        if shape:
            parts.append(f"subtype: {_yaml(f'{base.name}{list(shape)}')}")
        parts.append(f"description: {_yaml(item.text)}")
        lines.append("# - {" + ", ".join(parts) + "}")
    if meta:
        lines.append("# meta: !!omap")
        lines += [f"# - {{{key}: {_yaml(text)}}}" for key, text in meta]
    lines += ["# schema: astropy-2.0", " ".join(item.name for item in columns)]
    return "\n".join(lines) + "\n"


def rows(columns: Sequence[TableColumn], table: NDArray[np.void]) -> str:
    """The lines of a structured array whose fields are the columns."""
    if len(table) == 0:
        return ""
    texts = [_texts(table[item.name]) for item in columns]
    return "\n".join(map(" ".join, zip(*texts, strict=True))) + "\n"


def write(path: Path, columns: Sequence[TableColumn], table: NDArray[np.void], meta: Sequence[tuple[str, str]] = ()) -> None:
    """Write a table atomically."""
    write_parts(path, columns, [table], meta)


def write_parts(
    path: Path, columns: Sequence[TableColumn], parts: Iterable[NDArray[np.void]], meta: Sequence[tuple[str, str]] = ()
) -> None:
    """Write a table atomically from consecutive parts, holding one part in memory."""
    with replacing(path) as stream:
        _write(stream, columns, parts, meta)


def write_table(path: Path, table: Table) -> None:
    """Write an astropy table atomically, with its units, descriptions and string metadata."""
    write_pieces(path, [table])


def write_pieces(path: Path, pieces: Iterable[Table]) -> None:
    """The same from consecutive pieces of one table, at least one. One piece is in memory at a time; the first defines the
    columns."""
    left = iter(pieces)
    first = next(left)
    columns = [
        TableColumn(
            name=name,
            dtype=np.dtype((first[name].dtype, first[name].shape[1:])),
            unit=str(first[name].unit or ""),
            text=str(first[name].description or ""),
        )
        for name in first.colnames
    ]
    meta = [(str(key), str(value)) for key, value in first.meta.items()]
    write_parts(path, columns, (piece.as_array() for piece in chain((first,), left)), meta)


def _write(
    stream: IO[bytes], columns: Sequence[TableColumn], parts: Iterable[NDArray[np.void]], meta: Sequence[tuple[str, str]]
) -> None:
    started = False
    for part in parts:
        if len(part):
            if not started:
                stream.write(header(columns, meta).encode())
            started = True
            stream.write(rows(columns, part).encode())
    if not started:
        stream.write(header(columns, meta, empty=True).encode())


def _texts(values: NDArray[Any]) -> list[str]:
    """Text of each cell."""
    if values.ndim > 1:
        # JSON inside CSV: no spaces, so that only the quotes of the format are needed.
        return ['"' + json.dumps(cell, separators=(",", ":")).replace('"', '""') + '"' for cell in values.tolist()]
    if values.dtype == np.float32:
        # Shortest text that reads back to the same single-precision number.
        return [str(text) for text in values.astype("U").tolist()]
    if values.dtype.kind == "U":
        return [_quoted(text) for text in values.tolist()]
    return [repr(value) for value in values.tolist()]


def _quoted(text: str) -> str:
    if not text or _QUOTED.intersection(text) or text.startswith("#"):
        return '"' + text.replace('"', '""') + '"'
    return text


def _yaml(text: str) -> str:
    """A YAML scalar of one line in double quotes."""
    return json.dumps(text, ensure_ascii=False)
