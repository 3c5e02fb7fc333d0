"""Members of tracks to the payloads of their packets: the number of a region that was sent, or strips from a kept frame."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from onboard.downlink import packets, roi
from onboard.downlink.kept_counts import KeptCounts
from onboard.downlink.roi_coding import BLOCK_ROOM_BYTES, code_strips, pixels_per_strip
from onboard.options import RoiOptions
from sboc_e2e.icd import layout
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.signals import Detection, RoiGroup, Track, TrackMember
from sboc_e2e.icd.steps import Encoder

ROOM_BYTES: Final = BLOCK_ROOM_BYTES - layout.TRACK_MEMBER.size

SAME_PX: Final = 3.0
"""Largest distance across the trail at which a region's detection is a member of the track; it must also cover half of the
trail."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CodedMember:
    """A member of a track ready to be sent. strips : how many follow; 0 where its region was sent before."""

    track: Track
    member: TrackMember
    payloads: tuple[bytes, ...]
    strips: int


def code_member(
    track: Track, member: TrackMember, kept: KeptCounts, codec: Encoder, options: RoiOptions, psf_sigma_px: float
) -> CodedMember:
    """Payloads of one member, from the frame it lies in."""
    t_start = kept.header.t_start_tai_ns
    before = sent_before(member.detection, kept.sent)
    if before is not None:
        payload = packets.track_payload(track, member, t_start, before.roi_id)
        return CodedMember(track=track, member=member, payloads=(payload,), strips=0)
    sigma_px = math.hypot(psf_sigma_px, 0.29)
    detection = member.detection
    # The ends have the accuracy of the whole track.
    margin = roi.end_margin_px(detection.length_px, track.snr, sigma_px, options.end_margin)
    sigma_counts = float(np.median(kept.background.sigma_adu)) / kept.adu_scale
    plan = roi.plan_strips(
        detection,
        kept.shape,
        half_width_px=min(options.half_width_sigma * sigma_px, options.max_half_width_px),
        margin_px=margin,
        pixels_per_strip=pixels_per_strip(sigma_counts, ROOM_BYTES),
    )
    if not codec.lossless:
        detection = replace(detection, flags=detection.flags | StreakFlag.LOSSY)
    coded = code_strips(detection, plan, kept.cut, kept.background, kept.adu_scale, kept.adu_offset, codec, room_bytes=ROOM_BYTES)
    payloads = tuple(
        packets.track_payload(track, member, t_start, layout.TRACK_STRIP_FOLLOWS, payload) for payload in coded.payloads
    )
    return CodedMember(track=track, member=member, payloads=payloads, strips=len(payloads))


def sent_before(found: Detection, groups: Sequence[RoiGroup]) -> RoiGroup | None:
    """The region of a trail that was already sent, if there is one."""
    length = max(found.length_px, 1e-6)
    u_row, u_col = (found.row1 - found.row0) / length, (found.col1 - found.col0) / length
    for group in groups:
        d = group.detection
        ends = [(row - found.row0, col - found.col0) for row, col in ((d.row0, d.col0), (d.row1, d.col1))]
        along = sorted(row * u_row + col * u_col for row, col in ends)
        across = max(abs(row * u_col - col * u_row) for row, col in ends)
        overlap = min(along[1], length) - max(along[0], 0.0)
        if across < SAME_PX + 0.02 * length and overlap > 0.5 * min(length, along[1] - along[0] + 1.0):
            return group
    return None
