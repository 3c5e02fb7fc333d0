"""The start of exposure as a FITS header tells it."""

from collections.abc import Mapping
from typing import Any, Final

from astropy.time import Time

from sboc_e2e.icd.tai import NS_PER_S, from_jd_parts
from sboc_e2e.outside.header_values import number_of, quietly

MJD_KEYS: Final = ("MJD-OBS", "MJD-STR")
FIRST_ASSUMED_TAI_NS: Final = 1_325_376_000 * NS_PER_S
"""2000-01-01T00:00:00 TAI: frames without a time are numbered from here, one second apart."""


def start_tai_ns(header: Mapping[str, Any]) -> int | None:
    """Start of exposure from DATE-OBS (with TIME-OBS or UT where the date stands alone) or MJD-OBS, UTC; None without one."""
    date = header.get("DATE-OBS")
    texts = []
    if isinstance(date, str) and date.strip():
        day = date.strip().rstrip("Z")
        clock = next((str(header[key]).strip() for key in ("TIME-OBS", "UTC-OBS", "UT", "UTSTART") if header.get(key)), "")
        texts = [day] if "T" in day or not clock else [f"{day}T{clock}", day]
    for text in texts:
        try:
            with quietly():
                return _tai_ns(Time(text, format="isot" if "T" in text else "iso", scale="utc"))
        except (ValueError, TypeError, OverflowError):
            continue
    mjd = number_of(header, MJD_KEYS, 36_934.0, 100_000.0)
    with quietly():
        return None if mjd is None else _tai_ns(Time(mjd, format="mjd", scale="utc"))


def _tai_ns(utc: Time) -> int | None:
    """An epoch on the scale of the contract, if headers may hold it."""
    tai = utc.tai
    tai_ns = from_jd_parts(float(tai.jd1), float(tai.jd2))
    return tai_ns if 0 <= tai_ns < 2**62 else None
