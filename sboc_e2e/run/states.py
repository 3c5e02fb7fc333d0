"""Checkpoints of a chain's state: often enough that little is lost, seldom enough that they cost little."""

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from sboc_e2e.files import checkpoint
from sboc_e2e.run.directory import RunDirectory

WORK_PER_COST: Final = 10.0
"""A state is written once the work since the last one took this many times longer than writing takes."""


@dataclass(kw_only=True)
class StateKeeper:
    """Keeps the newest state of a sequential stage on disk."""

    run: RunDirectory
    stage: str
    shared: Mapping[str, Any] = field(default_factory=dict)
    """Large objects that are not the state's own, by name."""
    resumed: bool = True
    """Whether anything can go on from a state; if not, none is kept."""
    _cost_s: float = 0.0
    _since: float = field(default_factory=time.perf_counter)

    def last(self) -> tuple[int, Any] | None:
        """Number of the frame after which a state was kept, and that state."""
        numbers = self.run.numbers(self.stage, "state") if self.resumed else []
        if not numbers:
            return None
        return numbers[-1], checkpoint.load(self.run.work_file(self.stage, numbers[-1], "state"), self.shared)

    def offer(self, frame: int, state: Any) -> None:
        """Keep the state after this frame if enough was done since the last one; older states go."""
        start = time.perf_counter()
        if not self.resumed or start - self._since < WORK_PER_COST * self._cost_s:
            return
        older = self.run.numbers(self.stage, "state")
        checkpoint.save(self.run.work_file(self.stage, frame, "state"), state, self.shared)
        for number in older:
            if number != frame:
                self.run.work_file(self.stage, number, "state").unlink(missing_ok=True)
        self._since = time.perf_counter()
        self._cost_s = self._since - start
