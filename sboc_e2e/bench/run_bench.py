"""Run the parts of the benchmark report, each in a process of its own, and gather their figures."""

import json
import os
import platform
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields
from pathlib import Path
from typing import Any, Final

from sboc_e2e.bench.baseline import Regression, read_baseline, regressions, write_baseline
from sboc_e2e.bench.entries import Entry, flatten
from sboc_e2e.bench.pages import write_pages
from sboc_e2e.bench.parts import COSTS, ROOT, SCRIPTS, STORED, Part, cost_words, expected_costs, parts
from sboc_e2e.bench.yardstick import NAME as YARDSTICK
from sboc_e2e.bench.yardstick import yardstick_s
from sboc_e2e.files.atomic import require_writable, write_json
from sboc_e2e.icd.errors import UserError
from sboc_e2e.run.workers import worker_count

ONE_THREAD: Final = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS", "MKL_NUM_THREADS"), "1")
CHECKOUT_ONLY: Final = " (benches of single steps run from a source checkout)"
Measured = tuple[list[Entry], float]
"""Figures of a part, and its wall seconds."""


def run_bench(
    out: Path,
    *,
    quick: bool = False,
    peers: bool = False,
    long: bool = False,
    only: tuple[str, ...] = (),
    check: bool = False,
    rewrite_baseline: bool = False,
    report: Callable[[str], None] = lambda line: None,
) -> list[Regression]:
    """Write report.json, report.md, report.html, files for github-action-benchmark and a line of history into `out`.

    quick : the subset for CI. peers : also the peers that live in an environment of their own (tests/benchmarks/peers).
    long : the parts that last hours in full. only : names of parts, empty for all.
    rewrite_baseline : the figures replace the baseline; with `only`, they replace these parts of it.
    check : compare with the baseline; the regressions are returned. Raises UserError, before anything runs, for an unknown part,
    for a new baseline outside a source checkout, and when the baseline that `check` or a part of a new one needs is not there;
    and after the report is written when a part failed.
    """
    installed = not SCRIPTS.is_dir()
    if installed and rewrite_baseline:
        raise UserError("--write-baseline: an installed package keeps the baseline that it was built with; use a source checkout")
    # Parts run where the project is, which need not be where the user stands.
    out = out.resolve()
    baseline_path = baseline_file(quick=quick)
    baseline = read_baseline(baseline_path) if check else {}
    kept = read_baseline(baseline_path) if rewrite_baseline and only else {}
    known = [part.name for part in parts(quick=quick, peers=True)]
    if unknown := set(only) - set(known):
        where = CHECKOUT_ONLY if installed else ""
        raise UserError(f"--only: there is no part {', '.join(sorted(unknown))}; known: {', '.join(known)}{where}")
    wanted = parts(quick=quick, peers=peers or any(name.startswith("peers_") for name in only), long=long, only=only)
    require_writable(out)
    processors = worker_count(0)
    if installed:
        report(f"{', '.join(part.name for part in wanted)}{CHECKOUT_ONLY}")
    report(cost_words(expected_costs(wanted, quick=quick), wanted, processors))
    start = time.monotonic()
    report("compile kernels that are not compiled yet")
    _child([sys.executable, "-m", "sboc_e2e.warm_up"], "warm-up")
    done = _measure(wanted, out, processors, report)
    entries = [entry for part in wanted for entry in done[part.name][0]]
    costs = {part.name: round(done[part.name][1], 1) for part in wanted}
    environment = _environment() | {"quick": quick, "wall_s": round(time.monotonic() - start, 1)}
    failed = [entry.name for entry in entries if entry.name in done]
    if rewrite_baseline and not failed:
        # each part has a yardstick of its own, so that parts measured on different days stand side by side
        write_baseline(baseline_path, entries, kept=kept)
        stored = json.loads(COSTS.read_text()) if COSTS.is_file() else {}
        size = "quick" if quick else "full"
        write_json(COSTS, stored | {size: (stored.get(size, {}) if only else {}) | costs})
    found = regressions(entries, baseline)
    beside = baseline or (read_baseline(baseline_path) if baseline_path.is_file() else {})
    write_pages(entries, costs, environment, [str(r) for r in found], out, beside)
    if failed:
        raise UserError(f"{out / 'report.json'}: parts that failed: {', '.join(failed)}; no baseline was written")
    return found


def baseline_file(*, quick: bool) -> Path:
    """The committed baseline of the quick or the full benchmark."""
    return STORED / ("baseline_quick.json" if quick else "baseline.json")


def check_report(path: Path, baseline: Path | None = None) -> list[Regression]:
    """Regressions of a stored report.json against a baseline, by default the committed one of its size. Raises UserError."""
    try:
        stored = json.loads(path.read_text(encoding="utf-8"))
        quick, figures = bool(stored["environment"]["quick"]), stored["figures"]
        entries = [Entry(**{f.name: figure[f.name] for f in fields(Entry)}) for figure in figures]
    except OSError as error:
        raise UserError(f"{path}: cannot be read: {error.strerror or error}") from error
    except (ValueError, KeyError, TypeError) as error:
        raise UserError(f"{path}: not a report.json of sboc bench ({type(error).__name__}: {error})") from error
    return regressions(entries, read_baseline(baseline or baseline_file(quick=quick)))


def _measure(wanted: list[Part], out: Path, processors: int, report: Callable[[str], None]) -> dict[str, Measured]:
    """Parts that need the machine for themselves one after the other, then the rest side by side."""

    def one(part: Part) -> Measured:
        report(f"{'run' if part.scenario else 'bench'} {part.name}")
        began, fast = time.monotonic(), yardstick_s()
        try:
            made = _scores_of_run(part, out / "runs" / part.name) if part.scenario else flatten(part.name, _run_script(part, out))
        except UserError as error:
            # The other parts took minutes: they are worth a report of their own.
            report(f"FAILED {part.name}: {error}")
            made = [Entry(name=part.name, value=None, n=0, low=0.0, high=0.0, reason=str(error))]
        both = sorted((fast, yardstick_s()))
        made.append(Entry(name=f"{part.name}.{YARDSTICK}", value=sum(both) / 2, n=2, low=both[0], high=both[1]))
        return made, time.monotonic() - began

    done = {part.name: one(part) for part in wanted if part.alone}
    shared = [part for part in wanted if not part.alone]
    with ThreadPoolExecutor(processors) as pool:
        done |= dict(zip((part.name for part in shared), pool.map(one, shared), strict=True))
    return done


def _child(arguments: list[str], what: str) -> None:
    environment = os.environ | ONE_THREAD
    done = subprocess.run(arguments, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)  # noqa: S603  our own command lines
    if done.returncode != 0:
        last = (done.stderr or done.stdout).strip().splitlines()[-1:] or ["no output"]
        raise UserError(f"benchmark {what} failed with exit code {done.returncode}: {last[0][:300]}")


def _scores_of_run(part: Part, folder: Path) -> list[Entry]:
    _child([sys.executable, "-m", "sboc_e2e", "run", *part.scenario, "--out", str(folder), "--force"], part.name)
    score: dict[str, Any] = json.loads((folder / "score.json").read_text())
    for section in ("score_version", "passed", "notes"):
        score.pop(section, None)
    return flatten(part.name, score)


def _run_script(part: Part, out: Path) -> dict[str, Any]:
    module = f"bench_{part.name}"
    result = out / f"{module}.json"
    _child([sys.executable, "-m", "tests.benchmarks.driver", module, "quick" if part.quick else "full", str(result)], module)
    return dict(json.loads(result.read_text()))


def _environment() -> dict[str, Any]:
    return {"python": platform.python_version(), "machine": platform.machine(), "processors": worker_count(0)}
