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
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
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

ROOT: Final = Path(__file__).resolve().parents[2]
SHARED: Final = ROOT.parent / "shared"
TRUTH: Final = Path(__file__).with_name("real_frames_truth.json")
SUFFIXES: Final = (".fits", ".fits.fz", ".fits.xz", ".tiff")
UNPUBLISHED_PICTURES: Final = ("opd_control", "hst_", "wallace_")
"""Frames whose licence does not clearly allow a picture in these documents."""

PANEL_IN: Final = 3.0
SHOWN_PANELS: Final = 12
PUBLISHED_STYLE: Final[dict[str, Any]] = {"color": "#ff9a3c", "ls": "-", "lw": 1.2}
REJECTED_STYLE: Final[dict[str, Any]] = {"color": "#4aa3ff", "ls": ":", "lw": 1.0}
BEGIN, END = "<!-- table: tests.benchmarks.real_frames -->", "<!-- end of table -->"

BESIDE_PX: Final = 6.0
BESIDE_WIDTHS: Final = 2.0
"""A measured streak is of an eye's trail where both its ends lie within so much of its line (the eye is good to some pixels)."""

HALF: Final = 0.5
NEAR_PX: Final = 2.0


@dataclass(frozen=True, kw_only=True)
class Trail:
    """What became of one trail that the eye saw.

    found, published : share of its length that the longest measured and the longest published streak cover.
    end_px : (2,) distance of the published streak's ends from the eye's. inside : which are within 2 px or their interval.
    extra : further published streaks on the same trail.
    """

    found: float
    published: float
    end_px: tuple[float, float]
    inside: tuple[bool, bool]
    snr: float
    probability: float
    extra: int


@dataclass(frozen=True, kw_only=True)
class Row:
    """One frame."""

    frame: str
    camera: str
    trails: tuple[Trail, ...]
    measured: int
    false: int
    false_sure: int
    sure: int
    cpu_s: float
    exit_code: int


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


def process(command: Sequence[str], path: Path, out: Path) -> tuple[int, float]:
    """Exit code and CPU seconds of `sboc process` on a file."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run([*command, "process", str(path), "--out", str(out)], capture_output=True, check=False)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode != 0:
        report(done.stderr.decode(errors="replace").strip()[-300:])
    return done.returncode, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def is_published(streak: Any) -> bool:
    """Whether the vetter let it through."""
    return not int(streak["flags"]) & StreakFlag.VETOED


def covered(streak: Any, trail: Sequence[float]) -> float:
    """Share of an eye's trail that a measured streak covers, 0 where it is not on its line."""
    start, stop = np.array([trail[1], trail[0]], dtype=float), np.array([trail[3], trail[2]], dtype=float)
    along = (stop - start) / (length := float(np.linalg.norm(stop - start)))
    ends = np.array([[streak["row0"], streak["col0"]], [streak["row1"], streak["col1"]]], dtype=float) - start
    across = ends @ np.array([-along[1], along[0]])
    if not np.abs(across).max() < max(BESIDE_PX, BESIDE_WIDTHS * float(streak["width_px"])):
        return 0.0
    low, high = np.clip(np.sort(ends @ along), 0.0, length)
    return float((high - low) / length)


def ends_of(streak: Any, trail: Sequence[float]) -> tuple[tuple[float, float], tuple[bool, bool]]:
    """Distance of each end along the trail from the eye's nearest one, and whether it is within 2 px or the quoted interval.

    The eye's ends on a border stand for light that goes on: a measured end beyond the border is no error.
    """
    eye = np.array([[trail[1], trail[0]], [trail[3], trail[2]]], dtype=float)
    ends = np.array([[streak["row0"], streak["col0"]], [streak["row1"], streak["col1"]]], dtype=float)
    if np.linalg.norm(ends - eye, axis=1).sum() > np.linalg.norm(ends[::-1] - eye, axis=1).sum():
        eye = eye[::-1]
    along = (eye[1] - eye[0]) / np.linalg.norm(eye[1] - eye[0])
    flags = int(streak["flags"])
    away, inside = [], []
    for k, edge in enumerate((StreakFlag.EDGE0, StreakFlag.EDGE1)):
        beyond = float((ends[k] - eye[k]) @ along) * (-1.0 if k == 0 else 1.0)
        error = max(-beyond, 0.0) if flags & edge else abs(beyond)
        low, high = float(streak[f"end{k}_low_px"]), float(streak[f"end{k}_high_px"])
        quoted = max(abs(low), abs(high)) if math.isfinite(low) and math.isfinite(high) else 0.0
        away.append(error)
        inside.append(error <= max(NEAR_PX, quoted))
    return (away[0], away[1]), (inside[0], inside[1])


def trail_of(streaks: Table, trail: Sequence[float]) -> tuple[Trail, set[int]]:
    """What became of a trail, and the rows of `streaks` that lie on it."""
    share = np.array([covered(s, trail) for s in streaks])
    on = {int(k) for k in np.flatnonzero(share > 0.0)}
    let_through = [k for k in on if is_published(streaks[k])]
    nothing = Trail(
        found=max((share[k] for k in on), default=0.0),
        published=0.0, end_px=(math.nan, math.nan), inside=(False, False), snr=math.nan, probability=math.nan, extra=0,
    )  # fmt: skip
    if not let_through:
        best = max(on, key=lambda k: share[k], default=None)
        if best is None:
            return nothing, on
        seen = {"snr": float(streaks[best]["snr"]), "probability": float(streaks[best]["probability"])}
        return Trail(**(asdict(nothing) | seen)), on
    best = max(let_through, key=lambda k: share[k])
    end_px, inside = ends_of(streaks[best], trail)
    made = Trail(
        found=nothing.found, published=float(share[best]), end_px=end_px, inside=inside, snr=float(streaks[best]["snr"]),
        probability=float(streaks[best]["probability"]), extra=len(let_through) - 1,
    )  # fmt: skip
    return made, on


def rows_of(path: Path, frames: Table, streaks: Table, entries: Sequence[dict[str, Any]], cpu_s: float, code: int) -> list[Row]:
    """One row for each frame of a file."""
    rows = []
    for frame in frames:
        hdu = int(frame["hdu"])
        camera, trails = seen_in(entries, path.name.removesuffix(".xz"), hdu)
        here = streaks[np.asarray(streaks["frame"]) == frame["frame"]]
        made = [trail_of(here, trail) for trail in trails]
        on = set().union(*(places for _, places in made)) if made else set()
        wrong = [s for k, s in enumerate(here) if k not in on and is_published(s)]
        sure = [k for k, s in enumerate(here) if is_published(s) and s["probability"] >= 0.9]
        rows.append(
            Row(
                frame=path.name.partition(".")[0] + (f" [{hdu}]" if len(frames) > 1 else ""),
                camera=camera,
                trails=tuple(trail for trail, _ in made),
                measured=len(here),
                false=len(wrong) + sum(trail.extra for trail, _ in made),
                false_sure=sum(float(s["probability"]) >= 0.9 for s in wrong),
                sure=len(sure),
                cpu_s=cpu_s / len(frames),
                exit_code=code,
            )
        )
    return rows


def table_text(rows: Sequence[Row]) -> str:
    """The table of the page: a line for each frame with a trail, one for all blank frames of a camera, and the sums."""
    lines = [
        "| frame | trail by eye | measured | published | ends off (px) | S/N, p | false | CPU s | exit |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        for number, trail in enumerate(row.trails):
            ends = "-" if trail.published == 0.0 else " ".join(
                f"{px:.1f}{'' if ok else ' (outside)'}" for px, ok in zip(trail.end_px, trail.inside, strict=True)
            )  # fmt: skip
            lines.append(
                f"| {row.frame} | {number + 1} | {trail.found:.0%} | {trail.published:.0%} | {ends} | "
                f"{trail.snr:.0f}, {trail.probability:.2f} | {row.false} | {row.cpu_s:.1f} | {row.exit_code} |"
            )
    blank = [row for row in rows if not row.trails]
    for camera in dict.fromkeys(row.camera for row in blank):
        mine = [row for row in blank if row.camera == camera]
        codes = ", ".join(str(code) for code in sorted({row.exit_code for row in mine}))
        lines.append(
            f"| {camera}: {len(mine)} | none | {sum(row.measured for row in mine)} | - | - | - | "
            f"{sum(row.false for row in mine)} | {sum(row.cpu_s for row in mine):.1f} | {codes} |"
        )
    trails = [trail for row in rows for trail in row.trails]
    half = sum(trail.published >= HALF for trail in trails)
    ends = [ok for trail in trails if trail.published >= HALF for ok in trail.inside]
    false = sum(row.false for row in blank)
    sure, wrong = sum(row.sure for row in rows), sum(row.false_sure for row in rows)
    failed = sum(row.exit_code != 0 for row in rows)
    words = (
        f"Published with half their length or more: {half} of {len(trails)}. Ends within 2 px or their interval: {sum(ends)} of "
        f"{len(ends)}. False in {len(blank)} blank frames: {false}. Of {sure} published at p >= 0.9, {wrong} are false. "
        f"Frames of runs that ended in an error: {failed}."
    )
    return "\n".join([*lines, "", words])


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


def with_table(page: str, table: str) -> str:
    """A page with the table between its marks replaced."""
    head, begin, rest = page.partition(BEGIN)
    _, end, tail = rest.partition(END)
    if not (begin and end):
        raise SystemExit(f'the page holds no "{BEGIN}" and "{END}"')
    return f"{head}{BEGIN}\n\n{table}\n\n{END}{tail}"


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
    parser.add_argument("--sboc", default=f"{sys.executable} -m sboc_e2e", help="the command that is measured")
    arguments = parser.parse_args()
    paths = sorted(p for f in arguments.frames for p in f.iterdir() if p.name.endswith(SUFFIXES) and arguments.only in p.name)
    if not paths:
        raise SystemExit(f"{', '.join(map(str, arguments.frames))}: no {', '.join(SUFFIXES)}")
    entries, rows = truth_of(arguments.frames), []
    with tempfile.TemporaryDirectory() as scratch:
        for number, path in enumerate(paths):
            readable, out = as_fits(path, Path(scratch)), Path(scratch) / f"out-{number}"
            code, cpu_s = process(arguments.sboc.split(), readable, out)
            if code != 0:
                camera, trails = seen_in(entries, path.name.removesuffix(".xz"), 0)
                lost = [trail_of(Table(), trail)[0] for trail in trails]
                rows.append(Row(
                    frame=path.name.partition(".")[0], camera=camera, trails=tuple(lost), measured=0, false=0, false_sure=0,
                    sure=0, cpu_s=cpu_s, exit_code=code,
                ))  # fmt: skip
                continue
            tables = out / "products"
            frames, streaks = (Table.read(tables / f"{name}.ecsv", format="ascii.ecsv") for name in ("frames", "streaks"))
            made = rows_of(path, frames, streaks, entries, cpu_s, code)
            report(f"{path.name}: {len(made)} frames, {sum(r.false for r in made)} false, {cpu_s:.1f} s")
            rows += made
            if arguments.pictures and not path.name.startswith(UNPUBLISHED_PICTURES):
                arguments.pictures.mkdir(parents=True, exist_ok=True)
                draw(readable, frames, streaks, arguments.pictures / f"real-{path.name.partition('.')[0]}.png")
    report(table_text(rows))
    if arguments.page:
        arguments.page.write_text(with_table(arguments.page.read_text(), table_text(rows)))
    if arguments.json:
        arguments.json.write_text(json.dumps([asdict(row) for row in rows], indent=1) + "\n")


if __name__ == "__main__":
    main()
