"""The Python functions work as written: no guard, kernels kept where the command line keeps them, results as tables."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from sboc_e2e import api
from sboc_e2e.icd.errors import UserError

SCRIPT = """
import numba  # a notebook may have imported it first
from sboc_e2e.api import run

result = run("smoke", "made", set={"frames": 1, "stars.faint_limit": "12 mag"}, use={"onboard.detector": "threshold"})
print(result.value("detection.ground.false_per_frame"), len(result.streaks), len(result.truth()), result.report.is_file())
print(numba.config.CACHE_DIR)
print(result)
"""


@pytest.mark.slow
def test_a_script_without_a_guard(tmp_path: Path) -> None:
    """With spawned processes a script without a guard starts itself again and dies."""
    (tmp_path / "script.py").write_text(SCRIPT)
    environment = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"} | {"XDG_CACHE_HOME": str(tmp_path / "cache")}
    if "NUMBA_CACHE_DIR" in os.environ:
        # The kernels of this test session serve: compiling them again would take minutes.
        environment["NUMBA_CACHE_DIR"] = os.environ["NUMBA_CACHE_DIR"]
    done = subprocess.run(
        [sys.executable, "script.py"], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]
    figures, cache, *words = done.stdout.splitlines()
    assert figures.split()[-1] == "True"
    assert float(figures.split()[0]) >= 0.0
    assert cache == environment.get("NUMBA_CACHE_DIR", cache)
    assert any(line.startswith("completeness") for line in words)


def test_numba_that_is_imported_already_learns_the_folder(tmp_path: Path) -> None:
    code = "import numba, sboc_e2e.kernel_cache as k; k.use_cache_of_these_sources(); print(numba.config.CACHE_DIR)"
    environment = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"} | {"XDG_CACHE_HOME": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.startswith(str(tmp_path))


def test_folders_without_a_run_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"score\.json: not found"):
        api.open_run(tmp_path)


def test_figures_by_name() -> None:
    score = {"linking": {"purity": {"value": 0.5, "n": 4, "low": 0.2, "high": 0.8}}}
    result = api.RunResult(folder=Path("nowhere"), score=score, manifest={"stages": {}})
    assert result.value("linking.purity") == 0.5
    with pytest.raises(UserError, match="is a section of the score"):
        result.figure("linking")
    with pytest.raises(UserError, match="there is no table"):
        _ = result.streaks
