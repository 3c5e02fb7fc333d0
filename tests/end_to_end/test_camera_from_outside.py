"""Astrometry with another model of the camera, from a package that is no part of the project, runs end to end."""

import json
from pathlib import Path

import pytest
from astropy.table import Table

from sboc_e2e.checks import examine
from sboc_e2e.registry import Registry
from tests.end_to_end.conftest import command

LAB = Path(__file__).parents[1] / "plugin_example"
BENT = "instrument.distortion.sip_a=[{col_power=2,row_power=0,coefficient=1e-5}]"
"""Moves pixels at the left and right edges by 0.65 px, which no Brown-Conrady camera follows."""

TOLERANCE_ARCSEC = 2.0
"""0.05 px of `smoke`; cubic polynomials of one frame's 240 stars."""


@pytest.mark.slow
def test_a_tan_sip_camera_gives_directions_and_tracklets(tmp_path: Path) -> None:
    out = tmp_path / "run"
    chosen = ("--set", 'ground.astrometry.use="tan_sip"', "--set", BENT)
    done = command("run", "smoke", "--out", str(out), "--workers", "1", *chosen, PYTHONPATH=str(LAB))
    assert done.returncode == 0, done.stderr
    score = json.loads((out / "score.json").read_text())
    assert score["astrometry"]["frame_rms_arcsec"]["n"] == 6
    assert score["astrometry"]["frame_rms_arcsec"]["value"] < TOLERANCE_ARCSEC
    # All five objects that the shipped camera links in `smoke`; a sixth is found in two frames only when the field is bent.
    linking = score["linking"]
    assert round(linking["completeness"]["value"] * linking["completeness"]["n"]) >= 5
    assert linking["purity"]["value"] == 1.0
    assert len(Table.read(out / "products" / "tracklets.ecsv", format="ascii.ecsv")) >= 5
    frames = Table.read(out / "products" / "frames.ecsv", format="ascii.ecsv")
    assert {"crpix_row", "cd1_1", "a_2_0"} <= set(frames.colnames)
    assert not {"focal_px", "k1"} & set(frames.colnames)
    assert frames["a_2_0"][0] == pytest.approx(1e-5, rel=0.2)


def test_the_exam_passes_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(LAB))
    seam, verdicts = examine("sboc_example_lab.tan_sip:SipAstrometry", Registry())
    assert seam.name == "ground.astrometry"
    assert [f"{v.question}: {v.detail}" for v in verdicts if not v.passed] == []


def test_the_exam_finds_a_camera_whose_methods_disagree(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "bent_lab.py").write_text(
        "from dataclasses import dataclass, replace\n"
        "from ground.astrometry.astrometer import CameraFit\n"
        "from ground.astrometry.camera import Camera\n"
        "@dataclass(frozen=True, kw_only=True)\n"
        "class Bent(Camera):\n"
        "    def project(self, vectors):\n"
        "        row, col = super().project(vectors)\n"
        "        return row + 0.01, col\n"
        "@dataclass(frozen=True, kw_only=True)\n"
        "class BentFit(CameraFit):\n"
        "    def solve(self, state, frame):\n"
        "        state, solution = super().solve(state, frame)\n"
        "        return state, replace(solution, camera=Bent(**vars(solution.camera)))\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    _, verdicts = examine("bent_lab:BentFit", Registry())
    failed = [v for v in verdicts if not v.passed]
    assert [v.question for v in failed] == ["pixel to direction to pixel comes back"]
    assert "off by 0.01 px" in failed[0].detail
