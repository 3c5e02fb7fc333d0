"""Exit codes of the command line where output has no reader, and where a path is of the wrong kind."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from sboc_e2e import cli

SBOC = f'"{sys.executable}" -m sboc_e2e'


def shell(line: str, folder: Path) -> list[str]:
    """The words that a line of bash prints."""
    environment = os.environ | {"PYTHONPATH": str(Path(cli.__file__).parents[2])}
    done = subprocess.run(["bash", "-c", line], capture_output=True, check=False, text=True, cwd=folder, env=environment)
    assert "Traceback" not in done.stderr
    return done.stdout.split()


def test_a_reader_that_has_enough_is_no_failed_check(tmp_path: Path) -> None:
    assert shell(f'{SBOC} scenarios | true; echo "${{PIPESTATUS[0]}}"', tmp_path) == ["0"]
    assert list(tmp_path.iterdir()) == []


def test_a_closed_standard_error_leaves_the_exit_code(tmp_path: Path) -> None:
    """Python has no stream then."""
    assert shell(f"{SBOC} run nonsense 2>&-; echo $?", tmp_path) == ["2"]
    assert shell(f"{SBOC} run smoke --nonsense 2>&-; echo $?", tmp_path) == ["2"]
    code = "from sboc_e2e.cli.progress import make_progress; make_progress().note('one')"
    assert shell(f'"{sys.executable}" -c "{code}" 2>&-; echo $?', tmp_path) == ["0"]


def test_a_pipe_that_breaks_within_the_program_is_an_error(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Such as that to a process which has ended too early."""

    def broken(**_: object) -> None:
        raise BrokenPipeError(32, "Broken pipe")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys.modules["sboc_e2e.cli.main"], "app", broken)
    assert cli.run(["scenarios"]) == 3
    assert "Broken pipe" in capsys.readouterr().err
