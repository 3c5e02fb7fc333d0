"""A day of precise orbits fitted, and the next day predicted: GPS and Galileo satellites of two consecutive SP3 files.

Any analysis centre's files of two days will do (IGS, also compressed with `compress`). Run from the repository's root:

    python -m tests.benchmarks.precise_day_ahead DAY1.sp3 DAY2.sp3 [DAY3.sp3 ...] [--degree 12] [--systems GE] [--out TABLE.json]

Every satellite of a pair of files is in the table, or it is named with the reason why it is not. A fit's rms is that of all
epochs, whether they count in the fit or not. `eclipse`: the Sun is so near the orbit's plane that the satellite enters the
Earth's shadow. `both_m` is given beyond 30 m: the rms of one free orbit through both days. Where that is large and each day
alone fits, the satellite was moved or turned.
"""

import argparse
import json
import math
import sys
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import Final

import numpy as np

from ground.determination.batch import Solution
from ground.determination.forces import ForceModel
from ground.determination.precise import Ephemeris, fitted, read_sp3
from ground.determination.propagation import propagate
from ground.orbit.size import sun_direction
from sboc_e2e.icd import tai
from sboc_e2e.icd.errors import UserError

ASKED_FIT_M: Final = 1.0
ASKED_AHEAD_M: Final = 30.0
SIGMA_M: Final = 0.1
"""That `fitted` takes for each axis; residuals are whitened by it."""
LEAST_SHARE: Final = 0.9
"""Of the epochs of a file that a satellite must have in both files."""
EARTH_KM: Final = 6378.137


@dataclass(frozen=True, kw_only=True)
class Row:
    """One satellite of one pair of days.

    fit_m : rms of the first (3-D). ahead_m, ahead_rms_m : largest distance and rms within the second. next_m : of its own fit.
    """

    pair: str
    name: str
    fit_m: float
    ahead_m: float
    ahead_rms_m: float
    both_m: float
    next_m: float
    sun_to_plane_deg: float
    eclipse: bool
    flagged: bool


def rms_m(solution: Solution) -> float:
    """Of all epochs, three-dimensional."""
    return math.sqrt(3.0) * SIGMA_M * float(np.sqrt(np.mean(solution.residuals**2)))


def row_of(pair: str, first: Ephemeris, second: Ephemeris, forces: ForceModel) -> Row:
    """Fit the first day, predict the second."""
    solution = fitted(first, forces)
    ahead = propagate(solution.state, solution.t0_tai_ns, second.t_tai_ns, solution.forces).states[:, :3]
    away_m = 1e3 * np.linalg.norm(ahead - second.positions(1.0).position_km, axis=1)
    normal = np.cross(solution.state[:3], solution.state[3:])
    sun = sun_direction(int(second.t_tai_ns[0]))
    beta = math.asin(float(normal @ sun) / float(np.linalg.norm(normal)))
    later = second.t_tai_ns > first.t_tai_ns[-1]
    both = Ephemeris(
        name=first.name,
        t_tai_ns=np.concatenate([first.t_tai_ns, second.t_tai_ns[later]]),
        itrs_km=np.vstack([first.itrs_km, second.itrs_km[later]]),
    )
    worst = float(away_m.max())
    return Row(
        pair=pair,
        name=first.name,
        fit_m=rms_m(solution),
        ahead_m=worst,
        ahead_rms_m=float(np.sqrt(np.mean(away_m**2))),
        both_m=rms_m(fitted(both, forces)) if worst > ASKED_AHEAD_M else math.nan,
        next_m=rms_m(fitted(second, forces)) if worst > ASKED_AHEAD_M else math.nan,
        sun_to_plane_deg=math.degrees(beta),
        eclipse=abs(math.sin(beta)) < EARTH_KM / float(np.linalg.norm(first.itrs_km, axis=1).min()),
        flagged=solution.manoeuvre,
    )


def pair_of(paths: tuple[Path, Path], systems: str, forces: ForceModel) -> tuple[list[Row], list[str]]:
    """Rows of a pair of files, and satellites that are left out, with the reason."""
    one, two = (read_sp3(path.read_bytes(), path.name) for path in paths)
    full = [max(len(e.t_tai_ns) for e in day.values()) for day in (one, two)]
    start, next_start = (min(int(e.t_tai_ns[0]) for e in day.values()) for day in (one, two))
    if next_start - start != tai.NS_PER_DAY:
        raise UserError(f"{paths[1].name}: expected to begin a day after {paths[0].name}")
    pair = f"{paths[0].name.split('.')[0]}+1"
    rows, left_out = [], []
    for name in sorted(name for name in {*one, *two} if name[0] in systems):
        short = [
            path.name
            for path, day, n in zip(paths, (one, two), full, strict=True)
            if name not in day or len(day[name].t_tai_ns) < LEAST_SHARE * n
        ]
        if short:
            left_out.append(f"{pair} {name}: fewer than {LEAST_SHARE:.0%} of the epochs in {', '.join(short)}")
            continue
        try:
            rows.append(row_of(pair, one[name], two[name], forces))
        except UserError as error:
            left_out.append(f"{pair} {name}: {error}")
    return rows, left_out


def summary(rows: list[Row], what: str) -> str:
    """Median and worst of some rows in one line."""
    if not rows:
        return f"{what}: none"
    fit_m, ahead_m = (np.array([getattr(row, name) for row in rows]) for name in ("fit_m", "ahead_m"))
    worst = rows[int(np.argmax(ahead_m))]
    return (
        f"{what}: n {len(rows)}, fit rms median {np.median(fit_m):.3f} m, worst {fit_m.max():.3f} m, "
        f"{int((fit_m <= ASKED_FIT_M).sum())} within {ASKED_FIT_M:g} m; day ahead median {np.median(ahead_m):.2f} m, "
        f"worst {worst.ahead_m:.2f} m ({worst.pair} {worst.name}), "
        f"{int((ahead_m <= ASKED_AHEAD_M).sum())} within {ASKED_AHEAD_M:g} m"
    )


def main(arguments: list[str] | None = None) -> None:
    """Write each pair's and all pairs' median and worst; name what is beyond the limits and what is left out."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("files", nargs="+", type=Path)
    parser.add_argument("--degree", type=int, default=12)
    parser.add_argument("--systems", default="GE", help="first letters of satellites")
    parser.add_argument("--out", type=Path)
    given = parser.parse_args(arguments)
    forces = ForceModel(gravity_degree=given.degree)
    rows: list[Row] = []
    left_out: list[str] = []
    for paths in pairwise(given.files):
        found, without = pair_of(paths, given.systems, forces)
        rows += found
        left_out += without
        sys.stdout.write(summary(found, f"{paths[0].name} and the next day") + "\n")
        sys.stdout.flush()
    for system in given.systems:
        mine = [row for row in rows if row.name[0] == system]
        for eclipse, words in ((False, "no eclipse"), (True, "eclipse season")):
            sys.stdout.write(summary([row for row in mine if row.eclipse == eclipse], f"{system}, {words}") + "\n")
    sys.stdout.write(summary(rows, "all") + "\n")
    beyond = [row for row in rows if row.fit_m > ASKED_FIT_M or row.ahead_m > ASKED_AHEAD_M or row.flagged]
    sys.stdout.write("".join(f"beyond, or flagged by the fit: {row}\n" for row in beyond))
    sys.stdout.write("".join(f"left out: {line}\n" for line in left_out) or "left out: none\n")
    if given.out:
        given.out.write_text(json.dumps({"rows": [asdict(row) for row in rows], "left_out": left_out}, indent=1))


if __name__ == "__main__":
    main()
