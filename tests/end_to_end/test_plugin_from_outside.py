"""A small package that is no part of the project, as it lies in somebody's environment, swaps the detector."""

import hashlib
import json
from pathlib import Path

import pytest

from sboc_e2e.checks import examine
from sboc_e2e.registry import SEAMS, Registry
from tests.end_to_end.conftest import command, tiny

LAB = Path(__file__).parents[1] / "plugin_example"


@pytest.mark.slow
def test_an_installed_package_swaps_the_detector_by_name(tmp_path: Path) -> None:
    scenario_file = tiny(tmp_path, '\n[onboard.detector]\nuse = "brightest_pixel"\nn_sigma = 6.0\n')
    without = command("run", str(scenario_file), "--out", str(tmp_path / "run"))
    assert without.returncode == 2
    assert 'no step is called "brightest_pixel"' in without.stderr
    done = command("run", str(scenario_file), "--out", str(tmp_path / "run"), "--workers", "1", PYTHONPATH=str(LAB))
    assert done.returncode == 0, done.stderr
    components = json.loads((tmp_path / "run" / "manifest.json").read_text())["components"]
    step = components["onboard.detector"]
    assert (step["use"], step["class"]) == ("brightest_pixel", "sboc_example_lab:BrightestPixel")
    assert step["distribution"] == "sboc-example-lab 1.0"
    assert step["file_sha256"] == hashlib.sha256((LAB / "sboc_example_lab" / "__init__.py").read_bytes()).hexdigest()


@pytest.mark.slow
def test_the_exam_passes_it_and_says_what_is_wrong_with_a_bad_one(tmp_path: Path) -> None:
    good = command("check", "sboc_example_lab:LongPatches", PYTHONPATH=str(LAB))
    assert good.returncode == 0, good.stdout + good.stderr
    assert "as onboard.detector" in good.stdout
    assert "FAIL" not in good.stdout
    assert "completeness 0." in good.stdout
    useless = command("check", "sboc_example_lab:BrightestPixel", PYTHONPATH=str(LAB))
    assert useless.returncode == 1
    assert "found none of 48 trails" in useless.stdout
    (tmp_path / "bad_lab.py").write_text(
        "from dataclasses import dataclass\n"
        "from sboc_e2e.icd.signals import Detection\n"
        "import numpy as np\n"
        "@dataclass(frozen=True, kw_only=True)\n"
        "class Bad:\n"
        "    history_frames: int = 0\n"
        "    def detect(self, view):\n"
        "        view.residual_adu.base[0, 0] += 1\n"
        "        return (Detection(row0=-99, col0=0, row1=1, col1=1, snr=np.random.random()),)\n"
    )
    bad = command("check", "bad_lab:Bad", PYTHONPATH=str(tmp_path))
    assert bad.returncode == 1
    for line in (
        "FAIL  leaves its input untouched: changed the arrays",
        "FAIL  gives the same twice: two calls gave different results",
        "FAIL  survives a frame: streak: end (-99.0, 0.0) lies outside the frame",
    ):
        assert line in bad.stdout


@pytest.mark.slow
def test_every_shipped_step_passes_its_own_exam() -> None:
    for seam in SEAMS:
        for name in Registry().names(seam):
            found = Registry().resolve(seam, name)
            _, verdicts = examine(f"{found.__module__}:{found.__qualname__}", Registry(), seam)
            failed = [f"{v.question}: {v.detail}" for v in verdicts if not v.passed]
            assert failed == [], f"{seam}: {name}"
