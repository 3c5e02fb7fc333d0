"""The tutorial, run verbatim: its files written, its commands executed in order in an empty folder."""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

TUTORIAL = Path(__file__).resolve().parents[2] / "docs" / "tutorial.md"
BLOCK = re.compile(r"^```(\w+)([^\n]*)\n(.*?)^```", re.MULTILINE | re.DOTALL)


@pytest.mark.slow
def test_tutorial_runs_as_written(tmp_path: Path) -> None:
    environment = os.environ | {"PYTHONPATH": str(tmp_path)}
    commands = 0
    for language, note, body in BLOCK.findall(TUTORIAL.read_text(encoding="utf-8")):
        if language == "python":
            target = tmp_path / note.strip().removeprefix("file=")
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_text(body)
        elif language == "sh":
            for line in body.strip().splitlines():
                program, *arguments = shlex.split(line)
                assert program == "sboc"
                code = "from sboc_e2e.cli import main; main()"
                done = subprocess.run(
                    [sys.executable, "-c", code, *arguments],
                    cwd=tmp_path,
                    env=environment,
                    capture_output=True,
                    text=True,
                    check=False,
                )
                assert done.returncode == 0, f"{line}\n{done.stderr[-2000:]}"
                commands += 1
    assert commands == 3
    assert (tmp_path / "runs/mine/report.html").is_file()
    assert (tmp_path / "runs/versus/compare.html").is_file()
