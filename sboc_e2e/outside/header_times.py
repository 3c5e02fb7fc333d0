"""The start of exposure as a FITS header tells it: a date with a clock, a date and a clock in keys of their own, a Julian date.

The scale is that of TIMESYS, UTC where it is absent (FITS standard 4.0, section 9.2.1).
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

from astropy.time import Time

from sboc_e2e.icd.tai import NS_PER_S, from_jd_parts
from sboc_e2e.outside.frame_source import Note
from sboc_e2e.outside.header_values import MAX_SHOWN, number_of, quietly

DATE_KEY: Final = "DATE-OBS"
CLOCK_KEYS: Final = ("TIME-OBS", "UTC-OBS", "UT", "UTSTART")
"""Keys of the clock of a date that stands alone; some hold a date too."""
BEGIN_KEY: Final = "DATE-BEG"
"""Start of the observation in the FITS standard 4.0 (section 9.5), always a date and a time of day."""
MJD_KEYS: Final = ("MJD-OBS", "MJD-STR", "MJD-BEG")
FIRST_ASSUMED_TAI_NS: Final = 1_325_376_000 * NS_PER_S
"""2000-01-01T00:00:00 TAI: frames without a time are numbered from here, one second apart."""

SCALES: Final = {
    "": "utc", "UTC": "utc", "UT": "utc", "GMT": "utc", "TAI": "tai", "IAT": "tai", "GPS": "tai", "TT": "tt", "TDT": "tt",
    "ET": "tt", "TDB": "tdb", "TCG": "tcg", "TCB": "tcb",
}  # fmt: skip
"""Values of TIMESYS by astropy's names of scales. UT1 is none of them: its difference from UTC needs tables of the Earth."""
GPS_BEHIND_TAI_NS: Final = 19 * NS_PER_S
"""GPS time has no leap seconds since 1980, when TAI was so much ahead of UTC."""

CLOCK: Final = re.compile(r"\d{1,2}:\d")
"""What tells a text with a time of day from a day."""
DATED: Final = re.compile(r"\d{4}-\d\d?-\d\d?[T ]")
"""Beginning of a text that holds a date and a time."""
OFFSET: Final = re.compile(r"(:\d\d(?:\.\d*)?)\s*(?:Z|UTC?|([+-])(\d\d):?(\d\d)?)$")
"""A clock's end with the offset of ISO 8601 from the scale: `Z`, `+00:00`, `-0500`, `+02`; or with UTC."""

IN_RANGE: Final = "is no time from 1958 to 2104"
"""What the contract holds: integer nanoseconds of TAI in 62 bits."""


@dataclass(frozen=True, kw_only=True)
class Start:
    """Start of exposure, None where the header does not tell it, and what there is to say of it."""

    tai_ns: int | None
    notes: tuple[Note, ...] = ()
    clock: bool = True
    """Whether the header tells the time of day too."""

    @property
    def timed(self) -> bool:
        """Whether frames can be put in order by it."""
        return self.tai_ns is not None and self.clock


def start_of(header: Mapping[str, Any]) -> Start:
    """Start of exposure by DATE-OBS and its clock, by DATE-BEG, by MJD-OBS where no clock can be read, or at 0 h of a day."""
    timesys = re.sub(r"\(.*\)$", "", _text_of(header.get("TIMESYS")).upper())  # realisations, as TT(TAI)
    notes = []
    if timesys not in SCALES:
        text = f"TIMESYS = {timesys[:MAX_SHOWN]!r} is no scale that is known here: times are taken as UTC"
        notes.append(Note(kind="TIMESYS", text=text))
    for text in _with_clock(header):
        tai_ns = _of_text(text, timesys)
        if _is_held(tai_ns):
            return Start(tai_ns=tai_ns, notes=tuple(notes))
    mjd = number_of(header, MJD_KEYS, 36_934.0, 100_000.0)
    if mjd is not None and _is_held(tai_ns := _tai_ns(mjd, "mjd", timesys)):
        notes += [_only_a_day(header)] if mjd.is_integer() else []
        return Start(tai_ns=tai_ns, notes=tuple(notes), clock=not mjd.is_integer())
    day = _text_of(header.get(DATE_KEY))
    if not CLOCK.search(day) and _is_held(tai_ns := _of_text(day.rstrip("Z"), timesys)):
        return Start(tai_ns=tai_ns, notes=(*notes, _only_a_day(header)), clock=False)
    return Start(tai_ns=None, notes=(_unknown(header, timesys),))


def _text_of(value: object) -> str:
    return value.strip() if isinstance(value, str) else ""


def _with_clock(header: Mapping[str, Any]) -> Iterator[str]:
    """Texts of a date and a time of day, the best first."""
    date = _text_of(header.get(DATE_KEY))
    if CLOCK.search(date):
        yield date
        return
    for key in CLOCK_KEYS:
        clock = _text_of(header.get(key))
        if DATED.match(clock):
            yield clock
        elif date and CLOCK.match(clock):
            yield f"{date.rstrip('Z')}T{clock}"
    begin = _text_of(header.get(BEGIN_KEY))
    if CLOCK.search(begin):
        yield begin


def _of_text(text: str, timesys: str) -> int | None:
    """An epoch on the scale of the contract, from a text; None where it cannot be read."""
    ahead_ns = 0
    offset = OFFSET.search(text)
    if offset is not None:
        text = text[: offset.end(1)]
        if offset[2]:
            minutes = 60 * int(offset[3]) + int(offset[4] or 0)
            ahead_ns = (1 if offset[2] == "+" else -1) * 60 * minutes * NS_PER_S
    tai_ns = _tai_ns(text, "isot" if "T" in text else "iso", timesys)
    return None if tai_ns is None else tai_ns - ahead_ns


def _tai_ns(value: str | float, form: str, timesys: str) -> int | None:
    """An epoch on the scale of the contract, in range or not; None where astropy cannot read it."""
    try:
        with quietly():
            tai = Time(value, format=form, scale=SCALES.get(timesys, "utc")).tai
            tai_ns = from_jd_parts(float(tai.jd1), float(tai.jd2))
    except (ValueError, TypeError, OverflowError):
        return None
    return tai_ns + (GPS_BEHIND_TAI_NS if timesys == "GPS" else 0)


def _is_held(tai_ns: int | None) -> bool:
    """Whether the contract holds an epoch."""
    return tai_ns is not None and 0 <= tai_ns < 2**62


def _only_a_day(header: Mapping[str, Any]) -> Note:
    """Note on a start without a time of day; it names a clock that is there and was of no use."""
    key = next((key for key in CLOCK_KEYS if header.get(key) is not None), None)
    useless = "" if key is None else f" ({key} = {str(header[key])[:MAX_SHOWN]!r} cannot be read as a time of day)"
    return Note(kind="no clock", text=f"the day of the exposure is known, its time is not{useless}: 0 h is taken")


def _unknown(header: Mapping[str, Any], timesys: str) -> Note:
    """Note on a start that is not known: without a key, with one that cannot be read, or with one out of range."""
    without = "the epoch is a number, not a time"
    key = next((key for key in (DATE_KEY, *MJD_KEYS) if header.get(key) is not None), None)
    if key is None:
        return Note(kind=f"no {DATE_KEY}", text=f"no {DATE_KEY}: {without}")
    if key == DATE_KEY:
        is_time = _of_text(_text_of(header[key]), timesys) is not None
    else:
        is_time = number_of(header, (key,), float("-inf"), float("inf")) is not None
    wrong = IN_RANGE if is_time else "cannot be read as a time"
    return Note(kind=key, text=f"{key} = {str(header[key])[:MAX_SHOWN]!r} {wrong}: {without}")
