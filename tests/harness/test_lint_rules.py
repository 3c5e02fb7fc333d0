"""The linter refuses what could run code from data: pickle, eval, exec, yaml.load (the project's own settings)."""

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


@pytest.mark.parametrize("rule", FORBIDDEN)
@pytest.mark.parametrize("place", ["ground/x.py", "tests/x.py"])
def test_code_from_data_is_refused(rule: str, place: str) -> None:
    arguments = ["check", "--no-cache", "--output-format", "concise", "--stdin-filename", str(ROOT / place), "-"]
    found = subprocess.run(
        [sys.executable, "-m", "ruff", *arguments], cwd=ROOT, input=FORBIDDEN[rule], capture_output=True, text=True, check=False
    )
    assert f": {rule} " in found.stdout


def test_nothing_loads_pickled_arrays() -> None:
    sources = [path for folder in ("sboc_e2e", "simulator", "onboard", "ground") for path in (ROOT / folder).rglob("*.py")]
    assert len(sources) > 200
    assert [path for path in sources if "allow_pickle=True" in path.read_text(encoding="utf-8")] == []
