"""Records of a frame put together; what a lost header held is taken from other packets of the run."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ground.ingest.records import Chunk, HeaderRecord, MeshBand, StripRecord, Telemetry, ThumbnailBand, star_list
from sboc_e2e.icd.downlink import DownlinkFrame
from sboc_e2e.icd.errors import ContractError
from sboc_e2e.icd.flags import FrameFlag
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.signals import BackgroundModel, RoiGroup, StarList


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


def assemble(parts: Sequence[FrameParts]) -> tuple[tuple[DownlinkFrame, ...], tuple[int, ...]]:
    """Frames in the order given, and the numbers of those that no header of the run lets one build."""
    known = [part for part in parts if part.header is not None]
    telemetry = {part.header.previous.frame: part.header.previous for part in known if part.header and part.header.previous}
    frames: list[DownlinkFrame] = []
    unusable: list[int] = []
    for part in parts:
        record = part.header or _rebuilt_header(part, known, telemetry)
        if record is None:
            unusable.append(part.frame)
        else:
            frames.append(_frame(part, record))
    return tuple(frames), tuple(unusable)


def _rebuilt_header(part: FrameParts, known: Sequence[FrameParts], telemetry: dict[int, Telemetry]) -> HeaderRecord | None:
    """A lost header from the nearest one of the run, this frame's own times, and the telemetry that is repeated later."""
    if not known:
        return None
    nearest = min(known, key=lambda other: (abs(other.frame - part.frame), other.frame)).header
    if nearest is None:
        return None
    repeated = telemetry.get(part.frame)
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


def _frame(part: FrameParts, record: HeaderRecord) -> DownlinkFrame:
    """A frame of its parts."""
    header = record.header
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
            )
        )
    stars = star_list(np.concatenate(part.stars)) if part.stars else StarList.empty()
    return DownlinkFrame(
        header=header,
        flags=flags,
        housekeeping=housekeeping,
        stars=stars,
        rois=tuple(groups),
        background=_mesh(part.mesh, header),
        thumbnail_adu=_thumbnail(part.thumbnail, header),
        whole_frame=_whole(part.chunks, header),
        adu_scale=record.adu_scale,
        adu_offset=record.adu_offset,
    )


def _absent(header: FrameHeader) -> FrameFlag:
    """Flags of telemetry that a rebuilt header lacks."""
    flags = FrameFlag(0)
    flags |= FrameFlag.NO_ATTITUDE if header.attitude is None else FrameFlag(0)
    flags |= FrameFlag.NO_OBSERVER if header.observer is None else FrameFlag(0)
    flags |= FrameFlag.GAIN_ASSUMED if header.gain_e_adu is None else FrameFlag(0)
    return flags


def _mesh(bands: Sequence[MeshBand], header: FrameHeader) -> BackgroundModel | None:
    """The background mesh; rows that did not arrive are those of the nearest one that did."""
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


def _whole(chunks: Sequence[Chunk], header: FrameHeader) -> NDArray[np.int32] | NDArray[np.float32] | None:
    """The whole frame if every pixel arrived; raw minus rounded dark, in transmitted units."""
    if not chunks or sum(chunk.values.size for chunk in chunks) != header.rows * header.cols:
        return None
    out = np.zeros((header.rows, header.cols), dtype=chunks[0].values.dtype)
    covered = np.zeros(out.shape, dtype=bool)
    for chunk in chunks:
        n_rows, n_cols = chunk.values.shape
        if chunk.row + n_rows > header.rows or chunk.col + n_cols > header.cols:
            raise ContractError(f"frame {header.frame}: a chunk lies outside the frame of {header.rows} x {header.cols} px")
        out[chunk.row : chunk.row + n_rows, chunk.col : chunk.col + n_cols] = chunk.values
        covered[chunk.row : chunk.row + n_rows, chunk.col : chunk.col + n_cols] = True
    return out if covered.all() else None
