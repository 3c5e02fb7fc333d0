"""Epochs of messages as integer TAI, with the leap seconds of ERFA."""

import re
from collections.abc import Callable, Sequence
from datetime import date
from functools import lru_cache
from typing import Final

import erfa
import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd.errors import UserError

_TEXT: Final = re.compile(r"(\d{4})-(?:(\d\d)-(\d\d)|(\d{3}))T(\d\d):(\d\d):(\d\d)(?:\.(\d*))?Z?")
_ZERO: Final = date(1958, 1, 1).toordinal()
_GPS_BEHIND_TAI_S: Final = 19  # TAI - UTC on 6 January 1980, where GPS time began (IS-GPS-200): `erfa.dat` has 19.


@lru_cache(maxsize=64)
def _tai_minus_utc_s(ordinal: int) -> float:
    day = date.fromordinal(ordinal)
    return float(erfa.dat(day.year, day.month, day.day, 0.0))


_BEHIND_TAI_S: Final[dict[str, Callable[[int], float]]] = {
    "UTC": _tai_minus_utc_s,
    "TAI": lambda _: 0.0,
    "GPS": lambda _: _GPS_BEHIND_TAI_S,
}
"""How far each scale is behind TAI on a day."""


def tai_ns(epochs: Sequence[str], time_system: str) -> NDArray[np.int64]:
    """Nanoseconds since 1958-01-01 TAI (n,) of calendar or day-of-year texts. Raises UserError."""
    if time_system not in _BEHIND_TAI_S:
        raise UserError(f"TIME_SYSTEM is {time_system}; read are {', '.join(_BEHIND_TAI_S)}")
    out = np.zeros(len(epochs), np.int64)
    for k, text in enumerate(epochs):
        found = _TEXT.fullmatch(text.strip())
        if not found:
            raise UserError(f"{text[:40]!r} is no epoch")
        year, month, day, of_year, hour, minute, second, fraction = found.groups()
        try:
            first = date(int(year), int(month or 1), int(day or 1)).toordinal()
        except ValueError as error:
            raise UserError(f"{text[:40]!r} is no epoch") from error
        start = first + int(of_year or 1) - 1
        whole_s = (start - _ZERO) * 86_400 + int(hour) * 3_600 + int(minute) * 60 + int(second)
        part_ns = int(((fraction or "") + "0" * 9)[:9])
        out[k] = whole_s * 1_000_000_000 + part_ns + round(_BEHIND_TAI_S[time_system](start) * 1e9)
    return out
