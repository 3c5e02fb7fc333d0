"""Progress on standard error: a bar on a terminal, plain lines elsewhere."""

import sys
import time
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from rich.progress import TaskID

SECONDS_BETWEEN_LINES: Final = 10.0
"""Lines of a log: a run of an hour writes 360. Chosen for readers; nothing else depends on it."""


class PlainProgress:
    """A line when a stage begins, one in ten seconds, and one when it ends."""

    def __init__(self) -> None:
        self._name, self._total, self._done = "", 0, 0
        self._start = self._last = time.monotonic()

    def stage(self, name: str, total: int, done: int = 0) -> None:
        """A stage begins."""
        self._name, self._total, self._done = name, total, done
        self._start = self._last = time.monotonic()
        self.note(f"{name}: {total} to do" + (f", {done} done before" if done else ""))

    def advance(self) -> None:
        """One step is done."""
        self._done += 1
        now = time.monotonic()
        if self._done >= self._total:
            self.note(f"{self._name}: done in {now - self._start:.1f} s")
        elif now - self._last >= SECONDS_BETWEEN_LINES:
            self._last = now
            self.note(f"{self._name}: {self._done} of {self._total}")

    def note(self, text: str) -> None:
        """A line for the reader."""
        if sys.stderr is not None:  # None: the caller has closed it
            sys.stderr.write(text + "\n")
            sys.stderr.flush()

    def close(self) -> None:
        """Nothing to tidy."""


class BarProgress:
    """A bar for each stage."""

    def __init__(self) -> None:
        # takes 40 ms, which commands without a bar do not need
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
        from rich.progress import Progress as Bar

        self._bar = Bar(
            TextColumn("{task.description:>20}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
            console=Console(stderr=True),
        )
        self._task: TaskID | None = None
        self._bar.start()

    def stage(self, name: str, total: int, done: int = 0) -> None:
        """A stage begins."""
        self._task = self._bar.add_task(name, total=total, completed=done)

    def advance(self) -> None:
        """One step is done."""
        if self._task is not None:
            self._bar.advance(self._task)

    def note(self, text: str) -> None:
        """A line for the reader."""
        self._bar.console.print(text, highlight=False)

    def close(self) -> None:
        """Leave the terminal as it was."""
        self._bar.stop()


def make_progress() -> PlainProgress | BarProgress:
    """A bar on a terminal, plain lines elsewhere."""
    return BarProgress() if sys.stderr is not None and sys.stderr.isatty() else PlainProgress()
