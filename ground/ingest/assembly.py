"""Assembly of a frame from its records. The content of a lost header is taken from other packets of the run."""

from bisect import bisect_left
from collections.abc import Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ground.ingest.packets import Packet
from ground.ingest.records import (
    Chunk,
    HeaderRecord,
    MemoryLimit,
    MeshBand,
    Record,
    StripRecord,
    Telemetry,
    ThumbnailBand,
    TrackRecord,
    star_list,
)
from sboc_e2e.icd.downlink import DownlinkFrame
from sboc_e2e.icd.errors import ContractError
from sboc_e2e.icd.flags import FrameFlag, StarFlag
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.signals import BackgroundModel, RoiGroup, StarList

FIRST_TRACK_ROI = 1 << 16
"""Numbers from here on are for regions that came in track packets, by track. Numbers of ROI packets have 16 bits."""

AFTER_OWN = 1 << 16
"""Added to the segment of a strip that came later than its region: the region's own, numbered by 16 bits, go first."""


@dataclass(kw_only=True)
class FrameParts:
    """Decoded records of one frame. missing : packets known to be lacking, by kind."""

    frame: int
    t_start_tai_ns: int
    exposure_ns: int
    line_time_ns: int
    header: HeaderRecord | None = None
    stars: list[NDArray[np.void]] = field(default_factory=list)
    strips: dict[int, list[tuple[int, StripRecord]]] = field(default_factory=dict)
    n_strips: dict[int, int] = field(default_factory=dict)
    mesh: list[MeshBand] = field(default_factory=list)
    thumbnail: list[ThumbnailBand] = field(default_factory=list)
    chunks: list[Chunk] = field(default_factory=list)
    missing: dict[str, int] = field(default_factory=dict)
    members: list[tuple[int, int, int, TrackRecord]] = field(default_factory=list)
    """Track packets that this frame carried, with item, segment and number of segments; they may belong to earlier frames."""
    tracks: dict[int, tuple[int, float]] = field(default_factory=dict)
    """Number and joint S/N of the track of each region that is in one."""

    def add(self, packet: Packet, record: Record) -> None:
        """Store a record by its kind."""
        if isinstance(record, HeaderRecord):
            self.header = replace(record, header=replace(record.header, frame=self.frame))
        elif isinstance(record, StripRecord):
            self.strips.setdefault(packet.item, []).append((packet.segment, record))
        elif isinstance(record, TrackRecord):
            self.members.append((packet.item, packet.segment, packet.n_segments, record))
        elif isinstance(record, MeshBand):
            self.mesh.append(record)
        elif isinstance(record, ThumbnailBand):
            self.thumbnail.append(record)
        elif isinstance(record, Chunk):
            self.chunks.append(record)
        else:
            self.stars.append(record)


def is_of_track_only(roi_id: int) -> bool:
    """Whether a region is one of a track over several frames that the detector did not find in the frame alone."""
    return roi_id >= FIRST_TRACK_ROI


def with_tracks(parts: Sequence[FrameParts], failures: list[str]) -> None:
    """Put the members from track packets into their frames. Members of missing frames are listed.

    Strips in one item with the number of a region hold what that region lacks of the trail: they become strips of it.
    """
    frames = {(part.frame, part.t_start_tai_ns): part for part in parts}
    for carrier in parts:
        regions = {item: record.roi_id for item, _, _, record in carrier.members if record.roi_id is not None}
        for item, segment, n_segments, record in carrier.members:
            part = frames.get((record.frame, record.t_start_tai_ns))
            if part is None:
                failures.append(f"frame {carrier.frame} TRACK item {item}: frame {record.frame} of its member is not there")
                continue
            roi_id = regions.get(item, FIRST_TRACK_ROI + record.number)
            if record.strip is None and n_segments > 1:
                part.n_strips[roi_id] = part.n_strips.get(roi_id, 1) + n_segments - 1
            elif record.strip is not None:
                after = AFTER_OWN * (item in regions)
                part.strips.setdefault(roi_id, []).append((after + segment, record.strip))
                if item not in regions:
                    part.n_strips[roi_id] = n_segments
            if roi_id in part.strips:
                known = part.tracks.get(roi_id, (record.number, 0.0))
                part.tracks[roi_id] = (record.number, max(record.snr, known[1]))


def assemble(
    parts: Sequence[FrameParts], memory: MemoryLimit, failures: list[str], ambiguous: AbstractSet[int] = frozenset()
) -> tuple[tuple[DownlinkFrame, ...], tuple[int, ...]]:
    """Frames in the order given (by number), and the numbers of frames that cannot be built because no header of the run fits.

    ambiguous : numbers that several frames had, whose telemetry a later header may repeat for any of them.
    """
    headers = [part.header for part in parts if part.header is not None]
    numbers = [header.header.frame for header in headers]
    telemetry = {h.previous.frame: h.previous for h in headers if h.previous and h.previous.frame not in ambiguous}
    frames: list[DownlinkFrame] = []
    unusable: list[int] = []
    for part in parts:
        if part.header is not None:
            frames.append(_frame(part, part.header, memory, failures))
        elif headers:
            nearest = headers[_nearest(numbers, part.frame)]
            frames.append(_frame(part, _rebuilt_header(part, nearest, telemetry.get(part.frame)), memory, failures))
        else:
            unusable.append(part.frame)
    return tuple(frames), tuple(unusable)


def _nearest(numbers: Sequence[int], number: int) -> int:
    """Index of the nearest of sorted numbers."""
    after = bisect_left(numbers, number)
    candidates = [k for k in (after - 1, after) if 0 <= k < len(numbers)]
    return min(candidates, key=lambda k: abs(numbers[k] - number))


def _rebuilt_header(part: FrameParts, nearest: HeaderRecord, repeated: Telemetry | None) -> HeaderRecord:
    """A lost header from the nearest one of the run, this frame's own times, and the telemetry that is repeated later."""
    header = replace(
        nearest.header,
        frame=part.frame,
        t_start_tai_ns=part.t_start_tai_ns,
        exposure_ns=part.exposure_ns,
        line_time_ns=part.line_time_ns,
        attitude=repeated.attitude if repeated else None,
        observer=repeated.observer if repeated else None,
    )
    return replace(nearest, header=header)


def _frame(part: FrameParts, record: HeaderRecord, memory: MemoryLimit, failures: list[str]) -> DownlinkFrame:
    """A frame from its parts. A whole frame that cannot be assembled is listed."""
    header = record.header
    whole = None
    if part.chunks:
        try:
            whole = _whole(part.chunks, header, memory)
        except ContractError as error:
            failures.append(f"frame {part.frame} FRAME: {error}")
    housekeeping = part.header.housekeeping if part.header is not None else None
    flags = housekeeping.flags if housekeeping is not None else FrameFlag.HEADER_REBUILT | _absent(header)
    if part.missing:
        flags |= FrameFlag.PACKETS_MISSING
    groups = []
    for roi_id in sorted(part.strips):
        strips = [strip for _, strip in sorted(part.strips[roi_id], key=lambda pair: pair[0])]
        groups.append(
            RoiGroup(
                roi_id=roi_id,
                detection=strips[0].detection,
                strips=tuple(strip.strip for strip in strips),
                n_strips=part.n_strips[roi_id],
                track=part.tracks.get(roi_id, (-1, 0.0))[0],
                track_snr=part.tracks.get(roi_id, (-1, 0.0))[1],
            )
        )
    stars, remembered = _stars(part.stars)
    return DownlinkFrame(
        header=header,
        flags=flags,
        housekeeping=housekeeping,
        stars=stars,
        rois=tuple(groups),
        background=_mesh(part.mesh, header),
        thumbnail_adu=_thumbnail(part.thumbnail, header),
        whole_frame=whole,
        adu_scale=record.adu_scale,
        adu_offset=record.adu_offset,
        remembered=remembered,
        psf_sigma_px=part.header.psf_sigma_px if part.header is not None else None,
    )


def _stars(records: list[NDArray[np.void]]) -> tuple[StarList, StarList]:
    """Stars measured in the frame, and stars remembered from the frames before."""
    if not records:
        return StarList.empty(), StarList.empty()
    entries = np.concatenate(records)
    old = (entries["flags"] & int(StarFlag.REMEMBERED)) > 0
    return star_list(entries[~old]), star_list(entries[old])


def _absent(header: FrameHeader) -> FrameFlag:
    """Flags of telemetry that a rebuilt header lacks."""
    flags = FrameFlag(0)
    flags |= FrameFlag.NO_ATTITUDE if header.attitude is None else FrameFlag(0)
    flags |= FrameFlag.NO_OBSERVER if header.observer is None else FrameFlag(0)
    flags |= FrameFlag.GAIN_ASSUMED if header.gain_e_adu is None else FrameFlag(0)
    return flags


def _mesh(bands: Sequence[MeshBand], header: FrameHeader) -> BackgroundModel | None:
    """The background mesh. Rows that did not arrive repeat the nearest row that did."""
    if not bands:
        return None
    tile, shape = bands[0].tile_px, bands[0].shape
    fitting = [band for band in bands if (band.tile_px, band.shape) == (tile, shape)]
    if shape != (-(-header.rows // tile), -(-header.cols // tile)):
        return None
    level, sigma = np.zeros(shape, dtype=np.float32), np.ones(shape, dtype=np.float32)
    known = np.zeros(shape[0], dtype=bool)
    for band in fitting:
        rows = np.s_[band.first : band.first + len(band.level_adu)]
        level[rows], sigma[rows], known[rows] = band.level_adu, band.sigma_adu, True
    present = np.flatnonzero(known)
    nearest = present[np.abs(np.arange(shape[0])[:, None] - present).argmin(axis=1)]
    return BackgroundModel(tile_px=tile, level_adu=level[nearest], sigma_adu=sigma[nearest])


def _thumbnail(bands: Sequence[ThumbnailBand], header: FrameHeader) -> NDArray[np.float32] | None:
    """The thumbnail; NaN where rows did not arrive."""
    if not bands:
        return None
    cell, shape = bands[0].cell_px, bands[0].shape
    if shape != (-(-header.rows // cell), -(-header.cols // cell)):
        return None
    out = np.full(shape, np.nan, dtype=np.float32)
    for band in bands:
        if (band.cell_px, band.shape) == (cell, shape):
            out[band.first : band.first + len(band.cells_adu)] = band.cells_adu
    return out


def _whole(chunks: Sequence[Chunk], header: FrameHeader, memory: MemoryLimit) -> NDArray[np.int32] | NDArray[np.float32] | None:
    """The whole frame if every pixel arrived; raw minus rounded dark, in transmitted units."""
    if sum(chunk.values.size for chunk in chunks) != header.rows * header.cols:
        return None
    if any(c.row + c.values.shape[0] > header.rows or c.col + c.values.shape[1] > header.cols for c in chunks):
        raise ContractError(f"a chunk lies outside the frame of {header.rows} x {header.cols} px")
    memory.take(5 * header.rows * header.cols)
    out: NDArray[np.int32] | NDArray[np.float32] = np.zeros((header.rows, header.cols), dtype=np.int32)
    if any(chunk.values.dtype == np.float32 for chunk in chunks):
        out = np.zeros((header.rows, header.cols), dtype=np.float32)
    covered = np.zeros(out.shape, dtype=bool)
    for chunk in chunks:
        part = np.s_[chunk.row : chunk.row + chunk.values.shape[0], chunk.col : chunk.col + chunk.values.shape[1]]
        out[part], covered[part] = chunk.values, True
    return out if covered.all() else None
