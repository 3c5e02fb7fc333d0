"""The order of things on board: counts, background, calibrated image, stars, detections, ROIs, packets.

`OnboardChain.process` is a step from state and frame to state and packets. Bad frames give flagged packets; a plug-in
that raises or breaks its Protocol stops the run and is named.
"""

import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from onboard.downlink import packets
from onboard.downlink.budget import Allowance, Outbox, packet_bytes, within_limits
from onboard.downlink.roi_coding import CodedRoi, code_roi
from onboard.downlink.thumbnail import thumbnail
from onboard.downlink.whole_frame import frame_payloads
from onboard.image.calibrate import ROW_LIMIT_SIGMA, Counts, IntegerCalibration, background_in_adu, residual_pass, to_counts
from onboard.image.dead_area import mark_dead_area
from onboard.image.star_free_sky import without_stars
from onboard.image.static import HotPixels, flag_static
from onboard.options import OnboardOptions
from onboard.stars.matched import best_spread
from onboard.stars.memory import EarlierStars, brought_forward, part_of, remembered_stars, usable_stars, with_frame
from sboc_e2e.icd.downlink import Housekeeping
from sboc_e2e.icd.errors import ContractError, PluginError, UserError
from sboc_e2e.icd.flags import FrameFlag, MaskBit, StreakFlag
from sboc_e2e.icd.frame import Calibration, Frame, FrameHeader, NominalCamera
from sboc_e2e.icd.layout import HEADER_FIXED, TELEMETRY, Apid
from sboc_e2e.icd.results import check_background, check_detections, check_stars
from sboc_e2e.icd.signals import Detection, DetectorView, RoiGroup, StarList
from sboc_e2e.icd.steps import BackgroundEstimator, Detector, Encoder, GainAwareEncoder, SelectiveMemory, StarExtractor
from sboc_e2e.icd.tai import NS_PER_S

REMEMBERED_ITEM = 1
"""Item number of the star packets with remembered stars; those measured in the frame are item 0."""

RECENT_FRAMES = 2
CHECKED_ROWS = 64
"""Rows of a frame that go into the checksum which recognises a repeated frame."""


@dataclass(frozen=True, kw_only=True)
class OnboardSteps:
    """The swappable steps."""

    background: BackgroundEstimator
    star_extractor: StarExtractor
    detector: Detector
    codec: Encoder


@dataclass(frozen=True, kw_only=True, eq=False)
class OnboardState:
    """What the chain remembers from frame to frame; picklable.

    earlier_stars : star lists of the last frames, newest last.
    history : views of the last frames, or what the detector keeps of them, as many as it declares, newest last.
    recent : detections of the last frames, for the STATIC flag. pixel_check : checksum of some rows of the last frame.
    """

    writer: packets.PacketWriter
    allowance: Allowance
    hot_pixels: HotPixels
    previous: FrameHeader | None = None
    history: tuple[Any, ...] = ()
    recent: tuple[tuple[Detection, ...], ...] = ()
    earlier_stars: tuple[EarlierStars, ...] = ()
    pixel_check: int | None = None
    frames_done: int = 0


@dataclass(frozen=True, kw_only=True, eq=False)
class OnboardResult:
    """What one frame gave. rois : groups as sent. bytes_by_apid : bytes of packets of each APID, headers included."""

    packets: bytes
    housekeeping: Housekeeping
    stars: StarList
    detections: tuple[Detection, ...]
    rois: tuple[RoiGroup, ...]
    bytes_by_apid: dict[int, int]


@dataclass(frozen=True, kw_only=True, eq=False)
class Writable:
    """residual : the memory under a view's read-only image. row_sums : (rows, 2) of `residual_pass`."""

    residual: NDArray[np.float32]
    row_sums: NDArray[np.float64]


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
        self._scratch: tuple[NDArray[np.float32], NDArray[np.uint8]] | None = None

    def initial_state(self) -> OnboardState:
        """State before the first frame."""
        downlink = self._options.downlink
        return OnboardState(
            writer=packets.PacketWriter(run_id=self._run_id),
            allowance=Allowance(rate_bytes_s=downlink.budget_mbit_s * 125_000.0, burst_s=downlink.burst_s),
            hot_pixels=HotPixels.empty(),
        )

    def process(self, state: OnboardState, frame: Frame) -> tuple[OnboardState, OnboardResult]:
        """Packets of one frame and the state after it. Arrays of the state belong to the chain."""
        header = self._with_saturation(frame.header)
        check = _checksum(frame.pixels)
        residual, mask = self._buffers(frame.pixels.shape)
        counts = to_counts(replace(frame, header=header), self._calibration_of(header), mask)
        mark_dead_area(mask, counts.pixels, counts.saturation)
        state.hot_pixels.mark(mask)
        view, under, n_masked = self._calibrated(header, counts, residual, state)
        flags = _header_flags(header) | _sequence_flags(header, state, check) | _content_flags(view, counts, n_masked)
        usable = not flags & (FrameFlag.ALL_MASKED | FrameFlag.EMPTY_SIGNAL | FrameFlag.REPEATED_FRAME)
        if usable:
            view = self._with_stars(view, under)
            detections = flag_static(self._detections(view), state.recent)
            earlier = brought_forward(state.earlier_stars, view.stars)
        else:
            detections, earlier = (), ()
        if len(view.stars) == 0:
            flags |= FrameFlag.NO_STARS
        outbox = Outbox(writer=state.writer, allowance=state.allowance.after(_elapsed_s(header, state.previous)), header=header)
        housekeeping, rois = self._send(outbox, state, view, counts, detections, earlier, flags, n_masked)
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
        )
        result = OnboardResult(
            packets=outbox.joined(),
            housekeeping=housekeeping,
            stars=view.stars,
            detections=detections,
            rois=rois,
            bytes_by_apid=outbox.bytes_by_apid(),
        )
        return after, result

    def _with_saturation(self, header: FrameHeader) -> FrameHeader:
        """The header with the camera's saturation level where the frame brings none but a calibration is there."""
        if header.saturation_adu is not None or self._calibration is None:
            return header
        return replace(header, saturation_adu=self._camera.saturation_adu)

    def _calibration_of(self, header: FrameHeader) -> IntegerCalibration:
        """Dark and defects under a frame."""
        return IntegerCalibration.none(header) if self._calibration is None else self._calibration.window(header)

    def _calibrated(
        self, header: FrameHeader, counts: Counts, residual: NDArray[np.float32], state: OnboardState
    ) -> tuple[DetectorView, Writable, int]:
        """The view without stars, what lies under it, and how many pixels are masked; `residual` is filled."""
        row_sums = np.empty((len(residual), 2))
        # the calibrated image is not there yet: its memory holds the whole ADU of the dark until then
        dark = counts.dark.whole_adu(residual.reshape(-1).view(np.int16)[: residual.size].reshape(residual.shape))
        given = (counts.pixels, _read_only(dark), _read_only(counts.defects))
        estimated = self._guarded("background", self._steps.background.estimate, *given)
        self._guarded("background", check_background, estimated, counts.pixels.shape)
        background = background_in_adu(estimated, counts)
        n_masked = residual_pass(
            counts.pixels,
            counts.dark.codes,
            counts.defects,
            background.level_adu - np.float32(counts.adu_offset),
            background.tile_px,
            counts.saturation,
            counts.adu_scale,
            ROW_LIMIT_SIGMA * float(np.median(background.sigma_adu)),
            residual,
            row_sums,
        )
        view = DetectorView(
            header=header,
            residual_adu=residual,
            background=background,
            mask=counts.defects,
            stars=StarList.empty(),
            psf_sigma_px=self._camera.psf_sigma_px,
            history=state.history,
        )
        return view, Writable(residual=residual, row_sums=row_sums), int(n_masked)

    def _buffers(self, shape: tuple[int, ...]) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
        """Memory for the calibrated image and the mask; used again for every frame unless views are kept."""
        if self._steps.detector.history_frames > 0 and not isinstance(self._steps.detector, SelectiveMemory):
            return np.empty(shape, dtype=np.float32), np.empty(shape, dtype=np.uint8)
        if self._scratch is None or self._scratch[0].shape != shape:
            self._scratch = (np.empty(shape, dtype=np.float32), np.empty(shape, dtype=np.uint8))
        return self._scratch

    def _with_stars(self, view: DetectorView, under: Writable) -> DetectorView:
        """The view with its star list, and with level and noise of the sky measured beside these stars.

        The memory under the view's image is brought to the new level.
        """
        stars = self._guarded("star_extractor", self._steps.star_extractor.extract, view)
        self._guarded("star_extractor", check_stars, stars, view.mask.shape)
        background = without_stars(
            under.residual,
            view.mask,
            under.row_sums,
            stars,
            view.background,
            gain_e_adu=view.header.gain_e_adu or 1.0,
            psf_sigma_px=view.psf_sigma_px,
        )
        return replace(view, stars=stars, background=background)

    def _remembered(self, view: DetectorView) -> Any:
        """What the history holds of a view."""
        view = replace(view, history=())
        detector = self._steps.detector
        return self._guarded("detector", detector.remembered, view) if isinstance(detector, SelectiveMemory) else view

    def _detections(self, view: DetectorView) -> tuple[Detection, ...]:
        """Detections of the detector, checked."""
        found = self._guarded("detector", self._steps.detector.detect, view)
        self._guarded("detector", check_detections, found, view.mask.shape)
        return tuple(found)

    def _guarded(self, seam: str, call: Callable[..., Any], *arguments: Any) -> Any:
        """What a step, or a check of its result, returns; whatever it raises becomes a `PluginError` that names the step.

        A `UserError` about something that the user can mend passes; a record that breaks the contract is the step's fault.
        """
        try:
            return call(*arguments)
        except Exception as error:  # a plug-in may raise anything; it is reported by name
            if isinstance(error, UserError) and not isinstance(error, ContractError):
                raise
            what = str(error) if isinstance(error, ContractError) else f"{type(error).__name__}: {error}"
            raise self._fault(seam, what) from error

    def _fault(self, seam: str, what: str) -> PluginError:
        """The error that names a step."""
        step = type(getattr(self._steps, seam))
        return PluginError(f"onboard.{seam} {step.__module__}:{step.__qualname__}: {what}")

    def _send(
        self,
        outbox: Outbox,
        state: OnboardState,
        view: DetectorView,
        counts: Counts,
        detections: tuple[Detection, ...],
        earlier: tuple[EarlierStars, ...],
        flags: FrameFlag,
        n_masked: int,
    ) -> tuple[Housekeeping, tuple[RoiGroup, ...]]:
        """Everything into the outbox in order of priority; what does not fit is counted."""
        options, background = self._options.downlink, view.background
        codec = self._codec_of(counts)
        outbox.reserve(packet_bytes([bytes(HEADER_FIXED.size + 2 * TELEMETRY.size)]))
        chosen = part_of(view.stars, best_spread(view.stars, view.mask.shape, options.max_stars))
        n_stars = len(chosen) if outbox.offer(Apid.STARS, packets.star_payloads(chosen)) else 0
        limits = self._options.roi
        in_storm = len(detections) > limits.max_per_frame
        flags |= FrameFlag.STORM if in_storm else FrameFlag(0)
        sendable = within_limits(detections, most=limits.max_per_frame, most_cosmic_like=limits.max_cosmic_like)
        groups = self._send_rois(outbox, view, counts, codec, sendable)
        old = remembered_stars(earlier, groups, psf_sigma_px=view.psf_sigma_px, most=options.max_stars)
        if len(old) and outbox.offer(Apid.STARS, packets.star_payloads(old), item=REMEMBERED_ITEM):
            n_stars += len(old)
        level, sigma = float(np.median(background.level_adu)), float(np.median(background.sigma_adu))
        unit = float(np.float32(0.05 * max(sigma, 1e-6)))
        outbox.offer(Apid.BACKGROUND, packets.background_payloads(background, level_unit_adu=unit, sigma_unit_adu=0.5 * unit))
        cells, offset, step = thumbnail(view.residual_adu, level, sigma, options.thumbnail_px)
        outbox.offer(
            Apid.THUMBNAIL,
            packets.thumbnail_payloads(cells, cell_px=options.thumbnail_px, offset_adu=offset, unit_adu=step),
        )
        in_turn = options.whole_frame_every > 0 and state.frames_done % options.whole_frame_every == 0
        if in_turn or view.header.frame in options.whole_frames:
            outbox.send(Apid.FRAME, frame_payloads(counts, background, codec))
        kept_snr = [group.detection.snr for group in groups if not group.detection.flags & StreakFlag.COSMIC_LIKE]
        housekeeping = Housekeeping(
            flags=flags | (FrameFlag.BUDGET_CUT if outbox.bytes_dropped else FrameFlag(0)),
            n_stars_found=len(view.stars),
            n_stars_sent=n_stars,
            n_detections=len(detections),
            n_rois_sent=len(groups),
            n_rois_dropped=len(detections) - len(groups),
            bytes_dropped=outbox.bytes_dropped,
            threshold_sigma=min(kept_snr) if in_storm and kept_snr else 0.0,
            background_adu=level,
            sigma_adu=sigma,
            n_masked=n_masked,
        )
        payload = packets.header_payload(
            view.header,
            housekeeping,
            state.previous,
            adu_scale=counts.adu_scale,
            adu_offset=counts.adu_offset,
            psf_sigma_px=view.stars.psf_sigma_px,
        )
        outbox.send(Apid.HEADER, [payload])
        return housekeeping, groups

    def _codec_of(self, counts: Counts) -> Encoder:
        """The codec as a frame's counts need it."""
        codec = self._steps.codec
        if counts.adu_scale == 1.0 or not isinstance(codec, GainAwareEncoder):
            return codec
        scaled: Encoder = self._guarded("codec", codec.for_counts, counts.adu_scale)
        return scaled

    def _send_rois(
        self, outbox: Outbox, view: DetectorView, counts: Counts, codec: Encoder, detections: list[Detection]
    ) -> tuple[RoiGroup, ...]:
        """ROIs in the given order: as planned, or tighter when that does not fit, or not at all."""
        groups: list[RoiGroup] = []
        for detection in detections:
            coded = self._fitting(outbox, detection, view, counts, codec)
            if coded is None or not coded.strips:
                continue
            roi_id = len(groups)
            outbox.offer(Apid.ROI, coded.payloads, item=roi_id)
            groups.append(RoiGroup(roi_id=roi_id, detection=coded.detection, strips=coded.strips, n_strips=len(coded.strips)))
        return tuple(groups)

    def _fitting(
        self, outbox: Outbox, detection: Detection, view: DetectorView, counts: Counts, codec: Encoder
    ) -> CodedRoi | None:
        """The fullest form of a ROI that fits; None, counted as dropped, when even the tight one does not."""
        full = code_roi(detection, view, counts, codec, self._options.roi)
        if outbox.fits(full.payloads):
            return full
        tight = code_roi(detection, view, counts, codec, self._options.roi, tight=True)
        fits = outbox.fits(tight.payloads)
        outbox.bytes_dropped += packet_bytes(full.payloads) - (packet_bytes(tight.payloads) if fits else 0)
        return tight if fits else None


def _read_only(array: NDArray[Any]) -> NDArray[Any]:
    """A view that a plug-in cannot write to."""
    view = array.view()
    view.flags.writeable = False
    return view


def _checksum(pixels: NDArray[np.uint16] | NDArray[np.float32]) -> int:
    """Checksum of some rows, enough to recognise the same frame again."""
    return zlib.crc32(np.ascontiguousarray(pixels[:: max(1, pixels.shape[0] // CHECKED_ROWS)]).data)


def _elapsed_s(header: FrameHeader, previous: FrameHeader | None) -> float:
    """Time for which the downlink budget has grown: since the frame before, or one exposure."""
    if previous is None:
        return max(header.exposure_ns, 1) / NS_PER_S
    return (header.t_start_tai_ns - previous.t_start_tai_ns) / NS_PER_S


def _header_flags(header: FrameHeader) -> FrameFlag:
    """What the header does not know."""
    missing = (
        (header.gain_e_adu, FrameFlag.GAIN_ASSUMED),
        (header.read_noise_e, FrameFlag.READ_NOISE_ASSUMED),
        (header.attitude, FrameFlag.NO_ATTITUDE),
        (header.observer, FrameFlag.NO_OBSERVER),
    )
    flags = FrameFlag(0)
    for value, flag in missing:
        flags |= flag if value is None else FrameFlag(0)
    return flags


def _sequence_flags(header: FrameHeader, state: OnboardState, check: int) -> FrameFlag:
    """What is wrong with a frame's place in the run."""
    flags, previous = FrameFlag(0), state.previous
    if previous is None:
        return flags
    if header.t_start_tai_ns < previous.t_start_tai_ns + previous.exposure_ns:
        flags |= FrameFlag.TIME_BACKWARDS
    if check == state.pixel_check or header.frame == previous.frame:
        flags |= FrameFlag.REPEATED_FRAME
    return flags


def _content_flags(view: DetectorView, counts: Counts, n_masked: int) -> FrameFlag:
    """What is wrong with a frame's pixels."""
    flags, size = FrameFlag(0), view.mask.size
    if n_masked > 0.9 * size:
        flags |= FrameFlag.ALL_MASKED
    if n_masked > 0.5 * size and np.count_nonzero(view.mask & MaskBit.SATURATED) > 0.5 * size:
        flags |= FrameFlag.SATURATED
    first = counts.pixels[0, 0]
    if (counts.pixels[0] == first).all() and (counts.pixels == first).all():
        flags |= FrameFlag.EMPTY_SIGNAL
    return flags
