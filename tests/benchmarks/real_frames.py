"""What the chain finds in real frames of other telescopes, with pictures: docs/real-frames.md.

    python -m tests.benchmarks.real_frames [--frames ../shared/data/real] [--pictures docs/images]

Runs `sboc process` on each file, prints one line for each streak that is published or rejected, and draws both over the frame.
TIFF star fields are handed over as FITS, with nothing but their pixels.
"""

import argparse
import sys
import tempfile
from pathlib import Path
from typing import Any, Final

import matplotlib.image
import numpy as np
from astropy.io import fits
from astropy.table import Table
from astropy.visualization import ZScaleInterval
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from sboc_e2e import cli
from sboc_e2e.icd.flags import StreakFlag

ROOT: Final = Path(__file__).resolve().parents[2]
SUFFIXES: Final = (".fits", ".fits.fz", ".tiff")
UNPUBLISHED_PICTURES: Final = ("opd_control.fits",)
"""Frames whose licence does not clearly allow a picture in these documents."""

PANEL_IN: Final = 3.0
SHOWN_PANELS: Final = 12


def as_fits(path: Path, folder: Path) -> Path:
    """A file that `sboc process` takes."""
    if path.suffix != ".tiff":
        return path
    made = folder / f"{path.stem}.fits"
    fits.PrimaryHDU(matplotlib.image.imread(path)).writeto(made)
    return made


def process(path: Path, out: Path, *extra: str) -> tuple[Table, Table]:
    """Frames and streaks of a file."""
    if cli.run(["process", str(path), "--out", str(out), *extra]) != 0:
        raise SystemExit(f"sboc process failed on {path}")
    frames, streaks = (Table.read(out / "products" / f"{name}.ecsv", format="ascii.ecsv") for name in ("frames", "streaks"))
    return frames, streaks


def line_of(s: Any) -> str:
    """A streak in words."""
    flags = StreakFlag(int(s["flags"]))
    names = ", ".join((flag.name or "").lower() for flag in flags)
    verdict = "rejected " if flags & StreakFlag.VETOED else "published"
    ends = f"({s['row0']:.1f}, {s['col0']:.1f}) to ({s['row1']:.1f}, {s['col1']:.1f})"
    return f"  {verdict} frame {int(s['frame'])}: {ends}, {s['length_px']:.0f} px, S/N {s['snr']:.1f}; {names}"


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
            rejected = bool(int(s["flags"]) & StreakFlag.VETOED)
            style = {"color": "#4aa3ff", "ls": ":", "lw": 1.0} if rejected else {"color": "#ff9a3c", "ls": "-", "lw": 1.2}
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


def report(line: str) -> None:
    """A line for the reader."""
    sys.stdout.write(line + "\n")


def main() -> None:
    """Process, print, draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=Path, default=ROOT.parent / "shared" / "data" / "real")
    parser.add_argument("--pictures", type=Path, default=ROOT / "docs" / "images")
    parser.add_argument("--only", default="", help="part of a file's name")
    arguments = parser.parse_args()
    paths = sorted(p for p in arguments.frames.iterdir() if p.name.endswith(SUFFIXES) and arguments.only in p.name)
    if not paths:
        raise SystemExit(f"{arguments.frames}: holds no {', '.join(SUFFIXES)}")
    with tempfile.TemporaryDirectory() as scratch:
        for number, path in enumerate(paths):
            readable = as_fits(path, Path(scratch))
            frames, streaks = process(readable, Path(scratch) / f"out-{number}")
            published = streaks[(np.asarray(streaks["flags"]) & int(StreakFlag.VETOED)) == 0]
            report(f"{path.name}: {len(frames)} frames, {len(published)} published, {len(streaks) - len(published)} rejected")
            for s in streaks:
                report(line_of(s))
            if path.name not in UNPUBLISHED_PICTURES:
                draw(readable, frames, streaks, arguments.pictures / f"real-{path.name.partition('.')[0]}.png")


if __name__ == "__main__":
    main()
