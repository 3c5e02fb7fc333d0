"""The on-board half of `sboc process`: frames -> packets, the camera that they are of, and what was learned of them."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ground.vetting.look_alikes import OwnEvidence
from ground.vetting.rim import ImageCircle
from onboard.options import OnboardOptions
from onboard.state import OnboardSteps
from sboc_e2e.icd.frame import Frame, NominalCamera
from sboc_e2e.outside.camera import KnownCamera
from sboc_e2e.outside.cameras_apart import CamerasApart
from sboc_e2e.outside.first_frame import FirstFrame
from sboc_e2e.outside.frame_source import FrameSource, Note, SourcedFrame
from sboc_e2e.outside.guessed_camera import camera_of_frame
from sboc_e2e.outside.look_alikes import CountingChain
from sboc_e2e.outside.star_width import star_sigma_px
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
    same_exposure: dict[int, frozenset[int]] = field(default_factory=dict)
    """Other frames of the same exposure, by frame."""
    circles: dict[int, ImageCircle] = field(default_factory=dict)
    """Image circles of lenses that do not fill their frame, by frame."""
    cameras: list[NominalCamera] = field(default_factory=list)
    """The first frame's, and those of other cameras in the order of their first frames."""
    camera_of: dict[int, int] = field(default_factory=dict)
    """Places in `cameras`, by frame."""


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
    focal_px: Callable[[SourcedFrame], float] | None = None,
) -> Flight:
    """All frames through the chain, those of each camera apart where none was ordered.

    keep : takes the packets that left at a position, in place of the run's files. focal_px : of the camera of a frame, where
    headers do not tell it alone.
    """
    seen = Seen(cameras=[camera])
    evidence: dict[int, OwnEvidence] = {}

    def chain_of(number: int) -> CountingChain:
        chain = CountingChain(
            orders.options, orders.steps, camera=seen.cameras[number], run_id=orders.run_id, same_exposure=seen.same_exposure
        )
        chain.evidence = evidence  # of all cameras
        return chain

    def guessed(sourced: SourcedFrame) -> NominalCamera:
        found = camera_of_frame(sourced, star_sigma_px(np.asarray(sourced.frame.pixels, dtype=np.float32)))
        return found if focal_px is None else replace(found, focal_px=focal_px(sourced))

    frames = first.frames() if orders.known else _of_cameras(first.frames(), seen, guessed)
    sequence = CamerasApart(chain_of=chain_of, camera_of=seen.camera_of)
    stage = OnboardStage(run=orders.run, chain=chain_of(0), resumed=False, keep=keep, sequence=sequence)
    n_frames = stage.take(_noted(frames, seen), progress)
    left_out = first.source.left_out
    return Flight(n_frames=n_frames, seen=seen, evidence=evidence, left_out=left_out, figures=stage.figures())


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

    def fly(self, camera: NominalCamera, progress: Progress, focal_px: Callable[[SourcedFrame], float] | None = None) -> Flight:
        """All frames through the chain; packets into the run's files. focal_px : see `fly`."""
        return fly(self.first, self._orders, camera, progress, focal_px=focal_px)


def _of_cameras(
    frames: Iterator[SourcedFrame], seen: Seen, guessed: Callable[[SourcedFrame], NominalCamera]
) -> Iterator[SourcedFrame]:
    """Frames, while each camera's place is noted, and those of other cameras than the first frame's say so."""
    places: dict[tuple[str, int, int], int] = {}
    for sourced in frames:
        header = sourced.frame.header
        key = (sourced.camera, header.rows, header.cols)
        if places and key not in places:
            seen.cameras.append(guessed(sourced))
        place = places.setdefault(key, len(places))
        seen.camera_of[header.frame] = place
        if place:
            text = "another camera than the first frame's, by header, HDU or size: judged apart, by its own gain, noise and PSF"
            sourced = replace(sourced, notes=(*sourced.notes, Note(kind="camera", text=text)))
        yield sourced


def _noted(frames: Iterator[SourcedFrame], seen: Seen) -> Iterator[Frame]:
    """Frames, while what is known of each is noted."""
    for sourced in frames:
        number = sourced.frame.header.frame
        seen.camera_of.setdefault(number, 0)
        seen.origin[number] = (sourced.file, sourced.hdu)
        if sourced.wcs is not None:
            seen.wcs[number] = sourced.wcs
        if sourced.circle is not None:
            seen.circles[number] = sourced.circle
        if sourced.same_exposure:
            seen.same_exposure[number] = sourced.same_exposure
        seen.of_frame[number] = tuple(note.text for note in sourced.notes)
        for note in sourced.notes:
            seen.notes.setdefault(note.kind, []).append(note.text)
        yield sourced.frame
