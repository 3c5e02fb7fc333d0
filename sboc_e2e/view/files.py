"""Beside each frame: a DS9 region file of streaks and stars, and a VOTable of each (Aladin, TOPCAT, DS9)."""

from pathlib import Path
from typing import Any

import numpy as np
from astropy.table import Table

from sboc_e2e.files.atomic import replacing, write_text
from sboc_e2e.view.run_frames import RunFrames, ShownFrame, is_published

HEAD = '# Region file format: DS9 version 4.1\nglobal width=1 font="helvetica 10 normal roman"\nimage\n'
STAR_RADIUS_PX = 4.0  # Of the circle in DS9: two FWHM of `sboc_like`, so that the star stays visible inside. Chosen.


def write_files(run: RunFrames, folder: Path) -> list[tuple[ShownFrame, Path, Path]]:
    """Region file and VOTable of the streaks of each frame of a run; star lists beside them."""
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for frame in run:
        regions, streaks = folder / f"{frame.name}.reg", folder / f"{frame.name}.streaks.vot"
        write_text(regions, region_text(frame))
        write_votable(streaks, with_fits_pixels(frame.streaks), f"streaks of frame {frame.number}")
        write_votable(folder / f"{frame.name}.stars.vot", with_fits_pixels(frame.stars), f"stars of frame {frame.number}")
        written.append((frame, regions, streaks))
    return written


def region_text(frame: ShownFrame) -> str:
    """DS9 regions in image coordinates, which count from 1: streaks as lines, stars as circles."""
    lines = []
    for s in frame.streaks:
        ends = ",".join(f"{float(s[name]) + 1.0:.3f}" for name in ("col0", "row0", "col1", "row1"))
        if not np.isfinite([float(s[name]) for name in ("col0", "row0", "col1", "row1")]).all():
            continue
        published = is_published(s)
        words = f"streak {int(s['streak_id'])}, S/N {float(s['snr']):.1f}, p {float(s['probability']):.2f}"
        kind = "published" if published else "rejected"
        style = "color=orange" if published else "color=cyan dash=1"
        lines.append(f"line({ends}) # line=0 0 {style} text={{{words}}} tag={{{kind}}}")
    for s in frame.stars:
        place = f"{float(s['col']) + 1.0:.3f},{float(s['row']) + 1.0:.3f}"
        lines.append(f"circle({place},{STAR_RADIUS_PX:g}) # color=green tag={{star}}")
    return HEAD + "\n".join(lines) + "\n"


def with_fits_pixels(table: Table) -> Table:
    """A table with FITS pixel coordinates (x = col + 1, y = row + 1) beside ours, which count from 0."""
    out = table.copy()
    for end in ("", "0", "1", "_mid"):
        for ours, theirs in (("col", "x"), ("row", "y")):
            if ours + end in out.colnames:
                out[f"fits_{theirs}{end}"] = np.asarray(out[ours + end], dtype=np.float64) + 1.0
                out[f"fits_{theirs}{end}"].unit = "pix"
    return out


def write_votable(path: Path, table: Table, description: str) -> None:
    """A VOTable file."""
    out: Any = table.copy()
    out.meta = {"description": description}
    for name in out.colnames:
        unit = str(out[name].unit or "")
        if "electron" in unit:  # no unit of the VOTable standard
            out[name].unit, out[name].description = None, f"{out[name].description or name} ({unit})"
    with replacing(path) as stream:
        out.write(stream, format="votable")
