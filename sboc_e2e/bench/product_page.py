"""How right the published files are, in one table: aims, values, intervals, from stored cases of fresh seeds.

``python -m sboc_e2e.bench.product_page docs/products.md`` writes the page from bench/products.json, which
``python -m tests.benchmarks.product_runs`` measures; a test holds the page there.
"""

import argparse
import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from sboc_e2e.bench.parts import STORED as FOLDER
from sboc_e2e.report.words import figure_words
from sboc_e2e.score.figures import Figure, absent, bootstrap, bootstrap_by_owner, exact, figure, proportion, pull_width, rms

STORED: Final = FOLDER / "products.json"
Cases = Sequence[Mapping[str, Any]]

YARDSTICK_S: Final = 0.083
"""Of the machine that the baseline was made on."""
RUNS: Final = {
    "nadir_rotation": "`nadir_rotation`",
    "sso_antisun": "`sso_antisun`",
    "sso_antisun_ideal": "`sso_antisun` with the ideal camera",
}
"""Parts of whole runs, and what the page calls them."""

NEW_LIGHT: Final = 20047
"""First seed of runs whose magnitudes were measured with one version of the code."""

HEAD_TEXT: Final = """# How right the published files are

Generated from `bench/products.json` by `python -m sboc_e2e.bench.product_page docs/products.md`.
`python -m tests.benchmarks.product_runs FOLDER` measures all of it again, in about an hour of one core, and goes on where it
stopped.

The seeds are new: none was looked at while the code they judge was written, magnitudes excepted (below). Intervals (in brackets)
hold 90 %. Those of angles
resample objects, because the angles of one object share errors; those of the population resample runs. "Met" compares the value,
not its interval, with the aim. The readers of the files share no code with their writers ([scoring](scoring.md#products)).

"""


@dataclass(frozen=True, kw_only=True)
class Line:
    """One number: how it is made of the cases of its parts, and what it should be."""

    name: str
    parts: tuple[str, ...]
    least: float = -math.inf
    most: float = math.inf
    aim: str
    figure: Callable[[Cases], Figure]
    note: str = ""
    first: int = 0
    """First seed that counts."""


def _within(column: int, sigmas: float) -> Callable[[Cases], Figure]:
    """Share of angles whose error is within so many stated sigmas, objects resampled."""

    def share(cases: Cases) -> Figure:
        rows, owners = [], []
        for number, case in enumerate(cases):
            rows += [float(abs(row[column]) <= sigmas) for row in case["angles"]]
            owners += [1000 * number + int(row[0]) for row in case["angles"]]
        return bootstrap_by_owner(np.array(rows), np.array(owners), _mean)

    return share


def _mean(values: Any) -> float:
    return float(np.mean(values))


def _of_shares(name: str) -> Callable[[Cases], Figure]:
    """Runs' shares of one name put together."""

    def together(cases: Cases) -> Figure:
        of = [(case[name]["value"], case[name]["n"]) for case in cases if case[name]["value"] is not None]
        return proportion(round(sum(share * n for share, n in of)), sum(n for _, n in of))

    return together


def _largest(name: str, over: str = "") -> Callable[[Cases], Figure]:
    """Largest value of the runs, or ratio to another figure of the same run; `n` is the number of runs."""

    def largest(cases: Cases) -> Figure:
        if not cases:
            return absent("no run")
        return exact(max(case[name]["value"] / (case[over]["value"] if over else 1.0) for case in cases), len(cases))

    return largest


def _of_items(name: str, statistic: Callable[[Any], float]) -> Callable[[Cases], Figure]:
    """Statistic of all items of the cases, which are independent."""

    def together(cases: Cases) -> Figure:
        items = [item for case in cases for item in case[name]]
        return bootstrap(np.array(items), statistic)

    return together


def _focal_pulls(cases: Cases) -> Figure:
    """Rms of the pulls; runs with drift and without it share their stars, so those of one star field are resampled together."""
    kinds = ("rest_still", "rest_scan", "warm_still", "warm_scan")
    pulls = [[case[kind][k] for kind in kinds] for case in cases for k in range(len(case[kinds[0]]))]
    found = bootstrap(np.array(pulls), rms)
    return found | {"n": len(kinds) * len(pulls)}


def _flux(cases: Cases) -> Figure:
    """Share of sizes whose interval holds the true flux, runs resampled; `n` counts sizes."""
    known = [[inside for inside in case["inside"] if inside is not None] for case in cases]
    held = np.array([[sum(inside), len(inside)] for inside in known])
    found = bootstrap(held, lambda counts: float(counts[:, 0].sum() / counts[:, 1].sum()))
    return found | {"n": int(held[:, 1].sum()) if len(held) else 0}


def _ground_cpu(cases: Cases) -> Figure:
    """Mean over runs of the CPU seconds a frame at the speed of the baseline's machine."""
    return bootstrap(np.array([case["ground_cpu_s"] * YARDSTICK_S / case["yardstick_s"] for case in cases]), _mean)


def _corner(cases: Cases) -> Figure:
    """Rms over the runs; the interval is the smallest and the largest of them."""
    found = [case["corner_arcsec"] for case in cases]
    return figure(rms(np.array(found)), len(found), min(found), max(found)) if found else absent("no run")


def _corner_bound(cases: Cases) -> Figure:
    return exact(float(np.mean([case["bound_arcsec"] for case in cases])), len(cases)) if cases else absent("no run")


def _coverage_lines() -> Iterator[Line]:
    for part, called in RUNS.items():
        for way, column in (("along", 1), ("across", 2)):
            for words, sigmas, wanted in (("one", 1.0, 0.68), ("1.96", 1.96, 0.95)):
                if (way, words) == ("along", "one"):
                    yield Line(
                        name=f"{called}: TDM angles along the motion within half of the stated 68 % interval", parts=(part,),
                        least=0.64, most=0.72, aim="0.68 +- 0.04", figure=_within(5, 1.0),
                    )  # fmt: skip
                yield Line(
                    name=f"{called}: TDM angles {way} the motion within {words} stated sigma", parts=(part,),
                    least=wanted - 0.04, most=wanted + 0.04, aim=f"{wanted} +- 0.04", figure=_within(column, sigmas),
                )  # fmt: skip


LINES: Final = (
    Line(
        name="TDM angles that differ from `streaks.ecsv` by more than 1 mas", parts=tuple(RUNS), most=0.0, aim="0",
        figure=_of_shares("differs"),
    ),
    Line(
        name="rms along the motion: TDM over `streaks.ecsv`, worst run", parts=tuple(RUNS), most=1.0001, aim="1",
        figure=_largest("along_rms", "streaks_along_rms"), note="epochs of the message are rounded to a microsecond",
    ),
    *_coverage_lines(),
    Line(name="`nadir_rotation`: objects linked", parts=("nadir_rotation",), least=0.95, aim="0.95", figure=_of_shares("linked")),
    Line(
        name="`nadir_rotation`: objects linked, worst run", parts=("nadir_rotation",), least=0.95, aim="0.95",
        figure=lambda cases: exact(min(case["linked"]["value"] for case in cases), len(cases)) if cases else absent("no run"),
    ),
    Line(
        name="NEES of orbit states, natural population, default prior", parts=("states_natural",), least=0.9, most=1.1,
        aim="0.9 to 1.1 (n >= 150)", figure=_of_items("nees", _mean),
    ),
    Line(
        name="NEES of orbit states, breakup orbits, prior of that population", parts=("states_breakup_own_prior",), least=0.9,
        most=1.1, aim="0.9 to 1.1 (n >= 150)", figure=_of_items("nees", _mean),
    ),
    Line(
        name="OEM: implied minus quoted velocity, rms of the worst run, m/s", parts=tuple(RUNS), most=0.05, aim="0.05",
        figure=_largest("velocity"),
    ),
    Line(
        name="pulls of tracklet magnitudes, lists of 2 to 24 exposures, three in ten tumbling", parts=("light",), least=0.9,
        most=1.1, aim="0.9 to 1.1", figure=_of_items("light", pull_width),
    ),
    Line(
        name="the same through the chain, tumblers as they are drawn", parts=tuple(RUNS), least=0.9, most=1.1,
        aim="0.9 to 1.1", figure=_of_items("light", pull_width), first=NEW_LIGHT,
        note="the common error of the members was fitted on these runs",
    ),
    Line(
        name='corner of the field, camera at rest, 40 of 600 frames, "', parts=("camera_at_rest",), most=0.05, aim="0.05",
        figure=_corner, note="brackets: smallest and largest run",
    ),
    Line(
        name='corner of the field, focal length drifting by 20 ppm, "', parts=("camera_that_warms",), most=0.05, aim="0.05",
        figure=_corner, note="brackets: smallest and largest run",
    ),
    Line(
        name='Cramer-Rao bound of that corner for the stars that came down, "', parts=("camera_at_rest", "camera_that_warms"),
        aim="", figure=_corner_bound, note="60 mas of errors of the catalogue, the same in every frame",
    ),
    Line(
        name="pulls of the focal length, with and without drift, one field or a scan", parts=("focal_length",), least=0.9,
        most=1.1, aim="0.9 to 1.1", figure=_focal_pulls,
    ),
    Line(
        name="90 % intervals of the published flux that hold the truth", parts=("flux",), least=0.86, most=0.94,
        aim="0.86 to 0.94, 40 runs", figure=_flux,
    ),
    Line(
        name="ground, CPU-s a frame of `sso_antisun` at the baseline machine's speed",
        parts=("sso_antisun", "sso_antisun_ideal"), most=0.25, aim="0.25", figure=_ground_cpu,
        note="yardsticks just before and after each run, on a loaded machine",
    ),
)  # fmt: skip


def summary(cases: Cases) -> list[dict[str, Any]]:
    """Every line with its figure and where the cases come from."""
    out = []
    for line in LINES:
        mine = [case for case in cases if case["part"] in line.parts and case["seed"] >= line.first]
        found = line.figure(mine) if mine else absent("not measured")
        seeds = {part: sorted(case["seed"] for case in mine if case["part"] == part) for part in line.parts}
        out.append({"name": line.name, "figure": found, "seeds": seeds})
    return out


def _seeds(seeds: Mapping[str, Sequence[int]]) -> str:
    words = {f"{of[0]} to {of[-1]} ({len(of)})" if len(of) > 1 else str(of[0]) for of in seeds.values() if of}
    return ", ".join(sorted(words))


def page() -> str:
    """The whole page."""
    stored = {row["name"]: row for row in json.loads(STORED.read_text(encoding="utf-8"))}
    lines = [HEAD_TEXT + "| number | aim | measured | n | met | seeds (cases) |", "|---|---|---|---|---|---|"]
    for line in LINES:
        row = stored.get(line.name, {"figure": absent("not measured"), "seeds": {}})
        found = row["figure"]
        words, _ = figure_words(found)
        met = "" if not line.aim or found["value"] is None else "yes" if line.least <= found["value"] <= line.most else "**no**"
        text = line.name + (f" ({line.note})" if line.note else "")
        lines.append(f"| {text} | {line.aim} | {words} | {found['n']:,} | {met} | {_seeds(row['seeds'])} |")
    return "\n".join(lines) + "\n\n" + REMARKS


REMARKS: Final = """## What stands behind them

- **Seeds that were looked at.** `nadir_rotation` was measured on seeds 20001 to 20009 first, then on 20010 to 20019,
  `sso_antisun` on 20001 to 20010 and 20021 to 20024. They showed that ends of steady trails of S/N 5,000 lay 0.2 to 0.7 px
  outside, that errors of joint fits with change points were widened twice, that a glint was masked as a star, that a piece of a
  trail had the magnitude of the whole exposure, and that a mask of a glint was longer than a flash may be. All are mended
  ([limits](limits.md#what-made-tdm-angles-miss-their-coverage)), so these seeds are not in the table.
- **Two cameras.** `sso_antisun` has a camera as cameras are. Its rows "with the ideal camera" were made with `--set
  psf.preset=ideal` (until then the scenario itself), as were the corners.
- **A real lens.** Across the motion `sso_antisun` holds 62 and 91 % where 68 and 95 % are stated: the images of a lens with 250
  nm of wavefront error are not symmetric, and their middle is not where the fit of a symmetric one is. With the ideal camera 67
  and 93 % are held.
- **Along, rms.** The rms of a run is that of its few longest faint trails, whose ends err by minutes of arc and say so. Medians
  are 0.5" to 1.3" in `nadir_rotation` and 0.6" in `sso_antisun` with the ideal camera.
- **Along, sigma or interval.** Posteriors of faint ends have heavy tails, so that their standard deviation holds more than 68
  %. Half of their 68 % interval, which `tdm_angles.ecsv` states beside it, holds 66 %.
- **Magnitudes through the chain.** The truth is the mean light over the object's light curve, which is what a tracklet states.
  `nadir_rotation` has 0.98 (n = 226), `sso_antisun` 1.10 with the ideal camera (57) and 1.23 with the real one (62), whose
  trails lose light that the fit does not know of. Faint exposures are found because noise or light curve makes them brighter.
  Without account of that, tracklets of S/N 7 to 9 were 0.13 mag too bright: 2.1 stated errors in the median class. Two numbers
  were chosen with these runs in view: the common error of 0.007 mag, and that the chance to be found does not change the
  probability of a light curve. Versions before gave, on runs not seen until then, 0.90 (n = 117) and 0.84 (91; ideal camera) with
  a common error of 0.008 mag, 1.03 (189), 1.21 (57) and 1.34 (61) with 0.005. Nine of the 345 tracklets err by more than four
  sigma. Of seven that earlier code had, four are tumblers whose trails are right and show one phase; three are not explained.
- **Linking, worst run.** One of seven objects is not linked. It is the only one of 238.
- **Linking in another table.** The table of [all scenarios](scenarios.md) has one run of `nadir_rotation`, its default seed: 11
  of 12 objects are linked, with an interval from 0.70 to 0.98. The twelfth has three trails of 520 px at S/N 8. Two of their
  ends were fitted 123 and 200 px outside, 5 and 10 sigma, which is probably why no motion passes through
  them. Completeness there (0.925)
  counts single streaks of S/N 8 and more, and the false ones (0.42 a frame) are five streaks of S/N 7 to 9, two of them in one
  tracklet.
- **Corner.** Listed stars err by 60 mas (catalogue and centroid) for as long as the field is the same. From some 240 of them
  attitude, focal length and distortion give a corner no better than the bound, on the mean over fields. One run is one draw of
  these errors: runs lie below and above it (0.038, 0.038, 0.061 and 0.066" in an earlier session, with drift and without). The
  list is that short because of the downlink.
- **Breakup orbits with the default shares** (10 % of large objects; seeds of an earlier session): NEES 1.02 +-0.07 (n = 108),
  but angles of large ones hold 76 to 81 % where 90 % is stated.
- **Flux.** The 40 runs (skies out to 11,000 km) hold 215 of 240 sizes. 22 runs hold all six, two hold three. All sizes of a
  run share their albedo, so that misses come together; the interval resamples runs.
- **Code.** All of the table was measured with ea96f780 (1 December 2026), in some 70 minutes of a shared computer. The rows
  of earlier code differ from it by less than their intervals.
"""

if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="python -m sboc_e2e.bench.product_page", description="Page of published files.")
    parser.add_argument("page", type=Path, help="the page's file, docs/products.md")
    parser.parse_args().page.write_text(page(), encoding="utf-8")
