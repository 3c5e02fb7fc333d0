"""How well two eyes agree on the trails of an exam, and the program with each of them: the bound of what an exam can tell.

    python -m tests.benchmarks.second_eye EXAM.json ... [--runs DIR]

`second_eye.json` beside this script holds the marks of a second eye, who saw neither the first one's nor the program's. DIR has
the runs of `real_frames_exam`, by the name of the frame.
"""

import argparse
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from astropy.table import Table

from tests.benchmarks.real_frames import report, trail_of
from tests.benchmarks.real_frames_exam import by_column, row_of
from tests.benchmarks.real_frames_table import HALF, NEAR_PX, share_text

MARKS: Final = Path(__file__).with_name("second_eye.json")

Marks = Mapping[str, Mapping[str, Any]]
"""Marks of an eye by the name of the frame: "trails" and "doubtful" as [row0, col0, row1, col1]."""


def as_streaks(trails: Sequence[Sequence[float]]) -> Table:
    """Marks of an eye as published streaks, whose ends quote no interval."""
    ends = np.reshape(np.asarray(trails, dtype=np.float64), (-1, 4))
    table = Table(ends, names=("row0", "col0", "row1", "col1"))
    for name in ("width_px", "sagitta_px", "flags"):
        table[name] = np.zeros(len(ends), dtype=np.int64)
    for name in ("snr", "probability", "light0_low_px", "light0_high_px", "light1_low_px", "light1_high_px"):
        table[name] = np.full(len(ends), math.nan)
    return table


def agreement(first: Marks, second: Marks) -> tuple[int, int, list[float]]:
    """Trails of one eye that another has with half their length or more, all of the one, and how far the ends lie apart (px)."""
    made = [
        trail_of(as_streaks(second[file]["trails"]), by_column(ends))[0]
        for file, marks in first.items()
        for ends in marks["trails"]
    ]
    seen = [trail for trail in made if trail.published >= HALF]
    return len(seen), len(made), [px for trail in seen for px in trail.end_px]


def against(marks: Marks, entries: Sequence[Mapping[str, Any]], runs: Path) -> str:
    """The program's runs against the marks of an eye, in a line."""
    rows = []
    for entry in entries:
        table = runs / Path(entry["file"]).stem / "products" / "streaks.ecsv"
        own = {key: marks[entry["file"]][key] for key in ("trails", "doubtful")}
        if table.exists():
            rows.append(row_of({**entry, **own}, Table.read(table), 0.0, 0.0, 0))
    trails = [trail for row in rows for trail in row.trails]
    half = [trail for trail in trails if trail.published >= HALF]
    inside = [ok for trail in half for ok in trail.inside]
    return (
        f"{len(rows)} frames: published {share_text(len(half), len(trails))}, "
        f"measured {sum(trail.found >= HALF for trail in trails)}, ends {share_text(sum(inside), len(inside))}, "
        f"false {sum(row.false for row in rows)}, of those at 0.9 or more {sum(row.false_sure for row in rows)} of "
        f"{sum(row.sure for row in rows)}"
    )


def main() -> None:
    """Compare, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("exam", type=Path, nargs="+")
    parser.add_argument("--runs", type=Path, help="folder of the runs of real_frames_exam")
    chosen = parser.parse_args()
    other: Marks = {each["file"]: each for each in json.loads(MARKS.read_text())}
    entries = [each for path in chosen.exam for each in json.loads(path.read_text()) if each["file"] in other]
    first: Marks = {each["file"]: each for each in entries}
    second = {file: other[file] for file in first}
    report(f"{len(entries)} frames with the marks of two eyes")
    for name, one, two in (("first", first, second), ("second", second, first)):
        seen, number, apart = agreement(one, two)
        near = sum(px <= NEAR_PX for px in apart)
        report(
            f"trails of the {name} eye that the other one has: {share_text(seen, number)}; ends within {NEAR_PX:g} px: "
            f"{share_text(near, len(apart))}"
        )
    if chosen.runs is not None:
        for name, marks in (("first", first), ("second", second)):
            report(f"program against the {name} eye: {against(marks, entries, chosen.runs)}")


if __name__ == "__main__":
    main()
