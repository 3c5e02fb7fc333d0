"""Every command of the user guide runs as written; the generated page of steps is current; links lead somewhere."""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from sboc_e2e.step_pages import page

ROOT = Path(__file__).resolve().parents[2]
SHELL_BLOCK = re.compile(r"^```sh\n(.*?)^```", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\(([^)#]+)")


@pytest.mark.slow
def test_user_guide_runs_as_written(tmp_path: Path) -> None:
    text = (ROOT / "docs" / "user-guide.md").read_text(encoding="utf-8")
    lines = [line for block in SHELL_BLOCK.findall(text) for line in block.strip().splitlines()]
    assert len(lines) >= 6
    for line in lines:
        program, *arguments = shlex.split(line)
        assert program == "sboc"
        command = [sys.executable, "-c", "from sboc_e2e.cli import main; main()", *arguments]
        done = subprocess.run(command, cwd=tmp_path, env=dict(os.environ), capture_output=True, text=True, check=False)
        assert done.returncode == 0, f"{line}\n{done.stderr[-2000:]}"


def test_page_of_steps_is_current() -> None:
    assert (ROOT / "docs" / "steps.md").read_text(encoding="utf-8") == page()


@pytest.mark.parametrize("document", ["README.md", *(str(p.relative_to(ROOT)) for p in sorted((ROOT / "docs").rglob("*.md")))])
def test_links_lead_somewhere(document: str) -> None:
    path = ROOT / document
    for target in LINK.findall(path.read_text(encoding="utf-8")):
        if not target.startswith(("http", "file=")):
            assert (path.parent / target).exists(), f"{document}: {target}"
