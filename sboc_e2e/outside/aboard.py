"""The on-board half of `sboc process`: frames -> packets, the camera that they are of, and what was learned of them."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from ground.vetting.look_alikes import OwnEvidence
from ground.vetting.rim import ImageCircle
from onboard.options import OnboardOptions
from onboard.state import OnboardSteps
from sboc_e2e.icd.frame import Frame, NominalCamera
from sboc_e2e.outside.camera import KnownCamera
from sboc_e2e.outside.first_frame import FirstFrame
from sboc_e2e.outside.frame_source import FrameSource, SourcedFrame
from sboc_e2e.outside.guessed_camera import camera_of_frame
from sboc_e2e.outside.look_alikes import CountingChain
from sboc_e2e.run.directory import RunDirectory
from sboc_e2e.run.onboard_stage import OnboardStage
from sboc_e2e.run.progress import Progress

if TYPE_CHECKING:
    from sboc_e2e.catalogue import StarCatalogue
    from sboc_e2e.scenario import Scenario


@dataclass(frozen=True, kw_only=True)
class Orders:
    """What is done on board and with what. known : the camera; None: to be guessed. run : where packets are kept."""

    options: OnboardOptions
    steps: OnboardSteps
    run_id: int
    known: KnownCamera | None
    run: RunDirectory


@dataclass(kw_only=True)
class Seen:
    """What was learned of the frames as they went by."""

    origin: dict[int, tuple[str, int]] = field(default_factory=dict)
    wcs: dict[int, object] = field(default_factory=dict)
    notes: dict[str, list[str]] = field(default_factory=dict)
    """Texts of the notes by kind."""
    of_frame: dict[int, tuple[str, ...]] = field(default_factory=dict)
    """Texts of the notes by frame."""
    circles: dict[int, ImageCircle] = field(default_factory=dict)
    """Image circles of lenses that do not fill their frame, by frame."""


@dataclass(frozen=True, kw_only=True)
class Flight:
    """What the half leaves beside packets. figures : its cost, for the manifest. left_out : what was no frame."""

    n_frames: int
    seen: Seen
    evidence: Mapping[int, OwnEvidence]
    left_out: tuple[str, ...]
    figures: Mapping[str, float]


def nominal_camera(orders: Orders, first: SourcedFrame, star_sigma_px: Callable[[], float | None]) -> NominalCamera:
    """The camera that was ordered, for frames of this size and unit, else the one that the first frame shows."""
    if orders.known is None:
        return camera_of_frame(first, star_sigma_px())
    return orders.known.for_frame(first.frame, first.unit)


def fly(
    first: FirstFrame,
    orders: Orders,
    camera: NominalCamera,
    progress: Progress,
    *,
    keep: Callable[[int, bytes], None] | None = None,
) -> Flight:
    """All frames through the chain. keep : takes the packets that left at a position, in place of the run's files."""
    seen = Seen()
    chain = CountingChain(orders.options, orders.steps, camera=camera, run_id=orders.run_id)
    stage = OnboardStage(run=orders.run, chain=chain, resumed=False, keep=keep)
    n_frames = stage.take(_noted(first.frames(), seen), progress)
    left_out = first.source.left_out
    return Flight(n_frames=n_frames, seen=seen, evidence=chain.evidence, left_out=left_out, figures=stage.figures())


@dataclass(kw_only=True)
class InTurn:
    """The half done here, before ground. Work on large frames is begun beside it."""

    first: FirstFrame

    @property
    def source(self) -> FrameSource:
        """The frames."""
        return self.first.source

    @property
    def threaded(self) -> bool:
        """Whether what ground needs is made ready in a thread."""
        return self.first.is_beside

    def begin(self, orders: Orders) -> None:
        """Take orders."""
        self._orders = orders
        # a process is forked before there are threads
        self._star_sigma_px: Callable[[], float | None] | None = None if orders.known else self.first.star_sigma_px()

    def rehearse(self, begin: Callable[..., Any], scenario: "Scenario", catalogue: "StarCatalogue") -> None:
        """Send a small frame ahead. begin : begins a call in a thread."""
        if self.first.is_beside:
            from sboc_e2e.outside.ground_rehearsal import rehearse

            begin(rehearse, scenario, catalogue)

    def camera(self) -> NominalCamera:
        """The nominal camera."""
        camera = nominal_camera(self._orders, self.first.frame, self._star_sigma_px or (lambda: None))
        self._star_sigma_px = None  # it holds a copy of the frame
        return camera

    def fly(self, camera: NominalCamera, progress: Progress) -> Flight:
        """All frames through the chain; packets into the run's files."""
        return fly(self.first, self._orders, camera, progress)


def _noted(frames: Iterator[SourcedFrame], seen: Seen) -> Iterator[Frame]:
    """Frames, while what is known of each is noted."""
    for sourced in frames:
        number = sourced.frame.header.frame
        seen.origin[number] = (sourced.file, sourced.hdu)
        if sourced.wcs is not None:
            seen.wcs[number] = sourced.wcs
        if sourced.circle is not None:
            seen.circles[number] = sourced.circle
        seen.of_frame[number] = tuple(note.text for note in sourced.notes)
        for note in sourced.notes:
            seen.notes.setdefault(note.kind, []).append(note.text)
        yield sourced.frame
