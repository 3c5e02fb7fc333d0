"""Truth from elsewhere: one table of trails, completed to the truth tables that the scores read.

What the table does not say is NaN there and makes figures that need it absent. Two things are filled in, because they can
be known from the run: the PSF sigma from the nominal camera, and the S/N, where a flux is given, from the noise that the
on-board software measured in the frame.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from astropy.table import MaskedColumn, Table
from numpy.typing import NDArray

from sboc_e2e.icd.downlink import DownlinkFrame
from sboc_e2e.icd.errors import UserError
from sboc_e2e.score.trail import TruePath, draw
from sboc_e2e.truth import EXTERNAL, EXTERNAL_REQUIRED, PATH_NODES, empty

Truth = dict[str, Table]
"""The tables frames, streaks and objects."""

MAX_BYTES: Final = 1 << 30  # 1 GiB, some 1e7 trails of 100 characters; keeps a wrong path from filling the memory.
_KINDS: Final = {column.name: np.dtype(column.dtype).kind for column in EXTERNAL}
_NODES: Final = np.linspace(0.0, 1.0, PATH_NODES)
_FINE: Final = 2000  # Points along a trail at which it is cut to the frame: its ends are right to 1/2000 of its length.


def read_table(path: Path) -> Table:
    """A table of the columns EXTERNAL: ECSV, or CSV by the name's ending. Raises `UserError` with what is wrong."""
    kind = "ascii.csv" if path.suffix.lower() == ".csv" else "ascii.ecsv"
    try:
        if path.stat().st_size > MAX_BYTES:
            raise UserError(f"{path}: larger than {MAX_BYTES} bytes")
        table = Table.read(path, format=kind)
    except UserError:
        raise
    except Exception as error:  # astropy's readers raise nearly everything on files that are no tables
        words = " ".join(str(error).split())[:160] or type(error).__name__
        raise UserError(f"{path}: not a readable {kind.partition('.')[2].upper()} table ({words})") from error
    return checked(table, str(path))


def checked(table: Table, where: str) -> Table:
    """The known columns of a table as plain arrays, NaN where optional cells are empty. Raises `UserError`."""
    missing = [name for name in EXTERNAL_REQUIRED if name not in table.colnames]
    if missing or not {"frame", "file"} & set(table.colnames):
        lacking = [*missing, *([] if {"frame", "file"} & set(table.colnames) else ["frame (or file)"])]
        required = (*EXTERNAL_REQUIRED, "frame", "file")
        optional = ", ".join(column.name for column in EXTERNAL if column.name not in required)
        raise UserError(
            f"{where}: lacks the columns {', '.join(lacking)}; it needs {', '.join(EXTERNAL_REQUIRED)}, and frame or file, "
            f"and may have {optional}"
        )
    out = Table()
    for column in EXTERNAL:
        if column.name in table.colnames:
            needed = column.name in EXTERNAL_REQUIRED or _KINDS[column.name] in "iU"
            out[column.name] = _plain(table[column.name], column.name, needed, where)
    return out


def _plain(cells: Any, name: str, needed: bool, where: str) -> NDArray[Any]:
    """A column of the kind that EXTERNAL says; `needed` cells may not be empty."""
    hidden = np.asarray(cells.mask, bool) if isinstance(cells, MaskedColumn) else np.zeros(len(cells), bool)
    if needed and hidden.any():
        raise UserError(f"{where}: row {int(np.argmax(hidden)) + 1} has no {name}")
    plain = np.asarray(cells.filled() if isinstance(cells, MaskedColumn) else cells)
    if plain.ndim != 1:
        raise UserError(f"{where}: column {name} holds arrays; expected one value in each row")
    if _KINDS[name] == "U":
        return plain.astype(str)
    try:
        values = plain.astype(np.float64)
    except (TypeError, ValueError) as error:
        raise UserError(f"{where}: column {name} holds texts; expected numbers") from error
    values[hidden] = np.nan
    wrong = ~np.isfinite(values) if needed else np.isinf(values)
    if _KINDS[name] == "i":
        wrong |= values != np.rint(np.nan_to_num(values))
    if name in ("flux_e", "snr", "psf_sigma_px", "range_km"):
        wrong |= values <= 0.0
    if wrong.any():
        row = int(np.argmax(wrong))
        allowed = "a whole number" if _KINDS[name] == "i" else "a positive number" if not needed else "a finite number"
        raise UserError(f"{where}: row {row + 1}: {name} is {values[row]:g}; expected {allowed}")
    return values.astype(np.int64) if _KINDS[name] == "i" else values


def frame_numbers(table: Table, frames: Table, n_frames: int, where: str) -> NDArray[np.int64]:
    """Frame number of each row, from its own column or from the files that the run was made of."""
    if "frame" in table.colnames:
        numbers = np.asarray(table["frame"], np.int64)
        wrong = (numbers < 0) | (numbers >= n_frames)
        if wrong.any():
            row = int(np.argmax(wrong))
            raise UserError(f"{where}: row {row + 1}: frame is {numbers[row]}; the run has frames 0 to {n_frames - 1}")
        return numbers
    if "file" not in frames.colnames:
        raise UserError(f"{where}: names files, but the run was not made of files; give the column frame instead")
    places: dict[str, dict[int, int]] = {}
    for s in frames:
        places.setdefault(str(s["file"]), {})[int(s["hdu"])] = int(s["frame"])
    found = np.zeros(len(table), np.int64)
    for row, name in enumerate(table["file"]):
        hdus = places.get(str(name))
        if hdus is None:
            raise UserError(f"{where}: row {row + 1}: no frame of the run came from {str(name)[:80]!r}; files: {_few(places)}")
        hdu = int(table["hdu"][row]) if "hdu" in table.colnames else next(iter(hdus))
        if hdu not in hdus or (len(hdus) > 1 and "hdu" not in table.colnames):
            raise UserError(f"{where}: row {row + 1}: give in column hdu which of {_few(map(str, hdus))} of {name} is meant")
        found[row] = hdus[hdu]
    return found


def _few(names: Any) -> str:
    listed = list(names)
    return ", ".join(listed[:4]) + (f" ... ({len(listed)})" if len(listed) > 4 else "")


def completed(
    table: Table, frames: Table, downlink: Sequence[DownlinkFrame], camera_psf_sigma_px: float, n_frames: int, where: str
) -> Truth:
    """The truth tables of a run from a table of `checked` columns.

    frames : products/frames.ecsv, for epochs and sizes. Trails that miss their frame are left out. Raises `UserError`.
    """
    numbers = frame_numbers(table, frames, n_frames, where)
    by_number = {int(s["frame"]): s for s in frames}
    noise_e = {f.header.frame: _noise_e(f) for f in downlink}
    names, object_ids = np.unique(np.asarray(table["object"]).astype(str), return_inverse=True)
    streaks = empty("streaks", len(table))
    _unknown(streaks)
    kept = np.zeros(len(table), dtype=bool)
    for index, given in enumerate(table):
        frame = by_number.get(int(numbers[index]))
        if frame is None:
            # The frame did not arrive: the trail is a missed one, its frame as large as the others.
            frame = frames[0] if len(frames) else None
        if frame is None:
            raise UserError(f"{where}: the run has no frames to score")
        t = streaks[index]
        t["frame"], t["object_id"] = numbers[index], object_ids[index]
        kept[index] = _fill(t, _cells(given), frame, noise_e.get(int(numbers[index])), camera_psf_sigma_px)
    objects = empty("objects", len(names))
    _unknown(objects)
    objects["object_id"], objects["name"], objects["kind"] = np.arange(len(names)), names, "external"
    rows = empty("frames", n_frames)
    _unknown(rows)
    rows["frame"] = np.arange(n_frames)
    return {"frames": Table(rows), "streaks": Table(streaks[kept]), "objects": Table(objects)}


def _cells(given: Any) -> dict[str, float]:
    """Numbers of a row; absent columns are NaN."""
    return {c.name: float(given[c.name]) if c.name in given.colnames else np.nan for c in EXTERNAL if _KINDS[c.name] == "f"}


def _unknown(table: NDArray[np.void]) -> None:
    """Every floating-point number of a table as NaN."""
    for name in table.dtype.names or ():
        if table.dtype[name].base.kind == "f":
            table[name] = np.nan


def _noise_e(frame: DownlinkFrame) -> float:
    """Noise of a pixel without sources, electrons; NaN when the frame's header did not arrive."""
    if frame.housekeeping is None:
        return np.nan
    return frame.housekeeping.sigma_adu * frame.adu_scale * (frame.header.gain_e_adu or 1.0)


def _fill(t: Any, given: Mapping[str, float], frame: Any, noise_e: float | None, camera_sigma_px: float) -> bool:
    """Write a trail into a row of STREAKS; False when no part of it lies inside the frame."""
    rows, cols = int(frame["rows"]), int(frame["cols"])
    fine = np.linspace(0.0, 1.0, _FINE + 1)
    row, col = _along(given, "row", fine), _along(given, "col", fine)
    inside = (row >= -0.5) & (row <= rows - 0.5) & (col >= -0.5) & (col <= cols - 0.5)
    if not inside.any():
        return False
    # One piece: of a curved trail that leaves and comes back, all from its first to its last point inside.
    first, last = int(np.argmax(inside)), _FINE - int(np.argmax(inside[::-1]))
    phase = fine[first] + _NODES * (fine[last] - fine[first])
    t["path_row"], t["path_col"] = _along(given, "row", phase), _along(given, "col", phase)
    t["row0"], t["col0"], t["row1"], t["col1"] = t["path_row"][0], t["path_col"][0], t["path_row"][-1], t["path_col"][-1]
    t["edge0"], t["edge1"] = first > 0, last < _FINE
    t["length_px"] = np.hypot(np.diff(t["path_row"]), np.diff(t["path_col"])).sum()
    exposure_s = float(frame["exposure_s"])
    start = int(frame["t_start_tai_ns"]) + (t["path_row"] * float(frame["line_time_s"]) * 1e9).astype(np.int64)
    t["path_t_tai_ns"] = start + np.rint(phase * exposure_s * 1e9).astype(np.int64)
    t["t0_tai_ns"], t["t1_tai_ns"] = t["path_t_tai_ns"][0], t["path_t_tai_ns"][-1]
    t["mag"], t["range_km"] = given["mag"], given["range_km"]
    t["psf_sigma_px"] = given["psf_sigma_px"] if np.isfinite(given["psf_sigma_px"]) else camera_sigma_px
    t["defocus_px"] = 0.0
    share = float(fine[last] - fine[first])
    duration_s = max(exposure_s * share, 1e-12)
    t["flux_e"] = given["flux_e"] * share
    t["path_flux_e_s"] = t["flux_e"] / duration_s
    t["snr"] = given["snr"]
    if not np.isfinite(given["snr"]) and np.isfinite(given["flux_e"]) and noise_e is not None and noise_e > 0.0:
        t["snr"] = _matched_snr(t, duration_s, (rows, cols), noise_e)
    _fill_sky(t, given, phase, exposure_s)
    return True


def _along(given: Mapping[str, float], name: str, phase: NDArray[np.float64]) -> NDArray[np.float64]:
    """Row or col at phases 0 to 1: straight, or the parabola through the point at mid-exposure."""
    start, end, middle = given[f"{name}0"], given[f"{name}1"], given[f"{name}_mid"]
    straight = start + phase * (end - start)
    return straight + 4.0 * phase * (1.0 - phase) * (middle - 0.5 * (start + end)) if np.isfinite(middle) else straight


def _matched_snr(t: Any, duration_s: float, shape: tuple[int, int], noise_e: float) -> float:
    """sqrt(sum T^2) / noise over the pixels inside the frame (docs/scoring.md, Symbols)."""
    path = TruePath(
        row=np.array(t["path_row"]), col=np.array(t["path_col"]), flux_e_s=np.array(t["path_flux_e_s"]), duration_s=duration_s,
        sigma_px=float(t["psf_sigma_px"]), edge0=bool(t["edge0"]), edge1=bool(t["edge1"]),
    )  # fmt: skip
    _, _, electrons = draw(path).pixels(*shape)
    return float(np.sqrt(np.sum(electrons * electrons)) / noise_e)


def _fill_sky(t: Any, given: Mapping[str, float], phase: NDArray[np.float64], exposure_s: float) -> None:
    """Directions along the great circle between the ends, and the rate; left unknown without both ends."""
    ends = np.radians([[given["ra0_deg"], given["dec0_deg"]], [given["ra1_deg"], given["dec1_deg"]]])
    if not np.isfinite(ends).all():
        return
    ra, dec = ends[:, 0], ends[:, 1]
    unit = np.stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)], axis=-1)
    points = unit[0] + phase[:, None] * (unit[1] - unit[0])
    t["path_ra_deg"] = np.degrees(np.arctan2(points[:, 1], points[:, 0])) % 360.0
    t["path_dec_deg"] = np.degrees(np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1])))
    angle = 2.0 * np.arcsin(0.5 * np.linalg.norm(unit[1] - unit[0]))
    t["rate_deg_s"] = np.degrees(angle) / exposure_s if exposure_s > 0 else np.nan
    t["ra_app_deg"], t["dec_app_deg"] = t["path_ra_deg"][PATH_NODES // 2], t["path_dec_deg"][PATH_NODES // 2]
