"""Every shipped scenario as it is shipped: what it finds, what it makes up, what it links, and what a frame costs by stage.

``python -m tests.benchmarks.bench_scenarios NAME ...`` runs some of them, or all, and renews their rows in
bench/scenarios.json, from which ``python -m sboc_e2e.bench.scenario_page docs/scenarios.md`` makes the page.
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from sboc_e2e.bench.scenario_page import STORED_RUNS, row_of
from sboc_e2e.scenario import available


def measured(name: str) -> dict[str, Any]:
    """The figures of one run, in a process of its own."""
    with tempfile.TemporaryDirectory(prefix="sboc-scenario-") as folder:
        target = Path(folder) / "run"
        command = [sys.executable, "-m", "sboc_e2e", "run", name, "--out", str(target), "--workers", "1"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise RuntimeError(f"{name}: {done.stderr[-300:]}")
        return row_of(target)


def main() -> dict[str, Any]:
    """All scenarios that come with the project."""
    return {name: measured(name) for name in shipped()}


def shipped() -> list[str]:
    """Names, without the recreated real frames, which `sboc validate` judges."""
    return [name for name in available() if "/" not in name]


if __name__ == "__main__":
    rows = json.loads(STORED_RUNS.read_text()) if STORED_RUNS.is_file() else {}
    for name in sys.argv[1:] or shipped():
        try:
            rows[name] = measured(name)
        except RuntimeError as error:
            print(error, file=sys.stderr)  # noqa: T201 - the script's word on a scenario that failed
            continue
        STORED_RUNS.write_text(json.dumps(dict(sorted(rows.items())), indent=1) + "\n")
