"""Notebooks of docs/notebooks run from top to bottom, as Jupyter would run them."""

import json
from pathlib import Path

import pytest

from tests.docs.documents import ROOT

NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_and_carries_no_outputs(path: Path) -> None:
    """Code cells in order in one namespace; no kernel is needed for that. Outputs are made anew, and so they are not kept."""
    cells = [cell for cell in json.loads(path.read_text())["cells"] if cell["cell_type"] == "code"]
    assert cells
    names: dict[str, object] = {"__name__": "notebook"}
    for number, cell in enumerate(cells):
        assert cell["outputs"] == []
        exec(compile("".join(cell["source"]), f"{path.name}, code cell {number + 1}", "exec"), names)  # noqa: S102 - our own
