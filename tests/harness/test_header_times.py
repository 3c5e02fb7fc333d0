"""The start of exposure of FITS headers."""

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from astropy.io import fits

from sboc_e2e.icd.tai import from_jd_parts
from sboc_e2e.outside.fits_frames import FitsFolder, _frame_header
from sboc_e2e.outside.frame_source import Note
from sboc_e2e.outside.header_times import FIRST_ASSUMED_TAI_NS, start_of

DAY_JD = 2455259.5
"""2010-03-04; TAI was 34 s ahead of UTC (IERS Bulletin C 36 and 39: from 2009 to mid-2012)."""

LEAP_S = 34.0


def day_s(header: dict[str, Any]) -> float:
    """Seconds of TAI after 2010-03-04T00:00:00 TAI."""
    tai_ns = start_of(header).tai_ns
    assert tai_ns is not None
    return (tai_ns - from_jd_parts(DAY_JD, 0.0)) * 1e-9


@pytest.mark.parametrize(
    ("header", "hours"),
    [
        ({"DATE-OBS": "2010-03-04T05:30:00"}, 5.5),
        ({"DATE-OBS": "2010-03-04 05:30:00"}, 5.5),
        ({"DATE-OBS": "2010-03-04T05:30"}, 5.5),
        ({"DATE-OBS": "2010-03-04", "TIME-OBS": "05:30:00.0"}, 5.5),
        ({"DATE-OBS": "2010-03-04", "UT": " 5:30:00"}, 5.5),
        ({"DATE-OBS": "2010-03-04", "TIME-OBS": "2010-03-04T05:30:00"}, 5.5),
        ({"DATE-OBS": "2010-03-04", "TIME-OBS": "dawn", "UT": "05:30:00"}, 5.5),
        ({"TIME-OBS": "2010-03-04T05:30:00"}, 5.5),
        ({"DATE-OBS": "2010-03-04", "MJD-OBS": 55259.5}, 12.0),
        ({"DATE-OBS": "2010-03-04", "UT": 5.5, "MJD-OBS": 55259.25}, 6.0),
        ({"DATE-OBS": "2010-03-04", "TIME-OBS": "dawn", "MJD-STR": "55259.25"}, 6.0),
        ({"DATE-OBS": "yesterday", "MJD-OBS": 55259.25}, 6.0),
        ({"DATE-OBS": "1850-06-01T00:00:00", "MJD-OBS": 55259.25}, 6.0),
        ({"DATE-BEG": "2010-03-04T05:30:00"}, 5.5),
        ({"DATE-OBS": "2010-03-04", "DATE-BEG": "2010-03-04T05:30:00"}, 5.5),
        ({"DATE-OBS": "2010-03-04T04:00:00", "DATE-BEG": "2010-03-04T05:30:00"}, 4.0),
        ({"MJD-BEG": 55259.25}, 6.0),
        ({"DATE-OBS": "2010-03-04T05:30:00Z"}, 5.5),
        ({"DATE-OBS": "2010-03-04T05:30:00.000+00:00"}, 5.5),
        ({"DATE-OBS": "2010-03-04T05:30:00-0000"}, 5.5),
        ({"DATE-OBS": "2010-03-04 05:30:00 UTC"}, 5.5),
        ({"DATE-OBS": "2010-03-04T05:30:00+02:00"}, 3.5),
        ({"DATE-OBS": "2010-03-04T05:30:00-0430"}, 10.0),
        ({"DATE-OBS": "2010-03-04", "UT": "05:30:00+00:00"}, 5.5),
    ],
)
def test_the_time_of_day_is_looked_for_before_a_day_is_taken(header: dict[str, Any], hours: float) -> None:
    assert day_s(header) == pytest.approx(3600.0 * hours + LEAP_S, abs=1e-5)
    assert start_of(header).notes == ()
    assert start_of(header).timed


@pytest.mark.parametrize(
    ("header", "words"),
    [
        ({"DATE-OBS": "2010-03-04"}, "its time is not: 0 h is taken"),
        ({"DATE-OBS": "2010-03-04Z"}, "its time is not: 0 h is taken"),
        ({"MJD-OBS": 55259}, "its time is not: 0 h is taken"),
        ({"DATE-OBS": "2010-03-04", "UT": 5.5}, "its time is not (UT = '5.5' cannot be read as a time of day): 0 h is taken"),
        ({"DATE-OBS": "2010-03-04", "MJD-OBS": "soon"}, "its time is not: 0 h is taken"),
    ],
)
def test_a_day_alone_is_its_midnight_and_that_is_said(header: dict[str, Any], words: str) -> None:
    assert day_s(header) == pytest.approx(LEAP_S, abs=1e-5)
    assert [note.text for note in start_of(header).notes] == [f"the day of the exposure is known, {words}"]
    assert not start_of(header).timed


TT_S = 32.184
ELAPSED_S = (DAY_JD + 0.25 - 2443144.5) * 86400.0  # Since 1977-01-01T00:00:00 TAI, when TT, TCG and TCB were alike.


@pytest.mark.parametrize(
    ("timesys", "behind_s", "error_s"),
    [
        ("UTC", LEAP_S, 1e-5), ("utc", LEAP_S, 1e-5), ("UTC(NIST)", LEAP_S, 1e-5), ("GMT", LEAP_S, 1e-5), ("TAI", 0.0, 1e-5),
        ("IAT", 0.0, 1e-5), ("GPS", 19.0, 1e-5), ("TT", -TT_S, 1e-5), ("TT(TAI)", -TT_S, 1e-5), ("TDT", -TT_S, 1e-5),
        ("ET", -TT_S, 1e-5), ("TDB", -TT_S, 2e-3), ("TCG", -TT_S - 6.969290134e-10 * ELAPSED_S, 1e-5),
        ("TCB", -TT_S - 1.550519768e-8 * ELAPSED_S, 5e-3),
    ],
)  # fmt: skip
@pytest.mark.parametrize("form", [{"DATE-OBS": "2010-03-04T06:00:00"}, {"MJD-OBS": 55259.25}])
def test_timesys_tells_the_scale(form: dict[str, Any], timesys: str, behind_s: float, error_s: float) -> None:
    """TT is TAI + 32.184 s, GPS TAI - 19 s; TCG and TCB by their rates of the IAU (2000 B1.9; 2006 B3), TDB within 2 ms of TT."""
    header = form | {"TIMESYS": timesys}
    assert day_s(header) == pytest.approx(6 * 3600.0 + behind_s, abs=error_s)
    assert start_of(header).notes == ()


def test_an_unknown_scale_is_said_to_be_taken_for_utc() -> None:
    header = {"DATE-OBS": "2010-03-04T06:00:00", "TIMESYS": "LOCAL"}
    assert day_s(header) == pytest.approx(6 * 3600.0 + LEAP_S, abs=1e-6)
    (note,) = start_of(header).notes
    assert note.text == "TIMESYS = 'LOCAL' is no scale that is known here: times are taken as UTC"


def test_the_note_comes_with_the_frame(tmp_path: Path) -> None:
    hdu = fits.PrimaryHDU(np.random.default_rng(4).normal(1000.0, 5.0, (65, 71)).astype(np.uint16))
    hdu.header.update({"DATE-OBS": "2010-03-04", "EXPTIME": 1.0, "GAIN": 1.0})
    hdu.writeto(tmp_path / "a.fits")
    (found,) = FitsFolder(path=tmp_path).frames()
    assert [note.kind for note in found.notes] == ["no clock"]


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
    assert (start_of(header).tai_ns is not None) == known


@pytest.mark.parametrize(
    ("key", "value", "wrong"),
    [
        ("DATE-OBS", "yesterday", "cannot be read as a time"),
        ("DATE-OBS", "2024-02-30T25:61:61", "cannot be read as a time"),
        ("DATE-OBS", "9999-01-01T00:00:00\x1b", "cannot be read as a time"),
        ("DATE-OBS", 20240301, "cannot be read as a time"),
        ("DATE-OBS", "1850-06-01T00:00:00", "is no time from 1958 to 2104"),
        ("DATE-OBS", "1850-06-01", "is no time from 1958 to 2104"),
        ("DATE-OBS", "9999-01-01T00:00:00", "is no time from 1958 to 2104"),
        ("MJD-OBS", "soon", "cannot be read as a time"),
        ("MJD-OBS", 2455259.5, "is no time from 1958 to 2104"),
    ],
)
def test_a_time_that_cannot_be_is_shown_and_warns_of_nothing_else(key: str, value: object, wrong: str) -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        header = {key: value, "EXPTIME": 1.0, "GAIN": 1.0}
        notes: list[Note] = []
        made = _frame_header(header, 0, np.zeros((64, 64), np.float32), None, 1.0, notes)
    assert made.t_start_tai_ns == FIRST_ASSUMED_TAI_NS
    (note,) = notes
    assert note.text == f"{key} = {str(value)!r} {wrong}: the epoch is a number, not a time"
    assert not caught
