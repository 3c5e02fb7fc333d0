"""SatNet annotations, the truth that SatSim writes beside its frames, as a table of the columns `sboc_e2e.truth.EXTERNAL`.

One JSON file for each frame, named like it: ``data.file.filename`` and ``data.sensor.height/width``; in ``data.objects``
places from 0 to 1 of the image between its outer edges, y downwards with the row: row = y * height - 0.5, col = x * width
- 0.5 (ssc-ai/satsim, satsim/io/satnet.py, ``_annotate_object``). Objects of class 1 are satellites, class 2 stars.
"""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from astropy.table import Table

from sboc_e2e.icd.errors import UserError

SATELLITE: Final = 1  # `class_id` of satellites; 2 are stars (satsim/io/satnet.py).
MAX_BYTES: Final = 64 << 20  # 64 MiB for the annotations of one frame. Chosen: keeps a wrong path from filling the memory.
ENDS: Final = ("y_start", "x_start", "y_end", "x_end")


def is_satnet(folder: Path) -> bool:
    """Whether a folder holds annotations, in itself or in its folder Annotations, and no truth tables."""
    return not (folder / "streaks.ecsv").exists() and bool(_files(folder))


def read_satnet(folder: Path, exposure_s: Mapping[str, float]) -> Table:
    """Satellites of all annotations as an external table. Raises `UserError` for what is not such a file.

    exposure_s : exposure of each FITS file of the run by name, for fluxes; annotations of other files are refused later.
    """
    columns: dict[str, list[Any]] = {name: [] for name in (
        "file", "object", "row0", "col0", "row1", "col1", "row_mid", "col_mid", "flux_e", "mag"
    )}  # fmt: skip
    for path in _files(folder):
        data = _data(path)
        name = _file_name(data, path)
        height, width = (_number(_table(data, "sensor", path), key, path, "data.sensor") for key in ("height", "width"))
        objects = data.get("objects")
        if not isinstance(objects, list):
            raise UserError(f"{path}: data.objects is not a list; expected SatNet annotations")
        for index, item in enumerate(objects):
            where = f"data.objects[{index}]"
            if not isinstance(item, dict):
                raise UserError(f"{path}: {where} is not an object; expected SatNet annotations")
            if item.get("class_id", SATELLITE) != SATELLITE:
                continue
            y0, x0, y1, x1 = (_number(item, key, path, where) for key in ENDS)
            y, x = (_number(item, key, path, where) if key in item else math.nan for key in ("y_mid", "x_mid"))
            places = (y0 * height, x0 * width, y1 * height, x1 * width, y * height, x * width)
            for column, place in zip(("row0", "col0", "row1", "col1", "row_mid", "col_mid"), places, strict=True):
                columns[column].append(place - 0.5)
            electrons_s = _number(item, "pe_per_sec", path, where) if "pe_per_sec" in item else math.nan
            flux_e = electrons_s * exposure_s.get(name, math.nan)
            columns["flux_e"].append(flux_e if flux_e > 0.0 else math.nan)
            columns["mag"].append(_number(item, "magnitude", path, where) if "magnitude" in item else math.nan)
            columns["file"].append(name)
            columns["object"].append(_name(item, index))
    return Table(columns, names=list(columns), dtype=["U", "U", *(["f8"] * (len(columns) - 2))])


def _files(folder: Path) -> list[Path]:
    below = folder / "Annotations"
    return sorted((below if below.is_dir() else folder).glob("*.json"))


def _data(path: Path) -> dict[str, Any]:
    try:
        if path.stat().st_size > MAX_BYTES:
            raise UserError(f"{path}: larger than {MAX_BYTES} bytes")
        document = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise UserError(f"{path}: not readable JSON ({' '.join(str(error).split())[:160]})") from error
    if not isinstance(document, dict) or not isinstance(document.get("data"), dict):
        raise UserError(f'{path}: has no table "data"; expected SatNet annotations')
    data: dict[str, Any] = document["data"]
    return data


def _table(data: Mapping[str, Any], key: str, path: Path) -> Mapping[str, Any]:
    table = data.get(key)
    if not isinstance(table, dict):
        raise UserError(f'{path}: has no table "data.{key}"; expected SatNet annotations')
    return table


def _file_name(data: Mapping[str, Any], path: Path) -> str:
    """Name of the frame; annotations that were written without one belong to the frame of the same name."""
    name = _table(data, "file", path).get("filename")
    return name if isinstance(name, str) and name not in ("", "undefined") else f"{path.stem}.fits"


def _number(item: Mapping[str, Any], key: str, path: Path, where: str) -> float:
    value = item.get(key)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise UserError(f"{path}: {where}.{key} is {str(value)[:40]}; expected a number")
    return float(value)


def _name(item: Mapping[str, Any], index: int) -> str:
    """Name of an object, the same in all frames: its own, or its place in the list of a frame."""
    for key in ("object_name", "object_id"):
        value = item.get(key)
        if value not in (None, ""):
            return str(value)
    seg_id = item.get("seg_id")
    return f"segment {seg_id}" if isinstance(seg_id, int) and seg_id >= 0 else f"object {index}"
