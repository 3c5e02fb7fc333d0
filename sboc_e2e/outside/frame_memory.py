"""What is remembered of frames by number, so that a frame can be held against those of other exposures alone."""

from collections.abc import Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass
from typing import Any

from onboard.chain import RECENT_FRAMES
from sboc_e2e.icd.signals import Detection


@dataclass(frozen=True, kw_only=True, eq=False)
class FrameMemory:
    """The newest frames, and the newest of another exposure where a frame of the newest one is still to come.

    frames : that a detector looks back. _kept : what is remembered by number. _found : detections by number.
    """

    frames: int
    _kept: tuple[tuple[int, Any], ...] = ()
    _found: tuple[tuple[int, tuple[Detection, ...]], ...] = ()

    def remembered(self, same: AbstractSet[int]) -> tuple[Any, ...]:
        """What is remembered of the newest frames without these."""
        return _newest([kept for number, kept in self._kept if number not in same], self.frames)

    def found(self, same: AbstractSet[int]) -> tuple[tuple[Detection, ...], ...]:
        """Detections in recent frames without these."""
        return tuple(found for number, found in self._found if number not in same)

    def after(
        self, number: int, remembered: tuple[Any, ...], found: tuple[Detection, ...], same: AbstractSet[int]
    ) -> "FrameMemory":
        """With a frame more. same : the numbers of the frames of its exposure."""
        kept = (*self._kept, *((number, each) for each in remembered))
        wanted = set(_newest([n for n, _ in kept], self.frames))
        if any(other > number for other in same):
            wanted.update(_newest([n for n, _ in self._kept if n not in same], self.frames))
        return FrameMemory(
            frames=self.frames,
            _kept=tuple(each for each in kept if each[0] in wanted),
            _found=(*self._found, (number, found))[-RECENT_FRAMES:],
        )


def _newest(values: Sequence[Any], n: int) -> tuple[Any, ...]:
    """The last n of some."""
    return tuple(values[max(len(values) - n, 0) :])
