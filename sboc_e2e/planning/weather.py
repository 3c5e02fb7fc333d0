"""The weather calendar of a site: when its dome is closed."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from astropy.table import Table

from ground.planning.sky import Orbit, Site
from sboc_e2e.icd.errors import UserError
from simulator.platform import earth

COLUMNS = ("start_utc", "end_utc")


def with_weather(station: Site | Orbit, file: Path, where: str) -> Site:
    """The site with the closed times of a calendar: CSV or ECSV with the columns `start_utc` and `end_utc`.

    UserError, one line that begins with `where`, for a camera in orbit and for a file that is no such calendar.
    """
    if isinstance(station, Orbit):
        raise UserError(f"{where}: the camera is in orbit; a calendar is allowed for a site on the ground")
    try:
        table = Table.read(file, format="ascii.ecsv" if file.suffix == ".ecsv" else "ascii.csv")
    except Exception as error:  # astropy's readers raise what they like
        raise UserError(f"{where}: {file} cannot be read as a table: {str(error).splitlines()[0]}") from error
    missing = [name for name in COLUMNS if name not in table.colnames]
    if missing:
        raise UserError(f"{where}: {file} has no column {' and '.join(missing)}; expected {' and '.join(COLUMNS)}")
    closed = []
    for number, row in enumerate(table, start=1):
        start, end = (instant(str(row[name]), f"{where}: {file}, row {number}, {name}") for name in COLUMNS)
        if end <= start:
            raise UserError(f"{where}: {file}, row {number}: {row['end_utc']} is not after {row['start_utc']}")
        closed.append((start, end))
    return replace(station, closed_tai_ns=tuple(closed))


def instant(text: str, where: str) -> int:
    """TAI nanoseconds of a date. UserError, one line that begins with `where`, for a text that is none."""
    with as_errors_of(where):
        return earth.tai_ns_of_utc(text)


@contextmanager
def as_errors_of(where: str) -> Iterator[None]:
    """Complaints about an epoch name the key or the file that it stands in."""
    try:
        yield
    except UserError as error:
        raise UserError(f"{where}: {str(error).removeprefix('epoch_utc: ')}") from error
