"""Lines of a CCSDS message in keyword-value notation (502.0-B-2 section 7, 503.0-B-2 section 4)."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from sboc_e2e.icd.errors import UserError

_UNIT: Final = re.compile(r"\s*\[[^\]]*\]\s*$")


class UnreadableProduct(UserError):
    """A published file that breaks its standard: file, line, and what was expected."""


@dataclass(frozen=True, kw_only=True)
class Line:
    """One line that is no comment. keyword : empty for a row of bare numbers and for META_START and its like."""

    number: int
    keyword: str
    value: str


@dataclass(frozen=True, kw_only=True)
class Kvn:
    """A message without its comments and blank lines."""

    name: str
    lines: tuple[Line, ...]

    def wrong(self, line: Line | None, expected: str) -> UnreadableProduct:
        """The error that names file and line."""
        return UnreadableProduct(f"{self.name}{'' if line is None else f' line {line.number}'}: expected {expected}")

    def numbers(self, line: Line, words: Sequence[str], count: int) -> list[float]:
        """Exactly `count` numbers."""
        try:
            values = [float(word) for word in words]
        except ValueError as error:
            raise self.wrong(line, f"{count} numbers") from error
        if len(values) != count:
            raise self.wrong(line, f"{count} numbers")
        return values


def read_kvn(path: Path, version_keyword: str) -> Kvn:
    """The message in a file, whose first keyword must be `version_keyword`. Raises UnreadableProduct."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise UnreadableProduct(f"{path.name}: cannot be read as text") from error
    message = Kvn(name=path.name, lines=tuple(_lines(text)))
    if not message.lines or message.lines[0].keyword != version_keyword:
        raise message.wrong(message.lines[0] if message.lines else None, version_keyword)
    return message


def _lines(text: str) -> Iterator[Line]:
    for number, raw in enumerate(text.splitlines(), start=1):
        line = raw.strip()
        if not line or line == "COMMENT" or line.startswith("COMMENT "):
            continue
        keyword, equals, value = line.partition("=")
        if equals:
            yield Line(number=number, keyword=keyword.strip(), value=_UNIT.sub("", value.strip()))
        else:
            yield Line(number=number, keyword="", value=line)
