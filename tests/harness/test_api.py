"""The Python functions work as written: no guard, kernels kept where the command line keeps them, results as tables."""

import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from astropy import units as u

from sboc_e2e import api
from sboc_e2e.icd.errors import UserError
from sboc_e2e.scenario import toml_files

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


@pytest.mark.parametrize("content", [b'{"detection": ', b"[1]", b"\xff\xfe"])
def test_a_damaged_score_is_one_line(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "score.json").write_bytes(content)
    (tmp_path / "manifest.json").write_text("{}")
    with pytest.raises(UserError, match=r"score\.json: damaged: .*; make it again: sboc score"):
        api.open_run(tmp_path)


@pytest.mark.parametrize(
    ("given", "stored"),
    [
        (np.int64(3), 3),
        (np.float32(0.5), 0.5),
        (np.bool_(True), True),
        (np.arange(2), [0, 1]),
        (Path("a") / "b", "a/b"),
        ('caf\u00e9 \U0001f600 \x7f "3"', 'caf\u00e9 \U0001f600 \x7f "3"'),
        ([{"file name": np.int16(1), "b": []}], [{"file name": 1, "b": []}]),
        (math.inf, math.inf),
        ((1, "x = 1"), [1, "x = 1"]),
    ],
)
def test_values_of_python_arrive_as_they_are(given: object, stored: object) -> None:
    for changed in ({"table.key": given}, {"table": {"key": given}}):
        (text,) = api._overrides(changed)
        assert toml_files.with_override({"table": {"other": 1}}, text) == {"table": {"other": 1, "key": stored}}


@pytest.mark.parametrize(
    ("given", "words"), [(None, "leave a key out"), ([1, None], "NoneType"), (b"x", "bytes"), (3 * u.s, "3")]
)
def test_values_that_no_scenario_has_are_refused(given: object, words: str) -> None:
    with pytest.raises(UserError, match=rf"^set: table\.key: expected a number, text.*{words}"):
        api.run("smoke", set={"table": {"key": given}})


def test_figures_by_name() -> None:
    score = {"linking": {"purity": {"value": 0.5, "n": 4, "low": 0.2, "high": 0.8}}}
    result = api.RunResult(folder=Path("nowhere"), score=score, manifest={"stages": {}})
    assert result.value("linking.purity") == 0.5
    with pytest.raises(UserError, match="is a section of the score"):
        result.figure("linking")
    with pytest.raises(UserError, match="there is no table"):
        _ = result.streaks
