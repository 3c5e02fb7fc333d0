"""The linter refuses what could run code from data (pickle, eval, exec, yaml.load) and parameters without effect: the project's
own settings."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

FORBIDDEN = {
    "S301": "import pickle\n\npickle.loads(b'')\n",
    "S307": "eval('1')\n",
    "S102": "exec('1')\n",
    "S506": "import yaml\n\nyaml.load('')\n",
}


def linted(place: str, source: str) -> str:
    """What the linter says of a source at a place of the project."""
    arguments = ["check", "--no-cache", "--output-format", "concise", "--stdin-filename", str(ROOT / place), "-"]
    command = [sys.executable, "-m", "ruff", *arguments]
    return subprocess.run(command, cwd=ROOT, input=source, capture_output=True, text=True, check=False).stdout


@pytest.mark.parametrize("rule", FORBIDDEN)
@pytest.mark.parametrize("place", ["ground/x.py", "tests/x.py"])
def test_code_from_data_is_refused(rule: str, place: str) -> None:
    assert f": {rule} " in linted(place, FORBIDDEN[rule])


@pytest.mark.parametrize("place", [f"{folder}/x.py" for folder in ("ground", "onboard", "simulator", "sboc_e2e")])
def test_parameters_without_effect_are_refused(place: str) -> None:
    """Of functions: methods may have parameters of their Protocol that they do not need."""
    assert ": ARG001 " in linted(place, "def half(value: float, limit: float) -> float:\n    return 0.5 * value\n")


def test_nothing_loads_pickled_arrays() -> None:
    sources = [path for folder in ("sboc_e2e", "simulator", "onboard", "ground") for path in (ROOT / folder).rglob("*.py")]
    assert len(sources) > 200
    assert [path for path in sources if "allow_pickle=True" in path.read_text(encoding="utf-8")] == []
