"""No six lines of code stand twice: what is the same has one home."""

import re
import subprocess
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
LINES = 6


def lines_that_count(text: str) -> list[tuple[int, str]]:
    """Numbers and text of lines, without white space; blank ones, comments, imports and lone punctuation are left out."""
    found = ((number, " ".join(line.split())) for number, line in enumerate(text.splitlines(), 1))
    return [(n, line) for n, line in found if re.search(r"\w", line) and not re.match(r"#|(import|from) ", line)]


def repeated(texts: dict[str, str]) -> Iterator[str]:
    """Where runs of lines of some files stand again."""
    places: dict[tuple[str, ...], tuple[str, int]] = {}
    seen: dict[str, int] = defaultdict(int)
    for name, text in texts.items():
        lines = lines_that_count(text)
        for k in range(len(lines) - LINES + 1):
            first_name, first_k = places.setdefault(tuple(line for _, line in lines[k : k + LINES]), (name, k))
            if (first_name, first_k) != (name, k) and not (first_name == name and k - first_k < LINES) and k >= seen[name]:
                seen[name] = k + LINES
                yield f"{first_name} and {name}:{lines[k][0]}"


def test_a_repeated_run_is_found() -> None:
    run = "\n".join(f"line_{k} = {k}" for k in range(LINES))
    assert list(repeated({"a": f"x = 1\n{run}", "b": f"y = 2\n\n{run}  # not the last\n"})) == []
    assert list(repeated({"a": f"x = 1\n{run}", "b": f"y = 2\n\n{run}\n"})) == ["a and b:3"]


def test_no_six_lines_stand_twice() -> None:
    if not (ROOT / ".git").exists():
        pytest.skip("needs the list of files of a git checkout")
    names = subprocess.run(["git", "ls-files", "*.py"], cwd=ROOT, check=True, capture_output=True, text=True).stdout.split()
    assert list(repeated({name: (ROOT / name).read_text(encoding="utf-8") for name in names if (ROOT / name).is_file()})) == []
