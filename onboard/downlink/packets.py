"""Packets of the downlink: records to bytes, by `sboc_e2e.icd.layout`. The ground half is `ground.ingest`.

Every function returns payloads; `PacketWriter` puts headers, sequence counts and checksums around them.
"""

import binascii
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import zstandard
from numpy.typing import NDArray

from onboard.downlink.codec.planes import encode_planes
from sboc_e2e.icd import layout
from sboc_e2e.icd.downlink import Housekeeping
from sboc_e2e.icd.errors import ContractError
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.signals import BackgroundModel, Detection, StarList, Strip, Track, TrackMember
from sboc_e2e.icd.tai import NS_PER_S
from sboc_e2e.icd.version import CONTRACT_MAJOR, CONTRACT_MINOR

SEQUENCE_MODULUS = 1 << 14  # packet sequence counts have 14 bits (CCSDS 133.0-B-2, 4.1.3.4)
MESH_CODE_LIMIT = 1 << 30
"""Mesh codes are 32 bits, and so are their differences; no sky is further from the dark in units of its noise."""

STARS_PER_PACKET = 100
"""Stars are dealt out in turn over packets of at most this many, so that a lost packet takes a fair share only."""


@dataclass(frozen=True, kw_only=True)
class PacketWriter:
    """Headers, counts and checksums. Immutable: `write` returns the packet and the writer that comes after it.

    counts : next sequence count of each APID, 14 bits (CCSDS 133.0-B-2, 4.1.3.4.3).
    """

    run_id: int
    counts: Mapping[int, int] = field(default_factory=dict)

    def write(
        self, apid: layout.Apid, header: FrameHeader, payloads: Sequence[bytes], *, item: int = 0
    ) -> tuple[tuple[bytes, ...], "PacketWriter"]:
        """One packet for each payload: the segments of one item."""
        count = self.counts.get(int(apid), 0)
        packets = tuple(
            _packet(apid, (count + k) % SEQUENCE_MODULUS, self.run_id, header, item, k, len(payloads), payload)
            for k, payload in enumerate(payloads)
        )
        after = {**self.counts, int(apid): (count + len(payloads)) % SEQUENCE_MODULUS}
        return packets, replace(self, counts=after)


def _packet(
    apid: int, count: int, run_id: int, header: FrameHeader, item: int, segment: int, n_segments: int, payload: bytes
) -> bytes:
    """A complete space packet (CCSDS 133.0-B-2, 4.1), unsegmented in the sense of the standard (sequence flags 3)."""
    if len(payload) > layout.MAX_PAYLOAD_BYTES:
        raise ContractError(f"packet payload: expected at most {layout.MAX_PAYLOAD_BYTES} bytes, got {len(payload)}")
    seconds, rest_ns = divmod(header.t_start_tai_ns, NS_PER_S)
    body = b"".join(
        (
            layout.CUC_PREAMBLE,
            layout.CUC_TIME.pack(seconds, (rest_ns * (1 << 32) + NS_PER_S // 2) // NS_PER_S),
            layout.ITEM.pack(
                CONTRACT_MAJOR,
                CONTRACT_MINOR,
                run_id,
                header.frame,
                header.exposure_ns,
                header.line_time_ns,
                item,
                segment,
                n_segments,
            ),
            payload,
        )
    )
    primary = layout.PRIMARY.pack(0x0800 | apid, 0xC000 | count, len(body) + layout.CRC.size - 1)
    checked = primary + body
    return checked + layout.CRC.pack(binascii.crc_hqx(checked, layout.CRC_START))


def header_payload(
    header: FrameHeader,
    housekeeping: Housekeeping,
    previous: FrameHeader | None,
    *,
    adu_scale: float,
    adu_offset: float,
    psf_sigma_px: float | None,
) -> bytes:
    """Frame header, housekeeping, and the telemetry of this and of the previous frame."""
    fixed = layout.HEADER_FIXED.pack(
        header.rows,
        header.cols,
        header.bin_rows,
        header.bin_cols,
        header.window_row0,
        header.window_col0,
        _or_nan(header.gain_e_adu),
        _or_nan(header.read_noise_e),
        _or_nan(header.saturation_adu),
        _or_nan(header.temperature_k),
        adu_scale,
        adu_offset,
        int(housekeeping.flags) & 0xFFFF,
        housekeeping.n_stars_found,
        housekeeping.n_stars_sent,
        housekeeping.n_detections,
        housekeeping.n_rois_sent,
        housekeeping.n_rois_dropped,
        min(housekeeping.bytes_dropped, 0xFFFFFFFF),
        housekeeping.threshold_sigma,
        housekeeping.background_adu,
        housekeeping.sigma_adu,
        _or_nan(psf_sigma_px),
        housekeeping.n_masked,
    )
    work = layout.HEADER_WORK.pack(
        housekeeping.parameter_set,
        min(round(housekeeping.operations / 1000), 0xFFFFFFFF),
        housekeeping.shed_stars,
        housekeeping.shed_halos,
        housekeeping.shed_candidates,
        housekeeping.shed_points,
        housekeeping.shed_trails,
        housekeeping.shed_regions,
    )
    return fixed + telemetry_block(header) + telemetry_block(previous) + work


def telemetry_block(header: FrameHeader | None) -> bytes:
    """Attitude and observer state of a frame; all zero when there is no frame."""
    present, quaternion, rate, covariance = 0, (0.0,) * 4, (0.0,) * 3, (0.0,) * 6
    tai_ns, position, velocity, sigma_m, sigma_m_s = 0, (0.0,) * 3, (0.0,) * 3, 0.0, 0.0
    if header is not None and header.attitude is not None:
        present |= layout.HAS_ATTITUDE
        quaternion, rate = tuple(header.attitude.quaternion), tuple(header.attitude.rate_rad_s)
        covariance = tuple(header.attitude.covariance_rad2[np.triu_indices(3)])
    if header is not None and header.observer is not None:
        present |= layout.HAS_OBSERVER
        state = header.observer
        tai_ns, position, velocity = state.tai_ns, tuple(state.position_m), tuple(state.velocity_m_s)
        sigma_m, sigma_m_s = state.sigma_position_m, state.sigma_velocity_m_s
    frame = 0 if header is None else header.frame
    return layout.TELEMETRY.pack(
        present, frame, *quaternion, *rate, *covariance, tai_ns, *position, *velocity, sigma_m, sigma_m_s
    )


def star_payloads(stars: StarList) -> tuple[bytes, ...]:
    """The star list, dealt out in turn over packets of `STARS_PER_PACKET` at most; one empty packet for no star."""
    codes = np.zeros(len(stars), dtype=layout.STAR_DTYPE)
    for axis, position in (("row", stars.row), ("col", stars.col)):
        code = np.rint((position - layout.STAR_POSITION_OFFSET_PX) / layout.STAR_POSITION_UNIT_PX)
        code = np.clip(code, 0, (1 << 24) - 1).astype(np.int64)
        codes[f"{axis}_hi"] = code >> 16
        codes[f"{axis}_lo"] = code & 0xFFFF
    codes["flux"] = _log_code(stars.flux_e, layout.STAR_FLUX_CODES_PER_OCTAVE, 0xFFFF)
    codes["snr"] = _log_code(stars.snr, layout.STAR_SNR_CODES_PER_OCTAVE, 0xFF)
    codes["flags"] = stars.flags
    n_packets = max(1, math.ceil(len(stars) / STARS_PER_PACKET))
    return tuple(codes[k::n_packets].tobytes() for k in range(n_packets))


def roi_payload(detection: Detection, strip: Strip, codec_number: int, sigma_adu: float, block: bytes) -> bytes:
    """One strip of a ROI group with the detection it belongs to."""
    n, width = strip.values_adu.shape
    group = layout.ROI_GROUP.pack(
        detection.row0,
        detection.col0,
        detection.row1,
        detection.col1,
        detection.snr,
        int(detection.flags) & 0xFFFF,
        detection.sagitta_px,
    )
    head = layout.STRIP.pack(
        codec_number,
        strip.axis,
        strip.major0,
        n,
        width,
        strip.minor0_fp,
        strip.slope_fp,
        strip.level_adu,
        sigma_adu,
        len(block),
    )
    return group + head + block


def track_payload(track: Track, member: TrackMember, t_start_tai_ns: int, roi_id: int, region: bytes = b"") -> bytes:
    """A member of a track. roi_id : number of its region, if that was sent; region : else the payload of one strip's ROI
    packet."""
    head = layout.TRACK_MEMBER.pack(track.number, member.frame, t_start_tai_ns, track.snr, roi_id, len(track.members), 0)
    return head + region


def background_payloads(background: BackgroundModel, *, level_unit_adu: float, sigma_unit_adu: float) -> tuple[bytes, ...]:
    """The background mesh in bands of rows that fit into one packet each."""
    level, sigma = (
        np.clip(np.rint(values / unit), -MESH_CODE_LIMIT, MESH_CODE_LIMIT).astype(np.int32)
        for values, unit in ((background.level_adu, level_unit_adu), (background.sigma_adu, sigma_unit_adu))
    )

    def band(first: int, last: int) -> bytes:
        centres = [int(np.median(codes[first:last])) for codes in (level, sigma)]
        blocks = [encode_planes(codes[first:last], centre) for codes, centre in zip((level, sigma), centres, strict=True)]
        head = layout.MESH.pack(
            background.tile_px, *level.shape, first, last - first, level_unit_adu, sigma_unit_adu, *centres, len(blocks[0])
        )
        return head + blocks[0] + blocks[1]

    return _in_bands(len(level), band, f"background mesh: a row of {level.shape[1]} nodes")


def thumbnail_payloads(cells: NDArray[np.uint8], *, cell_px: int, offset_adu: float, unit_adu: float) -> tuple[bytes, ...]:
    """A thumbnail (rows, cols) of uint8 in bands of rows that fit into one packet each."""
    compressor = zstandard.ZstdCompressor(level=3)

    def band(first: int, last: int) -> bytes:
        head = layout.THUMBNAIL.pack(*cells.shape, cell_px, first, last - first, offset_adu, unit_adu)
        return head + compressor.compress(np.ascontiguousarray(cells[first:last]).tobytes())

    return _in_bands(len(cells), band, f"thumbnail: a row of {cells.shape[1]} cells")


def _in_bands(n_rows: int, payload: Callable[[int, int], bytes], row: str) -> tuple[bytes, ...]:
    """Payloads of the bands from one row to another; all rows at first, halved until each fits into a packet."""
    done, waiting = list[bytes](), [(0, n_rows)]
    while waiting:
        first, last = waiting.pop()
        made = payload(first, last)
        if len(made) <= layout.MAX_PAYLOAD_BYTES:
            done.append(made)
        elif last - first == 1:
            raise ContractError(f"{row} does not fit into a packet")
        else:
            middle = (first + last) // 2
            waiting += [(middle, last), (first, middle)]
    return tuple(done)


def chunk_payload(
    window: tuple[int, int, int, int], codec_number: int, *, level_adu: int, sigma_adu: float, block: bytes
) -> bytes:
    """A rectangle (first row, rows, first col, cols) of a whole frame."""
    return layout.CHUNK.pack(codec_number, 0, *window, level_adu, sigma_adu, len(block)) + block


def _or_nan(value: float | None) -> float:
    return math.nan if value is None else value


def _log_code(values: NDArray[np.float32], codes_per_octave: float, largest: int) -> NDArray[np.int64]:
    """Logarithmic code of non-negative values: rint(codes_per_octave * log2(1 + value)), clipped."""
    code = np.rint(codes_per_octave * np.log2(1.0 + np.maximum(values.astype(np.float64), 0.0)))
    return np.clip(code, 0, largest).astype(np.int64)
