"""The start of exposure of FITS headers."""

import warnings
from pathlib import Path

import numpy as np
import pytest

from sboc_e2e.outside.fits_frames import _frame_header
from sboc_e2e.outside.frame_source import Note
from sboc_e2e.outside.header_times import FIRST_ASSUMED_TAI_NS, start_tai_ns


@pytest.mark.parametrize(
    ("header", "known"),
    [
        ({"DATE-OBS": "2024-03-01", "TIME-OBS": "02:03:04.5"}, True),
        ({"DATE-OBS": "2024-03-01"}, True),
        ({"MJD-OBS": 60370.0}, True),
        ({"DATE-OBS": "yesterday"}, False),
        ({"DATE-OBS": 20240301}, False),
        ({"MJD-OBS": "soon"}, False),
        ({"MJD-OBS": float("nan")}, False),
        ({}, False),
    ],
)
def test_times_are_read_or_known_to_be_unknown(header: dict[str, object], known: bool) -> None:
    assert (start_tai_ns(header) is not None) == known


@pytest.mark.parametrize("date", ["yesterday", "1850-06-01T00:00:00", "1850-06-01", "9999-01-01T00:00:00\x1b"])
def test_a_date_that_cannot_be_is_shown_and_warns_of_nothing_else(
    tmp_path: Path, date: str, capfd: pytest.CaptureFixture[str]
) -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        header = {"DATE-OBS": date, "EXPTIME": 1.0, "GAIN": 1.0}
        notes: list[Note] = []
        made = _frame_header(header, 0, np.zeros((64, 64), np.float32), None, 1.0, notes)
    assert made.t_start_tai_ns == FIRST_ASSUMED_TAI_NS
    (note,) = notes
    assert note.text == f"DATE-OBS = {date!r} is no time from 1958 to 2104: the epoch is a number, not a time"
    assert not caught
