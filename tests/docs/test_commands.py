"""Every command of the documents runs as written; commands named in a sentence exist; the page of steps is current."""

import importlib.util
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import pytest
import typer

from sboc_e2e.cli.application import app
from sboc_e2e.step_pages import page
from tests.conftest import SHARED
from tests.docs.documents import DOCUMENTS, ROOT, blocks, hidden_commands, named_commands, text_of

LINK: Final = re.compile(r"\]\(([^)#]+)")
WITH_COMMANDS: Final = tuple(document for document in DOCUMENTS if any(block.commands for block in blocks(document)))

NOT_RUN: Final = {
    "make e2e SCENARIO=sso_antisun": "installs an environment; `make -n` has to print the `sboc run` that it ends with",
}
"""Commands of `sh` blocks that are not run, each with its reason; printed by `pytest -ra`."""

BORROWED_FILES: Final = {"README.md": "docs/tutorial.md"}
"""The README sketches the detector that the tutorial writes out; commands that both have in the same words run there only."""

REAL_FRAMES: Final = {
    "docs/validation.md": ("saao_ystar_one_streak.fits", "opd_control.fits", "2019-07-29T204726_Alt60_Azi135_Try1.tiff")
}
"""Frames that are not part of the project and that a reader has to have."""


def test_documents_with_commands_are_known() -> None:
    assert {"README.md", "docs/tutorial.md", "docs/user-guide.md", "docs/validation.md"} <= set(WITH_COMMANDS)
    shown = {command for document in WITH_COMMANDS for block in blocks(document) for command in block.commands}
    assert set(NOT_RUN) <= shown
    assert len(NOT_RUN) <= 2


@pytest.mark.parametrize("document", DOCUMENTS)
def test_no_command_hides_where_nothing_runs_it(document: str) -> None:
    assert hidden_commands(document) == []


@pytest.mark.slow
@pytest.mark.parametrize("document", WITH_COMMANDS)
def test_commands_run_as_written(document: str, tmp_path: Path) -> None:
    """Files written, commands executed in order in an empty folder, as a reader with the environment active would."""
    for name in REAL_FRAMES.get(document, ()):
        found = next(iter((SHARED / "data" / "real").rglob(name)), None)
        if found is None:
            pytest.skip(f"real frame not present: {name}")
        (tmp_path / name).symlink_to(found)
    (tmp_path / ".venv").symlink_to(sys.prefix)
    run_elsewhere: set[str] = set()
    if (lender := BORROWED_FILES.get(document)) is not None:
        _write_files(lender, tmp_path)
        run_elsewhere = {command for block in blocks(lender) for command in block.commands}
    _write_files(document, tmp_path)
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"} | {"PATH": path}
    for block in blocks(document):
        for command in block.commands:
            if command not in NOT_RUN and command not in run_elsewhere:
                _run(["sh", "-ec", command], tmp_path, environment)
        if block.language == "python" and block.note == "run":
            _run([sys.executable, "-c", block.text], tmp_path, environment)
    for block in blocks(document):
        for command in block.commands:
            for out in re.findall(r"--out (\S+)", "" if command in run_elsewhere else command):
                assert (tmp_path / out).is_file() or any((tmp_path / out).iterdir()), out


def _write_files(document: str, folder: Path) -> None:
    for block in blocks(document):
        if block.file:
            target = folder / block.file
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_text(block.text, encoding="utf-8")


def _run(command: list[str], folder: Path, environment: dict[str, str]) -> None:
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{command[-1]}\n{done.stderr[-2000:]}"


@pytest.mark.parametrize(("command", "reason"), tuple(NOT_RUN.items()))
def test_commands_that_are_not_run(command: str, reason: str) -> None:
    if shutil.which("make") is None:
        pytest.skip("no make installed")
    done = subprocess.run(
        [*shlex.split(command.replace("make", "make -n", 1))], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "sboc run sso_antisun --force" in done.stdout
    pytest.skip(f"not run: {command}: {reason}")


def _named() -> Iterator[tuple[str, str]]:
    for document in DOCUMENTS:
        for command in dict.fromkeys(named_commands(document)):
            yield document, command


@pytest.mark.parametrize(("document", "command"), tuple(_named()))
def test_commands_in_sentences_exist(document: str, command: str) -> None:
    """`sboc X --option`: the command and its options exist; `make verb`: make knows it; `python -m module`: it is there."""
    program, *words = shlex.split(command.replace("[", "").replace("]", "").replace("…", ""))
    if program.endswith("sboc"):
        _known_to_sboc(words)
    elif program == "make":
        done = subprocess.run(["make", "-n", *words], cwd=ROOT, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
    elif program == "python":
        assert words[0] == "-m"
        assert importlib.util.find_spec(words[1]) is not None
    else:
        assert program in ("pip", "pytest")


def _known_to_sboc(words: list[str]) -> None:
    command: Any = typer.main.get_command(app)
    while words and hasattr(command, "commands"):
        name = words.pop(0)
        assert name in command.commands or name == "--help", f"sboc knows no {name}"
        command = command.commands.get(name)
        if command is None:
            return
    known = {option for parameter in command.params for option in parameter.opts} | {"--help"}
    assert {word for word in words if word.startswith("--")} <= known


def test_page_of_steps_is_current() -> None:
    assert text_of("docs/steps.md") == page()


@pytest.mark.parametrize("document", DOCUMENTS)
def test_links_lead_somewhere(document: str) -> None:
    path = ROOT / document
    for target in LINK.findall(text_of(document)):
        if not target.startswith(("http", "file=")):
            assert (path.parent / target).exists(), f"{document}: {target}"
