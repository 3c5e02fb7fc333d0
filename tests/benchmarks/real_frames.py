"""What the chain finds in real frames of other telescopes, frame by frame, with pictures: the table of docs/real-frames.md.

    python -m tests.benchmarks.real_frames [--frames FOLDER ...] [--pictures docs/images] [--page docs/real-frames.md]
        [--json FILE] [--only TEXT] [--sboc COMMAND]

Runs `sboc process` on each file with its defaults and compares what it measures and publishes with the trails that an eye put
down beforehand: `real_frames_truth.json` beside this script and `truth.json` in each folder. `--page` writes the table between
the marks of that page, so that page and script agree; `--sboc` measures another installation, such as an earlier commit's.
TIFF star fields are handed over as FITS, with nothing but their pixels; `.xz` is unpacked.
"""

import argparse
import json
import lzma
import math
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Final

import matplotlib.image
import numpy as np
from astropy.io import fits
from astropy.table import Table
from astropy.visualization import ZScaleInterval
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from sboc_e2e.icd.flags import StreakFlag
from tests.benchmarks.real_frames_table import SURE, Row, Trail, table_text

ROOT: Final = Path(__file__).resolve().parents[2]
SHARED: Final = ROOT.parent / "shared"
COMMAND: Final = (sys.executable, "-m", "sboc_e2e")
TRUTH: Final = Path(__file__).with_name("real_frames_truth.json")
SUFFIXES: Final = (".fits.fz", ".fits.xz", ".fits", ".fit", ".tiff")
UNPUBLISHED_PICTURES: Final = ("opd_control", "hst_", "wallace_")
"""Frames whose licence does not clearly allow a picture in these documents."""

PANEL_IN: Final = 3.0
SHOWN_PANELS: Final = 12
PUBLISHED_STYLE: Final[dict[str, Any]] = {"color": "#ff9a3c", "ls": "-", "lw": 1.2}
REJECTED_STYLE: Final[dict[str, Any]] = {"color": "#4aa3ff", "ls": ":", "lw": 1.0}
BEGIN, END = "<!-- table: tests.benchmarks.real_frames -->", "<!-- end of table -->"

BESIDE_PX: Final = 6.0
BESIDE_WIDTHS: Final = 2.0
"""A measured streak is of an eye's trail where it lies within so much of its line (the eye is good to some pixels)."""

PLACES: Final = 201
"""Places along a streak that are held against an eye's line."""


def truth_of(folders: Iterable[Path]) -> list[dict[str, Any]]:
    """All entries: file, hdu (None: every other one of the file), camera, streaks as [col0, row0, col1, row1]."""
    entries: list[dict[str, Any]] = json.loads(TRUTH.read_text())
    for folder in folders:
        if (folder / "truth.json").exists():
            entries += [entry | {"hdu": entry.get("hdu")} for entry in json.loads((folder / "truth.json").read_text())]
    return entries


def seen_in(entries: Sequence[dict[str, Any]], name: str, hdu: int) -> tuple[str, list[list[float]]]:
    """Camera and trails of a frame; of none where no eye has looked."""
    mine = [entry for entry in entries if entry["file"] == name]
    here = [entry for entry in mine if entry["hdu"] == hdu] or [entry for entry in mine if entry["hdu"] is None]
    return (here[0]["camera"], here[0]["streaks"]) if here else ("star field of 11 deg (tetra3)", [])


def stem_of(path: Path) -> str:
    """A file's name without its suffix."""
    return path.name.removesuffix(next(suffix for suffix in SUFFIXES if path.name.endswith(suffix)))


def as_fits(path: Path, folder: Path) -> Path:
    """A file that `sboc process` takes."""
    if path.suffix == ".xz":
        made = folder / path.stem
        made.write_bytes(lzma.decompress(path.read_bytes()))
        return made
    if path.suffix == ".tiff":
        made = folder / f"{path.stem}.fits"
        fits.PrimaryHDU(matplotlib.image.imread(path)).writeto(made)
        return made
    return path


def process_command(path: Path, out: Path, command: Sequence[str] = COMMAND) -> tuple[int, float, float]:
    """Exit code, CPU seconds and wall seconds of `sboc process` on a file."""
    start = time.perf_counter()
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run([*command, "process", str(path), "--out", str(out)], capture_output=True, check=False)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode != 0:
        report(done.stderr.decode(errors="replace").strip()[-300:])
    cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return done.returncode, cpu_s, time.perf_counter() - start


def is_published(streak: Any) -> bool:
    """Whether the vetter let it through."""
    return not int(streak["flags"]) & StreakFlag.VETOED


def covered(streak: Any, trail: Sequence[float]) -> float:
    """Share of an eye's trail that a measured streak covers, 0 where it is not on its line.

    Its chord or its arc is held against the eye's line between the ends that the eye saw: what lies beyond them is an error of
    the ends, which `ends_of` measures.
    """
    start, stop = np.array([trail[1], trail[0]], dtype=float), np.array([trail[3], trail[2]], dtype=float)
    along = (stop - start) / (length := float(np.linalg.norm(stop - start)))
    first, last = (np.array([streak[f"row{k}"], streak[f"col{k}"]], dtype=float) - start for k in (0, 1))
    share = np.linspace(0.0, 1.0, PLACES)
    chord = first + share[:, None] * (last - first)
    sideways = np.array([last[1] - first[1], first[0] - last[0]]) / max(float(np.linalg.norm(last - first)), 1e-9)
    arc = chord + (4.0 * float(streak["sagitta_px"]) * share * (1.0 - share))[:, None] * sideways
    seen = (chord @ along >= 0.0) & (chord @ along <= length)
    away = [np.abs(way[seen] @ np.array([-along[1], along[0]])).max(initial=0.0) for way in (chord, arc)]
    if not seen.any() or not min(away) < max(BESIDE_PX, BESIDE_WIDTHS * float(streak["width_px"])):
        return 0.0
    low, high = np.clip(np.sort([first @ along, last @ along]), 0.0, length)
    return float((high - low) / length)


def ends_of(streak: Any, trail: Sequence[float]) -> tuple[tuple[float, float], tuple[float, float]]:
    """Distance of each end along the trail from the eye's nearest one, and the interval of its light's end on that side, px.

    The eye's ends on a border stand for light that goes on: a measured end beyond the border is no error.
    """
    eye = np.array([[trail[1], trail[0]], [trail[3], trail[2]]], dtype=float)
    ends = np.array([[streak["row0"], streak["col0"]], [streak["row1"], streak["col1"]]], dtype=float)
    if np.linalg.norm(ends - eye, axis=1).sum() > np.linalg.norm(ends[::-1] - eye, axis=1).sum():
        eye = eye[::-1]
    along = (eye[1] - eye[0]) / np.linalg.norm(eye[1] - eye[0])
    flags = int(streak["flags"])
    away, interval = [], []
    for k, edge in enumerate((StreakFlag.EDGE0, StreakFlag.EDGE1)):
        beyond = float((ends[k] - eye[k]) @ along) * (-1.0 if k == 0 else 1.0)
        error = max(-beyond, 0.0) if flags & edge else abs(beyond)
        side = float(streak[f"light{k}_low_px" if beyond > 0.0 else f"light{k}_high_px"])
        interval.append(abs(side) if math.isfinite(side) else 0.0)
        away.append(error)
    return (away[0], away[1]), (interval[0], interval[1])


def trail_of(streaks: Table, trail: Sequence[float]) -> tuple[Trail, set[int]]:
    """What became of a trail, and the rows of `streaks` that lie on it."""
    share = np.array([covered(s, trail) for s in streaks])
    on = {int(k) for k in np.flatnonzero(share > 0.0)}
    let_through = [k for k in on if is_published(streaks[k])]
    nothing = Trail(
        found=max((share[k] for k in on), default=0.0),
        published=0.0, end_px=(math.nan, math.nan), interval_px=(math.nan, math.nan), snr=math.nan, probability=math.nan, extra=0,
    )  # fmt: skip
    if not let_through:
        best = max(on, key=lambda k: share[k], default=None)
        if best is None:
            return nothing, on
        return replace(nothing, snr=float(streaks[best]["snr"]), probability=float(streaks[best]["probability"])), on
    best = max(let_through, key=lambda k: share[k])
    end_px, interval_px = ends_of(streaks[best], trail)
    made = Trail(
        found=nothing.found, published=float(share[best]), end_px=end_px, interval_px=interval_px,
        snr=float(streaks[best]["snr"]), probability=float(streaks[best]["probability"]), extra=len(let_through) - 1,
    )  # fmt: skip
    return made, on


def rows_of(
    path: Path, frames: Table, streaks: Table, entries: Sequence[dict[str, Any]], cpu_s: float, wall_s: float
) -> list[Row]:
    """One row for each frame of a file whose run ended well."""
    rows = []
    for frame in frames:
        hdu = int(frame["hdu"])
        camera, trails = seen_in(entries, path.name.removesuffix(".xz"), hdu)
        here = streaks[np.asarray(streaks["frame"]) == frame["frame"]]
        made = [trail_of(here, trail) for trail in trails]
        on = set().union(*(places for _, places in made)) if made else set()
        wrong = [s for k, s in enumerate(here) if k not in on and is_published(s)]
        sure = [k for k, s in enumerate(here) if is_published(s) and s["probability"] >= SURE]
        rows.append(
            Row(
                file=path.name.removesuffix(".xz"),
                frame=stem_of(path) + (f" [{hdu}]" if len(frames) > 1 else ""),
                camera=camera,
                rows=int(frame["rows"]),
                cols=int(frame["cols"]),
                trails=tuple(trail for trail, _ in made),
                measured=len(here),
                false=len(wrong) + sum(trail.extra for trail, _ in made),
                false_sure=sum(float(s["probability"]) >= SURE for s in wrong),
                sure=len(sure),
                cpu_s=cpu_s / len(frames),
                wall_s=wall_s / len(frames),
                exit_code=0,
            )
        )
    return rows


def draw(path: Path, frames: Table, streaks: Table, picture: Path) -> None:
    """Panels of a file's frames, those with streaks first; published streaks orange, rejected ones blue and dashed."""
    busy = {int(s["frame"]) for s in streaks}
    order = sorted(range(len(frames)), key=lambda k: (int(frames["frame"][k]) not in busy, k))[:SHOWN_PANELS]
    columns = min(len(order), 4)
    rows = -(-len(order) // columns)
    side = PANEL_IN * (2.0 if len(order) == 1 else 1.0)
    figure = Figure(figsize=(side * columns, side * rows), layout="constrained")
    FigureCanvasAgg(figure)
    for place, k in enumerate(order):
        axes = figure.add_subplot(rows, columns, place + 1)
        image = np.asarray(fits.getdata(path, int(frames["hdu"][k])), dtype=np.float32)
        low, high = ZScaleInterval().get_limits(image[np.isfinite(image)])
        axes.imshow(image, cmap="gray", vmin=low, vmax=high, origin="lower", interpolation="nearest")
        for s in streaks[np.asarray(streaks["frame"]) == frames["frame"][k]]:
            style = PUBLISHED_STYLE if is_published(s) else REJECTED_STYLE
            across = np.array([s["col0"] - s["col1"], s["row1"] - s["row0"]])
            offset = 8.0 * across / max(float(np.hypot(*across)), 1e-6)  # beside the trail, which stays visible
            for sign in (-1, 1):
                axes.plot(
                    [s["col0"] + sign * offset[1], s["col1"] + sign * offset[1]],
                    [s["row0"] + sign * offset[0], s["row1"] + sign * offset[0]],
                    **style,
                )
        axes.set(xlim=(-0.5, image.shape[1] - 0.5), ylim=(-0.5, image.shape[0] - 0.5))
        if len(order) > 1:
            axes.set_title(f"HDU {int(frames['hdu'][k])}", fontsize=7)
        axes.set_axis_off()
    figure.savefig(picture, dpi=60, metadata={"Software": None})


def with_table(page: str, table: str, mark: str = BEGIN) -> str:
    """A page with the table after a mark, up to the mark of its end, replaced."""
    head, begin, rest = page.partition(mark)
    _, end, tail = rest.partition(END)
    if not (begin and end):
        raise SystemExit(f'the page holds no "{mark}" and "{END}"')
    return f"{head}{mark}\n\n{table}\n\n{END}{tail}"


def report(line: str) -> None:
    """A line for the reader."""
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


def main() -> None:
    """Process, compare, print, draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    folders = [SHARED / "data" / "real", SHARED / "data" / "real2"]
    parser.add_argument("--frames", type=Path, nargs="+", default=folders)
    parser.add_argument("--pictures", type=Path, help="folder for pictures of the frames, made where it is missing")
    parser.add_argument("--page", type=Path, help="page whose table is replaced")
    parser.add_argument("--json", type=Path, help="file for the rows as JSON")
    parser.add_argument("--only", default="", help="part of a file's name")
    parser.add_argument("--sboc", default=" ".join(COMMAND), help="the command that is measured")
    arguments = parser.parse_args()
    paths = sorted(p for f in arguments.frames for p in f.iterdir() if p.name.endswith(SUFFIXES) and arguments.only in p.name)
    if not paths:
        raise SystemExit(f"{', '.join(map(str, arguments.frames))}: no {', '.join(SUFFIXES)}")
    entries, rows = truth_of(arguments.frames), []
    with tempfile.TemporaryDirectory() as scratch:
        for number, path in enumerate(paths):
            readable, out = as_fits(path, Path(scratch)), Path(scratch) / f"out-{number}"
            code, cpu_s, wall_s = process_command(readable, out, arguments.sboc.split())
            if code != 0:
                camera, trails = seen_in(entries, path.name.removesuffix(".xz"), 0)
                lost = [trail_of(Table(), trail)[0] for trail in trails]
                rows.append(Row(
                    file=path.name.removesuffix(".xz"), frame=stem_of(path), camera=camera, rows=0, cols=0,
                    trails=tuple(lost), measured=0, false=0, false_sure=0, sure=0, cpu_s=cpu_s, wall_s=wall_s, exit_code=code,
                ))  # fmt: skip
                continue
            tables = out / "products"
            frames, streaks = (Table.read(tables / f"{name}.ecsv", format="ascii.ecsv") for name in ("frames", "streaks"))
            made = rows_of(path, frames, streaks, entries, cpu_s, wall_s)
            for row in made:
                report(row.line)
            rows += made
            if arguments.pictures and not path.name.startswith(UNPUBLISHED_PICTURES):
                arguments.pictures.mkdir(parents=True, exist_ok=True)
                draw(readable, frames, streaks, arguments.pictures / f"real-{stem_of(path)}.png")
    report(table_text(rows))
    if arguments.page:
        arguments.page.write_text(with_table(arguments.page.read_text(), table_text(rows)))
    if arguments.json:
        arguments.json.write_text(json.dumps([asdict(row) for row in rows], indent=1) + "\n")


if __name__ == "__main__":
    main()
