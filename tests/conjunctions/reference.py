"""NASA CARA's messages and probabilities and Alfano's cases of 2009, from ../shared (see its README for sources)."""

import xml.etree.ElementTree as ElementTree
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ground.conjunctions.encounter import StateEstimate

ORBITS = Path(__file__).resolve().parents[3] / "shared" / "data" / "orbits"
_NS = {"s": "http://schemas.openxmlformats.org/spreadsheetml/2006/main"}

ALFANO_HARD_BODY_M = {1: 15, 2: 4, 3: 15, 4: 15, 5: 10, 6: 10, 7: 10, 8: 4, 9: 6, 10: 6, 11: 4, 12: 4}
"""Combined radii: Alfano 2009 (AAS 09-233), table 1."""


def folder(name: str) -> Path:
    """A folder of the reference data; the test is skipped without it."""
    found = next((p / name for p in _places() if (p / name).is_dir()), None)
    if found is None:
        pytest.skip(f"reference data ../shared/data/orbits/{name} is not here")
    return found


def _places() -> list[Path]:
    """The data beside the project, or beside a folder of worktrees."""
    return [ORBITS, ORBITS.parents[3] / "shared" / "data" / "orbits"]


def sheet(path: Path) -> list[dict[str, Any]]:
    """Rows of the first sheet of an .xlsx file, by the names in its first row."""
    with zipfile.ZipFile(path) as archive:
        shared = [
            "".join(t.text or "" for t in item.iterfind(".//s:t", _NS))
            for item in ElementTree.fromstring(archive.read("xl/sharedStrings.xml"))  # noqa: S314 - a file of ours
        ]
        root = ElementTree.fromstring(archive.read("xl/worksheets/sheet1.xml"))  # noqa: S314 - a file of ours
    rows = []
    for row in root.iterfind(".//s:row", _NS):
        values: dict[str, Any] = {}
        for cell in row.iterfind("s:c", _NS):
            column = "".join(c for c in cell.get("r", "") if c.isalpha())
            text = cell.find("s:v", _NS)
            if text is not None and text.text is not None:
                values[column] = shared[int(text.text)] if cell.get("t") == "s" else float(text.text)
        rows.append(values)
    names = rows[0]
    return [{names[column]: value for column, value in row.items() if column in names} for row in rows[1:]]


@dataclass(frozen=True)
class AlfanoCase:
    """States and covariances of a case, and what Alfano found."""

    number: int
    first: StateEstimate
    second: StateEstimate
    hard_body_km: float
    half_window_s: float
    monte_carlo: float
    linear: float


def alfano_cases(when: str = "TCA") -> list[AlfanoCase]:
    """All twelve cases at "TCA" or "Epoch_Time"."""
    xlrd = pytest.importorskip("xlrd", reason="xlrd reads Alfano's tables")
    root = folder("alfano2009")
    cases = []
    for row in sheet(root / "Alfano_2009_Supplementary_Data.xlsx"):
        number = int(row["CaseNumber"])
        page = xlrd.open_workbook(str(root / f"Case{number}_data_at_{when}.xls")).sheets()[0]
        lines = [[value for value in page.row_values(k) if value != ""] for k in range(page.nrows)]
        objects = []
        for who in ("Primary", "Secondary"):
            start = next(k for k, line in enumerate(lines) if line and str(line[0]).startswith(f"{who} Object ECI position"))
            numbers = [line for line in lines[start:] if line and isinstance(line[0], float)]
            objects.append(
                StateEstimate(
                    name=f"case {number}, {who}",
                    state=np.concatenate(numbers[:2]) / 1e3,
                    covariance=np.array(numbers[2:8]) / 1e6,
                )
            )
        cases.append(
            AlfanoCase(
                number, objects[0], objects[1], 1e-3 * ALFANO_HARD_BODY_M[number],
                row["FinalTime_s"], row["PcMC1e8"], row["PcLinearAlfano100"],
            )
        )  # fmt: skip
    return cases
