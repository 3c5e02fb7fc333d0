"""Satellites in frames of an independent simulator, through `sboc process` with its defaults.

    python -m tests.benchmarks.outside_sky [--scenes N] [--side PX] [--seed S] [--page docs/real-frames.md] [ROW ...]

`sky_frames` draws pairs of frames with nothing of the simulator. The streaks are in the first frame of every
second pair, so that half of them lie in a frame without a predecessor. S/N is drawn evenly in its logarithm from 8 to 50, length
from 20 to 300 px. A streak is found when a published one covers half of it or more along its line. Each sky has seeds of its own:
the same ones would draw the same noise under most of them.
"""

import argparse
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from astropy.io import fits
from astropy.table import Table

from tests.benchmarks import sky_frames
from tests.benchmarks.detection_frames import Streak
from tests.benchmarks.real_frames import covered, is_published, process_command, report, with_table
from tests.benchmarks.real_frames_table import HALF, rate_text, share_text

MARK: Final = "<!-- table: tests.benchmarks.outside_sky -->"
SKIES: Final = ("clean", "companions", "aureoles", "stray_light", "particles", "ripple")
SNR: Final = (8.0, 50.0)
LENGTH_PX: Final = (20.0, 300.0)
EACH: Final = 5
"""Streaks of a scene."""

SEEDS_APART: Final = 100
"""Between the first seeds of two skies: more than the scenes of one."""

FAINT_SNR: Final = 10.0
"""Streaks below it are counted apart too."""


@dataclass(frozen=True, kw_only=True)
class Case:
    """One streak: S/N, whether its frame was the first of its sky, and what became of it."""

    snr: float
    first: bool
    measured: bool
    published: bool


def drawn(row: sky_frames.Row, side: int, seed: int) -> sky_frames.Scene:
    """One scene with streaks of random S/N and length."""
    rng = np.random.default_rng((seed, 18))
    wanted = [(float(np.exp(rng.uniform(*np.log(LENGTH_PX)))), float(np.exp(rng.uniform(*np.log(SNR))))) for _ in range(EACH)]
    return sky_frames.scene(row, side, wanted, seed)


def write(folder: Path, scene: sky_frames.Scene, number: int, *, first: bool) -> None:
    """The pair as files, that with the streaks first or second."""
    pair = (scene.later, scene.earlier) if first else (scene.earlier, scene.later)
    for k, pixels in enumerate(pair):
        hdu = fits.PrimaryHDU(pixels)
        second = 2 * number + k
        hdu.header.update({"DATE-OBS": f"2027-01-29T00:{second // 60:02d}:{second % 60:02d}", "EXPTIME": 0.5, "GAIN": 1.0})
        hdu.writeto(folder / f"{number:04d}_{k}.fits")


def best_share(streak: Streak, measured: list[Any]) -> float:
    """Largest share of a drawn streak that a measured one covers."""
    line = (streak.col0, streak.row0, streak.col1, streak.row1)
    return max((covered(each, line) for each in measured), default=0.0)


def examined(row: sky_frames.Row, side: int, scenes: int, seed: int, scratch: Path) -> tuple[list[Case], int, float]:
    """Cases of a sky, false published streaks of its frames, and wall seconds of the run."""
    folder, out = scratch / "frames", scratch / "out"
    folder.mkdir(parents=True)
    truth = [drawn(row, side, seed + k) for k in range(scenes)]
    for k, scene in enumerate(truth):
        write(folder, scene, k, first=k % 2 == 0)
    code, _, wall_s = process_command(folder, out)
    if code != 0:
        raise SystemExit(f"{row.name}: sboc process ended with {code}")
    table = Table.read(out / "products" / "streaks.ecsv", format="ascii.ecsv")
    frame = np.asarray(table["frame"])
    cases, false = [], 0
    for k, scene in enumerate(truth):
        first = k % 2 == 0
        for late in (False, True):
            here = list(table[frame == 2 * k + late])
            published = [each for each in here if is_published(each)]
            streaks = scene.streaks if late != first else []
            false += sum(all(covered(each, _line(s)) == 0.0 for s in streaks) for each in published)
            cases += [
                Case(
                    snr=s.snr,
                    first=first,
                    measured=best_share(s, here) >= HALF,
                    published=best_share(s, published) >= HALF,
                )
                for s in streaks
            ]
    return cases, false, wall_s


def _line(streak: Streak) -> tuple[float, float, float, float]:
    return streak.col0, streak.row0, streak.col1, streak.row1


def line_of(name: str, cases: list[Case], frames: int, false: int, wall_s: float) -> str:
    """One line of the table."""

    def found(chosen: list[Case]) -> str:
        return share_text(sum(case.published for case in chosen), len(chosen))

    faint = [case for case in cases if case.snr < FAINT_SNR]
    first = [case for case in cases if case.first]
    measured = share_text(sum(case.measured for case in cases), len(cases))
    return (
        f"| {name} | {measured} | {found(cases)} | {found(first)} | {found(faint)} | {rate_text(false, frames)} | "
        f"{wall_s / frames:.1f} |"
    )


def main() -> None:
    """Draw, process, compare, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rows", nargs="*", default=SKIES)
    parser.add_argument("--scenes", type=int, default=10)
    parser.add_argument("--side", type=int, default=1024)
    parser.add_argument("--seed", type=int, default=1000)
    parser.add_argument("--page", type=Path, help="page whose table is replaced")
    arguments = parser.parse_args()
    lines = [
        "| sky | measured | published | in first frames | S/N 8 to 10 | false | wall s a frame |",
        "|---|---|---|---|---|---|---|",
    ]
    cases: list[Case] = []
    false = frames = 0
    spent_s = 0.0
    for number, row in enumerate(sky_frames.ROWS):
        if row.name not in arguments.rows:
            continue
        seed = arguments.seed + SEEDS_APART * number
        with tempfile.TemporaryDirectory() as scratch:
            made, wrong, wall_s = examined(row, arguments.side, arguments.scenes, seed, Path(scratch))
        lines.append(line_of(row.name, made, 2 * arguments.scenes, wrong, wall_s))
        report(lines[-1])
        cases, false, frames, spent_s = cases + made, false + wrong, frames + 2 * arguments.scenes, spent_s + wall_s
    lines.append(line_of("all", cases, frames, false, spent_s))
    report("\n".join(lines))
    if arguments.page:
        arguments.page.write_text(with_table(arguments.page.read_text(), "\n".join(lines), MARK))


if __name__ == "__main__":
    main()
