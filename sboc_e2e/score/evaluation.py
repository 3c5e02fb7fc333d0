"""A run's truth and products brought together: what every score, plot and comparison starts from."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
from astropy.table import Table

from ground.ingest import decode_downlink
from ground.ingest.codecs import Ccsds121Decoder, PlanesDecoder, RawDecoder, SqrtPlanesDecoder
from sboc_e2e.icd.downlink import DownlinkFrame
from sboc_e2e.icd.errors import UserError
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.steps import Decoder
from sboc_e2e.score.bounds import CHANGE_POINT, TrailBounds, trail_bounds
from sboc_e2e.score.detection import FLUX_HELD, RoiFootprints
from sboc_e2e.score.matching import SNR_IGNORED, MeasuredStreak, TruthStreak, match_all
from sboc_e2e.score.trail import TruePath
from sboc_e2e.truth import dtype_of

SHIPPED_DECODERS: Final[tuple[Decoder, ...]] = (PlanesDecoder(), RawDecoder(), Ccsds121Decoder(), SqrtPlanesDecoder())


@dataclass(frozen=True, kw_only=True, eq=False)
class Evaluation:
    """Truth streaks, measured streaks and who is who.

    pairs : row of `streaks` -> truth streak. vetted_out : rows of `streaks` that carry VETOED (not counted as measured).
    bounds : by truth index, for truth with S/N >= 3 that was matched.
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

    @property
    def detected_onboard(self) -> set[int]:
        """Truth indices whose flux the ROIs hold."""
        return {i for i, share in self.footprints.captured.items() if share >= FLUX_HELD}

    @property
    def accepted(self) -> list[int]:
        """Rows of `streaks` that survived vetting."""
        return [i for i, flags in enumerate(self.streaks["flags"]) if not int(flags) & StreakFlag.VETOED]

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
        path = TruePath(
            row=np.asarray(t["path_row"], float),
            col=np.asarray(t["path_col"], float),
            flux_e_s=np.asarray(t["path_flux_e_s"], float),
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
                attainable_end_px=CHANGE_POINT * length_px / max(snr, 1.0) ** 2,
            )
        )
    return tuple(out)


def measured_streaks(table: Table) -> list[MeasuredStreak]:
    """Measured streaks of products/streaks.ecsv."""
    return [
        MeasuredStreak(
            index=i, frame=int(s["frame"]), ends=np.array([[s["row0"], s["col0"]], [s["row1"], s["col1"]]], dtype=float)
        )
        for i, s in enumerate(table)
    ]


def read_table(path: Path) -> Table:
    """A table of a run directory, or one clear line about what is missing."""
    if not path.is_file():
        raise UserError(f"{path}: not found; run the stage that writes it first")
    return Table.read(path, format="ascii.ecsv")


def read_truth(folder: Path) -> dict[str, Table]:
    """Truth tables a score needs; a table without the contract's columns is refused by name."""
    tables = {name: read_table(folder / f"{name}.ecsv") for name in ("frames", "streaks", "objects")}
    for name, table in tables.items():
        missing = [c for c in dtype_of(name).names or () if c not in table.colnames]
        if missing:
            raise UserError(f"{folder / name}.ecsv: lacks the columns {', '.join(missing)} (see sboc_e2e/truth.py)")
    return tables


def evaluate(run_dir: Path, truth_dir: Path | None = None, extra_decoders: Sequence[Decoder] = ()) -> Evaluation:
    """Read a finished run and match it with its truth (or with external truth tables).

    extra_decoders : of codecs that do not come with the project.
    """
    manifest = json.loads((run_dir / "manifest.json").read_text())
    truth_tables = read_truth(truth_dir or run_dir / "truth")
    products = {name: read_table(run_dir / "products" / f"{name}.ecsv") for name in ("streaks", "frames", "orbits", "tracklets")}
    downlink = (run_dir / "downlink.bin").read_bytes()
    downlink_frames, _ = decode_downlink(downlink, (*SHIPPED_DECODERS, *extra_decoders))
    truth = truth_streaks(truth_tables["streaks"])
    shape = (int(products["frames"]["rows"][0]), int(products["frames"]["cols"][0])) if len(products["frames"]) else (1, 1)
    return assemble(truth, truth_tables, products, downlink, downlink_frames, shape, manifest)


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
    bounds = {t.index: trail_bounds(t.path, t.snr, shape) for t in pairs.values() if t.snr >= SNR_IGNORED}
    footprints = RoiFootprints(shape)
    by_frame: dict[int, list[TruthStreak]] = {}
    for t in truth:
        by_frame.setdefault(t.frame, []).append(t)
    for frame in downlink_frames:
        footprints.add_frame(frame.header.frame, frame.rois, by_frame.get(frame.header.frame, []))
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
