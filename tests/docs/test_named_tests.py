"""Tests that documents and docstrings name exist."""

import ast
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
NAMED = re.compile(r"\btest_\w+(?:\.\.\.|\.py\b)?")
"""A test, a file of tests, or with dots the beginning of a test's name."""
FEWEST_NAMED = 20
"""The documents name more: fewer show that they are not found."""


def texts() -> dict[str, str]:
    """Documents by their place, and the docstrings of each module as one text."""
    found = {
        str(path.relative_to(ROOT)): path.read_text(encoding="utf-8")
        for path in (*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"))
    }
    for folder in ("sboc_e2e", "simulator", "onboard", "ground", "tests"):
        for path in (ROOT / folder).rglob("*.py"):
            tree = ast.parse(path.read_text(encoding="utf-8"))
            found[str(path.relative_to(ROOT))] = "\n".join(
                node.value.value
                for node in ast.walk(tree)
                if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
            )
    return found


def test_every_test_that_is_named_exists() -> None:
    sources = list((ROOT / "tests").rglob("test_*.py"))
    files = {path.name for path in sources}
    tests = {
        name for path in sources for name in re.findall(r"^ *def (test_\w+)", path.read_text(encoding="utf-8"), re.MULTILINE)
    }
    named = {(place, name) for place, text in texts().items() for name in NAMED.findall(text)}
    assert len(named) >= FEWEST_NAMED

    def exists(name: str) -> bool:
        if name.endswith("..."):
            return any(test.startswith(name.removesuffix("...")) for test in tests)
        return name in tests or name in files or f"{name}.py" in files

    assert sorted((place, name) for place, name in named if not exists(name)) == []
