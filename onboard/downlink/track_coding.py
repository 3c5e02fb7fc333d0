"""Members of tracks to the payloads of their packets: the number of a region that was sent, and strips from a kept frame."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from onboard.downlink import packets, roi
from onboard.downlink.kept_counts import KeptCounts
from onboard.downlink.roi_coding import BLOCK_ROOM_BYTES, code_strips, least_margin_px, pixels_per_strip
from onboard.options import RoiOptions
from sboc_e2e.icd import layout
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.signals import Detection, RoiGroup, Track, TrackMember
from sboc_e2e.icd.steps import Encoder

ROOM_BYTES: Final = BLOCK_ROOM_BYTES - layout.TRACK_MEMBER.size

SAME_PX: Final = 3.0
"""Largest distance across the trail at which a region's detection is a member of the track; it must also cover half of the
trail."""


def code_member(
    track: Track, member: TrackMember, kept: KeptCounts, codec: Encoder, options: RoiOptions, psf_sigma_px: float
) -> tuple[bytes, ...]:
    """Payloads of one member, from the frame it lies in: the number of a region with its pixels, strips of what none has."""
    t_start = kept.header.t_start_tai_ns
    sigma_px = math.hypot(psf_sigma_px, 0.29)
    detection = member.detection
    # The ends have the accuracy of the whole track.
    margin = roi.end_margin_px(detection.length_px, track.snr, sigma_px, options.end_margin)
    before = sent_before(detection, kept.sent)
    wanted = (
        [(detection, margin)]
        if before is None
        else [(piece, 0.0) for piece in unsent(detection, before, margin, sigma_px, options)]
    )
    sigma_counts = float(np.median(kept.background.sigma_adu)) / kept.adu_scale
    plan = [
        strip
        for piece, margin_px in wanted
        for strip in roi.plan_strips(
            piece,
            kept.shape,
            half_width_px=min(options.half_width_sigma * sigma_px, options.max_half_width_px),
            margins_px=(margin_px, margin_px),
            pixels_per_strip=pixels_per_strip(sigma_counts, ROOM_BYTES),
        )
    ]
    if not codec.lossless:
        detection = replace(detection, flags=detection.flags | StreakFlag.LOSSY)
    coded = code_strips(detection, plan, kept.cut, kept.background, kept.adu_scale, kept.adu_offset, codec, room_bytes=ROOM_BYTES)
    reference = () if before is None else (packets.track_payload(track, member, t_start, before.roi_id),)
    strips = (packets.track_payload(track, member, t_start, layout.TRACK_STRIP_FOLLOWS, payload) for payload in coded.payloads)
    return (*reference, *strips)


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


def unsent(found: Detection, region: RoiGroup, margin_px: float, psf_sigma_px: float, options: RoiOptions) -> list[Detection]:
    """Pieces of a trail, with the margins at its ends, beyond a region that was sent; none where the trail itself ends in it.

    The region's own frame put its ends where noise had them; the track knows better.
    """
    length, d = max(found.length_px, 1e-6), region.detection
    u = np.array([found.row1 - found.row0, found.col1 - found.col0]) / length
    start = np.array([found.row0, found.col0])
    low, high = sorted(float((np.array(end) - start) @ u) for end in ((d.row0, d.col0), (d.row1, d.col1)))
    sent_px = least_margin_px(d, psf_sigma_px, options)
    spans = []
    if low - sent_px > 0.0:
        spans.append((0.0 if found.flags & StreakFlag.EDGE0 else -margin_px, low - sent_px))
    if high + sent_px < length:
        spans.append((high + sent_px, length + (0.0 if found.flags & StreakFlag.EDGE1 else margin_px)))
    ends = [np.concatenate([start + a * u, start + b * u]) for a, b in spans]
    return [replace(found, row0=float(e[0]), col0=float(e[1]), row1=float(e[2]), col1=float(e[3])) for e in ends]
