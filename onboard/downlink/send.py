"""Fill the outbox of a frame in order of priority: stars, ROIs, stars under ROIs, sky, thumbnail, header."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from onboard.downlink import packets
from onboard.downlink.budget import Outbox, packet_bytes, priority, within_limits
from onboard.downlink.kept_counts import KeptCounts
from onboard.downlink.roi_coding import CodedRoi, code_roi
from onboard.downlink.thumbnail import thumbnail
from onboard.downlink.track_coding import code_member
from onboard.downlink.whole_frame import frame_payloads
from onboard.image.calibrate import Counts
from onboard.options import DownlinkOptions, OnboardOptions, RoiOptions
from onboard.stars.matched import best_spread
from onboard.stars.memory import EarlierStars, part_of, remembered_stars
from sboc_e2e.icd.downlink import Housekeeping
from sboc_e2e.icd.flags import FrameFlag, StreakFlag
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.layout import HEADER_FIXED, HEADER_WORK, TELEMETRY, Apid
from sboc_e2e.icd.signals import Detection, DetectorView, RoiGroup, Track
from sboc_e2e.icd.steps import Encoder
from sboc_e2e.icd.work import Work

REGION_WORK = 150_000  # operations of a region, whatever its length ...
REGION_WORK_PER_PX = 1_500
"""Operations of a region: its profile over 41 px across, sorted for each, and strips of some 20 px across, cut and coded."""

REMEMBERED_ITEM = 1
"""Item number of the star packets with remembered stars; those measured in the frame are item 0."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Content:
    """Contents of a frame that may be sent.

    earlier : stars of earlier frames, in this frame's coordinates. n_masked : masked pixels. previous : header of the frame
    before, None at the first. frames_done : frames of the run before this one. codec : for the counts of this frame.
    parameter_set : number of the options that flew.
    """

    view: DetectorView
    counts: Counts
    detections: tuple[Detection, ...]
    earlier: tuple[EarlierStars, ...]
    flags: FrameFlag
    n_masked: int
    previous: FrameHeader | None
    frames_done: int
    codec: Encoder
    parameter_set: int = 0


@dataclass(frozen=True, kw_only=True, eq=False)
class TrackPixels:
    """Kept frames that strips of tracks are cut from, oldest first.

    sent : (track, frame) of the members sent so far. items : members sent with the newest frame.
    """

    kept: tuple[KeptCounts, ...] = ()
    sent: tuple[tuple[int, int], ...] = ()
    items: int = 0

    def after(self, frame: KeptCounts) -> "TrackPixels":
        """The record with one more frame."""
        return replace(self, kept=(*self.kept, frame), items=0)

    def newest(self, number: int) -> "TrackPixels":
        """The newest frames alone, so that there is room before the next one comes."""
        kept = self.kept[-number:] if number > 0 else ()
        return replace(self, kept=kept, sent=tuple(place for place in self.sent if kept and place[1] >= kept[0].header.frame))


def send_tracks(
    tracks: Sequence[Track], pixels: TrackPixels, outbox: Outbox, codec: Encoder, options: RoiOptions, psf_sigma_px: float
) -> TrackPixels:
    """Send members of tracks that were not sent yet, best tracks first, while they fit; sent members are recorded."""
    frames = {kept.header.frame: kept for kept in pixels.kept}
    sent, item = list(pixels.sent), pixels.items
    for track in sorted(tracks, key=lambda t: -t.snr):
        for member in track.members:
            place = (track.number, member.frame)
            if place in sent or member.frame not in frames:
                continue
            payloads = code_member(track, member, frames[member.frame], codec, options, psf_sigma_px)
            if payloads and outbox.offer(Apid.TRACK, payloads, item=item):
                sent.append(place)
                item += 1
    return replace(pixels, sent=tuple(sent), items=item)


def send(content: Content, outbox: Outbox, options: OnboardOptions) -> tuple[Housekeeping, tuple[RoiGroup, ...]]:
    """Fill the outbox and count dropped items. Returns the housekeeping and the ROI groups as sent."""
    view, limits = content.view, options.roi
    level, sigma = float(np.median(view.background.level_adu)), float(np.median(view.background.sigma_adu))
    outbox.reserve(packet_bytes([bytes(HEADER_FIXED.size + 2 * TELEMETRY.size + HEADER_WORK.size)]))
    n_stars = _send_stars(content, outbox, options.downlink)
    sendable = within_limits(
        content.detections, view.mask.shape, most=limits.max_per_frame, most_cosmic_like=limits.max_cosmic_like
    )
    groups = _send_rois(content, outbox, limits, sendable)
    n_stars += _send_remembered(content, outbox, options.downlink, groups)
    _send_sky(content, outbox, options.downlink, level, sigma)
    _send_whole_frame(content, outbox, options.downlink)
    in_storm = len(content.detections) > limits.max_per_frame
    sent_at = {(group.detection.row0, group.detection.col0, group.detection.snr) for group in groups}
    unsent = [d.snr for d in but_hits(content.detections) if (d.row0, d.col0, d.snr) not in sent_at]
    flags = content.flags | (FrameFlag.STORM if in_storm else FrameFlag(0))
    flags |= FrameFlag.WORK_SHED if view.work.has_shed else FrameFlag(0)
    shed = view.work.shed
    housekeeping = Housekeeping(
        flags=flags | (FrameFlag.BUDGET_CUT if outbox.bytes_dropped else FrameFlag(0)),
        n_stars_found=len(view.stars),
        n_stars_sent=n_stars,
        n_detections=len(content.detections),
        n_rois_sent=len(groups),
        n_rois_dropped=len(content.detections) - len(groups),
        bytes_dropped=outbox.bytes_dropped,
        threshold_sigma=max(unsent) if in_storm and unsent else 0.0,
        background_adu=level,
        sigma_adu=sigma,
        n_masked=content.n_masked,
        parameter_set=content.parameter_set,
        operations=round(view.work.operations, -3),
        shed_stars=shed[Work.STARS],
        shed_halos=shed[Work.HALOS],
        shed_candidates=shed[Work.CANDIDATES],
        shed_points=shed[Work.POINTS],
        shed_trails=shed[Work.TRAILS],
        shed_regions=shed[Work.REGIONS],
    )
    payload = packets.header_payload(
        view.header,
        housekeeping,
        content.previous,
        adu_scale=content.counts.adu_scale,
        adu_offset=content.counts.adu_offset,
        psf_sigma_px=view.stars.psf_sigma_px,
    )
    outbox.send(Apid.HEADER, [payload])
    return housekeeping, groups


def but_hits(detections: Sequence[Detection]) -> list[Detection]:
    """Detections that are no particle hits: those whose loss the threshold of a storm tells."""
    return [d for d in detections if not d.flags & StreakFlag.COSMIC_LIKE]


def _send_stars(content: Content, outbox: Outbox, options: DownlinkOptions) -> int:
    """Well-spread stars of the frame; returns how many were sent."""
    stars = content.view.stars
    chosen = part_of(stars, best_spread(stars, content.view.mask.shape, options.max_stars))
    return len(chosen) if outbox.offer(Apid.STARS, packets.star_payloads(chosen)) else 0


def _send_rois(content: Content, outbox: Outbox, options: RoiOptions, detections: Sequence[Detection]) -> tuple[RoiGroup, ...]:
    """ROIs, chosen in the given order: as planned, or tighter when that does not fit, or not at all; numbered by priority."""
    chosen: list[CodedRoi] = []
    work = content.view.work
    for k, detection in enumerate(detections):
        operations = REGION_WORK + REGION_WORK_PER_PX * detection.length_px
        if operations > work.left(Work.REGIONS):
            work.leave(Work.REGIONS, len(detections) - k)
            break
        work.spend(Work.REGIONS, operations)
        coded = _fitting(content, outbox, options, detection)
        if coded is None or not coded.strips:
            continue
        outbox.reserve(packet_bytes(coded.payloads))
        chosen.append(coded)
    groups: list[RoiGroup] = []
    for roi_id, k in enumerate(priority([coded.detection for coded in chosen])):
        coded = chosen[k]
        outbox.send(Apid.ROI, coded.payloads, item=roi_id)
        groups.append(RoiGroup(roi_id=roi_id, detection=coded.detection, strips=coded.strips, n_strips=len(coded.strips)))
    return tuple(groups)


def _fitting(content: Content, outbox: Outbox, options: RoiOptions, detection: Detection) -> CodedRoi | None:
    """The largest form of a ROI that fits. None, counted as dropped, if even the tight form does not fit."""
    full = code_roi(detection, content.view, content.counts, content.codec, options)
    if outbox.fits(full.payloads):
        return full
    tight = code_roi(detection, content.view, content.counts, content.codec, options, tight=True)
    fits = outbox.fits(tight.payloads)
    outbox.bytes_dropped += packet_bytes(full.payloads) - (packet_bytes(tight.payloads) if fits else 0)
    return tight if fits else None


def _send_remembered(content: Content, outbox: Outbox, options: DownlinkOptions, groups: Sequence[RoiGroup]) -> int:
    """Stars of earlier frames under the ROIs; returns how many were sent."""
    old = remembered_stars(content.earlier, groups, psf_sigma_px=content.view.psf_sigma_px, most=options.max_stars)
    sent = len(old) > 0 and outbox.offer(Apid.STARS, packets.star_payloads(old), item=REMEMBERED_ITEM)
    return len(old) if sent else 0


def _send_sky(content: Content, outbox: Outbox, options: DownlinkOptions, level_adu: float, sigma_adu: float) -> None:
    """Background mesh and thumbnail; level and sigma are the medians of the mesh."""
    unit = float(np.float32(0.05 * max(sigma_adu, 1e-6)))
    mesh = packets.background_payloads(content.view.background, level_unit_adu=unit, sigma_unit_adu=0.5 * unit)
    outbox.offer(Apid.BACKGROUND, mesh)
    cells, offset, step = thumbnail(content.view.residual_adu, level_adu, sigma_adu, options.thumbnail_px)
    picture = packets.thumbnail_payloads(cells, cell_px=options.thumbnail_px, offset_adu=offset, unit_adu=step)
    outbox.offer(Apid.THUMBNAIL, picture)


def _send_whole_frame(content: Content, outbox: Outbox, options: DownlinkOptions) -> None:
    """The whole frame when it is its turn or was asked for, on top of the budget."""
    in_turn = options.whole_frame_every > 0 and content.frames_done % options.whole_frame_every == 0
    if in_turn or content.view.header.frame in options.whole_frames:
        outbox.send(Apid.FRAME, frame_payloads(content.counts, content.view.background, content.codec))
