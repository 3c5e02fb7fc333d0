"""Run the benches, each in a process of its own, and gather their figures."""

import json
import os
import platform
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from sboc_e2e.bench.baseline import Regression, read_baseline, regressions, write_baseline
from sboc_e2e.bench.entries import Entry, flatten
from sboc_e2e.bench.pages import write_pages
from sboc_e2e.files.atomic import require_writable
from sboc_e2e.icd.errors import UserError

ROOT: Final = Path(__file__).resolve().parents[2]
SCRIPTS: Final = ROOT / "tests" / "benchmarks"
ONE_THREAD: Final = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS", "MKL_NUM_THREADS"), "1")

RUNS: Final = (
    ("smoke", ("smoke",)),
    ("sso_antisun", ("sso_antisun",)),
)
QUICK_RUNS: Final = (
    ("smoke", ("smoke",)),
    ("sso_antisun_8_frames", ("sso_antisun", "--set", "frames=8")),
)


def run_bench(
    out: Path,
    *,
    quick: bool = False,
    peers: bool = False,
    check: bool = False,
    rewrite_baseline: bool = False,
    report: Callable[[str], None] = lambda line: None,
) -> list[Regression]:
    """Write report.json, report.md, report.html, benchmark-action.json and a line of history into `out`.

    quick : the subset for CI. peers : also the peers that live in an environment of their own (tests/benchmarks/peers).
    check : compare with bench/baseline.json; the regressions are returned. Raises UserError outside a source checkout.
    """
    if not SCRIPTS.is_dir():
        raise UserError(f"sboc bench runs from a source checkout: {SCRIPTS} is not there")
    require_writable(out)
    start = time.monotonic()
    entries: list[Entry] = []
    costs: dict[str, float] = {}
    for name, arguments in QUICK_RUNS if quick else RUNS:
        report(f"run {name}")
        began = time.monotonic()
        entries += _scores_of_run(name, arguments, out / "runs" / name)
        costs[name] = time.monotonic() - began
    for script in sorted(SCRIPTS.glob("bench_*.py")):
        name = script.stem.removeprefix("bench_")
        if name.startswith("peers_") and not peers:
            continue
        report(f"bench {name}")
        began = time.monotonic()
        entries += flatten(name, _run_script(script.stem, quick, out))
        costs[name] = time.monotonic() - began
    environment = _environment() | {"quick": quick, "wall_s": round(time.monotonic() - start, 1)}
    baseline_path = ROOT / "bench" / ("baseline_quick.json" if quick else "baseline.json")
    if rewrite_baseline:
        write_baseline(baseline_path, entries)
    found = regressions(entries, read_baseline(baseline_path)) if check else []
    write_pages(entries, costs, environment, [str(r) for r in found], out)
    return found


def _child(arguments: list[str], what: str) -> None:
    environment = os.environ | ONE_THREAD
    done = subprocess.run(arguments, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)  # noqa: S603  our own command lines
    if done.returncode != 0:
        last = (done.stderr or done.stdout).strip().splitlines()[-1:] or ["no output"]
        raise UserError(f"benchmark {what} failed with exit code {done.returncode}: {last[0][:300]}")


def _scores_of_run(name: str, arguments: tuple[str, ...], folder: Path) -> list[Entry]:
    _child([sys.executable, "-m", "sboc_e2e", "run", *arguments, "--out", str(folder), "--force"], name)
    score: dict[str, Any] = json.loads((folder / "score.json").read_text())
    for section in ("score_version", "passed"):
        score.pop(section, None)
    return flatten(name, score)


def _run_script(module: str, quick: bool, out: Path) -> dict[str, Any]:
    result = out / f"{module}.json"
    _child([sys.executable, "-m", "tests.benchmarks.driver", module, "quick" if quick else "full", str(result)], module)
    return dict(json.loads(result.read_text()))


def _environment() -> dict[str, Any]:
    return {"python": platform.python_version(), "machine": platform.machine(), "processors": os.cpu_count()}
