"""Work of one frame on board, counted in operations: what each kind may take, what it took, what was left undone.

An operation is one value read and combined as a loop without vector instructions does it. Counts follow from pixels alone, never
from a clock, so that the same frame gives the same bytes on any machine.
"""

from dataclasses import dataclass, field
from enum import Enum
from typing import Final


class Work(Enum):
    """Kinds of work that grow with what a frame shows, in the order in which they are done."""

    STARS = "star list: entries, and their fits"
    HALOS = "light around bright stars: measured and taken out"
    CANDIDATES = "candidates of trails: searched and refined"
    POINTS = "star-like entries that are new in this frame: fitted"
    TRAILS = "trails: held against their surroundings and the frame before"
    REGIONS = "regions of interest: measured, cut and coded"


UNLIMITED: Final = 1 << 62
"""More operations than any frame takes."""


@dataclass(kw_only=True)
class WorkMeter:
    """Operations of one frame, by kind. Made anew for each frame; steps spend from it and note what they leave.

    limits : most operations of a kind. done : operations spent. shed : items left undone.
    """

    limits: dict[Work, int] = field(default_factory=lambda: dict.fromkeys(Work, UNLIMITED))
    regular: int = 0
    done: dict[Work, int] = field(default_factory=lambda: dict.fromkeys(Work, 0))
    shed: dict[Work, int] = field(default_factory=lambda: dict.fromkeys(Work, 0))

    def left(self, kind: Work) -> int:
        """Operations that may still be spent on a kind, never negative."""
        return max(0, self.limits[kind] - self.done[kind])

    def room(self, kind: Work, each: float, share: float = 1.0) -> int:
        """How many items of `each` operations fit into `share` of what is left."""
        return int(share * self.left(kind) / max(each, 1.0))

    def spend(self, kind: Work, operations: float) -> None:
        """Note operations that were done."""
        self.done[kind] += int(operations)

    def leave(self, kind: Work, items: int) -> None:
        """Note items that were left undone."""
        self.shed[kind] += int(items)

    @property
    def operations(self) -> int:
        """All operations of the frame, those of its regular passes included."""
        return self.regular + sum(self.done.values())

    @property
    def has_shed(self) -> bool:
        """Whether anything was left undone."""
        return any(self.shed.values())
