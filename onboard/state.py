"""Records of the chain: its steps, its state between frames, the result of one frame."""

from dataclasses import dataclass, field
from typing import Any

from onboard.downlink.budget import Allowance
from onboard.downlink.packets import PacketWriter
from onboard.downlink.send import TrackPixels
from onboard.image.calibrate import Counts
from onboard.image.hot_pixels import HotPixels
from onboard.stars.memory import EarlierStars
from onboard.track.none import NoTracker
from sboc_e2e.icd.downlink import Housekeeping
from sboc_e2e.icd.flags import FrameFlag
from sboc_e2e.icd.frame import Frame, FrameHeader
from sboc_e2e.icd.signals import Detection, DetectorView, RoiGroup, StarList, Track
from sboc_e2e.icd.steps import BackgroundEstimator, Detector, Encoder, StarExtractor, Tracker
from sboc_e2e.icd.work import WorkMeter


@dataclass(frozen=True, kw_only=True)
class OnboardSteps:
    """The swappable steps."""

    background: BackgroundEstimator
    star_extractor: StarExtractor
    detector: Detector
    codec: Encoder
    tracker: Tracker = field(default_factory=NoTracker)


@dataclass(frozen=True, kw_only=True, eq=False)
class Tracking:
    """State for the tracker. step : its own state; last : the newest frame it saw."""

    step: Any
    pixels: TrackPixels = field(default_factory=TrackPixels)
    last: FrameHeader | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Prepared:
    """A frame up to its stars.

    usable : its pixels show something new. earlier : stars of the frames before, in its coordinates.
    pixel_check : checksum of some rows.
    """

    view: DetectorView
    counts: Counts
    flags: FrameFlag
    usable: bool
    earlier: tuple[EarlierStars, ...]
    n_masked: int
    pixel_check: int


@dataclass(frozen=True, kw_only=True, eq=False)
class OnboardState:
    """State of the chain between frames; picklable.

    earlier_stars : star lists of the last frames, newest last.
    history : views of the last frames, or what the detector keeps of them, as many as it declares, newest last.
    recent : detections of the last frames, for the STATIC flag. pixel_check : checksum of some rows of the last frame.
    tracking : None without a tracker. held : a frame that waits for the next one, as it came, two bytes a pixel.
    """

    writer: PacketWriter
    allowance: Allowance
    hot_pixels: HotPixels
    previous: FrameHeader | None = None
    history: tuple[Any, ...] = ()
    recent: tuple[tuple[Detection, ...], ...] = ()
    earlier_stars: tuple[EarlierStars, ...] = ()
    pixel_check: int | None = None
    frames_done: int = 0
    tracking: Tracking | None = None
    held: Frame | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class OnboardResult:
    """Result of one frame.

    rois : groups as sent. bytes_by_apid : bytes of packets of each APID, headers included. work : operations by kind.
    """

    packets: bytes
    housekeeping: Housekeeping
    stars: StarList
    detections: tuple[Detection, ...]
    rois: tuple[RoiGroup, ...]
    bytes_by_apid: dict[int, int]
    tracks: tuple[Track, ...] = ()
    work: WorkMeter = field(default_factory=WorkMeter)


@dataclass(frozen=True, kw_only=True, eq=False)
class RunEnd:
    """What is sent after the last frame's packets: tracks that waited for later frames. None without such a tracker."""

    packets: bytes = b""
    tracks: tuple[Track, ...] = ()
