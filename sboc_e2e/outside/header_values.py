"""Values of FITS headers, as people write them: numbers that may be none, cards that cannot be read, notes on what is missing."""

import math
import warnings
from collections.abc import Mapping
from typing import Any, Final

from astropy.io import fits

from sboc_e2e.outside.frame_source import Note

MAX_SHOWN: Final = 40
"""Characters of a header's value that a note repeats: a FITS card holds 68, and a note is one line."""


def number_of(header: Mapping[str, Any], names: tuple[str, ...], low: float, high: float) -> float | None:
    """The first finite number among header keys that lies in [low, high]; None without one."""
    for name in names:
        value = header.get(name)
        try:
            number = float(value) if value is not None and not isinstance(value, bool) else math.nan
        except (TypeError, ValueError, OverflowError):
            continue
        if math.isfinite(number) and low <= number <= high:
            return number
    return None


def missing(header: Mapping[str, Any], names: tuple[str, ...], wanted: str, without: str) -> Note:
    """Note on a value that a header has not, or not as one that can be used; both need another remedy."""
    given = next((name for name in names if header.get(name) is not None), None)
    if given is None:
        return Note(kind=f"no {names[0]}", text=f"no {names[0]}: {without}")
    return Note(kind=given, text=f"{given} = {str(header[given])[:MAX_SHOWN]!r} {wanted}: {without}")


def take_out_illegible(header: fits.Header) -> list[str]:
    """Delete cards whose value astropy cannot parse, and return their keywords: one odd key that nobody needs costs no frame."""
    illegible: list[str] = []
    for index in reversed(range(len(header.cards))):
        card = header.cards[index]
        try:
            _ = card.value
        except fits.VerifyError:
            illegible.insert(0, card.keyword)
            del header[index]
    return illegible


def merged(hdus: fits.HDUList, hdu: Any) -> dict[str, Any]:
    """Keys of the primary header under those of the HDU's own."""
    values: dict[str, Any] = {}
    for source in (hdus[0].header, hdu.header):
        for card in source.cards:
            if card.keyword and card.keyword not in ("COMMENT", "HISTORY"):
                values[card.keyword] = card.value
    return values


class quietly(warnings.catch_warnings):
    """Headers of other people break the standard in ways that do not matter here."""

    def __init__(self) -> None:
        super().__init__(record=False, action="ignore")
