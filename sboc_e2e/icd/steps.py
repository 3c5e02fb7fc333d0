"""One Protocol for each swappable step. A step is a frozen dataclass whose fields are its options.

A step matches its Protocol by shape and inherits nothing. Arrays it receives are read-only. A step that needs memory
beyond one frame declares it: `history_frames` for detectors; `initial_state` plus a method that returns
``(state, result)`` for sequential steps, the state picklable and owned by the chain.
"""

from collections.abc import Sequence
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd.downlink import DownlinkFrame
from sboc_e2e.icd.frame import Calibration, FrameHeader
from sboc_e2e.icd.products import (
    FrameSolution,
    OrbitEstimate,
    PhotometricSolution,
    StreakFit,
    StreakMeasurement,
    StreakPixels,
    Tracklet,
)
from sboc_e2e.icd.signals import BackgroundModel, Detection, DetectorView, Searched, StarList, Track, TrackerView


@runtime_checkable
class BackgroundEstimator(Protocol):
    """`onboard.background`: sky level and noise mesh of a frame."""

    def estimate(
        self, pixels_adu: NDArray[np.int32] | NDArray[np.uint16], dark_adu: NDArray[np.int16], mask: NDArray[np.uint8]
    ) -> BackgroundModel:
        """Mesh of ``pixels - dark`` over pixels whose mask is 0. All arrays (rows, cols)."""
        ...


@runtime_checkable
class StarExtractor(Protocol):
    """`onboard.star_extractor`: centroids and fluxes of stars."""

    def extract(self, view: DetectorView) -> StarList:
        """All stars found, by falling flux; the chain chooses which are sent."""
        ...


@runtime_checkable
class Detector(Protocol):
    """`onboard.detector`: moving objects as segments. The chain alone cuts, budgets and packs ROIs."""

    @property
    def history_frames(self) -> int:
        """Number of views of neighbouring frames that `DetectorView.history` holds (0 for none).

        They are the frames before; for a frame whose stars the frame before does not show, the next one is the newest of them.
        """
        ...

    def detect(self, view: DetectorView) -> tuple[Detection, ...]:
        """Detections by falling S/N; ends inside or on the frame's edge."""
        ...


@runtime_checkable
class SelectiveMemory(Protocol):
    """Optional part of a detector that looks at earlier frames: it keeps a part of each view instead of the whole view."""

    def remembered(self, view: DetectorView) -> Any:
        """The part of this view that `DetectorView.history` holds later: picklable, with no reference to the view's arrays."""
        ...


@runtime_checkable
class SeedingDetector(Protocol):
    """Optional part of a detector that trackers can use: its search also returns segments fainter than its threshold."""

    def search(self, view: DetectorView, seed_sigma: float) -> tuple[tuple[Detection, ...], Searched]:
        """The detections that `detect` returns for the view, and segments of S/N `seed_sigma` or more."""
        ...


@runtime_checkable
class Tracker(Protocol):
    """`onboard.tracker`: objects over several frames, also objects that are too faint for a single frame.

    The chain keeps the pixels of the last `window_frames` frames and sends strips of a track's members from them.
    """

    @property
    def window_frames(self) -> int:
        """How many frames, the newest included, a track may span; 0: nothing is tracked and nothing kept."""
        ...

    @property
    def seed_sigma(self) -> float:
        """Least S/N of the segments that the detector returns to the tracker."""
        ...

    def initial_state(self) -> Any:
        """State before the first frame; picklable."""
        ...

    def track(self, state: Any, view: TrackerView) -> tuple[Any, tuple[Track, ...]]:
        """New state, and the tracks found or found again with this frame; members lie in the last `window_frames` frames.

        Frames come in order. Without a transform nothing of earlier frames may be used.
        """
        ...


@runtime_checkable
class FinishingTracker(Protocol):
    """Optional part of a tracker that waits for later frames before it says what a frame shows."""

    def finish(self, state: Any) -> tuple[Track, ...]:
        """What is found when no frame follows; asked for once, after the last frame of a run.

        Members lie in the last `Tracker.window_frames` - 1 frames.
        """
        ...


@runtime_checkable
class Encoder(Protocol):
    """`onboard.codec`: pixels to bytes. `number` names the block layout in the packet."""

    @property
    def number(self) -> int:
        """Codec number of `layout.CodecNumber`, plug-ins 128-255."""
        ...

    @property
    def lossless(self) -> bool:
        """Whether decoding gives the same integers."""
        ...

    def encode(self, values_adu: NDArray[np.int32], *, level_adu: int, sigma_adu: float) -> bytes:
        """Encode a (n, width) block around a level with the given noise."""
        ...


@runtime_checkable
class GainAwareEncoder(Protocol):
    """Optional part of an encoder whose blocks depend on the gain: float frames are sent in counts of their own."""

    def for_counts(self, adu_scale: float) -> Encoder:
        """The encoder of a frame in which one count is `adu_scale` ADU."""
        ...


@runtime_checkable
class Decoder(Protocol):
    """`ground.decoder`: the other half of a codec."""

    @property
    def number(self) -> int:
        """Codec number it decodes."""
        ...

    def decode(
        self, block: bytes, shape: tuple[int, int], *, level_adu: int, sigma_adu: float
    ) -> NDArray[np.int32] | NDArray[np.float32]:
        """Decode a block, to int32 or, after a loss, float32.

        Raises `ContractError` for anything malformed and allocates no more than the shape needs.
        """
        ...


@runtime_checkable
class StreakFitter(Protocol):
    """`ground.streak_fitter`: trailed-PSF fit of one ROI group."""

    def fit(self, pixels: StreakPixels, detection: Detection) -> StreakFit:
        """Best model with its uncertainties; a failed fit is flagged, not raised."""
        ...


@runtime_checkable
class Vetter(Protocol):
    """`ground.vetter`: how probable it is that a fitted streak is a real object."""

    def probability(self, fits: Sequence[StreakFit], frame: DownlinkFrame) -> NDArray[np.float64]:
        """Calibrated probabilities, shape (len(fits),), of being a real object."""
        ...


@runtime_checkable
class Astrometer(Protocol):
    """`ground.astrometry`: camera solution of each frame; sequential, because distortion is learned over the run."""

    def initial_state(self, calibration: Calibration, catalogue: Any) -> Any:
        """State before the first frame; `catalogue` is a `sboc_e2e.catalogue.StarCatalogue`."""
        ...

    def solve(self, state: Any, frame: DownlinkFrame) -> tuple[Any, FrameSolution]:
        """New state and the solution of this frame (flagged NO_SOLUTION when there is none)."""
        ...


@runtime_checkable
class Photometer(Protocol):
    """`ground.photometry`: zero point of a frame from its identified stars."""

    def calibrate(self, frame: DownlinkFrame, solution: FrameSolution, calibration: Calibration) -> PhotometricSolution:
        """Zero point, colour term and their uncertainties."""
        ...


@runtime_checkable
class Linker(Protocol):
    """`ground.linker`: streaks of all frames into tracklets.

    Given are streaks whose three directions hold at the mid-exposure epochs of their rows (`t_tai_ns`), ends in no order of time.
    If end A was seen when its row's shutter opened and B when its own closed, the object was in the direction of A, turned by
    ``-turn_rad_s exposure / 2``, at half an exposure before that epoch, and in that of B, turned by as much the other way, at
    half an exposure after it. A camera that turns shows other ends than one that stands still.

    What a linker says, and the chain takes: `tracklet_id`, `streak_ids` with `frames`, `pieces`, `probability`,
    `direction_resolved` (False: no member's ends can be told apart). Which end came first, all epochs, directions, errors,
    motion, magnitude and `chi2_nu` are measured anew by the chain from the members, so none of the numbers that a linker puts
    there is used. Only in a tracklet of one frame, whose members do not tell which way the object went, do `t_tai_ns`,
    `ra_deg` and `dec_deg` say it: two or more finite directions at different epochs, by any clock.

    Refused by name, and the run stops (`PluginError`): no member; arrays of members that are no integers or of different
    lengths; an id or a streak that another tracklet has; a streak that was not given; a piece that is no member;
    `direction_resolved` with one frame and no motion to say which; a probability outside 0 to 1.
    """

    def link(self, headers: Sequence[FrameHeader], streaks: Sequence[StreakMeasurement]) -> tuple[Tracklet, ...]:
        """Tracklets of two or more frames, each with an id of its own, no streak in two; directions resolved.

        headers : of all frames, in any order. streaks : of all frames, rejected ones flagged VETOED; may be made on demand: go
        through it once or by index. The same input gives the same result.
        """
        ...


@runtime_checkable
class OrbitDeterminer(Protocol):
    """`ground.orbit`: posterior of range and orbit of a tracklet."""

    def estimate(self, tracklet: Tracklet, headers: Sequence[FrameHeader]) -> OrbitEstimate:
        """Posterior over range; flagged when the arc says nothing."""
        ...
