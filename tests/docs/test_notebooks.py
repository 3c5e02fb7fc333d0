"""Notebooks are stored without outputs, and every cell runs (the quick one among the fast tests)."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).resolve().parents[2] / "docs" / "notebooks"
NOTEBOOKS = sorted(path.name for path in FOLDER.glob("*.ipynb"))
QUICK = ("one_step.ipynb",)


def code_of(name: str) -> str:
    """All code cells as one script; the value of a last line is evaluated as a notebook would."""
    cells = json.loads((FOLDER / name).read_text(encoding="utf-8"))["cells"]
    return "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_stored_without_outputs_and_listed(name: str) -> None:
    document = json.loads((FOLDER / name).read_text(encoding="utf-8"))
    assert all(
        not cell["outputs"] and cell["execution_count"] is None for cell in document["cells"] if cell["cell_type"] == "code"
    )
    assert f"`{name}`" in (FOLDER / "README.md").read_text(encoding="utf-8")
    compile(code_of(name), name, "exec")


@pytest.mark.parametrize("name", [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in NOTEBOOKS])
@pytest.mark.slow
def test_every_cell_runs(name: str, tmp_path: Path) -> None:
    done = subprocess.run([sys.executable, "-c", code_of(name)], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
