"""Progress of a long stage: its name, the number of steps done, and the total."""

from typing import Protocol


class Progress(Protocol):
    """Receives progress; the command line shows a bar or plain lines."""

    def stage(self, name: str, total: int, done: int = 0) -> None:
        """A stage begins, with `done` of `total` steps done in an earlier attempt."""
        ...

    def advance(self) -> None:
        """One step is done."""
        ...

    def note(self, text: str) -> None:
        """A line for the reader."""
        ...


class Silent:
    """Shows nothing."""

    def stage(self, name: str, total: int, done: int = 0) -> None:
        """A stage begins."""

    def advance(self) -> None:
        """One step is done."""

    def note(self, text: str) -> None:
        """A line for the reader."""
