"""A run's truth and products, matched: the common input of scores, plots and comparisons."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from astropy.table import Table

from ground.ingest import decode_downlink
from ground.ingest.codecs import Ccsds121Decoder, PlanesDecoder, RawDecoder, SqrtPlanesDecoder
from ground.ingest.rans import RansDecoder
from ground.ingest.report import IngestReport
from sboc_e2e.files import calibration_files, ecsv
from sboc_e2e.icd.downlink import DownlinkFrame
from sboc_e2e.icd.errors import UserError
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.steps import Decoder
from sboc_e2e.score.bounds import CHANGE_POINT, TrailBounds, trail_bounds
from sboc_e2e.score.detection import FLUX_HELD, RoiFootprints
from sboc_e2e.score.external_truth import Truth, checked, completed
from sboc_e2e.score.external_truth import read_table as read_external
from sboc_e2e.score.matching import SNR_IGNORED, MeasuredStreak, TruthStreak, match_all
from sboc_e2e.score.satnet import is_satnet, read_satnet
from sboc_e2e.score.trail import TruePath
from sboc_e2e.truth import PATH_NODES, dtype_of

SHIPPED_DECODERS: Final[tuple[Decoder, ...]] = (
    PlanesDecoder(),
    RawDecoder(),
    Ccsds121Decoder(),
    SqrtPlanesDecoder(),
    RansDecoder(),
)
NO_DECODER: Final = ": no decoder;"
"""How ingest says that nothing reads a codec's blocks."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Evaluation:
    """Truth streaks, measured streaks and who is who.

    pairs : row of `streaks` -> truth streak. vetted_out : rows of `streaks` that carry VETOED (not counted as measured).
    bounds : by truth index, for matched truth with S/N >= 3 whose S/N and flux are known.
    """

    shape: tuple[int, int]
    n_frames: int
    truth: tuple[TruthStreak, ...]
    truth_tables: dict[str, Table]
    streaks: Table
    frames: Table
    orbits: Table
    tracklets: Table
    pairs: dict[int, TruthStreak]
    bounds: dict[int, TrailBounds]
    footprints: RoiFootprints
    downlink: bytes
    downlink_frames: tuple[DownlinkFrame, ...]
    manifest: dict[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    """What a reader of the figures must know: packets that nothing could decode count as never sent."""

    @property
    def detected_onboard(self) -> set[int]:
        """Truth indices whose flux the ROIs hold."""
        return {i for i, share in self.footprints.captured.items() if share >= FLUX_HELD}

    @property
    def accepted(self) -> list[int]:
        """Rows of `streaks` that survived vetting."""
        return [i for i, flags in enumerate(self.streaks["flags"]) if not int(flags) & StreakFlag.VETOED]

    @property
    def measured(self) -> dict[int, TruthStreak]:
        """Row of `streaks` -> truth streak, of those whose position and light are judged: accepted, and their truth counted."""
        accepted = set(self.accepted)
        return {row: truth for row, truth in self.pairs.items() if truth.counted and row in accepted}

    @property
    def detected_ground(self) -> set[int]:
        """Truth indices matched by a measured streak after vetting."""
        accepted = set(self.accepted)
        return {truth.index for row, truth in self.pairs.items() if row in accepted}

    @property
    def false_rows(self) -> list[int]:
        """Rows of `streaks` that survived vetting and match no truth at all, duplicates included."""
        return [row for row in self.accepted if row not in self.pairs]


def truth_streaks(table: Table) -> tuple[TruthStreak, ...]:
    """Truth streaks of a table in the form of `sboc_e2e.truth.STREAKS`."""
    out = []
    for index, t in enumerate(table):
        length_px, snr = float(t["length_px"]), float(t["snr"])
        times = np.asarray(t["path_t_tai_ns"], np.int64)
        flux_known = bool(np.isfinite(t["path_flux_e_s"]).all())
        path = TruePath(
            row=np.asarray(t["path_row"], float),
            col=np.asarray(t["path_col"], float),
            flux_e_s=np.asarray(t["path_flux_e_s"], float) if flux_known else np.ones(PATH_NODES),
            duration_s=max(float(times[-1] - times[0]) * 1e-9, 1e-12),
            sigma_px=float(t["psf_sigma_px"]),
            edge0=bool(t["edge0"]),
            edge1=bool(t["edge1"]),
        )
        out.append(
            TruthStreak(
                index=index,
                frame=int(t["frame"]),
                object_id=int(t["object_id"]),
                path=path,
                snr=snr,
                length_px=length_px,
                rate_deg_s=float(t["rate_deg_s"]),
                attainable_end_px=CHANGE_POINT * length_px / max(snr, 1.0) ** 2 if np.isfinite(snr) else 0.0,
                flux_known=flux_known,
            )
        )
    return tuple(out)


def measured_streaks(table: Table) -> list[MeasuredStreak]:
    """Measured streaks of products/streaks.ecsv."""
    return [
        MeasuredStreak(
            index=i,
            frame=int(s["frame"]),
            ends=np.array([[s["row0"], s["col0"]], [s["row1"], s["col1"]]], dtype=float),
            middle=np.array([s["row_mid"], s["col_mid"]], dtype=float),
        )
        for i, s in enumerate(table)
    ]


def read_truth(folder: Path) -> Truth:
    """Truth tables a score needs; a table without the contract's columns is refused by name."""
    tables = {name: ecsv.read(folder / f"{name}.ecsv") for name in ("frames", "streaks", "objects")}
    for name, table in tables.items():
        missing = [c for c in dtype_of(name).names or () if c not in table.colnames]
        if missing:
            raise UserError(f"{folder / name}.ecsv: lacks the columns {', '.join(missing)} (see sboc_e2e/truth.py)")
    return tables


def evaluate(run_dir: Path, truth: Path | None = None, decoders: Sequence[Decoder] = ()) -> Evaluation:
    """Read a finished run and match it with its truth, or with truth from elsewhere.

    truth : a folder of our truth tables, one table of the columns `sboc_e2e.truth.EXTERNAL`, or SatNet annotations.
    decoders : of codecs from outside, or in place of a shipped one. Packets that no decoder can read are
    counted in the notes. Raises `UserError`.
    """
    manifest = json.loads((run_dir / "manifest.json").read_text())
    products = {name: ecsv.read(run_dir / "products" / f"{name}.ecsv") for name in ("streaks", "frames", "orbits", "tracklets")}
    downlink = (run_dir / "downlink.bin").read_bytes()
    run_id = manifest.get("stages", {}).get("ground", {}).get("run_id")
    given = {decoder.number for decoder in decoders}
    known = (*decoders, *(decoder for decoder in SHIPPED_DECODERS if decoder.number not in given))
    downlink_frames, ingest = decode_downlink(downlink, known, run_id=run_id)
    if truth is not None and not truth.exists():
        raise UserError(f"{truth}: not found; --truth takes a table, a folder of truth tables or of SatNet annotations")
    if truth is None or (truth.is_dir() and not is_satnet(truth)):
        truth_tables = read_truth(truth or run_dir / "truth")
    else:
        truth_tables = _from_elsewhere(truth, run_dir, products["frames"], downlink_frames, int(manifest["n_frames"]))
    shape = _shape(run_dir, products["frames"])
    streaks = truth_streaks(truth_tables["streaks"])
    made = assemble(streaks, truth_tables, products, downlink, downlink_frames, shape, manifest)
    return replace(made, notes=_notes(ingest))


def _notes(ingest: IngestReport) -> tuple[str, ...]:
    """What could not be decoded, in a sentence, the packets of codecs without a decoder apart."""
    if not ingest.n_decode_failures:
        return ()
    lines = (line for line in ingest.decode_failures if NO_DECODER in line)
    unread = sorted({line.rpartition("codec number ")[2].partition(":")[0] for line in lines})
    reason = f"no decoder for codec number {', '.join(unread)}" if unread else ingest.decode_failures[0]
    return (f"{ingest.n_decode_failures} packets could not be decoded ({reason}): what they hold counts as lost in every figure",)


def _shape(run_dir: Path, frames: Table) -> tuple[int, int]:
    """Rows and columns of the frames; the nominal camera's where no frame arrived."""
    if len(frames):
        return int(frames["rows"][0]), int(frames["cols"][0])
    camera = calibration_files.read_camera(run_dir / "calibration")
    return camera.rows, camera.cols


def _from_elsewhere(truth: Path, run_dir: Path, frames: Table, downlink_frames: Sequence[DownlinkFrame], n_frames: int) -> Truth:
    """Truth tables of a run from one table or from annotations."""
    if truth.is_dir():
        files = frames["file"] if "file" in frames.colnames else []
        exposure_s = {str(name): float(s) for name, s in zip(files, frames["exposure_s"], strict=True)} if len(files) else {}
        table = checked(read_satnet(truth, exposure_s), str(truth))
    else:
        table = read_external(truth)
    camera = calibration_files.read_camera(run_dir / "calibration")
    return completed(table, frames, downlink_frames, camera.psf_sigma_px, n_frames, str(truth))


def assemble(
    truth: tuple[TruthStreak, ...],
    truth_tables: dict[str, Table],
    products: dict[str, Table],
    downlink: bytes,
    downlink_frames: Sequence[DownlinkFrame],
    shape: tuple[int, int],
    manifest: dict[str, Any],
) -> Evaluation:
    """Match and bound; pure but for its arguments, so that synthetic runs can be scored."""
    matched = match_all(measured_streaks(products["streaks"]), list(truth))
    pairs = {row: truth[index] for row, index in matched.items()}
    bounds = {t.index: trail_bounds(t.path, t.snr, shape) for t in pairs.values() if t.snr >= SNR_IGNORED and t.flux_known}
    footprints = RoiFootprints()
    by_frame: dict[int, list[TruthStreak]] = {}
    for t in truth:
        by_frame.setdefault(t.frame, []).append(t)
    for frame in downlink_frames:
        number, size = frame.header.frame, (frame.header.rows, frame.header.cols)
        footprints.add_frame(number, size, frame.rois, by_frame.get(number, []))
    return Evaluation(
        shape=shape,
        n_frames=len(truth_tables["frames"]),
        truth=truth,
        truth_tables=truth_tables,
        streaks=products["streaks"],
        frames=products["frames"],
        orbits=products["orbits"],
        tracklets=products["tracklets"],
        pairs=pairs,
        bounds=bounds,
        footprints=footprints,
        downlink=downlink,
        downlink_frames=tuple(downlink_frames),
        manifest=manifest,
    )
