"""The shards of a survey, read back as columns."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd.errors import UserError
from sboc_e2e.survey.block import ALTITUDE_EDGES_KM, CLASS_EDGES_M, IDS_PER_BLOCK, INCLINATION_EDGES_DEG, KINDS
from sboc_e2e.survey.engine import IDENTITY

Array = NDArray[np.float64]

ESTIMATED: tuple[str, ...] = ("tracklet_id", "size_m", "altitude_km", "i_deg", "n_frames", "mag")


@dataclass(frozen=True, kw_only=True, eq=False)
class Survey:
    """What a survey holds. measured, true : columns of its tracklets by name; block (n,) : of each.

    crossings (sizes, altitudes, inclinations) : passages that could be seen; days : watched.
    """

    measured: dict[str, Array]
    true: dict[str, Array]
    block: NDArray[np.int64]
    crossings_by_block: dict[int, Array]
    watched_days: float
    span_days: float
    content: dict[str, Any]

    @property
    def crossings(self) -> Array:
        """Passages of all blocks."""
        return np.asarray(np.sum(list(self.crossings_by_block.values()), axis=0))


def read_survey(folder: Path) -> Survey:
    """Read the finished blocks of a survey. Raises `UserError` where there is none."""
    if not (folder / IDENTITY).is_file():
        raise UserError(f"{folder}: no survey; `sboc survey SCENARIO --out {folder}` makes one")
    content = json.loads((folder / IDENTITY).read_text(encoding="utf-8"))
    files = sorted((folder / "sums").glob("*.json"))
    if not files:
        raise UserError(f"{folder}: no block of the survey is finished; the same command goes on with it")
    sums = [json.loads(path.read_text(encoding="utf-8")) for path in files]
    blocks = [int(s["block"]) for s in sums]
    measured = _columns(folder / "tracklets", blocks, ESTIMATED)
    true = _columns(folder / "truth", blocks, ("kind", "size_m", "altitude_km", "i_deg"))
    # objects with names are known: they are no sample of the population
    sampled = true["kind"] <= KINDS.index("false")
    measured = {name: values[sampled] for name, values in measured.items()}
    true = {name: values[sampled] for name, values in true.items()}
    return Survey(
        measured=measured,
        true=true,
        block=(measured["tracklet_id"] // IDS_PER_BLOCK).astype(np.int64),
        crossings_by_block={int(s["block"]): np.array(s["crossings"], dtype=np.float64) for s in sums},
        watched_days=sum(s["watched_s"] for s in sums) / 86_400.0,
        span_days=sum(s["span_s"] for s in sums) / 86_400.0,
        content=content,
    )


def _columns(folder: Path, blocks: list[int], names: tuple[str, ...]) -> dict[str, Array]:
    """Columns of the shards of blocks, as floats of half the width where they were that."""
    from pyarrow import parquet

    parts: dict[str, list[Any]] = {name: [] for name in names}
    for block in blocks:
        table = parquet.read_table(folder / f"{block:06d}.parquet", columns=list(names), use_threads=False)
        for name in names:
            parts[name].append(table[name].to_numpy())
    return {name: np.concatenate(values) for name, values in parts.items()}


def cells(size_m: Array, altitude_km: Array, i_deg: Array) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Class of each size (-1: none is known), altitude and inclination; what lies beyond the edges is in the outermost."""

    def place(value: Array, edges: tuple[float, ...]) -> NDArray[np.int64]:
        return np.clip(np.searchsorted(edges, value, side="right") - 1, 0, len(edges) - 2).astype(np.int64)

    size = np.where(np.isfinite(size_m), place(np.nan_to_num(size_m), CLASS_EDGES_M), -1)
    return size, place(altitude_km, ALTITUDE_EDGES_KM), place(i_deg, INCLINATION_EDGES_DEG)
