"""Payloads to records: the inverse of `onboard.downlink.packets`, field by field as ICD.md has it.

Every announced length is checked against the payload before it is used. An invalid payload raises `ContractError`.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ground.ingest.codecs import decode_planes, inflate
from ground.ingest.packets import Packet
from sboc_e2e.icd import layout
from sboc_e2e.icd.downlink import Housekeeping
from sboc_e2e.icd.errors import ContractError, PluginError
from sboc_e2e.icd.flags import FrameFlag, StreakFlag
from sboc_e2e.icd.frame import AttitudeEstimate, FrameHeader, ObserverState
from sboc_e2e.icd.signals import Detection, StarList, Strip
from sboc_e2e.icd.steps import Decoder

Decoders = Mapping[int, Decoder]
LARGEST_TABLE = 1 << 16
"""Nodes of a background mesh or cells of a thumbnail."""

LARGEST_UNIT_ADU = 1e9
"""Bound of the step of levels that keeps products of it with 16-bit counts finite; no camera comes near."""
LARGEST_TRACK = 2**31 - 1
"""Fixed by ICD.md: the number of a track fits a signed 32-bit integer."""
MEMORY_FLOOR_BYTES = 1 << 27
"""128 MiB: a short stream may still hold a whole frame of 4096 x 4096 as int32 (64 MiB) and a copy."""
MEMORY_PER_STREAM_BYTE = 40
"""Noise expands about tenfold when it is decoded; a stream that claims much more is not a downlink."""


@dataclass(kw_only=True)
class MemoryLimit:
    """Bytes that decoded records may still take."""

    left_bytes: int

    @classmethod
    def for_stream(cls, n_bytes: int) -> "MemoryLimit":
        """128 MiB, and 40 bytes for each byte of the stream."""
        return cls(left_bytes=MEMORY_FLOOR_BYTES + MEMORY_PER_STREAM_BYTE * n_bytes)

    def take(self, n_bytes: int) -> None:
        """Account for an array; refuse it when the limit is reached."""
        if n_bytes > self.left_bytes:
            raise ContractError(f"decoded data beyond the memory limit: {n_bytes} bytes wanted, {self.left_bytes} left")
        self.left_bytes -= n_bytes


@dataclass(frozen=True, kw_only=True, eq=False)
class Telemetry:
    """Attitude and observer state as telemetered for a frame."""

    frame: int
    attitude: AttitudeEstimate | None
    observer: ObserverState | None


@dataclass(frozen=True, kw_only=True, eq=False)
class HeaderRecord:
    """A header packet."""

    header: FrameHeader
    housekeeping: Housekeeping
    previous: Telemetry | None
    adu_scale: float
    adu_offset: float
    psf_sigma_px: float | None


@dataclass(frozen=True, kw_only=True, eq=False)
class StripRecord:
    """A ROI packet: detection and one strip."""

    detection: Detection
    strip: Strip


@dataclass(frozen=True, kw_only=True, eq=False)
class TrackRecord:
    """A track packet: a member of a track in a frame, by its region's number or with one of its strips."""

    number: int
    frame: int
    t_start_tai_ns: int
    snr: float
    roi_id: int | None
    strip: StripRecord | None


@dataclass(frozen=True, kw_only=True, eq=False)
class MeshBand:
    """Rows of the background mesh."""

    tile_px: int
    shape: tuple[int, int]
    first: int
    level_adu: NDArray[np.float32]
    sigma_adu: NDArray[np.float32]


@dataclass(frozen=True, kw_only=True, eq=False)
class ThumbnailBand:
    """Rows of the thumbnail, ADU above the dark."""

    shape: tuple[int, int]
    cell_px: int
    first: int
    cells_adu: NDArray[np.float32]


@dataclass(frozen=True, kw_only=True, eq=False)
class Chunk:
    """A rectangle of a whole frame."""

    row: int
    col: int
    values: NDArray[np.int32] | NDArray[np.float32]


Record = HeaderRecord | NDArray[np.void] | StripRecord | TrackRecord | MeshBand | ThumbnailBand | Chunk


def decode_record(packet: Packet, decoders: Decoders, memory: MemoryLimit) -> Record:
    """The record of any packet, within a memory limit."""
    if packet.apid == layout.Apid.HEADER:
        return decode_header(packet)
    if packet.apid == layout.Apid.STARS:
        return decode_stars(packet)
    if packet.apid == layout.Apid.ROI:
        strip = decode_strip(packet, decoders)
        memory.take(strip.strip.values_adu.nbytes)
        return strip
    if packet.apid == layout.Apid.TRACK:
        track = decode_track(packet, decoders)
        if track.strip is not None:
            memory.take(track.strip.strip.values_adu.nbytes)
        return track
    if packet.apid == layout.Apid.BACKGROUND:
        mesh = decode_mesh(packet)
        memory.take(8 * mesh.shape[0] * mesh.shape[1])
        return mesh
    if packet.apid == layout.Apid.THUMBNAIL:
        band = decode_thumbnail(packet)
        memory.take(4 * band.shape[0] * band.shape[1])
        return band
    chunk = decode_chunk(packet, decoders)
    memory.take(chunk.values.nbytes)
    return chunk


def _unpack(layout_struct: Any, payload: bytes, what: str, offset: int = 0) -> tuple[Any, ...]:
    """Fields at an offset, if the payload is long enough."""
    if len(payload) < offset + layout_struct.size:
        raise ContractError(f"{what}: expected at least {offset + layout_struct.size} bytes, got {len(payload)}")
    fields: tuple[Any, ...] = layout_struct.unpack_from(payload, offset)
    return fields


def _known(value: float) -> float | None:
    """NaN means unknown."""
    return None if math.isnan(value) else value


def decode_header(packet: Packet) -> HeaderRecord:
    """Header packet to frame header, housekeeping and the previous frame's telemetry."""
    expected = layout.HEADER_FIXED.size + 2 * layout.TELEMETRY.size
    whole = expected + layout.HEADER_WORK.size
    if len(packet.payload) not in (expected, whole):  # contracts before 2.4 end with the telemetry
        raise ContractError(f"header packet: expected {whole} bytes, got {len(packet.payload)}")
    work = layout.HEADER_WORK.unpack_from(packet.payload, expected) if len(packet.payload) == whole else (0,) * 8
    (
        rows, cols, bin_rows, bin_cols, window_row0, window_col0, gain, read_noise, saturation, temperature,
        adu_scale, adu_offset, flags, stars_found, stars_sent, detections, rois_sent, rois_dropped, bytes_dropped,
        threshold, background, sigma, psf_sigma, n_masked,
    ) = layout.HEADER_FIXED.unpack_from(packet.payload)  # fmt: skip
    if not (math.isfinite(adu_scale) and adu_scale > 0.0 and math.isfinite(adu_offset)):
        raise ContractError(f"header packet: expected a positive ADU scale, got {adu_scale} and offset {adu_offset}")
    own = decode_telemetry(packet.payload, layout.HEADER_FIXED.size)
    before = decode_telemetry(packet.payload, layout.HEADER_FIXED.size + layout.TELEMETRY.size)
    header = FrameHeader(
        frame=packet.frame,
        t_start_tai_ns=packet.t_start_tai_ns,
        exposure_ns=packet.exposure_ns,
        line_time_ns=packet.line_time_ns,
        rows=rows,
        cols=cols,
        bin_rows=bin_rows,
        bin_cols=bin_cols,
        window_row0=window_row0,
        window_col0=window_col0,
        gain_e_adu=_known(gain),
        read_noise_e=_known(read_noise),
        saturation_adu=_known(saturation),
        attitude=own.attitude,
        observer=own.observer,
        temperature_k=_known(temperature),
    )
    housekeeping = Housekeeping(
        flags=FrameFlag(flags & 0xFFFF),
        n_stars_found=stars_found,
        n_stars_sent=stars_sent,
        n_detections=detections,
        n_rois_sent=rois_sent,
        n_rois_dropped=rois_dropped,
        bytes_dropped=bytes_dropped,
        threshold_sigma=threshold,
        background_adu=background,
        sigma_adu=sigma,
        n_masked=n_masked,
        parameter_set=work[0],
        operations=1000 * work[1],
        shed_stars=work[2],
        shed_halos=work[3],
        shed_candidates=work[4],
        shed_points=work[5],
        shed_trails=work[6],
        shed_regions=work[7],
    )
    has_previous = before.attitude is not None or before.observer is not None
    return HeaderRecord(
        header=header,
        housekeeping=housekeeping,
        previous=before if has_previous else None,
        adu_scale=adu_scale,
        adu_offset=adu_offset,
        psf_sigma_px=psf_sigma if 0.0 < psf_sigma < 1e3 else None,
    )


def decode_telemetry(payload: bytes, offset: int) -> Telemetry:
    """One telemetry block."""
    fields = _unpack(layout.TELEMETRY, payload, "telemetry", offset)
    present, frame = fields[0], fields[1]
    attitude, observer = None, None
    if present & layout.HAS_ATTITUDE:
        if not all(abs(component) <= 2.0 for component in fields[2:6]):
            raise ContractError(f"telemetry: expected a unit quaternion, got {fields[2:6]}")
        covariance = np.empty((3, 3))
        upper = np.triu_indices(3)
        covariance[upper] = fields[9:15]
        covariance.T[upper] = fields[9:15]
        attitude = AttitudeEstimate(
            quaternion=np.array(fields[2:6]), rate_rad_s=np.array(fields[6:9]), covariance_rad2=covariance
        )
    if present & layout.HAS_OBSERVER:
        observer = ObserverState(
            tai_ns=fields[15],
            position_m=np.array(fields[16:19]),
            velocity_m_s=np.array(fields[19:22]),
            sigma_position_m=fields[22],
            sigma_velocity_m_s=fields[23],
        )
    return Telemetry(frame=frame, attitude=attitude, observer=observer)


def decode_stars(packet: Packet) -> NDArray[np.void]:
    """Entries of a star packet, as they are coded."""
    if len(packet.payload) % layout.STAR_DTYPE.itemsize:
        raise ContractError(
            f"star packet: expected whole entries of {layout.STAR_DTYPE.itemsize} bytes, got {len(packet.payload)}"
        )
    return np.frombuffer(packet.payload, dtype=layout.STAR_DTYPE)


def star_list(entries: NDArray[np.void]) -> StarList:
    """Coded entries to a star list by falling flux."""
    position = {
        axis: layout.STAR_POSITION_OFFSET_PX
        + layout.STAR_POSITION_UNIT_PX * (entries[f"{axis}_hi"].astype(np.int64) << 16 | entries[f"{axis}_lo"])
        for axis in ("row", "col")
    }
    flux = np.exp2(entries["flux"] / layout.STAR_FLUX_CODES_PER_OCTAVE) - 1.0
    order = np.lexsort((position["col"], position["row"], -flux))
    return StarList(
        row=position["row"][order],
        col=position["col"][order],
        flux_e=flux[order].astype(np.float32),
        snr=(np.exp2(entries["snr"] / layout.STAR_SNR_CODES_PER_OCTAVE) - 1.0)[order].astype(np.float32),
        flags=entries["flags"][order],
    )


def decode_track(packet: Packet, decoders: Decoders) -> TrackRecord:
    """A track packet."""
    number, frame, t_start, snr, roi_id, _, _ = _unpack(layout.TRACK_MEMBER, packet.payload, "track packet")
    rest = packet.payload[layout.TRACK_MEMBER.size :]
    follows = roi_id == layout.TRACK_STRIP_FOLLOWS
    if not math.isfinite(snr) or number > LARGEST_TRACK or not (follows or (0 <= roi_id <= 0xFFFF and not rest)):
        raise ContractError(
            f"track packet: expected a region's number or a strip, got track {number}, region {roi_id}, S/N {snr}"
        )
    strip = _strip(rest, decoders) if follows else None
    return TrackRecord(
        number=number, frame=frame, t_start_tai_ns=t_start, snr=snr, roi_id=None if follows else roi_id, strip=strip
    )


def decode_strip(packet: Packet, decoders: Decoders) -> StripRecord:
    """A ROI packet."""
    return _strip(packet.payload, decoders)


def _strip(payload: bytes, decoders: Decoders) -> StripRecord:
    """Detection and strip of a ROI packet's payload."""
    row0, col0, row1, col1, snr, flags, sagitta = _unpack(layout.ROI_GROUP, payload, "roi packet")
    codec, axis, major0, n, width, minor0_fp, slope_fp, level, sigma, length = _unpack(
        layout.STRIP, payload, "roi packet", layout.ROI_GROUP.size
    )
    block = payload[layout.ROI_GROUP.size + layout.STRIP.size :]
    if len(block) != length:
        raise ContractError(f"roi packet: expected a block of {length} bytes, got {len(block)}")
    values = decode_block(block, codec, (n, width), level, sigma, decoders)
    detection = Detection(row0=row0, col0=col0, row1=row1, col1=col1, snr=snr, sagitta_px=sagitta, flags=StreakFlag(flags))
    strip = Strip(axis=axis, major0=major0, minor0_fp=minor0_fp, slope_fp=slope_fp, level_adu=level, values_adu=values)
    return StripRecord(detection=detection, strip=strip)


def decode_block(
    block: bytes, codec: int, shape: tuple[int, int], level: int, sigma: float, decoders: Decoders
) -> NDArray[np.int32] | NDArray[np.float32]:
    """A codec's block; a decoder that raises anything but `ContractError`, or returns nonsense, is named."""
    decoder = decoders.get(codec)
    if decoder is None:
        raise ContractError(f"codec number {codec}: no decoder; known are {sorted(decoders)}")
    if not 0 < shape[0] * shape[1] <= layout.MAX_STRIP_PIXELS or not (math.isfinite(sigma) and sigma >= 0.0):
        raise ContractError(f"block: expected 1 to {layout.MAX_STRIP_PIXELS} pixels and a noise, got {shape} and {sigma}")
    try:
        values = decoder.decode(block, shape, level_adu=level, sigma_adu=sigma)
    except ContractError:
        raise
    except Exception as error:  # a plug-in may raise anything; it is reported by name
        raise PluginError(f"ground.decoder {type(decoder).__name__}: {type(error).__name__}: {error}") from error
    if getattr(values, "shape", None) != shape or values.dtype not in (np.int32, np.float32):
        raise PluginError(f"ground.decoder {type(decoder).__name__}: expected int32 or float32 of shape {shape}")
    return values


def decode_mesh(packet: Packet) -> MeshBand:
    """A background packet."""
    tile, rows, cols, first, n_rows, level_unit, sigma_unit, level_centre, sigma_centre, level_bytes = _unpack(
        layout.MESH, packet.payload, "background packet"
    )
    _check_band("background packet", rows, cols, first, n_rows)
    if tile == 0 or not (0.0 < level_unit <= LARGEST_UNIT_ADU and 0.0 < sigma_unit <= LARGEST_UNIT_ADU):
        raise ContractError(f"background packet: expected a tile size and units, got {tile}, {level_unit}, {sigma_unit}")
    blocks = packet.payload[layout.MESH.size :]
    shape = (n_rows, cols)
    level = decode_planes(blocks[:level_bytes], shape, level_centre)
    sigma = decode_planes(blocks[level_bytes:], shape, sigma_centre)
    return MeshBand(
        tile_px=tile,
        shape=(rows, cols),
        first=first,
        level_adu=(level * np.float64(level_unit)).astype(np.float32),
        sigma_adu=(sigma * np.float64(sigma_unit)).astype(np.float32),
    )


def decode_thumbnail(packet: Packet) -> ThumbnailBand:
    """A thumbnail packet."""
    rows, cols, cell, first, n_rows, offset, unit = _unpack(layout.THUMBNAIL, packet.payload, "thumbnail packet")
    _check_band("thumbnail packet", rows, cols, first, n_rows)
    if cell == 0 or not (0.0 < unit <= LARGEST_UNIT_ADU and abs(offset) <= 1e3 * LARGEST_UNIT_ADU):
        raise ContractError(f"thumbnail packet: expected a cell size and units, got {cell}, {offset}, {unit}")
    plain = inflate(packet.payload[layout.THUMBNAIL.size :], n_rows * cols)
    cells = np.frombuffer(plain, dtype=np.uint8).reshape(n_rows, cols)
    return ThumbnailBand(
        shape=(rows, cols), cell_px=cell, first=first, cells_adu=(offset + unit * cells.astype(np.float64)).astype(np.float32)
    )


def decode_chunk(packet: Packet, decoders: Decoders) -> Chunk:
    """A packet of a whole frame."""
    codec, _, row, n_rows, col, n_cols, level, sigma, length = _unpack(layout.CHUNK, packet.payload, "frame packet")
    block = packet.payload[layout.CHUNK.size :]
    if len(block) != length:
        raise ContractError(f"frame packet: expected a block of {length} bytes, got {len(block)}")
    return Chunk(row=row, col=col, values=decode_block(block, codec, (n_rows, n_cols), level, sigma, decoders))


def _check_band(what: str, rows: int, cols: int, first: int, n_rows: int) -> None:
    """Whether rows first ... first + n_rows - 1 lie inside a table of a reasonable size."""
    if not (0 < rows * cols <= LARGEST_TABLE and n_rows > 0 and first + n_rows <= rows):
        raise ContractError(f"{what}: rows {first} to {first + n_rows - 1} of a table of {rows} x {cols}")
