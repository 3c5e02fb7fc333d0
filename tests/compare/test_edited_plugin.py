"""A comparison follows an edit of a plug-in and of what it imports (slow: runs the command line)."""

import json
from pathlib import Path

import pytest

from tests.end_to_end.conftest import command, tiny

LAB = """
from dataclasses import dataclass

from onboard.detect.threshold import ThresholdDetector
from edited_limit import n_sigma

@dataclass(frozen=True, kw_only=True)
class Limited:
    history_frames: int = 0

    def detect(self, view):
        return ThresholdDetector().detect(view) if n_sigma < 100 else ()
"""


@pytest.mark.slow
def test_a_comparison_follows_an_edit_of_what_a_plugin_imports(tmp_path: Path) -> None:
    """The first run finds nothing; after the edit of another file it must not say so again, nor simulate again."""
    path = tiny(tmp_path)
    (tmp_path / "edited_lab.py").write_text(LAB)
    out = tmp_path / "versus"

    def detected(limit: float, *more: str) -> float:
        (tmp_path / "edited_limit.py").write_text(f"n_sigma = {limit}\n")
        arguments = ["--seam", "onboard.detector", "--use", "line_integral", "--use", "edited_lab:Limited"]
        done = command("compare", str(path), *arguments, "--out", str(out), *more, PYTHONPATH=str(tmp_path))
        assert done.returncode == 0, done.stderr
        found = json.loads((out / "compare.json").read_text())["choices"]["edited_lab:Limited"]
        return float(found["false_per_frame"]["value"]) + float(found["downlink_bits_per_frame"])

    nothing = detected(1000.0)
    assert detected(1.0) > nothing
    (frames,) = (out / "frames").iterdir()
    before = (frames / "manifest.json").stat().st_mtime_ns
    assert detected(1000.0) == nothing
    assert (frames / "manifest.json").stat().st_mtime_ns >= before
    assert len(list((out / "runs").iterdir())) == 3
    detected(1000.0, "--force")
    assert len(list((out / "runs").iterdir())) == 2
