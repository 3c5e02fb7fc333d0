"""Long tables to files piece by piece, so that a run's streaks and stars are never in memory as a whole."""

from collections.abc import Iterable
from itertools import chain
from pathlib import Path

from astropy.table import Table

from sboc_e2e.files import ecsv


def write_pieces(path: Path, pieces: Iterable[Table]) -> None:
    """Write consecutive pieces of one table, at least one, as ECSV; units, descriptions and metadata are the first one's."""
    left = iter(pieces)
    first = next(left)
    columns = [
        ecsv.column(name, (first[name].dtype, first[name].shape[1:]), str(first[name].unit or ""), str(first[name].description))
        for name in first.colnames
    ]
    meta = [(str(key), str(value)) for key, value in first.meta.items()]
    ecsv.write_parts(path, columns, (piece.as_array() for piece in chain((first,), left)), meta)
