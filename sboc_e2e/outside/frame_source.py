"""The door through which frames come, simulated or real."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

from sboc_e2e.icd.frame import Frame

if TYPE_CHECKING:
    from ground.vetting.rim import ImageCircle


@dataclass(frozen=True, kw_only=True)
class Note:
    """A note to the user about a frame. kind : notes of one kind are shown once."""

    kind: str
    text: str


@dataclass(frozen=True, kw_only=True, eq=False)
class SourcedFrame:
    """A frame and where it came from: file, header-data unit, and the astropy WCS of its header if it has one.

    focal_hints_px : focal lengths in pixels that the header tells in one way or another, the best first.
    camera : words of the header that tell cameras, detectors and filters apart; frames with equal ones share a fixed pattern.
    circle : of a lens that does not fill the frame. unit : what the file's numbers were multiplied by, see `pixel_unit`.
    timed : whether the header tells the start of exposure by a clock. same_exposure : numbers of other frames of the same light
    (`same_exposure`).
    """

    frame: Frame
    file: str
    hdu: int
    wcs: Any
    notes: tuple[Note, ...]
    focal_hints_px: tuple[float, ...] = ()
    camera: str = ""
    circle: "ImageCircle | None" = None
    unit: float = 1.0
    timed: bool = False
    same_exposure: frozenset[int] = frozenset()


class FrameSource(Protocol):
    """Frames in order, one at a time."""

    @property
    def n_frames(self) -> int:
        """How many frames there are."""
        ...

    @property
    def left_out(self) -> tuple[str, ...]:
        """What could not be taken as a frame, one line each, as far as the frames have been gone through."""
        ...

    def frames(self) -> Iterator[SourcedFrame]:
        """The frames; each is made or read when it is asked for."""
        ...


@dataclass(frozen=True, kw_only=True)
class Calibrating:
    """What sources that change the frames of another one have in common; `frames` is theirs."""

    source: FrameSource

    @property
    def n_frames(self) -> int:
        """How many frames there are."""
        return self.source.n_frames

    @property
    def left_out(self) -> tuple[str, ...]:
        """What could not be taken as a frame."""
        return self.source.left_out
