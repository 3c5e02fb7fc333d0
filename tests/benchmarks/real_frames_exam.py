"""An exam on frames of other cameras, run again: frames by frame, and what is asked against what was measured.

    python -m tests.benchmarks.real_frames_exam EXAM.json FRAMES --out DIR [--only TEXT] [--sboc COMMAND]

EXAM.json (`real_frames_exam_*.json` beside this script) lists repository, commit, path, licence, cut and ends of the trails of
each frame: [row0, col0, row1, col1], rows and columns from 0. The frames are not part of the project. Whoever wants them makes a
file of each in FRAMES: a picture is the mean of red, green and blue as float32, its first row first, cut to [row0, row1, col0,
col1]; FITS files keep their numbers. `sha256` is that of the file. Lines on "doubtful" trails count neither way. Runs that exist
are not made again.
"""

import argparse
import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from astropy.table import Table

from tests.benchmarks.real_frames import COMMAND, covered, is_published, process_command, report, trail_of
from tests.benchmarks.real_frames_table import SURE, Row, sums_text


def by_column(ends: Sequence[float]) -> list[float]:
    """Ends with the column first, as `real_frames` has them."""
    row0, col0, row1, col1 = ends
    return [col0, row0, col1, row1]


def row_of(entry: dict[str, Any], streaks: Table, cpu_s: float, wall_s: float, exit_code: int) -> Row:
    """What became of a frame."""
    made = [trail_of(streaks, by_column(ends)) for ends in entry["trails"]]
    on = set().union(*(places for _, places in made))
    doubtful = [by_column(ends) for ends in entry["doubtful"]]
    kept = [
        (k, s) for k, s in enumerate(streaks)
        if is_published(s) and (k in on or not any(covered(s, trail) > 0.0 for trail in doubtful))
    ]  # fmt: skip
    wrong = [s for k, s in kept if k not in on]
    return Row(
        file=entry["file"],
        frame=entry["file"],
        camera=entry["camera"] + (", calibrated" if entry["blank_kind"] == "calibrated" else ""),
        rows=0,
        cols=0,
        trails=tuple(trail for trail, _ in made),
        measured=len(streaks),
        false=len(wrong),
        false_sure=sum(float(s["probability"]) >= SURE for s in wrong),
        sure=sum(float(s["probability"]) >= SURE for _, s in kept),
        cpu_s=cpu_s,
        wall_s=wall_s,
        exit_code=exit_code,
    )


def frame_of(entry: dict[str, Any], frames: Path) -> Path | None:
    """The file of an entry; None, and a line that says so, where it is not there or another."""
    path = frames / entry["file"]
    if not path.exists() or hashlib.sha256(path.read_bytes()).hexdigest() != entry["sha256"]:
        report(f"{path}: left out, " + ("its SHA-256 is not that of the exam" if path.exists() else "not there"))
        return None
    return path


def processed(entry: dict[str, Any], path: Path, out: Path, command: Sequence[str]) -> Row:
    """What became of a file, which is processed unless its run exists."""
    code, cpu_s, wall_s = 0, 0.0, 0.0
    if not (out / "report.html").exists():
        code, cpu_s, wall_s = process_command(path, out, command)
    table = out / "products" / "streaks.ecsv"
    row = row_of(entry, Table.read(table) if code == 0 else Table(), cpu_s, wall_s, code)
    report(row.line)
    return row


def main() -> None:
    """Process what was not yet, compare, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("exam", type=Path)
    parser.add_argument("frames", type=Path)
    parser.add_argument("--out", type=Path, required=True, help="folder of the runs")
    parser.add_argument("--only", default="", help="part of a file's name")
    parser.add_argument("--sboc", default=" ".join(COMMAND), help="the command that is measured")
    chosen = parser.parse_args()
    rows = []
    for entry in json.loads(chosen.exam.read_text()):
        path = frame_of(entry, chosen.frames) if chosen.only in entry["file"] else None
        if path is not None:
            rows.append(processed(entry, path, chosen.out / path.stem, chosen.sboc.split()))
    report(sums_text(rows))


if __name__ == "__main__":
    main()
