"""The order of the on-board steps: counts, background, calibrated image, stars, detections, tracks, ROIs, packets.

`OnboardChain.process` is a step from state and frame to state and packets. Bad frames give flagged packets; a plug-in
that raises or breaks its Protocol stops the run and is named.
"""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from onboard.detect.static import flag_static
from onboard.downlink.budget import Allowance, Outbox, elapsed_s
from onboard.downlink.kept_counts import kept_counts
from onboard.downlink.packets import PacketWriter
from onboard.downlink.send import Content, TrackPixels, send, send_tracks
from onboard.guard import guarded
from onboard.image.calibrate import Counts, IntegerCalibration, background_in_adu, fill_residual, to_counts
from onboard.image.dead_area import mark_dead_area
from onboard.image.frame_flags import checksum, content_flags, header_flags, sequence_flags
from onboard.image.glare import mark_glare
from onboard.image.hot_pixels import HotPixels
from onboard.image.star_free_sky import without_stars
from onboard.options import OnboardOptions
from onboard.stars.memory import EarlierStars, brought_forward, usable_stars, with_frame
from onboard.track.none import NoTracker
from sboc_e2e.icd.downlink import Housekeeping
from sboc_e2e.icd.errors import ContractError, UserError
from sboc_e2e.icd.flags import FrameFlag
from sboc_e2e.icd.frame import Calibration, Frame, FrameHeader, NominalCamera
from sboc_e2e.icd.results import check_background, check_detections, check_stars, check_tracks
from sboc_e2e.icd.signals import Detection, DetectorView, RoiGroup, Searched, StarList, Track, TrackerView
from sboc_e2e.icd.steps import (
    BackgroundEstimator,
    Detector,
    Encoder,
    GainAwareEncoder,
    SeedingDetector,
    SelectiveMemory,
    StarExtractor,
    Tracker,
)

RECENT_FRAMES = 2


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
class OnboardState:
    """State of the chain between frames; picklable.

    earlier_stars : star lists of the last frames, newest last.
    history : views of the last frames, or what the detector keeps of them, as many as it declares, newest last.
    recent : detections of the last frames, for the STATIC flag. pixel_check : checksum of some rows of the last frame.
    tracking : None without a tracker.
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


@dataclass(frozen=True, kw_only=True, eq=False)
class OnboardResult:
    """Result of one frame. rois : groups as sent. bytes_by_apid : bytes of packets of each APID, headers included."""

    packets: bytes
    housekeeping: Housekeeping
    stars: StarList
    detections: tuple[Detection, ...]
    rois: tuple[RoiGroup, ...]
    bytes_by_apid: dict[int, int]
    tracks: tuple[Track, ...] = ()


class OnboardChain:
    """The on-board software, configured. It holds scratch memory, but nothing of the run's state."""

    def __init__(
        self,
        options: OnboardOptions,
        steps: OnboardSteps,
        *,
        calibration: Calibration | None,
        camera: NominalCamera,
        run_id: int,
    ) -> None:
        if not 0 <= run_id < 2**32:
            raise ContractError(f"run_id: expected 0 to 4294967295, got {run_id}")
        self._options = options
        self._steps = steps
        self._calibration = None if calibration is None else IntegerCalibration.of(calibration)
        self._camera = camera
        self._run_id = run_id
        self._tracks = steps.tracker.window_frames > 0
        if self._tracks and not isinstance(steps.detector, SeedingDetector):
            name, detector = type(steps.tracker).__name__, type(steps.detector).__name__
            raise UserError(
                f"onboard.tracker: {name} goes on from what a detector's search leaves, and {detector} leaves nothing: "
                "use onboard.detector line_integral, or onboard.tracker none"
            )
        self._scratch: tuple[NDArray[np.float32], NDArray[np.uint8]] | None = None

    def initial_state(self) -> OnboardState:
        """State before the first frame."""
        downlink = self._options.downlink
        return OnboardState(
            writer=PacketWriter(run_id=self._run_id),
            allowance=Allowance(rate_bytes_s=downlink.budget_mbit_s * 125_000.0, burst_s=downlink.burst_s),
            hot_pixels=HotPixels.empty(),
            tracking=self._first_tracking() if self._tracks else None,
        )

    def process(self, state: OnboardState, frame: Frame) -> tuple[OnboardState, OnboardResult]:
        """Packets of one frame and the state after it. Arrays of the state belong to the chain."""
        header = self._with_saturation(frame.header)
        check = checksum(frame.pixels)
        residual, mask = self._buffers(frame.pixels.shape)
        counts = to_counts(replace(frame, header=header), self._calibration_of(header), mask)
        mark_dead_area(mask, counts.pixels, counts.saturation)
        state.hot_pixels.mark(mask)
        view, row_sums, n_masked = self._calibrated(header, counts, residual, state)
        flags = header_flags(header) | sequence_flags(header, check, state.previous, state.pixel_check)
        flags |= content_flags(view.mask, counts, n_masked)
        usable = not flags & (FrameFlag.ALL_MASKED | FrameFlag.EMPTY_SIGNAL | FrameFlag.REPEATED_FRAME)
        if usable:
            view = self._with_stars(view, residual, row_sums)
            found, searched = self._detections(view)
            # While stars trail, a source that does not move in the frame is the object.
            detections = flag_static(found, state.recent if view.stars.motion is None else ())
            earlier = brought_forward(state.earlier_stars, view.stars)
        else:
            detections, searched, earlier = (), None, ()
        tracking = state.tracking
        tracks: tuple[Track, ...] = ()
        if tracking is not None and usable:
            transform = earlier[-1].transform if earlier and continues(tracking.last, header) else None
            flags |= FrameFlag.TRACKS_ENDED if transform is None and tracking.last is not None else FrameFlag(0)
            seen = TrackerView(view=view, detections=detections, searched=searched, transform=transform)
            tracking, tracks = self._tracked(tracking, seen)
        if len(view.stars) == 0:
            flags |= FrameFlag.NO_STARS
        allowance = state.allowance.after(elapsed_s(header, state.previous), elapsed_s(header, None))
        outbox = Outbox(writer=state.writer, allowance=allowance, header=header)
        content = Content(
            view=view,
            counts=counts,
            detections=detections,
            earlier=earlier,
            flags=flags,
            n_masked=n_masked,
            previous=state.previous,
            frames_done=state.frames_done,
            codec=self._codec_of(counts),
        )
        housekeeping, rois = send(content, outbox, self._options)
        if tracking is not None and usable:
            kept = kept_counts(header, view.background, counts, rois)
            pixels = send_tracks(tracks, tracking.pixels.after(kept), outbox, content.codec, self._options.roi, view.psf_sigma_px)
            # After a break, numbers of earlier frames may repeat.
            pixels = pixels.newest(1 if flags & FrameFlag.TRACKS_ENDED else self._steps.tracker.window_frames - 1)
            tracking = replace(tracking, pixels=pixels)
        keep = self._steps.detector.history_frames if usable else 0
        history = (*state.history, self._remembered(view))[-keep:] if keep > 0 else state.history
        after = OnboardState(
            writer=outbox.writer,
            allowance=outbox.allowance,
            hot_pixels=state.hot_pixels.after(view.stars, view.mask.shape) if usable else state.hot_pixels,
            previous=header,
            history=history,
            recent=(*state.recent, detections)[-RECENT_FRAMES:] if usable else state.recent,
            earlier_stars=with_frame(earlier, usable_stars(view.stars, detections, view.psf_sigma_px))
            if usable
            else state.earlier_stars,
            pixel_check=check,
            frames_done=state.frames_done + 1,
            tracking=tracking,
        )
        result = OnboardResult(
            packets=outbox.joined(),
            housekeeping=housekeeping,
            stars=view.stars,
            detections=detections,
            rois=rois,
            bytes_by_apid=outbox.bytes_by_apid(),
            tracks=tracks,
        )
        return after, result

    def _first_tracking(self) -> Tracking:
        """What the tracker starts with."""
        return Tracking(step=guarded("tracker", self._steps.tracker, self._steps.tracker.initial_state))

    def _tracked(self, tracking: Tracking, seen: TrackerView) -> tuple[Tracking, tuple[Track, ...]]:
        """The tracker's next state, and its tracks, checked."""
        step, header = self._steps.tracker, seen.view.header
        state, tracks = guarded("tracker", step, step.track, tracking.step, seen)
        window = {kept.header.frame: kept.shape for kept in tracking.pixels.kept} | {header.frame: (header.rows, header.cols)}
        guarded("tracker", step, check_tracks, tracks, window)
        return replace(tracking, step=state, last=header), tuple(tracks)

    def _with_saturation(self, header: FrameHeader) -> FrameHeader:
        """The header with the camera's saturation level, if the frame has none and a calibration exists."""
        if header.saturation_adu is not None or self._calibration is None:
            return header
        return replace(header, saturation_adu=self._camera.saturation_adu)

    def _calibration_of(self, header: FrameHeader) -> IntegerCalibration:
        """Dark and defects under a frame."""
        return IntegerCalibration.none(header) if self._calibration is None else self._calibration.window(header)

    def _calibrated(
        self, header: FrameHeader, counts: Counts, residual: NDArray[np.float32], state: OnboardState
    ) -> tuple[DetectorView, NDArray[np.float64], int]:
        """The view without stars, the sums of its rows, and how many pixels are masked; `residual` is filled."""
        # The calibrated image is not made yet. Until then its memory holds the whole ADU of the dark.
        dark = counts.dark.whole_adu(residual.reshape(-1).view(np.int16)[: residual.size].reshape(residual.shape))
        given = (counts.pixels, _read_only(dark), _read_only(counts.defects))
        estimated = guarded("background", self._steps.background, self._steps.background.estimate, *given)
        guarded("background", self._steps.background, check_background, estimated, counts.pixels.shape)
        background = background_in_adu(estimated, counts)
        row_sums, n_masked = fill_residual(counts, background, residual)
        n_masked += mark_glare(residual, counts.defects, background)
        view = DetectorView(
            header=header,
            residual_adu=residual,
            background=background,
            mask=counts.defects,
            stars=StarList.empty(),
            psf_sigma_px=self._camera.psf_sigma_px,
            history=state.history,
        )
        return view, row_sums, n_masked

    def _buffers(self, shape: tuple[int, ...]) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
        """Memory for the calibrated image and the mask; used again for every frame unless views are kept."""
        if self._steps.detector.history_frames > 0 and not isinstance(self._steps.detector, SelectiveMemory):
            return np.empty(shape, dtype=np.float32), np.empty(shape, dtype=np.uint8)
        if self._scratch is None or self._scratch[0].shape != shape:
            self._scratch = (np.empty(shape, dtype=np.float32), np.empty(shape, dtype=np.uint8))
        return self._scratch

    def _with_stars(self, view: DetectorView, residual: NDArray[np.float32], row_sums: NDArray[np.float64]) -> DetectorView:
        """The view with its star list, and with level and noise of the sky measured beside these stars.

        residual : the memory under the view's read-only image, which is brought to the new level.
        """
        stars = guarded("star_extractor", self._steps.star_extractor, self._steps.star_extractor.extract, view)
        guarded("star_extractor", self._steps.star_extractor, check_stars, stars, view.mask.shape)
        background = without_stars(
            residual,
            view.mask,
            row_sums,
            stars,
            view.background,
            gain_e_adu=view.header.gain_e_adu or 1.0,
            psf_sigma_px=view.psf_sigma_px,
        )
        return replace(view, stars=stars, background=background)

    def _remembered(self, view: DetectorView) -> Any:
        """The part of a view that the history keeps."""
        view = replace(view, history=())
        detector = self._steps.detector
        return guarded("detector", detector, detector.remembered, view) if isinstance(detector, SelectiveMemory) else view

    def _detections(self, view: DetectorView) -> tuple[tuple[Detection, ...], Searched | None]:
        """Detections, checked; and the results of the search for the tracker, if there is one."""
        detector, searched = self._steps.detector, None
        if self._tracks and isinstance(detector, SeedingDetector):
            found, searched = guarded("detector", detector, detector.search, view, self._steps.tracker.seed_sigma)
        else:
            found = guarded("detector", detector, detector.detect, view)
        guarded("detector", detector, check_detections, found, view.mask.shape)
        return tuple(found), searched

    def _codec_of(self, counts: Counts) -> Encoder:
        """The codec as a frame's counts need it."""
        codec = self._steps.codec
        if counts.adu_scale == 1.0 or not isinstance(codec, GainAwareEncoder):
            return codec
        scaled: Encoder = guarded("codec", self._steps.codec, codec.for_counts, counts.adu_scale)
        return scaled


def continues(last: FrameHeader | None, header: FrameHeader) -> bool:
    """Whether a frame continues the sequence of the last one: next number, later start, same exposure and readout."""
    return (
        last is not None
        and header.frame == last.frame + 1
        and header.t_start_tai_ns > last.t_start_tai_ns
        and (header.exposure_ns, header.line_time_ns) == (last.exposure_ns, last.line_time_ns)
        and (header.rows, header.cols, header.bin_rows, header.bin_cols) == (last.rows, last.cols, last.bin_rows, last.bin_cols)
        and (header.window_row0, header.window_col0) == (last.window_row0, last.window_col0)
    )


def _read_only(array: NDArray[Any]) -> NDArray[Any]:
    """A view that a plug-in cannot write to."""
    view = array.view()
    view.flags.writeable = False
    return view
