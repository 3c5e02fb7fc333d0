"""The order of the on-board steps: counts, background, calibrated image, stars, detections, tracks, ROIs, packets.

`OnboardChain.process` is a step from state and frame to state and packets. Bad frames give flagged packets; a plug-in
that raises or breaks its Protocol stops the run and is named.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from onboard.comparisons import ComparesAll
from onboard.detect.static import flag_static
from onboard.downlink.budget import Allowance, Outbox, elapsed_s
from onboard.downlink.kept_counts import kept_counts
from onboard.downlink.packets import PacketWriter
from onboard.downlink.send import Content, send, send_tracks
from onboard.guard import guarded
from onboard.image.calibrate import IntegerCalibration, to_counts
from onboard.image.dead_area import mark_dead_area
from onboard.image.frame_flags import checksum, content_flags, continues, header_flags, sequence_flags
from onboard.image.hot_pixels import HotPixels
from onboard.image.view import calibrated_view, with_stars
from onboard.options import OnboardOptions
from onboard.parameter_set import parameter_set_id
from onboard.run_end import codec_of, run_end
from onboard.stars.memory import brought_forward, usable_stars, with_frame
from onboard.state import OnboardResult, OnboardState, OnboardSteps, Prepared, RunEnd, Tracking
from onboard.work import meter
from sboc_e2e.icd.errors import ContractError, UserError
from sboc_e2e.icd.flags import FrameFlag
from sboc_e2e.icd.frame import Calibration, Frame, FrameHeader, NominalCamera
from sboc_e2e.icd.results import check_detections, check_tracks
from sboc_e2e.icd.signals import Detection, DetectorView, Searched, Track, TrackerView
from sboc_e2e.icd.steps import SeedingDetector, SelectiveMemory
from sboc_e2e.icd.work import WorkMeter

__all__ = ["OnboardChain", "OnboardResult", "OnboardState", "OnboardSteps", "RunEnd", "Tracking"]

RECENT_FRAMES = 2  # that `detect.static` compares with: what one missed, the other may show. Chosen, not measured


class OnboardChain(ComparesAll):
    """The on-board software, configured; it holds scratch memory, but no state. work_meter : the meter of a frame of n pixels."""

    def __init__(
        self,
        options: OnboardOptions,
        steps: OnboardSteps,
        *,
        calibration: Calibration | None,
        camera: NominalCamera,
        run_id: int,
        work_meter: Callable[[int], WorkMeter] = meter,
    ) -> None:
        if not 0 <= run_id < 2**32:
            raise ContractError(f"run_id: expected 0 to 4294967295, got {run_id}")
        self._options = options
        self._steps = steps
        self._calibration = None if calibration is None else IntegerCalibration.of(calibration)
        self._camera = camera
        self._run_id = run_id
        self._work_meter = work_meter
        self._parameter_set = parameter_set_id(options, steps)
        self._tracks = steps.tracker.window_frames > 0
        if self._tracks and not isinstance(steps.detector, SeedingDetector):
            name, detector = type(steps.tracker).__name__, type(steps.detector).__name__
            raise UserError(
                f"onboard.tracker: {name} goes on from what a detector's search leaves, and {detector} leaves nothing: "
                "use onboard.detector line_integral, or onboard.tracker none"
            )
        self._scratch: tuple[NDArray[np.float32], NDArray[np.uint8]] | None = None

    @property
    def looks_back(self) -> bool:
        """Whether the detector holds a frame against another one."""
        return self._steps.detector.history_frames > 0

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
        """Packets of one frame, judged at once, and the state after it. Arrays of the state belong to the chain.

        `onboard.latency` has a frame without a predecessor wait for the next one. Here it is judged alone, and the figures
        of single frames hold for it (docs/limits.md, "First frames").
        """
        return self.judge(state, self.prepare(state, frame))

    def prepare(self, state: OnboardState, frame: Frame) -> Prepared:
        """A frame's calibrated image, stars and flags, in memory that the next call uses again."""
        header = self._completed(frame.header)
        check = checksum(frame.pixels)
        residual, mask = self._buffers(frame.pixels.shape)
        counts = to_counts(replace(frame, header=header), self._calibration_of(header), mask)
        mark_dead_area(mask, counts.pixels, counts.saturation)
        state.hot_pixels.in_window(header).mark(mask)
        view, sums, n_masked = calibrated_view(
            header,
            counts,
            residual,
            self._steps.background,
            psf_sigma_px=self._camera.psf_sigma_px,
            history=self.history_for(state, header),
            work=self._work_meter(frame.pixels.size),
        )
        flags = header_flags(frame.header) | sequence_flags(header, check, state.previous, state.pixel_check)
        flags |= content_flags(view.mask, counts, n_masked)
        usable = not flags & (FrameFlag.ALL_MASKED | FrameFlag.EMPTY_SIGNAL | FrameFlag.REPEATED_FRAME)
        if usable:
            view = with_stars(view, residual, sums, self._steps.star_extractor, float(counts.adu_scale))
        earlier = brought_forward(state.earlier_stars, view.stars) if usable else ()
        return Prepared(
            view=view, counts=counts, flags=flags, usable=usable, earlier=earlier, n_masked=n_masked, pixel_check=check
        )

    def judge(self, state: OnboardState, prepared: Prepared) -> tuple[OnboardState, OnboardResult]:
        """Packets of a prepared frame, held against what its view has as history, and the state after it."""
        view, counts, flags, usable, earlier = prepared.view, prepared.counts, prepared.flags, prepared.usable, prepared.earlier
        header, work = view.header, view.work
        if usable:
            found, searched = self._detections(view)
            # While stars trail, a source that does not move in the frame is the object.
            detections = flag_static(found, state.recent if view.stars.motion is None else ())
        else:
            detections, searched = (), None
        tracking = state.tracking
        tracks: tuple[Track, ...] = ()
        broken = True
        if tracking is not None and usable:
            transform = earlier[-1].transform if earlier and continues(tracking.last, header) else None
            flags |= FrameFlag.TRACKS_ENDED if (broken := transform is None) and tracking.last is not None else FrameFlag(0)
            focal_px = self._camera.focal_px
            seen = TrackerView(view=view, detections=detections, searched=searched, transform=transform, focal_px=focal_px)
            tracking, tracks = self._tracked(tracking, seen)
            del seen, searched  # their memory is wanted
        elif tracking is not None and tracking.last is not None:
            # Nothing is linked across a frame that came twice or shows nothing.
            flags |= FrameFlag.TRACKS_ENDED
            tracking = replace(tracking, last=None)
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
            n_masked=prepared.n_masked,
            previous=state.previous,
            frames_done=state.frames_done,
            codec=codec_of(self._steps.codec, counts.adu_scale),
            parameter_set=self._parameter_set,
        )
        housekeeping, rois = send(content, outbox, self._options)
        if tracking is not None and usable:
            kept = kept_counts(header, view.background, counts, rois)
            pixels = send_tracks(tracks, tracking.pixels.after(kept), outbox, content.codec, self._options.roi, view.psf_sigma_px)
            # After a break, numbers of earlier frames may repeat.
            pixels = pixels.newest(1 if broken else self._steps.tracker.window_frames - 1)
            tracking = replace(tracking, pixels=pixels)
        keep = self._steps.detector.history_frames if usable else 0
        history = (*state.history, self.remembered(view))[-keep:] if keep > 0 else state.history
        listed = with_frame(earlier, usable_stars(view.stars, detections, view.psf_sigma_px)) if usable else state.earlier_stars
        after = OnboardState(
            writer=outbox.writer,
            allowance=outbox.allowance,
            hot_pixels=state.hot_pixels.in_window(header).after(view.stars, view.mask.shape) if usable else state.hot_pixels,
            previous=header,
            history=history,
            recent=(*state.recent, detections)[-RECENT_FRAMES:] if usable else state.recent,
            earlier_stars=listed,
            pixel_check=prepared.pixel_check,
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
            work=work,
        )
        return after, result

    def finish(self, state: OnboardState) -> RunEnd:
        """What is found when no frame follows, once, after the last one."""
        return run_end(state, self._steps, self._options.roi, self._camera.psf_sigma_px)

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

    def _completed(self, header: FrameHeader) -> FrameHeader:
        """The header with the camera's gain, and with its saturation level if a calibration exists, where the frame has none."""
        if header.gain_e_adu is None:
            header = replace(header, gain_e_adu=self._camera.gain_e_adu)
        if header.saturation_adu is None and self._calibration is not None:
            header = replace(header, saturation_adu=self._camera.saturation_adu)
        return header

    def _calibration_of(self, header: FrameHeader) -> IntegerCalibration:
        """Dark and defects under a frame."""
        return IntegerCalibration.none(header) if self._calibration is None else self._calibration.window(header)

    def _buffers(self, shape: tuple[int, ...]) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
        """Memory for the calibrated image and the mask; used again for every frame unless views are kept."""
        if self._steps.detector.history_frames > 0 and not isinstance(self._steps.detector, SelectiveMemory):
            return np.empty(shape, dtype=np.float32), np.empty(shape, dtype=np.uint8)
        if self._scratch is None or self._scratch[0].shape != shape:
            self._scratch = (np.empty(shape, dtype=np.float32), np.empty(shape, dtype=np.uint8))
        return self._scratch

    def remembered(self, view: DetectorView) -> Any:
        """The part of a view that the history keeps."""
        view = replace(view, history=(), work=WorkMeter())
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
