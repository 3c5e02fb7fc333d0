"""The wheel holds what a run needs and installs into an empty environment (slow: builds and makes an environment)."""

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.slow
def test_the_wheel_builds_installs_and_lists_its_scenarios(tmp_path: Path) -> None:
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check"]
    subprocess.run([*pip, "wheel", "--quiet", "--no-deps", "--wheel-dir", str(tmp_path), str(ROOT)], check=True)
    (wheel,) = tmp_path.glob("*.whl")
    names = zipfile.ZipFile(wheel).namelist()
    for wanted in (
        "sboc_e2e/catalogue/data/tycho2_v11.npz",
        "scenarios/smoke.toml",
        "scenarios/presets/sboc_like.toml",
        "scenarios/campaigns/threshold_froc.toml",
        "sboc_e2e/bench/stored/baseline_quick.json",
        "simulator/chain.py",
    ):
        assert wanted in names
    assert not [name for name in names if name.startswith("tests/")]
    empty = tmp_path / "empty"
    subprocess.run([sys.executable, "-m", "venv", str(empty)], check=True)
    python = str(empty / "bin" / "python")
    subprocess.run([python, "-m", "pip", "install", "--quiet", "--no-deps", str(wheel)], check=True)
    # Dependencies come from the environment of the tests, so that the network is not needed twice.
    site = next(p for p in sys.path if p.endswith("site-packages"))
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    code = "import site, sys; sys.path.append(sys.argv.pop(1)); from sboc_e2e.cli import run; sys.exit(run(sys.argv[1:]))"
    listed = subprocess.run(
        [python, "-c", code, site, "scenarios"], cwd=tmp_path, env=environment, capture_output=True, text=True, check=True
    )
    assert "sso_antisun" in listed.stdout

    def sboc(*arguments: str) -> subprocess.CompletedProcess[str]:
        command = [python, "-c", code, site, *arguments]
        return subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)

    swept = sboc("sweep", "threshold_froc", "--set", "framse=1")
    assert swept.returncode == 2
    assert 'campaign threshold_froc: framse=1: unknown key "framse"; did you mean "frames"?' in swept.stderr
    unknown = sboc("bench", "--only", "orbit")
    assert unknown.returncode == 2
    assert "known: smoke, sso_antisun" in unknown.stderr
    where = subprocess.run(
        [python, "-c", "import sboc_e2e; print(sboc_e2e.__file__)"],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    assert str(empty) in where.stdout
