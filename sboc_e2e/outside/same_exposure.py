"""Frames that hold the same light: a raw frame and a calibrated copy, colours of one exposure, a sum and its parts, a file twice.

A trail stands at the same place in both. Held against each other, as frames of different times are, they show it as something
that stays, as a star does. Two frames of one size are of the same exposure if one starts within that of the other, where
both headers tell the time, or if they are equal pixel for pixel.
"""

import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from sboc_e2e.outside.frame_source import Note, SourcedFrame

MOST_AT_ONCE: Final = 5
"""Files that are exposed at once. With more of them times are not believed: a header that was copied to all, starts of a film in
whole seconds, EXPTIME in milliseconds. Chosen: four colours and a calibrated copy."""


@dataclass(frozen=True, kw_only=True)
class Mark:
    """What tells a frame's exposure. span_ns : its start and end in TAI, None where the header has no time. pixels : checksum."""

    number: int
    file: str
    span_ns: tuple[int, int] | None
    shape: tuple[int, int]
    pixels: int

    @classmethod
    def of(cls, sourced: SourcedFrame) -> "Mark":
        """Of a frame as it was read."""
        header, pixels = sourced.frame.header, np.ascontiguousarray(sourced.frame.pixels)
        start = header.t_start_tai_ns
        return cls(
            number=header.frame,
            file=sourced.file,
            span_ns=(start, start + header.exposure_ns) if sourced.timed else None,
            shape=(header.rows, header.cols),
            pixels=zlib.crc32(pixels.data),
        )

    def lasts_to(self, tai_ns: int) -> bool:
        """Whether the exposure began at that epoch or goes on then, of a frame that began no later."""
        return self.span_ns is not None and (self.span_ns[0] == tai_ns or self.span_ns[1] > tai_ns)


def same_exposures(marks: Sequence[Mark]) -> dict[int, frozenset[int]]:
    """Numbers of all frames of the same exposure, by the number of each frame that has others; of one size each."""
    found: dict[int, set[int]] = {}
    for one, other in _at_once(marks):
        found.setdefault(one.number, set()).add(other.number)
        found.setdefault(other.number, set()).add(one.number)
    equal: dict[tuple[tuple[int, int], int], set[int]] = {}
    for mark in marks:
        equal.setdefault((mark.shape, mark.pixels), set()).add(mark.number)
    for mark in marks:
        copies = equal[mark.shape, mark.pixels]
        if len(copies) > 1:
            found.setdefault(mark.number, set()).update(copies)
    return {number: frozenset(numbers - {number}) for number, numbers in found.items()}


def _at_once(marks: Sequence[Mark]) -> list[tuple[Mark, Mark]]:
    """Pairs of frames of one size that overlap in time, where times are believed."""
    pairs, crowded, running = list[tuple[Mark, Mark]](), set[int](), list[Mark]()
    for start_ns, mark in sorted(((mark.span_ns[0], mark) for mark in marks if mark.span_ns), key=lambda each: each[0]):
        running = [each for each in running if each.lasts_to(start_ns)]
        pairs += [(each, mark) for each in running if each.shape == mark.shape]
        running.append(mark)
        if len({each.file for each in running}) > MOST_AT_ONCE:
            crowded.update(each.number for each in running)
            running.remove(min(running, key=lambda each: (each.span_ns or (0, 0))[1]))  # what overlaps it overlaps enough others
    return [pair for pair in pairs if crowded.isdisjoint(each.number for each in pair)]


def note_of(numbers: Iterable[int], files: Mapping[int, str]) -> Note:
    """The note on a frame that has others of its exposure. files : of the frames by number."""
    named = sorted({files[number] for number in numbers})
    more = f" and {len(named) - 1} more" if len(named) > 1 else ""
    text = f"same exposure as {named[0]}{more}, by time or by pixels: they are not compared with each other"
    return Note(kind="same exposure", text=text)
