"""Processes of their own: waiting for them, and those that tests kill.

The latter are forked from one that has imported the program, and killed at a change of what is on disk. Only changes matter:
between two of them a kill leaves the same files behind. A renaming of a file (`os.replace`, by which every file of a run comes to
be), its end, some steps of SQLite's virtual machine while it writes, and a commit and its end are changes.
"""

import importlib
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
STEPS = 20
"""Instructions of SQLite's virtual machine that make a step."""


@dataclass(frozen=True, kw_only=True)
class Ended:
    """How a call ended: killed or not, and how many changes it made before."""

    killed: bool
    changes: int


def wait_for(path: Path, process: "subprocess.Popen[bytes]") -> None:
    """Until the path is there or the process has ended; two minutes at most."""
    deadline = time.monotonic() + 120.0
    while not path.exists() and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.01)


def points(changes: int, kills: int, seed: int) -> list[int]:
    """Changes to be killed at: a random one in each of so many equal parts."""
    edges = np.linspace(0.0, changes, kills + 1)
    return [1 + int(x) for x in np.random.default_rng(seed).uniform(edges[:-1], edges[1:])]


class Nursery:
    """Runs calls in forks of a process that is warm."""

    def __init__(self, process: "subprocess.Popen[str]") -> None:
        self._process = process

    def call(self, name: str, *arguments: Any, kill_at: int | None = None, fork: bool = True) -> Ended:
        """Call `module:function` with JSON-able arguments.

        kill_at : the change that it is killed at (SIGKILL, with all processes of its own), counted from 1; None: at none.
        fork=False calls it in the nursery itself, which is warm then.
        """
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        asked = {"name": name, "arguments": arguments, "kill_at": kill_at, "fork": fork}
        self._process.stdin.write(json.dumps(asked) + "\n")
        self._process.stdin.flush()
        answer = json.loads(self._process.stdout.readline())
        assert answer["code"] == 0 or answer["killed"], answer
        return Ended(killed=answer["killed"], changes=answer["changes"])


@contextmanager
def nursery() -> Iterator[Nursery]:
    """A nursery that ends with the block."""
    command = [sys.executable, "-m", "tests.processes"]
    with subprocess.Popen(command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        yield Nursery(process)
        assert process.stdin is not None
        process.stdin.close()


class _Changes:
    """Counts changes and kills at one of them."""

    def __init__(self, kill_at: int | None, told: Path) -> None:
        self.kill_at, self.n, self.told = kill_at, 0, told

    def one_more(self) -> None:
        self.n += 1
        if self.kill_at == self.n:
            self.told.write_text(str(self.n))
            os.killpg(0, signal.SIGKILL)


def _watch(changes: _Changes) -> None:
    """Hook into renamings and SQL."""
    from sqlalchemy import event
    from sqlalchemy.engine import Engine
    from sqlalchemy.pool import Pool

    rename = os.replace
    writing = False

    def replace(*arguments: Any, **named: Any) -> None:
        changes.one_more()
        rename(*arguments, **named)
        changes.one_more()

    os.replace = replace  # type: ignore[assignment]

    def step() -> None:
        if writing:
            changes.one_more()

    @event.listens_for(Pool, "connect")
    def _connected(connection: Any, _: Any) -> None:
        connection.set_progress_handler(step, STEPS)

    @event.listens_for(Engine, "before_cursor_execute")
    def _statement(_connection: Any, _cursor: Any, statement: str, *_: Any) -> None:
        nonlocal writing
        if statement.lstrip()[:6].upper() in ("INSERT", "UPDATE", "DELETE"):
            writing = True
            changes.one_more()

    @event.listens_for(Engine, "commit")
    def _commit(_: Any) -> None:
        step()

    @event.listens_for(Pool, "checkin")
    def _given_back(*_: Any) -> None:
        nonlocal writing
        step()
        writing = False


def _call(name: str, arguments: list[Any]) -> int:
    module, _, function = name.partition(":")
    return int(getattr(importlib.import_module(module), function)(*arguments) or 0)


def _child(asked: dict[str, Any], told: Path) -> None:
    """In a fork: the call, and nothing after it."""
    code = 1
    try:
        os.setsid()
        silence = os.open(os.devnull, os.O_RDWR)
        for stream in (0, 1):
            os.dup2(silence, stream)
        changes = _Changes(asked["kill_at"], told)
        _watch(changes)
        code = _call(asked["name"], asked["arguments"])
        told.write_text(str(changes.n))
    finally:
        os._exit(code)


def _main() -> None:
    import sqlalchemy.engine  # noqa: F401 - every fork hooks into it: imported here once

    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what the calls print goes to standard error
    told = Path(tempfile.mkdtemp(), "changes")
    for line in sys.stdin:
        asked = json.loads(line)
        if asked["fork"]:
            told.unlink(missing_ok=True)
            if (child := os.fork()) == 0:
                _child(asked, told)
            _, status = os.waitpid(child, 0)
            killed = os.WIFSIGNALED(status)
            code = 0 if killed else os.waitstatus_to_exitcode(status)
            answer = {"killed": killed, "code": code, "changes": int(told.read_text()) if told.exists() else 0}
        else:
            answer = {"killed": False, "code": _call(asked["name"], asked["arguments"]), "changes": 0}
        answers.write(json.dumps(answer) + "\n")
        answers.flush()
    shutil.rmtree(told.parent)


if __name__ == "__main__":
    _main()
