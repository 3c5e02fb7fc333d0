"""What runs with every change can fail for a figure that became worse."""

import importlib
import inspect
import subprocess
from pathlib import Path
from typing import Any, get_origin

import pytest
import yaml  # type: ignore[import-untyped]  # ships no types

from sboc_e2e.bench.baseline import read_baseline
from sboc_e2e.bench.parts import SCRIPTS, parts
from sboc_e2e.bench.run_bench import baseline_file

ROOT = Path(__file__).resolve().parents[2]
WORKFLOW = ROOT / ".github" / "workflows" / "ci.yml"


@pytest.fixture(scope="module")
def jobs() -> dict[str, Any]:
    return dict(yaml.safe_load(WORKFLOW.read_text())["jobs"])


def made_by(command: str) -> str:
    """What a `make` command would run."""
    verb = command.removeprefix("make ").split()
    return subprocess.run(["make", "-n", *verb], cwd=ROOT, capture_output=True, text=True, check=True).stdout


def test_a_job_measures_against_the_baseline_and_nothing_hides_its_verdict(jobs: dict[str, Any]) -> None:
    commands = [(job, step) for job in jobs.values() for step in job["steps"] if str(step.get("run", "")).startswith("make ")]
    judging = [(job, step) for job, step in commands if "sboc bench --quick --check" in made_by(step["run"])]
    assert len(judging) == 1
    for part in judging[0]:
        assert not part.get("continue-on-error")
        assert "if" not in part


def test_timings_of_the_quick_baseline_have_their_yardstick() -> None:
    baseline = read_baseline(baseline_file(quick=True))
    for part in parts(quick=True, peers=False):
        assert f"{part.name}.yardstick_s" in baseline


@pytest.mark.parametrize("script", sorted(path.stem for path in SCRIPTS.glob("bench_*.py")))
def test_each_part_is_called_as_the_driver_calls_it(script: str) -> None:
    main = importlib.import_module(f"tests.benchmarks.{script}").main
    signature = inspect.signature(main)
    assert all(name == "quick" or p.default is not p.empty for name, p in signature.parameters.items())
    returned = signature.return_annotation
    assert (get_origin(returned) or returned) is dict
