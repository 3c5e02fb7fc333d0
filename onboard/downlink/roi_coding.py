"""A detection to the payloads of its ROI packets: plan strips, cut, encode, split what does not fit into a packet."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from onboard.downlink import packets, roi
from onboard.downlink.trail_light import room_beyond_px, trail_half_width_px
from onboard.image.calibrate import Counts
from onboard.options import RoiOptions
from sboc_e2e.icd import layout
from sboc_e2e.icd.errors import PluginError
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.signals import BackgroundModel, Detection, DetectorView, Strip
from sboc_e2e.icd.steps import Encoder

BLOCK_ROOM_BYTES = layout.MAX_PAYLOAD_BYTES - layout.ROI_GROUP.size - layout.STRIP.size
FIRST_GUESS_FILL = 0.9
"""Strips are planned to fill this share of a packet, so that few need splitting."""

MARGIN_HALF_WIDTHS = 2.4
"""Half width of the margins in which light is followed, in those of the trail: lines beside it tell what light is no trail's."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CodedRoi:
    """A ROI ready to be sent."""

    detection: Detection
    strips: tuple[Strip, ...]
    payloads: tuple[bytes, ...]


def bits_per_pixel(sigma_counts: float) -> float:
    """Expected cost of a lossless pixel: the entropy log2(4.13 sigma) of rounded Gaussian noise, and coder's overhead."""
    return max(math.log2(4.13 * max(sigma_counts, 0.3)), 0.5) + 0.35


def least_margin_px(detection: Detection, psf_sigma_px: float, options: RoiOptions) -> float:
    """Margin that a region has at least beyond the ends of its detection: a smaller one where it is flagged ROI_CUT."""
    factor = min(options.end_margin, 1.0) if detection.flags & StreakFlag.ROI_CUT else options.end_margin
    return roi.end_margin_px(detection.length_px, detection.snr, psf_sigma_px, factor)


def region_margins_px(
    view: DetectorView, detection: Detection, half_width_px: float, psf_sigma_px: float, options: RoiOptions
) -> tuple[float, float]:
    """Margins that a region has beyond both ends of its detection, wider where light goes on and is followed."""
    least = least_margin_px(detection, psf_sigma_px, options)
    if StreakFlag.ROI_CUT in detection.flags or not options.follow_light:
        return least, least
    first, last = (max(least, room_beyond_px(view, detection, end, half_width_px / options.half_width_sigma)) for end in (0, 1))
    return first, last


def pixels_per_strip(sigma_counts: float, room_bytes: int) -> int:
    """Number of noise pixels that fit into a block of `room_bytes`, with some margin."""
    return min(max(64, int(FIRST_GUESS_FILL * 8.0 * room_bytes / bits_per_pixel(sigma_counts))), layout.MAX_STRIP_PIXELS)


def code_roi(
    detection: Detection, view: DetectorView, counts: Counts, codec: Encoder, options: RoiOptions, *, tight: bool = False
) -> CodedRoi:
    """Strips and payloads of a detection. `tight` gives the smallest useful region and flags it ROI_CUT."""
    sigma_px = math.hypot(view.psf_sigma_px, 0.29)
    half_width = trail_half_width_px(
        view,
        detection,
        least_px=min(options.half_width_sigma * sigma_px, options.max_half_width_px),
        largest_px=options.max_half_width_px,
    )
    if tight:
        half_width = min(half_width, 3.0 * sigma_px)
        detection = replace(detection, flags=detection.flags | StreakFlag.ROI_CUT)
    margins = region_margins_px(view, detection, half_width, sigma_px, options)
    sigma_counts = float(np.median(view.background.sigma_adu)) / counts.adu_scale
    plan = roi.plan_strips(
        detection,
        view.mask.shape,
        half_width_px=half_width,
        margins_px=margins,
        margin_half_width_px=half_width * MARGIN_HALF_WIDTHS if options.follow_light else None,
        pixels_per_strip=pixels_per_strip(sigma_counts, BLOCK_ROOM_BYTES),
    )
    if not codec.lossless:
        detection = replace(detection, flags=detection.flags | StreakFlag.LOSSY)

    def cut(geometry: roi.StripGeometry, level: int) -> Strip:
        return roi.cut_strip(geometry, counts.pixels, counts.dark, level)

    return code_strips(
        detection, plan, cut, view.background, counts.adu_scale, counts.adu_offset, codec, room_bytes=BLOCK_ROOM_BYTES
    )


def code_strips(
    detection: Detection,
    plan: Sequence[roi.StripGeometry],
    cut: Callable[[roi.StripGeometry, int], Strip],
    background: BackgroundModel,
    adu_scale: float,
    adu_offset: float,
    codec: Encoder,
    *,
    room_bytes: int,
) -> CodedRoi:
    """Strips as planned, split until each one's block fits into `room_bytes`. cut : the pixels of a strip, around a level."""
    strips, payloads = [], []
    waiting = list(reversed(plan))
    while waiting:
        geometry = waiting.pop()
        level_adu, noise_adu = roi.sky_at(background, geometry)
        level = round((level_adu - adu_offset) / adu_scale)
        sigma = float(np.float32(noise_adu / adu_scale))
        strip = cut(geometry, level)
        block = encoded(codec, strip.values_adu.astype(np.int32, copy=False), level, sigma)
        if len(block) > room_bytes:
            if geometry.n * geometry.width == 1:
                raise PluginError(f"codec {type(codec).__name__}: {len(block)} bytes for one pixel")
            waiting.extend(reversed(roi.split(geometry)))
            continue
        strips.append(strip)
        payloads.append(packets.roi_payload(detection, strip, codec.number, sigma, block))
    return CodedRoi(detection=detection, strips=tuple(strips), payloads=tuple(payloads))


def encoded(codec: Encoder, values: NDArray[np.int32], level: int, sigma: float) -> bytes:
    """The codec's block. An exception becomes an error that names the codec."""
    try:
        block = codec.encode(values, level_adu=level, sigma_adu=sigma)
    except Exception as error:  # a plug-in may raise anything; it is reported by name
        raise PluginError(f"codec {type(codec).__name__}: {type(error).__name__}: {error}") from error
    if not isinstance(block, bytes):
        raise PluginError(f"codec {type(codec).__name__}: expected bytes, got {type(block).__name__}")
    return block
